"""How fast a vehicle goes along its path: bounded acceleration, braking, jerk and lateral acceleration, and stops.

First the fastest speed over distance with piecewise constant acceleration (a pass forwards and one backwards over v²,
as in time-optimal path following), then its motion in time, averaged over a window of T = (a + d) / j. The average of
a motion is a motion: its acceleration stays within the bounds, its jerk within j, and position, speed and
acceleration are exact derivatives of one another. A stop lasts T longer before averaging, so that the vehicle stands
exactly where and as long as it should. What holds at one place is spread as far as the window reaches, so that the
averaged speed holds it too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.compiled.decorator import compiled
from camber.simulator.scene import Floats

_STRAIGHT = 1.0e-9  # 1/m, less is no curve


@dataclass(frozen=True, slots=True, kw_only=True)
class Driver:
    """What a driver allows."""

    acceleration_m_s2: float = 1.5
    deceleration_m_s2: float = 2.0
    lateral_acceleration_m_s2: float = 2.0
    jerk_m_s3: float = 3.0
    rest_before_s: float = 1.0
    rest_after_s: float = 1.0

    @property
    def window_s(self) -> float:
        """T, over which the motion is averaged."""
        return (self.acceleration_m_s2 + self.deceleration_m_s2) / self.jerk_m_s3


DRIVER = Driver()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Progress:
    """Distance over time before averaging: knots (n,) with constant acceleration after each, `area` = ∫ distance."""

    time_s: Floats
    distance_m: Floats
    speed_m_s: Floats
    acceleration_m_s2: Floats
    area_m_s: Floats
    window_s: float

    @property
    def duration_s(self) -> float:
        """From the beginning of the first rest to the end of the last one."""
        return float(self.time_s[-1])

    def at(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Distance, speed, acceleration (m,) at times (m,) from 0; at rest before and after."""
        half = 0.5 * self.window_s
        s0, v0, area0 = self._before_averaging(time_s - half)
        s1, v1, area1 = self._before_averaging(time_s + half)
        t = self.window_s
        return (area1 - area0) / t, (s1 - s0) / t, (v1 - v0) / t

    def _before_averaging(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        k = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.time_s) - 1)
        t = time_s - self.time_s[k]
        s, v, a = self.distance_m[k], self.speed_m_s[k], self.acceleration_m_s2[k]
        distance = s + t * (v + t * (0.5 * a))
        return distance, v + a * t, self.area_m_s[k] + t * (s + t * (v / 2.0 + t * a / 6.0))


def progress_along(
    distance_m: Floats, curvature: Floats, limits: tuple[Floats, Floats], driver: Driver
) -> Progress:
    """The motion over samples of a path (n,): from rest at its beginning to rest at its end.

    `curvature` in 1/m; `limits`: speed limits, and how long to stop where they are zero: at the first sample of such a
    stretch, for the longest of it. Raises ValueError for a path that allows no speed at all.
    """
    limit, stop_at_s = _limits_and_stops(*limits)
    in_curves = np.sqrt(driver.lateral_acceleration_m_s2 / np.maximum(np.abs(curvature), _STRAIGHT))
    limit = np.minimum(limit, in_curves)
    # Midpoints, so that there is room to move between two stops at neighbouring samples.
    s = np.interp(np.arange(2 * len(distance_m) - 1) / 2.0, np.arange(len(distance_m)), distance_m)
    most = np.empty(len(s))
    most[::2] = limit
    most[1::2] = np.minimum(limit[1:], limit[:-1])
    stop = np.full(len(s), -1.0)
    stop[::2] = stop_at_s
    stop[0] = max(stop[0], 0.0)
    stop[-1] = max(stop[-1], 0.0)
    bounds = driver.acceleration_m_s2, driver.deceleration_m_s2
    fastest = _fastest(s, most, stop, bounds)
    reach_m = driver.window_s * (fastest + max(bounds) * driver.window_s)
    speed = _fastest(s, _spread(s, most, reach_m), stop, bounds)
    return _in_time(s, speed, stop, driver)


def _limits_and_stops(speed_limit_m_s: Floats, stop_s: Floats) -> tuple[Floats, Floats]:
    """Limits without zeros (those next to them instead), and how long to stop at each sample, −1 not at all."""
    zero = speed_limit_m_s <= 0.0
    if zero.all() or not np.isfinite(speed_limit_m_s).all():
        raise ValueError("speed_limit_m_s allows no speed anywhere, or is not finite; expected some positive")
    stop_at_s = np.full(len(zero), -1.0)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], zero.astype(np.int64), [0]))))
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        stop_at_s[first] = max(0.0, float(stop_s[first:end].max()))
    known = np.flatnonzero(~zero)
    before = known[np.clip(np.searchsorted(known, np.arange(len(zero)), side="right") - 1, 0, None)]
    return speed_limit_m_s[before], stop_at_s


def _in_time(s: Floats, speed: Floats, stop: Floats, driver: Driver) -> Progress:
    """The knots in time; a stop is one too."""
    window = driver.window_s
    step_s = 2.0 * np.diff(s) / (speed[1:] + speed[:-1])
    rest_s = np.where(stop >= 0.0, stop + window, 0.0)
    rest_s[0] += driver.rest_before_s - 0.5 * window
    rest_s[-1] += driver.rest_after_s - 0.5 * window
    leave_s = np.cumsum(rest_s) + np.append(0.0, np.cumsum(step_s))
    arrive_s = leave_s - rest_s
    accelerate = np.append((speed[1:] - speed[:-1]) / step_s, 0.0)
    rests = stop >= 0.0
    order = np.argsort(np.concatenate((2 * np.flatnonzero(rests), 2 * np.arange(len(s)) + 1)), kind="stable")
    time_s = np.concatenate((arrive_s[rests], leave_s))[order]
    distance = np.concatenate((s[rests], s))[order]
    velocity = np.concatenate((np.zeros(int(rests.sum())), speed))[order]
    acceleration = np.concatenate((np.zeros(int(rests.sum())), accelerate))[order]
    dt = np.diff(time_s)
    part = dt * (distance[:-1] + dt * (velocity[:-1] / 2.0 + dt * acceleration[:-1] / 6.0))
    return Progress(
        time_s=time_s,
        distance_m=distance,
        speed_m_s=velocity,
        acceleration_m_s2=acceleration,
        area_m_s=np.append(0.0, np.cumsum(part)),
        window_s=window,
    )


@compiled
def _fastest(s: Floats, most: Floats, stop: Floats, bounds: tuple[float, float]) -> Floats:
    """The greatest speeds within the limits whose v² changes by no more than 2 a Δs."""
    acceleration, deceleration = bounds
    n = len(s)
    square = np.empty(n)
    for i in range(n):
        square[i] = 0.0 if stop[i] >= 0.0 else most[i] * most[i]
        if i > 0:
            square[i] = min(square[i], square[i - 1] + 2.0 * acceleration * (s[i] - s[i - 1]))
    for i in range(n - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + 2.0 * deceleration * (s[i + 1] - s[i]))
    return np.sqrt(square)


@compiled
def _spread(s: Floats, most: Floats, reach_m: Floats) -> Floats:
    """Each sample's limit holds as far as its reach to both sides."""
    n = len(s)
    spread = most.copy()
    for i in range(n):
        j = i - 1
        while j >= 0 and s[i] - s[j] <= reach_m[i]:
            spread[j] = min(spread[j], most[i])
            j -= 1
        j = i + 1
        while j < n and s[j] - s[i] <= reach_m[i]:
            spread[j] = min(spread[j], most[i])
            j += 1
    return spread
