"""Steps of the fixes: from one to the next they move otherwise than the vehicle, so the offset of their height is new.

A receiver that takes other integers, or another base, has another error from one epoch to the next. A height that has
changed by decimetres so, taken for the road's, would move a position found by relief by metres: 0.08 m on a slope of
4 % is 2 m. So heights before and after a step have no offset in common. East and north of fixes only say that there
was a step: they move nothing, and a step too many costs information alone.

Other integers move one fix, those before and after it move as the vehicle does. Fixes that are led away part from the
vehicle instead: in a turn those beside the road by their distance times the angle, those along it turn before the
vehicle. That has a velocity, which changes as a vehicle's does: a step is what a fix has moved by beyond it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from camber.geodesy.angles import wrap_pi
from camber.geodesy.horizontal_offsets import east_north_between
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.track import TrackPoint
from camber.schemas.gnss import Fix
from camber.schemas.pose import Road

_LEAST_STEP_M: Final = 0.3  # chosen: half of what wrong integers put a position off by in space, 0.5 m
_SIGMAS: Final = 3.0  # chosen: errors of successive fixes are nearly the same, so that σ is rather too large
_PATH_SHARE: Final = 0.01  # docs/theory/odometry.md: wheel scale before it is calibrated
_DIRECTION_SIGMA_RAD: Final = 0.02  # derived: 2 cm of a fix over 2 m, by half of its weight in the mean
_TURN_SHARE: Final = 0.25  # chosen: a yaw rate that is late by a quarter of the time between two fixes
_DIRECTION_WEIGHT: Final = 0.3  # chosen: the mean of some six displacements
_LEAST_DIRECTION_M: Final = 2.0  # chosen: the direction of a shorter displacement is known to 1° at most
_LONGEST_GAP_S: Final = 1.0  # as a run of fixes (`integrity.checks.carried_position`): turns go on for longer
_LOST_AFTER: Final = 3  # steps in a row; chosen: then it is the track that has turned otherwise
_LEAST_ROAD_SLOPE: Final = (
    0.12  # derived: the steepest road (RAS-L 1995) while the road below is that of another pose
)


class FixStep(NamedTuple):
    """What the fixes have moved by beyond the vehicle, east and north (m), and its variance in any direction (m²).

    `east_north_m` None: of another base, or the direction of the driven track is not known.
    """

    east_north_m: tuple[float, float] | None
    variance_m2: float = 0.0


class _PlacedFix(NamedTuple):
    fix: Fix
    track: TrackPoint
    road_m: float | None


class _Parting(NamedTuple):
    """Velocity of the fixes beyond the vehicle's, east and north (m/s), and its variance by the fixes (m²/s²)."""

    east_north_m_s: tuple[float, float] = (0.0, 0.0)
    variance: float = 0.0


class _Displacements(NamedTuple):
    """From one fix to the next: that of the fixes, east and north, and that of the antenna in the track's frame (m)."""

    shown_m: tuple[float, float]
    moved_m: tuple[float, float]

    @property
    def turn_rad(self) -> float:
        """The angle between both."""
        (east_m, north_m), (x_m, y_m) = self
        return math.atan2(north_m, east_m) - math.atan2(y_m, x_m)


class FixStepDetection:
    """Compares each fix with the one before; `lever_m`: antenna in the vehicle's axes, x forward, y left.

    The direction of the driven track is that of the fixes before, so no heading of a pose is in it.
    """

    def __init__(self, lever_m: tuple[float, float]) -> None:
        self._lever_m = lever_m
        self._last: _PlacedFix | None = None
        self._direction_rad: float | None = None
        self._parting = _Parting()
        self._steps = 0
        self.run_begin_ns: int | None = None
        """Time of the first of the fixes that continue one another, without a step or a gap; None: not known."""

    def step(self, fix: Fix, track: TrackPoint | None, road: Road) -> FixStep | None:
        """Take a fix at a point of the driven track, with the newest road; return its step, None if it is none.

        The first fix is none, nor is one that cannot be compared because the motion is not known.
        """
        if track is None:
            self._last = self._direction_rad = self.run_begin_ns = None
            self._parting = _Parting()
            return None
        last = self._last
        step = self._take(_PlacedFix(fix, track, road.elevation_m if road.status == "known" else None))
        if last is None or step is not None or not 0.0 < _since_s(last.fix, fix) <= _LONGEST_GAP_S:
            self.run_begin_ns = fix.time_ns
        return step

    def _take(self, this: _PlacedFix) -> FixStep | None:
        fix, last, self._last = this.fix, self._last, this
        if last is None:
            return None
        if _base_of(fix) != _base_of(last.fix):
            return FixStep(None)
        displacements = self._displacements(last, this)
        beyond = self._beyond(last, this, displacements)
        if not _is_vertical_step(last, this) and not self._is_step(last.fix, fix, beyond):
            self._steps = 0
            self._parting = _parting(last.fix, fix, beyond)
            self._follow(displacements)
            return None
        step = FixStep(None) if self._direction_rad is None else beyond
        self._steps += 1
        if self._steps >= _LOST_AFTER:
            self._direction_rad, self._steps = None, 0
            self._parting = _Parting()
        return step

    def _is_step(self, last: Fix, this: Fix, beyond: FixStep) -> bool:
        """Whether the fixes have moved neither as the vehicle nor as they were parting from it."""
        if not _is_beyond_errors(beyond):
            return False
        since_s, (velocity_m_s, variance) = _since_s(last, this), self._parting
        if not 0.0 < since_s <= _LONGEST_GAP_S:
            return True
        (east_m, north_m), (east_m_s, north_m_s) = beyond.east_north_m or (0.0, 0.0), velocity_m_s
        # The fix between both displacements has twice its error in their difference.
        variance_m2 = beyond.variance_m2 + since_s**2 * variance + 2.0 * _horizontal_m2(last)
        left_m = east_m - since_s * east_m_s, north_m - since_s * north_m_s
        return _is_beyond_errors(FixStep(left_m, variance_m2))

    def _beyond(self, last: _PlacedFix, this: _PlacedFix, displacements: _Displacements) -> FixStep:
        (shown_east_m, shown_north_m), moved_m = displacements
        direction_rad = displacements.turn_rad if self._direction_rad is None else self._direction_rad
        east_m, north_m = rotated(direction_rad, *moved_m)
        late_rad = _TURN_SHARE * (this.track.yaw_rad - last.track.yaw_rad)
        by_motion = _PATH_SHARE**2 + _DIRECTION_SIGMA_RAD**2 + late_rad**2
        variance_m2 = (
            _horizontal_m2(last.fix) + _horizontal_m2(this.fix) + by_motion * math.hypot(*moved_m) ** 2
        )
        return FixStep((shown_east_m - east_m, shown_north_m - north_m), variance_m2)

    def _follow(self, displacements: _Displacements) -> None:
        """Update the direction by a displacement that is long enough to have one."""
        if min(math.hypot(*each) for each in displacements) < _LEAST_DIRECTION_M:
            return
        turn_rad = displacements.turn_rad
        before_rad = turn_rad if self._direction_rad is None else self._direction_rad
        self._direction_rad = before_rad + _DIRECTION_WEIGHT * wrap_pi(turn_rad - before_rad)

    def _displacements(self, last: _PlacedFix, this: _PlacedFix) -> _Displacements:
        shown_m = east_north_between(
            last.fix.latitude_rad, last.fix.longitude_rad, this.fix.latitude_rad, this.fix.longitude_rad
        )
        return _Displacements(shown_m, self._moved_m(last.track, this.track))

    def _moved_m(self, last: TrackPoint, this: TrackPoint) -> tuple[float, float]:
        """What the antenna has moved by, in the track's frame."""
        now, then = rotated(this.yaw_rad, *self._lever_m), rotated(last.yaw_rad, *self._lever_m)
        return this.east_m - last.east_m + now[0] - then[0], this.north_m - last.north_m + now[1] - then[1]


def _is_beyond_errors(step: FixStep) -> bool:
    off_m = math.hypot(*(step.east_north_m or (0.0, 0.0)))
    return off_m > max(_LEAST_STEP_M, _SIGMAS * math.sqrt(step.variance_m2))


def _parting(last: Fix, this: Fix, beyond: FixStep) -> _Parting:
    since_s, (east_m, north_m) = _since_s(last, this), beyond.east_north_m or (0.0, 0.0)
    if since_s <= 0.0:
        return _Parting()
    variance_m2 = _horizontal_m2(last) + _horizontal_m2(this)
    return _Parting((east_m / since_s, north_m / since_s), variance_m2 / since_s**2)


def _since_s(last: Fix, this: Fix) -> float:
    return 1e-9 * (this.time_ns - last.time_ns)


def _is_vertical_step(last: _PlacedFix, this: _PlacedFix) -> bool:
    if last.road_m is None or this.road_m is None:
        return False
    off_m = (this.fix.height_m - this.road_m) - (last.fix.height_m - last.road_m)
    variance_m2 = _up_m2(last.fix) + _up_m2(this.fix)
    passed_m = abs(this.track.path_m - last.track.path_m)
    return abs(off_m) > max(_LEAST_STEP_M, _SIGMAS * math.sqrt(variance_m2)) + _LEAST_ROAD_SLOPE * passed_m


def _base_of(fix: Fix) -> tuple[str | None, ...]:
    return fix.origin, fix.datum, fix.base_station


def _horizontal_m2(fix: Fix) -> float:
    return 0.0 if fix.covariance_enu_m2 is None else max(fix.covariance_enu_m2[0], fix.covariance_enu_m2[3])


def _up_m2(fix: Fix) -> float:
    return 0.0 if fix.covariance_enu_m2 is None else fix.covariance_enu_m2[5]
