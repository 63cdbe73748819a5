"""When a packet was measured, in GPS time, from its stamp by the sensor's clock and from when it arrived.

The scale of the stamps is set, never guessed. The result is compared with the time of arrival: a sensor that is not as
set is refused, with what its distance from the machine's clock looks like.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

from camber.geodesy.gps_time import (
    NS_PER_SECOND,
    UNIX_OF_GPS_EPOCH_NS,
    gps_ns_from_unix_ns,
    unix_ns_from_gps_ns,
)

TimeScale = Literal["utc_hour", "utc", "tai", "gps", "arrival"]
"""utc_hour: since the hour of UTC. utc, tai, gps: since 1970, as computers count UTC, as PTP counts TAI, as GPS time
without leap seconds. arrival: from whenever it was switched on; then the quickest packets give its offset."""

_HOUR_NS = 3600 * NS_PER_SECOND
_TAI_AHEAD_NS = 19 * NS_PER_SECOND  # of GPS time, a constant
_JUMP_NS = 50_000_000  # chosen: stamps and arrivals of two packets part by more only where a clock was set
_QUICKEST_OF_NS = 10 * NS_PER_SECOND
_LATER_NS = 5_000_000  # chosen: the quickest of two seconds are so much later only where a clock was set
_LOOKS_LIKE = {
    18: "18 s: the stamps are UTC and were set to be GPS time, or the other way round",
    19: "19 s: the stamps are TAI and were set to be GPS time, or the other way round",
    37: "37 s: the stamps are TAI (PTP) and were set to be UTC, or the other way round",
}


class SensorClock:
    """`offset_ns` is added to the stamps; further than `limit_ns` from the arrival is refused."""

    def __init__(self, scale: TimeScale, offset_ns: int, limit_ns: int) -> None:
        self._scale: TimeScale = scale
        self._offset_ns, self._limit_ns = offset_ns, limit_ns
        self._last: tuple[int, int] | None = None  # stamp as time, arrival
        self._hours_ns = 0  # of an hour's counter, since the first packet
        self._quickest = _Quickest()
        self.refusal = ""
        self.jump = ""

    def go_on(self) -> None:
        """What comes next is of another time, and no clock was set."""
        self._last = None

    def time_ns(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """GPS time of a stamp; None where it cannot be, `refusal` says why.

        `arrival_ns` is the GPS time at which what was measured at the stamp could have been here: that of the packet
        less what it took to be filled. `jump` says whether the sensor's clock was set since the packet before, or this
        machine's; else it is empty.
        """
        self.jump = ""
        stamped_ns = self._of_stamp(stamp_ns, arrival_ns)
        if stamped_ns is None:
            return None
        if self._last is not None:
            since_ns = arrival_ns - self._last[1]
            moved_ns = (stamped_ns - self._last[0]) - since_ns
            if self._scale == "arrival" and abs(abs(moved_ns) - _HOUR_NS) <= _JUMP_NS:
                # A Velodyne counts the hour: it began anew, or a packet from before that has come late.
                hour_ns = -_HOUR_NS if moved_ns > 0 else _HOUR_NS
                self._hours_ns += hour_ns
                stamped_ns += hour_ns
                moved_ns += hour_ns
            # By whole hours it can be set back without the two moving apart: the hour follows from the arrival.
            if abs(moved_ns) > _JUMP_NS or since_ns < -_JUMP_NS:
                self.jump = f"this machine's clock was set back by {-since_ns / 1e9:.3f} s"
                if abs(moved_ns) > _JUMP_NS:
                    self.jump = _moved_apart(moved_ns)
                self._quickest = _Quickest()
        self._last = (stamped_ns, arrival_ns)
        if self._scale == "arrival":
            delay_ns = self._quickest.least_ns(arrival_ns - stamped_ns, arrival_ns)
            if self._quickest.later_by_ns and not self.jump:
                self.jump = _moved_apart(-self._quickest.later_by_ns)
            return stamped_ns + delay_ns + self._offset_ns
        time_ns = stamped_ns + self._offset_ns
        if abs(time_ns - arrival_ns) > self._limit_ns:
            self.refusal = _refusal(time_ns - arrival_ns, self._scale)
            return None
        return time_ns

    def _of_stamp(self, stamp_ns: int, arrival_ns: int) -> int | None:
        if self._scale == "arrival":
            return stamp_ns + self._hours_ns
        if self._scale == "utc_hour":
            if stamp_ns >= _HOUR_NS:
                self.refusal = "stamps of an hour or more: the sensor does not count the time since the hour"
                return None
            arrival_utc_ns = unix_ns_from_gps_ns(arrival_ns)
            # The hour in which it is nearest to its arrival.
            late_ns = (arrival_utc_ns - stamp_ns + _HOUR_NS // 2) % _HOUR_NS - _HOUR_NS // 2
            return arrival_ns - late_ns
        since_ns = stamp_ns - UNIX_OF_GPS_EPOCH_NS
        if since_ns < _TAI_AHEAD_NS:
            self.refusal = "stamps before 1980: the sensor counts from when it was switched on"
            return None
        if self._scale == "tai":
            return since_ns - _TAI_AHEAD_NS
        return since_ns if self._scale == "gps" else gps_ns_from_unix_ns(stamp_ns)


class _Quickest:
    """The least delay of the last ten seconds; of the last two alone where those are all later: a clock was set."""

    def __init__(self) -> None:
        self._seconds: deque[tuple[int, int]] = deque()  # begin of each, least delay in it
        self.later_by_ns = 0

    def least_ns(self, delay_ns: int, arrival_ns: int) -> int:
        """`later_by_ns` is by how much those are later, once, when that is noticed; else zero."""
        seconds, self.later_by_ns = self._seconds, 0
        if seconds and 0 <= arrival_ns - seconds[-1][0] < NS_PER_SECOND:
            seconds[-1] = (seconds[-1][0], min(seconds[-1][1], delay_ns))
        else:
            self._forget(arrival_ns)
            seconds.append((arrival_ns, delay_ns))
        return min(least for _, least in seconds)

    def _forget(self, arrival_ns: int) -> None:
        seconds = self._seconds
        while seconds and not 0 <= arrival_ns - seconds[0][0] < _QUICKEST_OF_NS:
            seconds.popleft()
        if len(seconds) > 2:
            newest_ns = min(least for _, least in list(seconds)[-2:])
            later_ns = newest_ns - min(least for _, least in list(seconds)[:-2])
            if later_ns > _LATER_NS:
                self.later_by_ns = later_ns
                while len(seconds) > 2:
                    seconds.popleft()


def _moved_apart(moved_ns: int) -> str:
    return f"the sensor's clock and this machine's have moved apart by {moved_ns / 1e9:+.3f} s"


def _refusal(apart_ns: int, scale: TimeScale) -> str:
    apart_s = apart_ns / 1e9
    text = f"stamps read as {scale} are {apart_s:+.3f} s from this machine's clock"
    looks = _LOOKS_LIKE.get(round(abs(apart_s))) if abs(abs(apart_s) - round(abs(apart_s))) < 0.5 else None
    if looks is not None:
        return f"{text}; {looks}"
    return f"{text}: the sensor is not synchronised, counts otherwise, or this machine's clock is wrong"
