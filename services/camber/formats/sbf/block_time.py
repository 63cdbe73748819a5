"""Time stamp of SBF blocks: `TOW` [ms] and `WNc`, GPS time with a week count that does not roll over.

Source: Septentrio mosaic-X5 reference guide, "SBF Block Time Stamp".
"""

from __future__ import annotations

import struct

from camber.formats.ubx.gps_week import MS_PER_WEEK, checked_time_ns
from camber.geodesy.gps_time import gps_ns_from_week_tow

TIME_STAMP = struct.Struct("<IH")
_NO_TIME_OF_WEEK, _NO_WEEK = 0xFFFFFFFF, 0xFFFF
_NS_PER_MS = 1_000_000  # unit


def block_time_ns(body: bytes) -> int | None:
    """Return the time of a block's body (without its header); None where the receiver does not know it.

    ValueError where the body is too short, or the time is impossible.
    """
    if len(body) < TIME_STAMP.size:
        raise ValueError(f"block of {len(body)} bytes, expected a time stamp of {TIME_STAMP.size}")
    of_week_ms, week = TIME_STAMP.unpack_from(body)
    if of_week_ms == _NO_TIME_OF_WEEK or week == _NO_WEEK:
        return None
    if of_week_ms >= MS_PER_WEEK:
        raise ValueError(f"TOW {of_week_ms} ms, expected less than {MS_PER_WEEK}")
    return checked_time_ns(gps_ns_from_week_tow(week, of_week_ms * _NS_PER_MS))
