"""Steps of the fixes: from one to the next they move otherwise than the vehicle, so the offset of their height is new.

A receiver that takes other integers, or another base, has another error from one epoch to the next. A height that has
changed by decimetres so, taken for the road's, would move a position found by relief by metres: 0.08 m on a slope of
4 % is 2 m. So heights before and after a step have no offset in common. East and north of fixes only say that there
was a step: they move nothing, and a step too many costs information alone.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from camber.geodesy.horizontal_offsets import east_north_between
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.pose_estimate import Prediction
from camber.localizer.filter.track import TrackPoint
from camber.schemas.gnss import Fix
from camber.schemas.pose import Road

_LEAST_STEP_M: Final = 0.3  # chosen: half of what wrong integers put a position off by in space, 0.5 m
_SIGMAS: Final = 3.0  # chosen: errors of successive fixes are nearly the same, so that σ is rather too large
_PATH_SHARE: Final = 0.01  # docs/theory/odometry.md: wheel scale before it is calibrated
_LEAST_ROAD_SLOPE: Final = (
    0.12  # derived: the steepest road (RAS-L 1995) while the road below is that of another pose
)


class _PlacedFix(NamedTuple):
    fix: Fix
    track: TrackPoint
    road_m: float | None


class FixStepDetection:
    """Compares each fix with the one before; `lever_m`: antenna in the vehicle's axes, x forward, y left."""

    def __init__(self, lever_m: tuple[float, float]) -> None:
        self._lever_m = lever_m
        self._last: _PlacedFix | None = None

    def is_step(self, fix: Fix, track: TrackPoint | None, pose: Prediction | None, road: Road) -> bool:
        """Take a fix at a point of the driven track, with the pose and the newest road; return whether it is a step.

        The first fix is none, nor is one that cannot be compared because motion or heading are not known.
        """
        if track is None:
            self._last = None
            return False
        road_m = road.elevation_m if road.status == "known" else None
        last, self._last = self._last, _PlacedFix(fix, track, road_m)
        if last is None:
            return False
        if _base_of(fix) != _base_of(last.fix):
            return True
        passed_m = abs(track.path_m - last.track.path_m)
        return _is_vertical_step(last, self._last, passed_m) or self._is_horizontal_step(
            last, self._last, passed_m, pose
        )

    def _is_horizontal_step(
        self, last: _PlacedFix, this: _PlacedFix, passed_m: float, pose: Prediction | None
    ) -> bool:
        if pose is None or not pose.yaw_known:
            return False
        moved = self._moved_m(last.track, this.track, pose.yaw_rad)
        east_m, north_m = east_north_between(
            last.fix.latitude_rad, last.fix.longitude_rad, this.fix.latitude_rad, this.fix.longitude_rad
        )
        off_m = math.hypot(east_m - moved[0], north_m - moved[1])
        variance_m2 = _horizontal_m2(last.fix) + _horizontal_m2(this.fix)
        variance_m2 += (_PATH_SHARE**2 + pose.yaw_sigma_rad**2) * passed_m**2
        return off_m > max(_LEAST_STEP_M, _SIGMAS * math.sqrt(variance_m2))

    def _moved_m(self, last: TrackPoint, this: TrackPoint, yaw_rad: float) -> tuple[float, float]:
        """East and north that the antenna has moved, by the track turned to the heading `yaw_rad` now."""
        east_m, north_m = rotated(
            yaw_rad - this.yaw_rad, this.east_m - last.east_m, this.north_m - last.north_m
        )
        now = rotated(yaw_rad, *self._lever_m)
        then = rotated(yaw_rad - this.yaw_rad + last.yaw_rad, *self._lever_m)
        return east_m + now[0] - then[0], north_m + now[1] - then[1]


def _is_vertical_step(last: _PlacedFix, this: _PlacedFix, passed_m: float) -> bool:
    if last.road_m is None or this.road_m is None:
        return False
    off_m = (this.fix.height_m - this.road_m) - (last.fix.height_m - last.road_m)
    variance_m2 = _up_m2(last.fix) + _up_m2(this.fix)
    return abs(off_m) > max(_LEAST_STEP_M, _SIGMAS * math.sqrt(variance_m2)) + _LEAST_ROAD_SLOPE * passed_m


def _base_of(fix: Fix) -> tuple[str | None, ...]:
    return fix.origin, fix.datum, fix.base_station


def _horizontal_m2(fix: Fix) -> float:
    return 0.0 if fix.covariance_enu_m2 is None else max(fix.covariance_enu_m2[0], fix.covariance_enu_m2[3])


def _up_m2(fix: Fix) -> float:
    return 0.0 if fix.covariance_enu_m2 is None else fix.covariance_enu_m2[5]
