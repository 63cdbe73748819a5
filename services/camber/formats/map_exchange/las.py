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

_MOST_POINTS = 500_000_000
_NOISE_CLASSES = (7, 18)
"""Low and high noise, by the specification's table of classes."""


@dataclass(frozen=True, slots=True, eq=False)
class LasCloud:
    """Points (n, 3) in the file's own reference system; `crs_wkt` is that, None where the file does not say it."""

    points: Floats
    crs_wkt: str | None


def read_las(path: Path) -> LasCloud:
    """Raises FormatError for what is no such file or breaks off, OSError if it cannot be read."""
    return cloud_from_las(path.read_bytes(), path.name)


def cloud_from_las(data: bytes, source_name: str) -> LasCloud:
    """The points of a file's bytes but for those classed as noise or withheld. Raises FormatError."""
    import laspy

    expected_points = _points_said(data, source_name)
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
    ) as error:  # for damaged files laspy raises nearly anything, and lazrs' panics are no Exception
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


def _points_said(data: bytes, source_name: str) -> int:
    """The number of points by the public header block; what laspy would allocate for is checked before it does."""
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
    # A record's header has 54 bytes, an extended one's 60; laspy would go on reading beyond the end.
    if records > len(data) // 54 or further > len(data) // 60:
        found = f"{records} and {further}"
        raise FormatError(source_name, "header", "as many records as fit into the file", actual=found)
    if count > _MOST_POINTS or point_size < 20:
        raise FormatError(source_name, "header", f"at most {_MOST_POINTS} points", actual=str(count))
    compressed = bool(point_format & 0x80)
    if not compressed and begin + count * point_size > len(data):
        expected = f"{count} points of {point_size} bytes, as the header says"
        found = f"{len(data) - begin} bytes"
        raise FormatError(source_name, "data", expected, actual=found, byte_offset=begin)
    if compressed and count > 1_000 * (
        len(data) - begin
    ):  # LAZ does not pack a point into less than some bits
        raise FormatError(source_name, "data", f"{count} points", actual=f"{len(data) - begin} bytes")
    return int(count)
