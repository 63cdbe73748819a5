"""Points of LAS and LAZ files, versions 1.0 to 1.4 (ASPRS LAS Specification), read by laspy.

laspy and lazrs come with the extra `map` and are imported when a file is read.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError

Floats = NDArray[np.float64]

_MAX_POINTS = 500_000_000  # chosen: 12 GB of coordinates, more than a map build can hold
_NOISE_CLASSES = (7, 18)
"""Low and high noise (ASPRS LAS 1.4 R15, table 17)."""


@dataclass(frozen=True, slots=True, eq=False)
class LasCloud:
    """Points (n, 3) in the file's reference system; `crs_wkt` is None if the file does not state it."""

    points: Floats
    crs_wkt: str | None


def read_las(path: Path) -> LasCloud:
    """Read a file. Raises FormatError for an invalid or truncated file, OSError if it cannot be read."""
    return cloud_from_las(path.read_bytes(), path.name)


def cloud_from_las(data: bytes, source_name: str) -> LasCloud:
    """Parse a file's bytes; without points classified as noise or withheld. Raises FormatError."""
    import laspy

    expected_points = _declared_points(data, source_name)
    try:
        file = laspy.read(io.BytesIO(data))
        points = np.asarray(file.xyz, np.float64)
        dropped = np.isin(np.asarray(file.classification), _NOISE_CLASSES)
        dropped |= np.asarray(file.withheld).astype(bool)
        crs = file.header.parse_crs()
    except MemoryError:
        raise FormatError(source_name, "LAS", "a file that memory can hold") from None
    except (
        BaseException
    ) as error:  # laspy raises many types for damaged files, lazrs panics outside Exception
        if isinstance(error, (KeyboardInterrupt, SystemExit)):
            raise
        why = " ".join(str(error).split())[:120] or type(error).__name__
        raise FormatError(source_name, "LAS", f"a whole file ({why})") from None
    if len(points) != expected_points:
        expected = f"{expected_points} points, as the header says"
        raise FormatError(source_name, "LAS", expected, actual=f"{len(points)} points")
    if not np.isfinite(points).all():
        raise FormatError(source_name, "x y z", "finite numbers")
    return LasCloud(points[~dropped], None if crs is None else crs.to_wkt())


def _declared_points(data: bytes, source_name: str) -> int:
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
    if not 227 <= header_size <= begin <= len(data):
        raise FormatError(source_name, "header", "points that begin within the file", actual=str(begin))
    # Headers of records have 54 bytes, of extended ones 60; laspy would read beyond the end of the file.
    if records > len(data) // 54 or further > len(data) // 60:
        expected = "as many records as fit into the file"
        raise FormatError(source_name, "header", expected, actual=f"{records} and {further}")
    if count > _MAX_POINTS or point_size < 20:
        raise FormatError(source_name, "header", f"at most {_MAX_POINTS} points", actual=str(count))
    compressed = bool(point_format & 0x80)
    if not compressed and begin + count * point_size > len(data):
        expected = f"{count} points of {point_size} bytes, as the header says"
        raise FormatError(
            source_name, "data", expected, actual=f"{len(data) - begin} bytes", byte_offset=begin
        )
    if compressed and count > 1_000 * (len(data) - begin):  # LAZ needs some bits for each point
        raise FormatError(source_name, "data", f"{count} points", actual=f"{len(data) - begin} bytes")
    return int(count)
