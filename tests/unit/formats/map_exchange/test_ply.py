from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.ply import points_from_ply, read_ply

POINTS = np.array([[1.5, -2.25, 300.125], [4.0, 5.0, 6.0], [7.0, 8.0, 9.5]])


def ply(order: str, kind: str = "double", points: np.ndarray = POINTS) -> bytes:
    """With a property before the coordinates, an element before the vertices and one after."""
    head = (
        f"ply\nformat {order} 1.0\ncomment made by a test\nelement camera 2\nproperty uchar n\n"
        f"element vertex {len(points)}\nproperty uchar red\n"
        + "".join(f"property {kind} {axis}\n" for axis in "xyz")
        + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if order == "ascii":
        return head + b"1\n2\n" + "".join(f"9 {x} {y} {z}\n" for x, y, z in points).encode() + b"3 0 1 2\n"
    sign = "<" if "little" in order else ">"
    code = f"{sign}f8" if kind == "double" else f"{sign}f4"
    rows = np.zeros(len(points), np.dtype([("r", "u1"), *((axis, code) for axis in "xyz")]))
    for k, axis in enumerate("xyz"):
        rows[axis] = points[:, k]
    return head + b"\1\2" + rows.tobytes() + b"\3" + np.arange(3, dtype=f"{sign}i4").tobytes()


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("kind", ["double", "float"])
def test_other_properties_and_elements_are_ignored(tmp_path: Path, order: str, kind: str) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply(order, kind))
    assert read_ply(path).tolist() == POINTS.tolist()


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian"])
def test_a_point_that_was_not_measured_is_left_out_and_an_infinite_one_refused(order: str) -> None:
    holed = POINTS.copy()
    holed[1, 2] = np.nan
    assert points_from_ply(ply(order, points=holed), "f").tolist() == POINTS[[0, 2]].tolist()
    holed[1, 2] = np.inf
    with pytest.raises(FormatError, match="finite"):
        points_from_ply(ply(order, points=holed), "f")


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian"])
def test_a_truncated_file_is_one_clear_error(order: str) -> None:
    data = ply(order)
    whole = data.index(b"3 0 1 2") if order == "ascii" else len(data) - 10
    for length in range(whole - 3):  # not within the last number, which may be shorter
        with pytest.raises(FormatError) as refused:
            points_from_ply(data[:length], "cut.ply")
        assert str(refused.value).startswith("cut.ply")
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"ply\n", b"plx\n"),
        (b"1.0", b"2.0"),
        (b"property double z", b"property double w"),
        (b"property double z", b"property quad z"),
        (b"vertex 3", b"vertex -3"),
        (b"vertex 3", b"vertex 99999999999"),
        (b"element vertex", b"element points"),
        (b"property uchar n", b"property list uchar int n"),
        (b"9 4.0", b"9 4_0"),
        (b"9 4.0", b"9 x"),
    ],
)
def test_an_invalid_header_or_number_is_refused(old: bytes, new: bytes) -> None:
    data = ply("ascii")
    assert old in data
    with pytest.raises(FormatError):
        points_from_ply(data.replace(old, new, 1), "f")
