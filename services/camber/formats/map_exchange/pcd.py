"""Read and write point clouds as PCD files, version 0.7 (the Point Cloud Library's "PCD file format" page).

Written: `binary`, little-endian, the fields x y z intensity (F4) and, for a sweep, t (I4): nanoseconds against the
sweep's end, not above zero. Read: `ascii`, `binary` and `binary_compressed`, the fields in any order and of any of the
format's types; x, y and z are required, fields besides the five are ignored. Points with NaN coordinates, the padding
of organised clouds, are left out.

A sweep's file is named after the time of its end, `<time_ns>.pcd`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lzf import LzfError, lzf_decompressed
from camber.schemas.base import EARLIEST_NS, LATEST_NS, Float32, Int32
from camber.schemas.lidar import Sweep

_Array = NDArray[Any]
_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_TYPES = {f"{kind}{size}": f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)} | {
    "F4": "<f4",
    "F8": "<f8",
}
# Chosen: bounds that no real cloud reaches, so that a damaged header is refused before it fills the memory.
_MAX_HEADER_BYTES = 65_536
_MAX_POINTS = 200_000_000
_MAX_COUNT = 65_536
_USED = ("x", "y", "z", "intensity", "t")
"""The fields that are read; each has one number per point."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PointCloud:
    """Points (n, 3) [m]; `intensity` and `offset_ns` (n,), None if the file has no such field."""

    points_m: Float32
    intensity: Float32 | None = None
    offset_ns: Int32 | None = None


def pcd_bytes(cloud: PointCloud) -> bytes:
    """Return a binary file. Raises ValueError for columns of different lengths or numbers that are not finite."""
    n = len(cloud.points_m)
    columns: list[tuple[str, str, _Array]]
    columns = [(name, "<f4", cloud.points_m[:, axis]) for axis, name in enumerate("xyz")]
    if cloud.intensity is not None:
        columns.append(("intensity", "<f4", cloud.intensity))
    if cloud.offset_ns is not None:
        columns.append(("t", "<i4", cloud.offset_ns))
    rows = np.empty(n, np.dtype([(name, kind) for name, kind, _ in columns]))
    for name, _, column in columns:
        if len(column) != n or not np.isfinite(column).all():
            raise ValueError(f"{name} has {len(column)} values, expected {n} finite ones")
        rows[name] = column
    header = [
        *("# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7"),
        f"FIELDS {' '.join(name for name, _, _ in columns)}",
        f"SIZE {' '.join('4' for _ in columns)}",
        f"TYPE {' '.join(kind[1].upper() for _, kind, _ in columns)}",
        f"COUNT {' '.join('1' for _ in columns)}",
        *(f"WIDTH {n}", "HEIGHT 1", "VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {n}", "DATA binary"),
    ]
    return ("\n".join(header) + "\n").encode("ascii") + rows.tobytes()


def write_pcd(path: Path, cloud: PointCloud) -> None:
    """Write a cloud as `pcd_bytes`."""
    path.write_bytes(pcd_bytes(cloud))


def read_pcd(path: Path) -> PointCloud:
    """Read a cloud. Raises FormatError for an invalid file, OSError if it cannot be read."""
    return cloud_from_pcd(path.read_bytes(), path.name)


def write_sweep(folder: Path, sweep: Sweep) -> Path:
    """Write a sweep to `<time_ns>.pcd` in a folder and return the file's path."""
    path = folder / f"{sweep.time_ns}.pcd"
    write_pcd(path, PointCloud(points_m=sweep.points_m, intensity=sweep.intensity, offset_ns=sweep.offset_ns))
    return path


def sweep_time_ns(path: Path) -> int:
    """Return the time of a sweep's end from its file name. Raises FormatError for another name."""
    time_ns = int(path.stem) if path.stem.isascii() and path.stem.isdecimal() and len(path.stem) < 20 else -1
    if not EARLIEST_NS <= time_ns <= LATEST_NS:
        raise FormatError(path.name, "name", "the GPS time of the sweep's end in ns, then .pcd")
    return time_ns


def read_sweep(path: Path, sensor: str) -> Sweep:
    """Read a sweep. Missing intensities and time offsets are zero.

    Raises FormatError for another name, a damaged file or offsets above zero, OSError if it cannot be read.
    """
    time_ns = sweep_time_ns(path)
    cloud = read_pcd(path)
    n = len(cloud.points_m)
    intensity = np.zeros(n, np.float32) if cloud.intensity is None else cloud.intensity
    offset_ns = np.zeros(n, np.int32) if cloud.offset_ns is None else cloud.offset_ns
    if n and offset_ns.max() > 0:
        raise FormatError(path.name, "t", "nanoseconds before the sweep's end", actual=str(offset_ns.max()))
    if not np.isfinite(intensity).all():
        raise FormatError(path.name, "intensity", "finite numbers")
    return Sweep(
        time_ns=time_ns, sensor=sensor, points_m=cloud.points_m, intensity=intensity, offset_ns=offset_ns
    )


def cloud_from_pcd(data: bytes, source_name: str) -> PointCloud:
    """Parse a file's bytes. Raises FormatError."""
    header = read_header(data, source_name)
    columns = _READERS[header.data](data, header, source_name)
    with np.errstate(over="ignore"):
        floats = {name: columns[name].astype(np.float32) for name in _USED[:4] if name in columns}
    points, intensity = np.column_stack([floats[axis] for axis in "xyz"]), floats.get("intensity")
    offset = _integers(columns["t"], source_name) if "t" in columns else None
    if np.isfinite(points).all():
        return PointCloud(points_m=points, intensity=intensity, offset_ns=offset)
    if np.isinf(points).any():
        raise FormatError(source_name, "x y z", "finite numbers, or NaN for a point that was not measured")
    kept = ~np.isnan(points).any(axis=1)
    return PointCloud(
        points_m=np.ascontiguousarray(points[kept]),
        intensity=None if intensity is None else intensity[kept],
        offset_ns=None if offset is None else offset[kept],
    )


def _integers(values: _Array, source_name: str) -> Int32:
    if values.dtype.kind == "f":
        raise FormatError(source_name, "t", "a type of integers, I or U")
    limits = np.iinfo(np.int32)
    if len(values) and not (values.min() >= limits.min and values.max() <= limits.max):
        raise FormatError(source_name, "t", "values within 32 bits", actual=str(values.max()))
    return values.astype(np.int32)


def _binary_columns(data: bytes, header: PcdHeader, source_name: str) -> dict[str, _Array]:
    row = header.row()
    _check_length(len(data) - header.begin, row.itemsize * header.points, header, source_name)
    rows = np.frombuffer(data, row, header.points, header.begin)
    return {name: rows[f"{k}"][:, 0] for k, name in enumerate(header.names) if name in _USED}


def _compressed_columns(data: bytes, header: PcdHeader, source_name: str) -> dict[str, _Array]:
    """Parse two lengths (U4: compressed, uncompressed), then LZF data with field after field."""
    if len(data) - header.begin < 8:
        raise FormatError(source_name, "data", "eight bytes of lengths", byte_offset=header.begin)
    packed, plain = (int(n) for n in np.frombuffer(data, "<u4", 2, header.begin))
    _check_length(len(data) - header.begin - 8, packed, header, source_name)
    if plain != header.row().itemsize * header.points:
        expected = f"{header.row().itemsize * header.points} bytes, as the header says"
        raise FormatError(source_name, "data", expected, actual=str(plain), byte_offset=header.begin + 4)
    try:
        plain_data = lzf_decompressed(data[header.begin + 8 :], plain)
    except LzfError as error:
        raise FormatError(source_name, "data", str(error), byte_offset=header.begin + 8) from None
    columns, at = dict[str, _Array](), 0
    for name, kind, count in zip(header.names, header.kinds, header.counts, strict=True):
        if name in _USED:
            columns[name] = np.frombuffer(plain_data, kind, header.points, at)
        at += np.dtype(kind).itemsize * count * header.points
    return columns


def _check_length(have: int, want: int, header: PcdHeader, source_name: str) -> None:
    if have != want:
        expected = f"{want} bytes of it, as the header says"
        raise FormatError(source_name, "data", expected, actual=f"{have} bytes", byte_offset=header.begin)


def _ascii_columns(data: bytes, header: PcdHeader, source_name: str) -> dict[str, _Array]:
    lines = data[header.begin :].decode("latin-1").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if len(lines) != header.points:
        expected, actual = f"{header.points} lines, as POINTS says", f"{len(lines)} lines"
        raise FormatError(source_name, "data", expected, actual=actual, line_number=header.lines + 1)
    rows, width = [line.split() for line in lines], sum(header.counts)
    for number, row in enumerate(rows):
        if len(row) != width:
            expected, at = f"{width} numbers, one per field", header.lines + 1 + number
            raise FormatError(source_name, "data", expected, actual=lines[number], line_number=at)
    starts = accumulate(header.counts, initial=0)
    return {
        name: _parsed(name, kind, [row[start] for row in rows], header=header, source_name=source_name)
        for name, kind, start in zip(header.names, header.kinds, starts, strict=False)
        if name in _USED
    }


def _parsed(name: str, kind: str, texts: list[str], header: PcdHeader, source_name: str) -> _Array:
    """Parse one field of every line, number by number, so that an error names its line."""
    dtype = np.dtype(kind)
    is_float = dtype.kind == "f"
    limits = None if is_float else np.iinfo(dtype)
    values: list[float] = []
    for number, text in enumerate(texts, start=header.lines + 1):
        try:
            value = float(text) if is_float else int(text) if len(text) < 25 else math.inf
            if "_" in text or (limits is not None and not limits.min <= value <= limits.max):
                raise ValueError  # an underscore is Python's notation, not the format's
        except ValueError:
            expected = "a number" if is_float else f"an integer of {dtype.itemsize} bytes"
            raise FormatError(source_name, name, expected, actual=text, line_number=number) from None
        values.append(value)
    with np.errstate(over="ignore"):
        return np.array(values, dtype)


_READERS = {"ascii": _ascii_columns, "binary": _binary_columns, "binary_compressed": _compressed_columns}


@dataclass(frozen=True, slots=True, kw_only=True)
class PcdHeader:
    """`kinds` are numpy's codes, `counts` the numbers per point of each field; the data begin at byte `begin`, after
    `lines` lines."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    counts: tuple[int, ...]
    points: int
    data: str
    begin: int
    lines: int

    def row(self) -> np.dtype[Any]:
        """Return the layout of one point in a binary file."""
        fields = enumerate(zip(self.kinds, self.counts, strict=True))
        return np.dtype([(f"{k}", kind, (count,)) for k, (kind, count) in fields])


def read_header(data: bytes, source_name: str) -> PcdHeader:
    """Parse the ten entries, each once, in the format's order; ignores comments and empty lines.

    Raises FormatError for the first invalid entry.
    """
    entries: dict[str, list[str]] = {}
    begin = line_number = 0
    while "DATA" not in entries:
        line_number += 1
        end = data.find(b"\n", begin, begin + _MAX_HEADER_BYTES)
        if end < 0:
            expected = f"the header to continue with {_KEYS[len(entries)]}"
            actual = data[begin : begin + 40]
            raise FormatError(source_name, "header", expected, actual=actual, line_number=line_number)
        line, begin = data[begin:end], end + 1
        words = line.decode("latin-1").split()
        if not words or words[0].startswith("#"):
            continue
        key = _KEYS[len(entries)]
        if key == "VIEWPOINT" and words[0] == "POINTS":
            entries[key], key = [], "POINTS"  # files before 0.7 have none
        if words[0] != key:
            raise FormatError(source_name, "header", key, actual=words[0], line_number=line_number)
        entries[key] = words[1:]
        _check(entries, key, line_number, source_name)
    counts = tuple(int(word) for word in entries["COUNT"])
    kinds = tuple(_TYPES[kind + size] for kind, size in zip(entries["TYPE"], entries["SIZE"], strict=True))
    return PcdHeader(
        names=tuple(entries["FIELDS"]),
        kinds=kinds,
        counts=counts,
        points=int(entries["POINTS"][0]),
        data=entries["DATA"][0],
        begin=begin,
        lines=line_number,
    )


def _check(entries: dict[str, list[str]], key: str, line_number: int, source_name: str) -> None:
    """Raise FormatError for an entry that the format or the entries before do not allow."""
    words = entries[key]
    expected = ""
    if key == "VERSION" and words not in (["0.7"], [".7"]):
        expected = "0.7"
    elif key == "FIELDS":
        wanted = [name for name in words if name in _USED]
        if not {"x", "y", "z"} <= set(words) or len(set(wanted)) != len(wanted):
            expected = "x, y and z, each once"
    elif key in ("SIZE", "TYPE", "COUNT") and len(words) != len(entries["FIELDS"]):
        expected = f"{len(entries['FIELDS'])} entries, one per field"
    elif key == "SIZE" and not set(words) <= {"1", "2", "4", "8"}:
        expected = "1, 2, 4 or 8"
    elif key == "TYPE" and not all(
        kind + size in _TYPES for kind, size in zip(words, entries["SIZE"], strict=True)
    ):
        expected = "I, U or F of a valid size"
    elif key == "COUNT":
        if not all(_whole(word, _MAX_COUNT) for word in words) or any(
            int(word) != 1 for name, word in zip(entries["FIELDS"], words, strict=True) if name in _USED
        ):
            expected = "integers, 1 for x y z intensity t"
        elif sum(int(word) for word in words) > _MAX_COUNT:
            expected = f"no more than {_MAX_COUNT} values per point"
    elif key in ("WIDTH", "HEIGHT") and not (len(words) == 1 and _whole(words[0], _MAX_POINTS)):
        expected = "an integer"
    elif key == "VIEWPOINT" and not (len(words) == 7 and all(_is_number(word) for word in words)):
        expected = "seven numbers"
    elif key == "POINTS":
        points = int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
        if not (len(words) == 1 and _whole(words[0], _MAX_POINTS) and int(words[0]) == points):
            expected = f"WIDTH × HEIGHT, {points}"
    elif key == "DATA" and words not in (["ascii"], ["binary"], ["binary_compressed"]):
        expected = "ascii, binary or binary_compressed"
    if expected:
        raise FormatError(source_name, key, expected, actual=" ".join(words), line_number=line_number)


def _whole(word: str, most: int) -> bool:
    return word.isascii() and word.isdecimal() and len(word) < 10 and int(word) <= most


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
