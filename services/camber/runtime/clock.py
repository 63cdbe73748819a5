"""GPS time now: from the machine's clock when live, from the feeder's ticks in a replay."""

from __future__ import annotations

import time

from camber.geodesy.gps_time import gps_minus_utc_s

GPS_EPOCH_UNIX_NS = 315_964_800 * 1_000_000_000  # 1980-01-06T00:00:00Z
_LATEST_OFFSET_NS = 18 * 1_000_000_000  # near enough to look up the leap seconds in force


class SystemClock:
    """This machine's clock as GPS time; it must be disciplined (NTP or PTP) to well below the age limits.

    A machine without a time stands in 1970: then this is below zero, and nobody takes its messages. `delay_ns`: how
    much later a service lives that receives everything that much later.
    """

    def __init__(self) -> None:
        self.delay_ns = 0

    def now_ns(self) -> int:
        """GPS time in nanoseconds."""
        utc_ns = time.time_ns() - GPS_EPOCH_UNIX_NS
        return utc_ns + gps_minus_utc_s(max(utc_ns + _LATEST_OFFSET_NS, 0)) * 1_000_000_000 - self.delay_ns


class ReplayClock:
    """Stands at the tick being worked on."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        """GPS time in nanoseconds; 0 before the first tick."""
        return self._now_ns

    def set(self, now_ns: int) -> None:
        """Move to the next tick."""
        self._now_ns = now_ns


Clock = SystemClock | ReplayClock
