"""Coupling of the two rotation sensors: row 2 of h, CN101360971 eq. (3), `yaw - alpha + phi = 0`.

With `phi = alpha - yaw_B` the link's direction alpha cancels, whatever its error. B's heading starts from the
heading at the last coupling, `yaw_B = yaw_0 + D_B`, and A's is `yaw = yaw_0 + D_A`; the error of `yaw_0` is in both
and cancels: `h_2 = D_A - D_B`. So `yaw_0` is a state, a clone of yaw, the row is `(yaw - yaw_0) - D_B = 0`, its
noise is that of B since the last coupling, and B's bias, which the next increment repeats, is a state too. A common
rotation stays unobserved.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from camber.localizer.filter.dead_reckoning_time_update import BIAS_B, SCALE, YAW
from camber.localizer.filter.filter_state import YAW_0, FilterState
from camber.localizer.filter.odometry import MotionStep, yaw_rate
from camber.localizer.filter.pose_model import PoseModel

_TURN_FLOOR_RAD2: Final = 1e-8  # chosen: (0.006°)², keeps the innovation covariance regular


class YawRateCoupling:
    """Integrates the yaw rate of system B and updates system A by it."""

    def __init__(self, state: FilterState, model: PoseModel) -> None:
        self._state, self._model = state, model
        self.forget()

    def forget(self) -> None:
        """Restart at the present heading."""
        x = self._state.x
        self._turn = self._d_bias = self._d_scale = self._var = self._s = 0.0
        self._bias, self._scale = float(x[BIAS_B]), float(x[SCALE])
        self._state.copy(YAW, YAW_0)

    def accumulate(self, step: MotionStep, *, heading_known: bool) -> None:
        """Integrate the turn by sensor B over a step."""
        motion = self._model.motion
        if step.standing:
            return
        turn = yaw_rate(step, motion.b_rate_sensor, motion, bias=self._bias, scale=self._scale)
        if turn is None or step.outcome == "gap" or step.is_integrated or not heading_known:
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
        """Update by the increments of both sensors since the last coupling, where B gave any and one is due."""
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
