"""Row 2 of h (3), `yaw - alpha + phi = 0`: the rotation sensor of system B against that of system A.

With `phi = alpha - yaw_B` alpha cancels, whatever its error. B's heading starts from the heading at the last
coupling, `yaw_B = yaw_0 + D_B`, and A's is `yaw = yaw_0 + D_A`. The error of `yaw_0` is in both and cancels:
`h_2 = D_A - D_B`, whose errors are only those of the increments. So `yaw_0` is a state (a clone of yaw, fully
correlated with it at first), the row is `(yaw - yaw_0) - D_B = 0`, its noise is B's noise since the last
coupling, and B's bias, which the next increment repeats, is a state too. A common rotation of everything is
left untouched by it, as it must.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from camber.localizer.filter.dead_reckoning import BIAS_B, SCALE, YAW, MotionStep, rotation
from camber.localizer.filter.filter_state import YAW_0, FilterState
from camber.localizer.filter.pose_model import PoseModel

_TURN_FLOOR_RAD2: Final = 1e-8


class RotationCoupling:
    """Collects what B's sensor turns, and weighs it against A's."""

    def __init__(self, state: FilterState, model: PoseModel) -> None:
        self._state, self._model = state, model
        self.forget()

    def forget(self) -> None:
        """Begin anew at the heading of now."""
        x = self._state.x
        self._turn = self._d_bias = self._d_scale = self._var = self._s = 0.0
        self._bias, self._scale = float(x[BIAS_B]), float(x[SCALE])
        self._state.copy(YAW, YAW_0)

    def accumulate(self, step: MotionStep, *, heading_known: bool) -> None:
        """Take in what B's sensor turned over a step."""
        motion = self._model.motion
        if step.standing:
            return
        turn = rotation(step, motion.b_rate_sensor, motion, self._bias, self._scale)
        if turn is None or step.outcome == "gap" or not heading_known:
            self._s = -1.0
            return
        if self._s < 0.0:
            self.forget()
        self._turn += turn.rate_rad_s * step.dt_s
        self._d_bias += turn.d_bias * step.dt_s
        self._d_scale += turn.d_scale * step.dt_s
        self._var += turn.turn_var_rad2
        self._s += step.dt_s

    def couple(self) -> None:
        """Weigh the increments of both rotation sensors since the last time, if B gave any."""
        if self._s < self._model.couple_rotation_every_s:
            return
        h = self._state.rows(1)
        h[0, YAW], h[0, YAW_0], h[0, BIAS_B], h[0, SCALE] = 1.0, -1.0, -self._d_bias, -self._d_scale
        x = self._state.x
        turn_b = self._turn + self._d_bias * (x[BIAS_B] - self._bias)
        turn_b += self._d_scale * (x[SCALE] - self._scale)
        innovation = np.array([turn_b - (x[YAW] - x[YAW_0])])
        self._state.update(h, innovation, np.array([[self._var + _TURN_FLOOR_RAD2]]))
        self.forget()
