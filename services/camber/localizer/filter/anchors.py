"""Anchors, that is confirmed fixes: `antenna = position + lever arm + common + noise`.

`common` is a Gauss-Markov process in time, for the errors of consecutive fixes resemble each other: a thousand
anchors at a standstill do not make a millimetre.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.filter.dead_reckoning import EAST, NORTH, YAW, TrackPoint
from camber.localizer.filter.filter_state import COMMON_EAST, COMMON_NORTH, FilterState
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.start import lever_arm
from camber.localizer.links.link_filter import Array, inverse_2x2

AnchorOutcome: TypeAlias = Literal["accepted", "recovered", "outside_gate", "too_old", "ahead"]

_LATE_PER_M: Final = 0.005  # error of the path driven since an anchor that comes late


class AnchorResult(NamedTuple):
    """What became of an anchor; `nis` is the normalised innovation squared (2 degrees of freedom)."""

    outcome: AnchorOutcome
    nis: float | None
    innovation_m: tuple[float, float] | None
    innovation_covariance: Array | None

    @property
    def accepted(self) -> bool:
        """Whether the pose has taken it in."""
        return self.outcome in ("accepted", "recovered")


class Anchors:
    """Takes confirmed positions into a pose whose heading is known."""

    def __init__(self, state: FilterState, model: PoseModel) -> None:
        self._state, self._model = state, model
        self._rejected_ns: deque[int] = deque(maxlen=max(1, model.recover_after_anchors))

    def forget(self) -> None:
        """The pose is another one, or agrees with them: no contradiction is left."""
        self._rejected_ns.clear()

    def update(
        self,
        time_ns: int,
        east_m: float,
        north_m: float,
        noise: Array,
        then: TrackPoint,
        here: TrackPoint,
        *,
        overrules: bool,
        held: bool,
    ) -> AnchorResult:
        """z = position now - displacement since + lever arm then + common; all of it turns with the yaw.

        Outside the gate it is refused, until several in a row say so; at once where it `overrules` the pose, and
        not at all where something else has `held` it until now.
        """
        model, x = self._model, self._state.x
        frame = float(x[YAW]) - here.yaw_rad
        to_here = lever_arm(frame, here.east_m - then.east_m, here.north_m - then.north_m)
        lever = lever_arm(frame + then.yaw_rad, model.antenna_x_m, model.antenna_y_m)
        east, north = lever[0] - to_here[0], lever[1] - to_here[1]
        h = self._state.rows(2)
        h[0, EAST] = h[1, NORTH] = h[0, COMMON_EAST] = h[1, COMMON_NORTH] = 1.0
        h[0, YAW], h[1, YAW] = -north, east
        innovation = np.array(
            [east_m - x[EAST] - east - x[COMMON_EAST], north_m - x[NORTH] - north - x[COMMON_NORTH]]
        )
        path = abs(here.path_m - then.path_m)
        noise = noise + np.diag([(_LATE_PER_M * path) ** 2] * 2)
        p = self._state.p
        s = h @ p @ h.T + noise
        nis = float(innovation @ inverse_2x2(s) @ innovation)
        moved = (float(innovation[0]), float(innovation[1]))
        if nis <= model.anchor_gate:
            self._state.update(h, innovation, noise)
            return AnchorResult("accepted", nis, moved, s)
        self._rejected_ns.append(time_ns)
        if not overrules and (held or not self.insist):
            return AnchorResult("outside_gate", nis, moved, s)
        p[:2, :2] += np.outer(innovation, innovation)
        p[YAW, YAW] += 0.01
        self._state.update(h, innovation, noise)
        return AnchorResult("recovered", nis, moved, s)

    @property
    def insist(self) -> bool:
        """Whether confirmed positions have contradicted the pose often and long enough to give it up."""
        enough = len(self._rejected_ns) == self._rejected_ns.maxlen
        return enough and self._rejected_ns[-1] - self._rejected_ns[0] >= self._model.recover_after_s * 1e9


def floored(covariance: Array, floor_m: float) -> Array:
    """Covariance (2, 2) in which no direction is better known than the floor (on the safe side)."""
    a, b, c = float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[0, 1])
    smallest = 0.5 * (a + b) - math.hypot(0.5 * (a - b), c)
    return covariance + np.eye(2) * max(0.0, floor_m**2 - smallest)
