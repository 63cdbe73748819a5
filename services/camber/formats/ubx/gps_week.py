"""GPS week of UBX messages, resolved from the receiver's week, its date, or a time known before.

A receiver's week count starts at a date in its firmware; beyond 1024 weeks (19.6 years) it is wrong by 1024 weeks.
"""

from __future__ import annotations

from camber.formats.broadcast.ephemeris_fields import gps_ns_near
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.schemas.base import EARLIEST_NS, LATEST_NS

_NS_PER_MS = 1_000_000  # unit
MS_PER_WEEK = 604_800_000
"""Range of `iTOW`."""
_ROLLOVER_NS = 1024 * NS_PER_WEEK


def resolve_week_rollover(time_ns: int, near_ns: int | None) -> int:
    """Return the time shifted by whole roll-overs to be nearest to `near_ns`, if that is known."""
    if near_ns is None:
        return time_ns
    difference_ns = (time_ns - near_ns + _ROLLOVER_NS // 2) % _ROLLOVER_NS - _ROLLOVER_NS // 2
    return near_ns + difference_ns


def checked_time_ns(time_ns: int) -> int:
    """Return the time; ValueError outside 2000 to 2080, which receivers without a fix report."""
    if not EARLIEST_NS <= time_ns <= LATEST_NS:
        raise ValueError(f"time {time_ns} ns, expected {EARLIEST_NS} to {LATEST_NS}")
    return time_ns


def navigation_time_ns(of_week_ms: int, near_ns: int, nanosecond: int | None = None) -> int:
    """Return the time of an `iTOW` in the week nearest to `near_ns`; ValueError where it exceeds the week.

    `iTOW` is rounded to ms. `nanosecond`, the fraction of NAV-PVT's UTC second, refines it: GPS time and UTC differ by
    whole seconds.
    """
    if of_week_ms >= MS_PER_WEEK:
        raise ValueError(f"iTOW {of_week_ms} ms, expected less than {MS_PER_WEEK}")
    time_ns = checked_time_ns(gps_ns_near("G", of_week_ms * _NS_PER_MS, near_ns))
    if nanosecond is None:
        return time_ns
    rest = (nanosecond - time_ns + NS_PER_SECOND // 2) % NS_PER_SECOND - NS_PER_SECOND // 2
    return time_ns + rest if abs(rest) <= _NS_PER_MS else time_ns
