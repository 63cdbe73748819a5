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
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lzf import LzfError, lzf_decompressed
from camber.formats.map_exchange.pcd_header import USED, PcdHeader, read_header
from camber.schemas.base import EARLIEST_NS, LATEST_NS, Float32, Int32
from camber.schemas.lidar import Sweep

_Array = NDArray[Any]


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
    points = np.empty((header.points, 3), np.float32)
    for axis, name in enumerate("xyz"):
        points[:, axis] = _narrowed(columns[header.names.index(name)], np.float32)
    intensity = _column(columns, header, "intensity", np.float32)
    offset = _column(columns, header, "t", np.int32, source_name=source_name)
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


def _column(
    columns: list[_Array], header: PcdHeader, name: str, dtype: type, source_name: str = ""
) -> _Array | None:
    if name not in header.names:
        return None
    values = columns[header.names.index(name)]
    if dtype is np.int32:
        if values.dtype.kind == "f":
            raise FormatError(source_name, name, "a type of integers, I or U")
        limits = np.iinfo(np.int32)
        if len(values) and not (values.min() >= limits.min and values.max() <= limits.max):
            raise FormatError(source_name, name, "values within 32 bits", actual=str(values.max()))
        return values.astype(np.int32)
    return _narrowed(values, dtype)


def _narrowed(values: _Array, dtype: type) -> _Array:
    with np.errstate(over="ignore"):
        return values.astype(dtype)


def _binary_columns(data: bytes, header: PcdHeader, source_name: str) -> list[_Array]:
    row = header.row()
    _check_length(len(data) - header.begin, row.itemsize * header.points, header, source_name)
    rows = np.frombuffer(data, row, header.points, header.begin)
    return [rows[f"{k}"][:, 0] if count else np.zeros(len(rows)) for k, count in enumerate(header.counts)]


def _compressed_columns(data: bytes, header: PcdHeader, source_name: str) -> list[_Array]:
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
    columns, at = [], 0
    for kind, count in zip(header.kinds, header.counts, strict=True):
        columns.append(np.frombuffer(plain_data, kind, header.points * count, at)[:: max(count, 1)])
        at += np.dtype(kind).itemsize * count * header.points
    return columns


def _check_length(have: int, want: int, header: PcdHeader, source_name: str) -> None:
    if have != want:
        expected = f"{want} bytes of it, as the header says"
        raise FormatError(source_name, "data", expected, actual=f"{have} bytes", byte_offset=header.begin)


def _ascii_columns(data: bytes, header: PcdHeader, source_name: str) -> list[_Array]:
    lines = data[header.begin :].decode("latin-1").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    width = sum(header.counts)
    if len(lines) != header.points:
        expected = f"{header.points} lines, as POINTS says"
        actual = f"{len(lines)} lines"
        raise FormatError(source_name, "data", expected, actual=actual, line_number=header.lines + 1)
    starts = np.append(0, np.cumsum(header.counts))[:-1].tolist()
    texts: list[list[str]] = [[] for _ in header.names]
    for number, line in enumerate(lines, start=header.lines + 1):
        words = line.split()
        if len(words) != width:
            expected = f"{width} numbers, one per field"
            raise FormatError(source_name, "data", expected, actual=line, line_number=number)
        for text, start in zip(texts, starts, strict=True):
            text.append(words[start] if start < width else "0")
    return [
        _parsed(name, kind, text, header=header, source_name=source_name) if name in USED else np.zeros(0)
        for name, kind, text in zip(header.names, header.kinds, texts, strict=True)
    ]


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
