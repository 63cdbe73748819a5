"""Speed without wheels: integrated from the accelerometer, with its error as a state that matches and anchors observe.

The error grows by the accelerometer's noise and by `ACCELERATION_ERROR`: bias, and gravity by a tilt that is not known
well. That state is a Gauss-Markov process, and becomes known from the speeds of consecutive matches and from
standstills (zero-velocity update; Groves, 2nd ed., 15.3).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from camber.localizer.filter.dead_reckoning_time_update import ACCELERATION_ERROR, SPEED_ERROR
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import InertialReading, MotionModel, MotionStep
from camber.localizer.filter.pose_model import AccelerationModel
from camber.localizer.filter.speed_error import SpeedError

_STANDING_SIGMA_M_S: Final = 0.02  # chosen: a body rocks on its springs
_MAY_STAND_SIGMA_M_S: Final = 0.5  # chosen: with a less certain speed a smooth road looks like a standstill
_MAY_STAND_SIGMAS: Final = 3.0  # chosen: of a normal error 99.7 %


class InertialSpeed:
    """Keeps the two states while the wheels give no speed."""

    def __init__(
        self, state: FilterState, error: SpeedError, *, motion: MotionModel, acceleration: AccelerationModel
    ) -> None:
        self._state, self._error, self._motion, self._acceleration = state, error, motion, acceleration
        self._speed_m_s = 0.0  # the integrated one

    @property
    def sigma_m_s(self) -> float:
        """σ of the speed."""
        return math.sqrt(max(0.0, float(self._state.p[SPEED_ERROR, SPEED_ERROR])))

    def begin(self, since_ns: int, *, speed_known: bool) -> None:
        """Begin to integrate: from the wheels' last speed, or from an unknown one."""
        motion = self._motion
        self._error.begin(since_ns, is_integrated=True)
        sigma = motion.speed_noise_m_s if speed_known else motion.unknown_speed_m_s
        self._state.set_independent(SPEED_ERROR, sigma**2)
        self._state.set_independent(ACCELERATION_ERROR, self._acceleration.error_sigma_m_s2**2)

    def end(self) -> None:
        """The wheels give the speed again."""
        self._error.end()
        self._state.set_independent(ACCELERATION_ERROR, 0.0)
        self._state.x[ACCELERATION_ERROR] = 0.0

    @property
    def may_stand(self) -> bool:
        """Whether the vehicle may stand by the integrated speed."""
        sigma = self.sigma_m_s
        speed = self._speed_m_s + float(self._state.x[SPEED_ERROR])
        largest = _MAY_STAND_SIGMAS * sigma + self._motion.standstill_speed_m_s
        return sigma < _MAY_STAND_SIGMA_M_S and abs(speed) < largest

    def after_step(self, step: MotionStep, inertial: InertialReading) -> None:
        """Advance both states by a step, after the pose was propagated; at a standstill speed and acceleration are
        zero.

        What levelling takes from the acceleration its error takes up: the vehicle goes on as before.
        """
        state, dt, model = self._state, step.dt_s, self._acceleration
        self._speed_m_s = step.wheel_m_s
        state.x[ACCELERATION_ERROR] += inertial.leveled_m_s2
        if step.standing:
            noise = model.noise_m_s_sqrt_s / math.sqrt(dt)
            self._observe(SPEED_ERROR, -step.wheel_m_s, _STANDING_SIGMA_M_S)
            self._observe(ACCELERATION_ERROR, -inertial.acceleration_m_s2, noise)
        else:
            state.x[SPEED_ERROR] += dt * state.x[ACCELERATION_ERROR]
            state.p[SPEED_ERROR] += dt * state.p[ACCELERATION_ERROR]
            state.p[:, SPEED_ERROR] += dt * state.p[:, ACCELERATION_ERROR]
            state.p[SPEED_ERROR, SPEED_ERROR] += model.noise_m_s_sqrt_s**2 * dt
        state.renew(ACCELERATION_ERROR, math.exp(-dt / model.error_time_s), model.error_sigma_m_s2)

    def _observe(self, state: int, value: float, sigma: float) -> None:
        h = self._state.rows(1)
        h[0, state] = 1.0
        before = float(self._state.x[SPEED_ERROR])
        innovation = np.array([value - float(self._state.x[state])])
        self._state.update_joseph(h, innovation, np.array([[sigma**2]]))
        self._error.record_update(before)
