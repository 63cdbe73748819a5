"""The dead-reckoned track of the last minutes, in a frame of its own that begins at zero.

It begins anew after a gap in time: how the vehicle has turned in it is not known, so nothing measured before the gap
can be carried to the present by the track.
"""

from __future__ import annotations

import bisect
import math
from typing import NamedTuple

from camber.localizer.filter.odometry import MotionStep


class TrackPoint(NamedTuple):
    """A point of the track [m, rad]. `wheel_m`, `wheel_m_s`: distance and speed by the wheels, uncorrected.

    Roll and pitch are those of an inertial unit, zero without one: their changes count, not they themselves.
    """

    east_m: float = 0.0
    north_m: float = 0.0
    yaw_rad: float = 0.0
    path_m: float = 0.0
    wheel_m: float = 0.0
    wheel_m_s: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0


class OverlayLag(NamedTuple):
    """Mean distance, change of speed and time from overlaid sweeps to the newest: by the track, and by the wheels."""

    path_m: float = 0.0
    wheel_m: float = 0.0
    wheel_change_m_s: float = 0.0
    duration_s: float = 0.0


class RelativeTrack:
    """Keeps the track that fixes are compared with before the heading is known and that carries late measurements
    to the present."""

    def __init__(self, keep_s: float = 120.0, extrapolate_s: float = 0.3) -> None:
        self._keep_ns, self._extrapolate_ns = round(keep_s * 1e9), round(extrapolate_s * 1e9)
        self._times_ns: list[int] = []
        self._points: list[TrackPoint] = []
        self._speed_m_s = self._rate_rad_s = 0.0
        self.begin_ns: int | None = None
        """Since when the track has had no gap; None before any motion. It is kept for less long."""

    def append(
        self,
        time_ns: int,
        step: MotionStep,
        speed_m_s: float,
        rate_rad_s: float,
        *,
        tilt_rad: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Extend the track by a step at corrected speed and yaw rate, to a roll and pitch; times must increase."""
        here = self._points[-1] if self._points else TrackPoint()
        wheel_m = here.wheel_m
        if step.standing:
            speed_m_s = rate_rad_s = 0.0
        else:
            wheel_m += step.speed_m_s * step.dt_s + step.creep_m
        moved = _moved(here, step.dt_s, speed_m_s * step.dt_s + step.creep_m, rate_rad_s)
        if self.begin_ns is None or step.outcome == "gap":
            self.begin_ns = time_ns
            self._times_ns.clear()
            self._points.clear()
        roll_rad, pitch_rad = tilt_rad
        self._points.append(
            moved._replace(wheel_m=wheel_m, wheel_m_s=step.wheel_m_s, roll_rad=roll_rad, pitch_rad=pitch_rad)
        )
        self._times_ns.append(time_ns)
        self._speed_m_s, self._rate_rad_s = speed_m_s, rate_rad_s
        if self._times_ns[0] < time_ns - 2 * self._keep_ns:
            first = bisect.bisect_left(self._times_ns, time_ns - self._keep_ns)
            del self._times_ns[:first], self._points[:first]

    def at(self, time_ns: int) -> TrackPoint | None:
        """Return the interpolated point, or one extrapolated shortly beyond the end; None outside."""
        times = self._times_ns
        if not times or time_ns < times[0]:
            return None
        ahead_ns = time_ns - times[-1]
        if ahead_ns >= 0:
            if ahead_ns > self._extrapolate_ns:
                return None
            ahead_s = ahead_ns * 1e-9
            ahead = _moved(self._points[-1], ahead_s, self._speed_m_s * ahead_s, self._rate_rad_s)
            return ahead._replace(wheel_m=ahead.wheel_m + ahead.wheel_m_s * ahead_s)
        after = bisect.bisect_right(times, time_ns)
        share = (time_ns - times[after - 1]) / (times[after] - times[after - 1])
        a, b = self._points[after - 1], self._points[after]
        return TrackPoint(*(u + share * (v - u) for u, v in zip(a, b, strict=True)))


def _moved(point: TrackPoint, dt_s: float, along_m: float, rate_rad_s: float) -> TrackPoint:
    middle = point.yaw_rad + 0.5 * rate_rad_s * dt_s
    return point._replace(
        east_m=point.east_m + along_m * math.cos(middle),
        north_m=point.north_m + along_m * math.sin(middle),
        yaw_rad=point.yaw_rad + rate_rad_s * dt_s,
        path_m=point.path_m + abs(along_m),
    )
