"""Points of LAS and LAZ files, versions 1.0 to 1.4 (ASPRS LAS Specification), read by laspy.

laspy and lazrs come with the extra `map` and are imported when a file is read.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError

Floats = NDArray[np.float64]

_MAX_POINTS = 500_000_000  # chosen: 12 GB of coordinates, more than a map build can hold
_PIECE_POINTS = 1_000_000  # chosen: some 100 MB with all attributes
_HEADER_BYTES = 375  # source: ASPRS LAS 1.4 R15, table 3
_NOISE_CLASSES = (7, 18)
"""Low and high noise (ASPRS LAS 1.4 R15, table 17)."""


@dataclass(frozen=True, slots=True, eq=False)
class LasCloud:
    """Points (n, 3) in the file's reference system; `crs_wkt` is None if the file does not state it."""

    points: Floats
    crs_wkt: str | None


def read_las(path: Path) -> LasCloud:
    """Read a file. Raises FormatError for an invalid or truncated file, OSError if it cannot be read."""
    with path.open("rb") as file:
        return _cloud(file, path.stat().st_size, path.name)


def cloud_from_las(data: bytes, source_name: str) -> LasCloud:
    """Parse a file's bytes; without points classified as noise or withheld. Raises FormatError."""
    return _cloud(io.BytesIO(data), len(data), source_name)


def _cloud(file: BinaryIO, size_bytes: int, source_name: str) -> LasCloud:
    """Read a piece at a time: of the file no more is in memory than its coordinates and one piece."""
    import laspy

    expected_points = _declared_points(file.read(_HEADER_BYTES), size_bytes, source_name)
    file.seek(0)
    count = kept = 0
    try:
        points = np.empty((expected_points, 3))
        with laspy.open(file, closefd=False) as reader:
            for piece in reader.chunk_iterator(_PIECE_POINTS):
                dropped = np.isin(np.asarray(piece.classification), _NOISE_CLASSES)
                dropped |= np.asarray(piece.withheld).astype(bool)
                count += len(dropped)
                end = kept + int(len(dropped) - dropped.sum())
                for axis, name in enumerate("xyz"):
                    points[kept:end, axis] = np.asarray(piece[name])[~dropped]
                kept = end
            crs = reader.header.parse_crs()
    except MemoryError:
        raise FormatError(source_name, "LAS", "a file that memory can hold") from None
    except (
        BaseException
    ) as error:  # laspy raises many types for damaged files, lazrs panics outside Exception
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            raise
        why = " ".join(str(error).split())[:120] or type(error).__name__
        raise FormatError(source_name, "LAS", f"a whole file ({why})") from None
    if count != expected_points:
        expected = f"{expected_points} points, as the header says"
        raise FormatError(source_name, "LAS", expected, actual=f"{count} points")
    if not np.isfinite(points[:kept]).all():
        raise FormatError(source_name, "x y z", "finite numbers")
    return LasCloud(points[:kept], None if crs is None else crs.to_wkt())


def _declared_points(data: bytes, size_bytes: int, source_name: str) -> int:
    """Return the point count of the public header block; checks it before laspy allocates memory."""
    if data[:4] != b"LASF":
        raise FormatError(source_name, "signature", "LASF", actual=data[:4], byte_offset=0)
    if len(data) < 227:
        raise FormatError(source_name, "header", "at least 227 bytes", actual=f"{len(data)} bytes")
    minor = data[25]
    (legacy,) = struct.unpack_from("<I", data, 107)
    count, further = legacy, 0
    if minor >= 4 and len(data) >= 375:
        further, count = struct.unpack_from("<IQ", data, 243)
    header_size, begin, records = struct.unpack_from("<HII", data, 94)
    point_format, point_size = struct.unpack_from("<BH", data, 104)
    if not 227 <= header_size <= begin <= size_bytes:
        raise FormatError(source_name, "header", "points that begin within the file", actual=str(begin))
    # Headers of records have 54 bytes, of extended ones 60; laspy would read beyond the end of the file.
    if records > size_bytes // 54 or further > size_bytes // 60:
        expected = "as many records as fit into the file"
        raise FormatError(source_name, "header", expected, actual=f"{records} and {further}")
    if count > _MAX_POINTS or point_size < 20:
        raise FormatError(source_name, "header", f"at most {_MAX_POINTS} points", actual=str(count))
    compressed = bool(point_format & 0x80)
    if not compressed and begin + count * point_size > size_bytes:
        expected = f"{count} points of {point_size} bytes, as the header says"
        raise FormatError(
            source_name, "data", expected, actual=f"{size_bytes - begin} bytes", byte_offset=begin
        )
    if compressed and count > 1_000 * (size_bytes - begin):  # LAZ needs some bits for each point
        raise FormatError(source_name, "data", f"{count} points", actual=f"{size_bytes - begin} bytes")
    return int(count)
