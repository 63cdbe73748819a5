from __future__ import annotations

import dataclasses
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lzf import LzfError, lzf_decompressed
from camber.formats.map_exchange.pcd import (
    PointCloud,
    cloud_from_pcd,
    pcd_bytes,
    read_pcd,
    read_sweep,
    write_pcd,
    write_sweep,
)
from camber.schemas.lidar import Sweep

TIME_NS = 1_400_000_000 * 1_000_000_000
FINITE = st.floats(-1e6, 1e6, width=32)


@st.composite
def clouds(draw: st.DrawFn) -> PointCloud:
    n = draw(st.integers(0, 40))
    points = draw(arrays.arrays(np.float32, (n, 3), elements=FINITE))
    intensity = draw(st.none() | arrays.arrays(np.float32, n, elements=FINITE))
    offset = draw(st.none() | arrays.arrays(np.int32, n))
    return PointCloud(points_m=points, intensity=intensity, offset_ns=offset)


def a_cloud(n: int = 5) -> PointCloud:
    rng = np.random.default_rng(4)
    points = rng.normal(0.0, 20.0, (n, 3)).astype(np.float32)
    return PointCloud(
        points_m=points, intensity=np.arange(n, dtype=np.float32), offset_ns=np.arange(-n, 0, dtype=np.int32)
    )


def cloud_of(points: list[list[float]], intensity: list[float], offset_ns: list[int]) -> PointCloud:
    columns = {"intensity": np.array(intensity, np.float32), "offset_ns": np.array(offset_ns, np.int32)}
    return PointCloud(points_m=np.array(points, np.float32), **columns)


def same(a: PointCloud, b: PointCloud) -> bool:
    return all(
        (x is None and y is None) or (x is not None and y is not None and x.tobytes() == y.tobytes())
        for x, y in ((a.points_m, b.points_m), (a.intensity, b.intensity), (a.offset_ns, b.offset_ns))
    )


def a_header(data: str = "ascii", **changed: str) -> str:
    entries = {
        "VERSION": "0.7",
        "FIELDS": "x y z intensity t",
        "SIZE": "4 4 4 4 4",
        "TYPE": "F F F F I",
        "COUNT": "1 1 1 1 1",
        "WIDTH": "2",
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": "2",
        "DATA": data,
    } | changed
    return "".join(f"{key} {value}\n" for key, value in entries.items())


TWO_POINTS = "1 2 3 9 -5\n4 5 6 8 -4\n"


def compressed(plain: bytes) -> bytes:
    """Every byte as it is: a valid LZF stream without repetitions."""
    pieces = [plain[k : k + 32] for k in range(0, len(plain), 32)]
    return b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(clouds())
def test_clouds_survive_bit_by_bit(cloud: PointCloud) -> None:
    assert same(cloud_from_pcd(pcd_bytes(cloud), "a.pcd"), cloud)


def test_the_bytes_are_those_of_the_format() -> None:
    data = pcd_bytes(cloud_of([[1, 2, 3]], [7], [-9]))
    head, tail = data[:-20].decode(), data[-20:]
    assert struct.unpack("<ffffi", tail) == (1.0, 2.0, 3.0, 7.0, -9)
    assert head.split("\n", 1)[1] == a_header("binary", WIDTH="1", POINTS="1")


@pytest.mark.parametrize(
    ("changed", "field", "expected"),
    [
        ({"VERSION": "0.6"}, "VERSION", "0.7"),
        ({"FIELDS": "x y intensity t w"}, "FIELDS", "x, y and z"),
        ({"FIELDS": "x y z z t"}, "FIELDS", "each once"),
        ({"SIZE": "4 4 4 4"}, "SIZE", "5 entries"),
        ({"SIZE": "4 4 4 3 4"}, "SIZE", "1, 2, 4 or 8"),
        ({"TYPE": "F F F Q I"}, "TYPE", "I, U or F"),
        ({"SIZE": "2 4 4 4 4"}, "TYPE", "size"),
        ({"COUNT": "1 1 2 1 1"}, "COUNT", "1 for x"),
        ({"WIDTH": "-2"}, "WIDTH", "integer"),
        ({"VIEWPOINT": "0 0 0"}, "VIEWPOINT", "seven"),
        ({"POINTS": "3"}, "POINTS", "2"),
        ({"DATA": "zipped"}, "DATA", "binary_compressed"),
        ({"TYPE": "F F F F F"}, "t", "integers"),
    ],
)
def test_a_bad_header_is_named_in_one_line(changed: dict[str, str], field: str, expected: str) -> None:
    with pytest.raises(FormatError) as caught:
        cloud_from_pcd((a_header(**changed) + TWO_POINTS).encode(), "sweep.pcd")
    assert caught.value.field == field
    assert expected in str(caught.value)
    assert str(caught.value).startswith("sweep.pcd")


@pytest.mark.parametrize(
    ("body", "field", "line"),
    [
        ("1 2 3 9 -5\n", "data", 11),
        ("1 2 3 9 -5\n4 5 6 8\n", "data", 12),
        ("1 2 3 9 -5\n4 5 six 8 -4\n", "z", 12),
        ("1 2 3 9 -5\n4 5 6 8 -4.5\n", "t", 12),
        ("1 2 3 9 5000000000\n4 5 6 8 -4\n", "t", 11),
        ("1 2 1_0 9 -5\n4 5 6 8 -4\n", "z", 11),
    ],
)
def test_a_bad_line_of_text_is_named(body: str, field: str, line: int) -> None:
    with pytest.raises(FormatError) as caught:
        cloud_from_pcd((a_header() + body).encode(), "a.pcd")
    assert (caught.value.field, caught.value.line_number) == (field, line)


def test_the_wrong_length_of_binary_data_is_named() -> None:
    data = pcd_bytes(a_cloud())
    for wrong in (data[:-1], data + b"\0"):
        with pytest.raises(FormatError, match="expected 100 bytes"):
            cloud_from_pcd(wrong, "a.pcd")


def test_a_header_that_promises_too_much_costs_no_memory() -> None:
    huge = a_header("binary", WIDTH="200000000", POINTS="200000000").encode()
    with pytest.raises(FormatError, match="4000000000 bytes"):
        cloud_from_pcd(huge + b"1234", "a.pcd")


def test_text_and_binary_hold_the_same() -> None:
    expected = cloud_of([[1, 2, 3], [4, 5, 6]], [9, 8], [-5, -4])
    text = a_header() + TWO_POINTS
    rows = struct.pack("<ffffi", 1, 2, 3, 9, -5) + struct.pack("<ffffi", 4, 5, 6, 8, -4)
    columns = struct.pack("<8f2i", 1, 4, 2, 5, 3, 6, 9, 8, -5, -4)
    packed = compressed(columns)
    for data in (
        text.encode(),
        text.replace("\n", "\r\n").encode(),
        text.replace("COUNT", "# a comment\n\nCOUNT").encode(),
        a_header("binary").encode() + rows,
        a_header("binary_compressed").encode() + struct.pack("<II", len(packed), len(columns)) + packed,
    ):
        assert same(cloud_from_pcd(data, "a.pcd"), expected)


def test_other_fields_types_and_orders_are_read() -> None:
    header = a_header(
        "binary",
        FIELDS="rgb z y x _ intensity ring",
        SIZE="4 8 8 8 1 1 2",
        TYPE="F F F F U U U",
        COUNT="1 1 1 1 7 1 1",
    )
    row = np.dtype(
        [("rgb", "<f4"), ("z", "<f8"), ("y", "<f8"), ("x", "<f8"), ("_", "u1", 7), ("i", "u1"), ("r", "<u2")]
    )
    rows = np.zeros(2, row)
    rows["x"], rows["y"], rows["z"], rows["i"] = (1, 2), (3, 4), (5, 6), (200, 255)
    cloud = cloud_from_pcd(header.encode() + rows.tobytes(), "a.pcd")
    np.testing.assert_array_equal(cloud.points_m, [[1, 3, 5], [2, 4, 6]])
    assert cloud.intensity is not None
    np.testing.assert_array_equal(cloud.intensity, [200, 255])
    assert cloud.offset_ns is None


def test_points_that_were_not_measured_are_left_out_and_infinite_ones_refused() -> None:
    body = "nan nan nan 0 0\n4 5 6 8 -4\n"
    cloud = cloud_from_pcd((a_header() + body).encode(), "a.pcd")
    np.testing.assert_array_equal(cloud.points_m, [[4, 5, 6]])
    np.testing.assert_array_equal(cloud.offset_ns, [-4])
    for infinite in ("inf", "1e300"):
        with pytest.raises(FormatError, match="finite"):
            cloud_from_pcd((a_header() + body.replace("6", infinite)).encode(), "a.pcd")


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(st.binary(min_size=1, max_size=32) | st.tuples(st.integers(1, 8192), st.integers(3, 264))))
def test_lzf_is_taken_apart_piece_by_piece(pieces: list[bytes | tuple[int, int]]) -> None:
    stream, plain = bytearray(), bytearray()
    for piece in pieces:
        if isinstance(piece, bytes):
            stream += bytes([len(piece) - 1]) + piece
            plain += piece
        elif piece[0] <= len(plain):
            back, count = piece
            high, low = divmod(back - 1, 256)
            stream += bytes([(count - 2) << 5 | high]) if count < 9 else bytes([7 << 5 | high, count - 9])
            stream += bytes([low])
            for _ in range(count):  # byte by byte, as the format defines it
                plain.append(plain[-back])
    assert lzf_decompressed(bytes(stream), len(plain)) == bytes(plain)
    with pytest.raises(LzfError):
        lzf_decompressed(bytes(stream), len(plain) + 1)
    if stream:
        with pytest.raises(LzfError):
            lzf_decompressed(bytes(stream[:-1]), len(plain))


def test_a_sweep_survives_its_file(tmp_path: Path) -> None:
    cloud = a_cloud(1_000)
    assert cloud.intensity is not None
    assert cloud.offset_ns is not None
    sweep = Sweep(
        time_ns=TIME_NS,
        sensor="lidar64",
        points_m=cloud.points_m,
        intensity=cloud.intensity,
        offset_ns=cloud.offset_ns,
    )
    path = write_sweep(tmp_path, sweep)
    assert path.name == f"{TIME_NS}.pcd"
    assert read_sweep(path, "lidar64") == sweep
    assert same(read_pcd(path), cloud)


def test_a_sweep_file_is_named_after_its_time(tmp_path: Path) -> None:
    for name in ("sweep.pcd", "12.pcd", "٣.pcd"):
        write_pcd(tmp_path / name, a_cloud())
        with pytest.raises(FormatError, match="GPS time"):
            read_sweep(tmp_path / name, "lidar64")
    late = dataclasses.replace(a_cloud(), offset_ns=np.arange(5, dtype=np.int32))
    write_pcd(tmp_path / f"{TIME_NS}.pcd", late)
    with pytest.raises(FormatError, match="before the sweep"):
        read_sweep(tmp_path / f"{TIME_NS}.pcd", "lidar64")


def test_columns_that_do_not_fit_are_not_written() -> None:
    with pytest.raises(ValueError, match="intensity"):
        pcd_bytes(dataclasses.replace(a_cloud(), intensity=np.zeros(4, np.float32)))
    points = np.array([[np.nan, 0.0, 0.0]], np.float32)
    with pytest.raises(ValueError, match="finite"):
        pcd_bytes(PointCloud(points_m=points))
