"""Anchors that odometry contradicts: sensors' errors that they pull out of their bounds, and paths that differ.

A single wrong anchor makes paths differ too, towards it and then back; anchors that are led away do so in one
direction. Therefore two windows in succession must contradict odometry, with departures to the same side.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.contradictions.path_comparison import PathComparison, PathTest, PlacedPosition
from camber.localizer.contradictions.sensor_bounds import SensorBounds, SensorFault
from camber.localizer.filter.dead_reckoning_time_update import SCALE, YAW
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import MotionStep
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.pose_model import PoseModel

_SAME_SIDE: Final = 0.5  # chosen: cosine of the angle between two departures
_SUCCESSION_S: Final = 30.0  # chosen: longer than the 10 s and 30 s windows take to end one after another
_LASTS_S: Final = 10.0  # chosen: as a fault of `sensor_bounds`


class OdometryContradiction:
    """What of the anchors contradicts odometry, and by how much they have led the pose away."""

    def __init__(self, state: FilterState, model: PoseModel) -> None:
        self._state, self._motion = state, model.motion
        self._bounds = SensorBounds(state, model.motion)
        self._paths = PathComparison(model.motion, FilterState(model))
        self._bounded_at_m = 0.0
        self._contradicted: tuple[int, PathTest] | None = None  # the last one, and its time
        self._led: tuple[int, PathTest] | None = None  # the last of two to the same side

    def use_sensors(self, sensors: FilterState) -> None:
        """Compare paths by the sensors' errors as another filter knows them, one without anchors."""
        self._paths = PathComparison(self._motion, sensors)

    def forget(self) -> None:
        """Clear all: the pose is another one."""
        self._bounds.forget()
        self._paths.forget()
        self._contradicted = self._led = None

    def shift(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        self._paths.shift(east_m, north_m)

    def sensor_fault(self, now_ns: int | None) -> SensorFault | None:
        """Return the sensor's error that has left its physical bound, while it lasts."""
        return self._bounds.fault(now_ns)

    def path_fault(self, now_ns: int | None) -> PathTest | None:
        """Return the comparison by which anchors are led away, while that lasts."""
        if self._led is None or now_ns is None or now_ns - self._led[0] > _LASTS_S * 1e9:
            return None
        return self._led[1]

    def advance(self, time_ns: int, step: MotionStep) -> None:
        """Follow a step of the motion. A speed that is integrated is no evidence of a path."""
        if step.is_integrated:
            self._paths.forget()
        else:
            self._paths.advance(step)
        self._bounds.enforce(time_ns)

    def add_anchor(
        self, now_ns: int, anchor: PlacedPosition, *, moved_m: Floats, travelled_m: float
    ) -> Floats | None:
        """Add an anchor that has moved the pose by (2,); return how far anchors have led the pose away (2,), east and
        north [m], where odometry contradicts them."""
        x, path_m = self._state.x, travelled_m - self._bounded_at_m
        self._bounded_at_m = travelled_m
        by_scale = rotated(float(x[YAW]), float(x[SCALE]) * path_m, 0.0)
        self._bounds.note_move(now_ns, moved_m + by_scale)
        self._bounds.enforce(now_ns)
        self._compare(now_ns, anchor)
        departures = []
        if self._bounds.fault(now_ns) is not None:
            departures.append(self._bounds.departure_m)
        path_fault = self.path_fault(now_ns)
        if path_fault is not None:
            departures.append(np.array(path_fault.departure_m))
        return max(departures, key=lambda departure: float(np.hypot(*departure)), default=None)

    def _compare(self, now_ns: int, anchor: PlacedPosition) -> None:
        test, before = self._paths.add(anchor), self._contradicted
        if test is None or not test.contradicts:
            return
        self._contradicted = now_ns, test
        if before is not None and now_ns - before[0] <= _SUCCESSION_S * 1e9 and _same_side(before[1], test):
            self._led = now_ns, test


def _same_side(one: PathTest, other: PathTest) -> bool:
    a, b = one.departure_m, other.departure_m
    product = a[0] * b[0] + a[1] * b[1]
    return product > _SAME_SIDE * math.hypot(*a) * math.hypot(*b)
