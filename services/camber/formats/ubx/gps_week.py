"""GPS time of UBX messages: whole weeks from what a receiver says of its week, its date, or from what is known already.

A receiver counts weeks on from a date in its firmware; beyond 1024 weeks (19.6 years) after it, it is off by as many.
"""

from __future__ import annotations

from camber.formats.broadcast.ephemeris_fields import gps_ns_near
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.schemas.base import EARLIEST_NS, LATEST_NS

NS_PER_MS = 1_000_000
_MS_PER_WEEK = 604_800_000
_ROLL_OVER_NS = 1024 * NS_PER_WEEK


def resolve_week_rollover(time_ns: int, near_ns: int | None) -> int:
    """Of this time and those whole roll-overs away from it that one which is nearest to `near_ns`, if that is known."""
    if near_ns is None:
        return time_ns
    since = (time_ns - near_ns + _ROLL_OVER_NS // 2) % _ROLL_OVER_NS - _ROLL_OVER_NS // 2
    return near_ns + since


def checked_time_ns(time_ns: int) -> int:
    """A time that a message of ours may have; ValueError before 2000 or after 2080, as receivers say without a fix."""
    if not EARLIEST_NS <= time_ns <= LATEST_NS:
        raise ValueError(f"time {time_ns} ns, expected {EARLIEST_NS} to {LATEST_NS}")
    return time_ns


def navigation_time_ns(of_week_ms: int, near_ns: int, nanosecond: int | None = None) -> int:
    """Of `iTOW` in the week nearest to `near_ns`; ValueError where it is beyond the week.

    `iTOW` is rounded to ms. `nanosecond`, the fraction of NAV-PVT's UTC second, says the rest: GPS time and UTC are
    whole seconds apart.
    """
    if of_week_ms >= _MS_PER_WEEK:
        raise ValueError(f"iTOW {of_week_ms} ms, expected less than {_MS_PER_WEEK}")
    time_ns = checked_time_ns(gps_ns_near("G", of_week_ms * NS_PER_MS, near_ns))
    if nanosecond is None:
        return time_ns
    rest = (nanosecond - time_ns + NS_PER_SECOND // 2) % NS_PER_SECOND - NS_PER_SECOND // 2
    return time_ns + rest if abs(rest) <= NS_PER_MS else time_ns
