"""Search for the heading of a known position, by a second position and the track between them."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.track import TrackPoint

# Chosen: 1 m of baseline and 9° are the least that the filter's linearisation tolerates; 2 % bounds the drift of dead
# reckoning before its scale is known.
_MIN_BASELINE_M: Final = 1.0
_MAX_SIGMA_RAD: Final = 0.15
_TOLERANCE_SIGMAS: Final = 4.0
_TOLERANCE_PER_M: Final = 0.02


class TrackedPosition(NamedTuple):
    """A position [m], its variance per axis, and the track's point at its time."""

    east_m: float
    north_m: float
    variance_m2: float
    track: TrackPoint

    def shifted(self, east_m: float, north_m: float) -> TrackedPosition:
        """Return the position in a plane whose origin has moved by (east, north)."""
        return self._replace(east_m=self.east_m - east_m, north_m=self.north_m - north_m)


class HeadingSearch:
    """A known position with an unknown heading, until the track to another position determines it.

    Positions are of the antenna or, from a given pose, of the vehicle: the lever arm is in the variance.
    """

    def __init__(self, position: TrackedPosition, antenna_m: tuple[float, float]) -> None:
        self._antenna_m = antenna_m
        self._first = self._last = position

    def add(self, position: TrackedPosition) -> tuple[float, Floats] | None:
        """Add a position; return the rotation from the track's frame to the plane and the covariance (3, 3) of antenna
        and yaw, or None while the heading is not determined."""
        first = self._first
        self._last = position
        begin = antenna_on_track(first.track, self._antenna_m)
        end = antenna_on_track(position.track, self._antenna_m)
        baseline = math.dist(begin, end)
        observed = math.hypot(position.east_m - first.east_m, position.north_m - first.north_m)
        spread = math.sqrt(position.variance_m2 + first.variance_m2)
        path = abs(position.track.path_m - first.track.path_m)
        agrees = abs(observed - baseline) <= _TOLERANCE_SIGMAS * spread + _TOLERANCE_PER_M * path
        if agrees and baseline > max(_MIN_BASELINE_M, spread / _MAX_SIGMA_RAD):
            direction = math.atan2(position.north_m - first.north_m, position.east_m - first.east_m)
            turned = direction - math.atan2(end[1] - begin[1], end[0] - begin[0])
            variances_m2 = (first.variance_m2, position.variance_m2)
            return turned, baseline_covariance(variances_m2, baseline, direction)
        if not agrees or first.variance_m2 > 9.0 * position.variance_m2:
            self._first = position
        return None

    def spread(self, here: TrackPoint) -> tuple[float, float, float]:
        """Return east, north and variance per axis now: a displacement d of unknown direction leaves the mean and
        adds a variance of d^2 / 2 in each axis."""
        last = self._last
        moved_m2 = (here.east_m - last.track.east_m) ** 2 + (here.north_m - last.track.north_m) ** 2
        lever_m2 = self._antenna_m[0] ** 2 + self._antenna_m[1] ** 2
        drift_m = _TOLERANCE_PER_M * (here.path_m - last.track.path_m)
        variance = last.variance_m2 + 0.5 * (moved_m2 + lever_m2) + drift_m * drift_m
        return last.east_m, last.north_m, variance

    def shift(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        self._first = self._first.shifted(east_m, north_m)
        self._last = self._last.shifted(east_m, north_m)


def antenna_on_track(point: TrackPoint, antenna_m: tuple[float, float]) -> tuple[float, float]:
    """Return the antenna's position in the track's frame; the antenna is x forward, y left of the vehicle's origin."""
    east, north = rotated(point.yaw_rad, *antenna_m)
    return point.east_m + east, point.north_m + north


def baseline_covariance(variances_m2: tuple[float, float], baseline_m: float, direction_rad: float) -> Floats:
    """Return the covariance (3, 3) of the antenna's position and the yaw from two positions, first and last.

    The yaw is the difference of their errors across the track by its length, so the last position's error is also in
    the yaw.
    """
    begin_m2, end_m2 = variances_m2
    across = (-math.sin(direction_rad), math.cos(direction_rad))
    covariance = np.diag([end_m2, end_m2, (begin_m2 + end_m2) / baseline_m**2])
    for axis in (0, 1):
        covariance[axis, 2] = covariance[2, axis] = end_m2 / baseline_m * across[axis]
    return covariance
