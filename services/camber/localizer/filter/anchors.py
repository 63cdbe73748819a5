"""Anchors, that is confirmed fixes: `antenna = position + lever arm + common + noise`.

`common` is a Gauss-Markov process in time, because errors of consecutive fixes are correlated: a thousand anchors at a
standstill do not average down to a millimetre.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.dead_reckoning_time_update import EAST, NORTH, SPEED_ERROR, YAW
from camber.localizer.filter.filter_state import COMMON_EAST, COMMON_NORTH, FilterState, inverse_2x2
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.speed_error import SpeedError
from camber.localizer.filter.track import TrackPoint

AnchorOutcome: TypeAlias = Literal["accepted", "recovered", "outside_gate", "too_old", "ahead", "no_speed"]

_LATE_PER_M: Final = 0.005  # error of the path since a late anchor: the σ of the wheel scale, `MotionModel`
_RECOVERY_YAW_VAR_RAD2: Final = 0.01  # chosen: 6°, added when a pose is given up for another


class AnchorResult(NamedTuple):
    """Outcome of an anchor; `nis` is the normalised innovation squared (2 degrees of freedom)."""

    outcome: AnchorOutcome
    nis: float | None = None
    innovation_m: tuple[float, float] | None = None

    @property
    def accepted(self) -> bool:
        """Whether the anchor updated the pose."""
        return self.outcome in ("accepted", "recovered")


class Anchors:
    """Updates a pose whose heading is known by confirmed positions."""

    def __init__(self, state: FilterState, error: SpeedError, model: PoseModel) -> None:
        self._state, self._error, self._model = state, error, model
        self._rejected_ns: deque[int] = deque(maxlen=max(1, model.recover_after_anchors))

    def forget(self) -> None:
        """Clear the rejected anchors: the pose is another one, or agrees with them."""
        self._rejected_ns.clear()

    def update(
        self,
        time_ns: int,
        position_m: tuple[float, float],
        noise: Floats,
        *,
        then: TrackPoint,
        here: TrackPoint,
        overrules: bool,
        held: bool,
    ) -> AnchorResult:
        """Update by z = position now - displacement since + lever arm then + common; all of it turns with the yaw.

        An anchor outside the gate is rejected until several in a row agree; it is accepted at once where it
        `overrules` the pose, and not at all where another source has `held` the pose until now.
        """
        model, x = self._model, self._state.x
        frame = float(x[YAW]) - here.yaw_rad
        to_here = rotated(frame, here.east_m - then.east_m, here.north_m - then.north_m)
        lever = rotated(frame + then.yaw_rad, model.antenna_x_m, model.antenna_y_m)
        untracked = rotated(float(x[YAW]), self._error.untracked_m(time_ns), 0.0)
        east, north = lever[0] - to_here[0] - untracked[0], lever[1] - to_here[1] - untracked[1]
        h = self._state.rows(2)
        h[0, EAST] = h[1, NORTH] = h[0, COMMON_EAST] = h[1, COMMON_NORTH] = 1.0
        h[0, YAW], h[1, YAW] = -north, east
        late_s, ahead = self._error.duration_s(time_ns), rotated(float(x[YAW]), 1.0, 0.0)
        h[0, SPEED_ERROR], h[1, SPEED_ERROR] = -late_s * ahead[0], -late_s * ahead[1]
        innovation = np.array(
            [
                position_m[0] - x[EAST] - east - x[COMMON_EAST],
                position_m[1] - x[NORTH] - north - x[COMMON_NORTH],
            ]
        )
        path = abs(here.path_m - then.path_m)
        noise = noise + np.diag([(_LATE_PER_M * path) ** 2] * 2)
        p = self._state.p
        nis = float(innovation @ inverse_2x2(h @ p @ h.T + noise) @ innovation)
        innovation_m = (float(innovation[0]), float(innovation[1]))
        speed_error = float(x[SPEED_ERROR])
        if nis <= model.anchor_gate:
            self._state.update(h, innovation, noise)
            self._error.record_update(speed_error)
            return AnchorResult("accepted", nis, innovation_m)
        self._rejected_ns.append(time_ns)
        if not overrules and (held or not self.is_persistent):
            return AnchorResult("outside_gate", nis, innovation_m)
        p[:2, :2] += np.outer(innovation, innovation)
        p[YAW, YAW] += _RECOVERY_YAW_VAR_RAD2
        self._state.update(h, innovation, noise)
        self._error.record_update(speed_error)
        return AnchorResult("recovered", nis, innovation_m)

    @property
    def is_persistent(self) -> bool:
        """Whether confirmed positions have contradicted the pose often and long enough to give it up."""
        enough = len(self._rejected_ns) == self._rejected_ns.maxlen
        return enough and self._rejected_ns[-1] - self._rejected_ns[0] >= self._model.recover_after_s * 1e9


def floored(covariance: Floats, floor_m: float) -> Floats:
    """Return the covariance (2, 2) enlarged until its smallest σ is at least the floor."""
    a, b, c = float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[0, 1])
    smallest = 0.5 * (a + b) - math.hypot(0.5 * (a - b), c)
    return covariance + np.eye(2) * max(0.0, floor_m**2 - smallest)
