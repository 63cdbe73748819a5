"""Speed without wheels: integrated from the accelerometer, with its error as a state that matches and anchors observe.

The error grows by the accelerometer's noise and by `ACCELERATION_ERROR`: bias, and gravity by a tilt that is not known
well. That state is a Gauss-Markov process, and becomes known from the speeds of consecutive matches and from
standstills (zero-velocity update; Groves, 2nd ed., 15.3).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from camber.localizer.filter.dead_reckoning_time_update import ACCELERATION_ERROR, SCALE, SPEED_ERROR
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import InertialReading, MotionModel, MotionStep
from camber.localizer.filter.pose_model import AccelerationModel
from camber.localizer.filter.speed_error import SpeedError

_STANDING_SIGMA_M_S: Final = 0.02  # chosen: a body rocks on its springs, for a second or so
_STANDING_NOISE_S: Final = 1.0  # chosen: after which the rocking is another one
_MAY_STAND_SIGMA_M_S: Final = 0.5  # chosen: with a less certain speed a smooth road looks like a standstill
_MAY_STAND_M_S: Final = 0.3  # chosen: no unit shows a slower vehicle
_STANDS_AFTER_S: Final = 2.0  # chosen: of quiet, at a speed that may be zero
_STANDS_ANYHOW_AFTER_S: Final = 5.0  # chosen: no road is so smooth for so long
_WHEEL_AGE_S: Final = 0.25  # the oldest wheel speed that a sample of the unit is given (`imu_motion`)
_AT_REST_M_S2: Final = 0.1  # chosen: what is left of a bias that was levelled at rest


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

    def begin_unknown(self, since_ns: int) -> None:
        """Begin to integrate from an unknown speed."""
        self._begin(since_ns, error_m_s=0.0, sigma_m_s=self._motion.unknown_speed_m_s)

    def begin_at_rest(self, since_ns: int) -> None:
        """Begin to integrate where the unit is quiet and has just been levelled."""
        self._begin(
            since_ns, error_m_s=0.0, sigma_m_s=self._motion.speed_noise_m_s, by_level_m_s2=_AT_REST_M_S2
        )

    def begin_from_wheels(self, since_ns: int, wheel_m_s: float) -> None:
        """Begin to integrate from the wheels' last speed, with what is known of their scale and of their slip."""
        state, motion = self._state, self._motion
        slip = float(state.x[SPEED_ERROR]) if self._error.is_estimated else 0.0
        variance = float(state.p[SPEED_ERROR, SPEED_ERROR]) + float(state.p[SCALE, SCALE]) * wheel_m_s**2
        late_m_s = motion.unknown_acceleration_m_s2 * _WHEEL_AGE_S
        sigma = math.sqrt(variance + motion.speed_noise_m_s**2 + late_m_s**2)
        self._begin(since_ns, error_m_s=float(state.x[SCALE]) * wheel_m_s + slip, sigma_m_s=sigma)

    def _begin(
        self, since_ns: int, *, error_m_s: float, sigma_m_s: float, by_level_m_s2: float | None = None
    ) -> None:
        state = self._state
        self._error.begin(since_ns, is_integrated=True)
        state.set_independent(SPEED_ERROR, sigma_m_s**2)
        state.x[SPEED_ERROR] = error_m_s
        sigma_m_s2 = self._acceleration.error_sigma_m_s2 if by_level_m_s2 is None else by_level_m_s2
        state.set_independent(ACCELERATION_ERROR, sigma_m_s2**2)
        state.x[ACCELERATION_ERROR] = 0.0

    def end(self) -> None:
        """The wheels give the speed again."""
        self._error.end()
        self._state.set_independent(ACCELERATION_ERROR, 0.0)
        self._state.x[ACCELERATION_ERROR] = 0.0

    def may_stand(self, quiet_s: float) -> bool:
        """Whether the vehicle stands by the integrated speed and by how long the unit has been quiet."""
        speed = self._speed_m_s + float(self._state.x[SPEED_ERROR])
        is_slow = self.sigma_m_s < _MAY_STAND_SIGMA_M_S and abs(speed) < _MAY_STAND_M_S
        return quiet_s >= (_STANDS_AFTER_S if is_slow else _STANDS_ANYHOW_AFTER_S)

    def after_step(self, step: MotionStep, inertial: InertialReading) -> None:
        """Advance both states by a step, after the pose was propagated; at a standstill speed and acceleration are
        zero.

        What levelling takes from the acceleration its error takes up: the vehicle goes on as before.
        """
        state, dt, model = self._state, step.dt_s, self._acceleration
        self._speed_m_s = step.wheel_m_s
        state.x[ACCELERATION_ERROR] += inertial.leveled_m_s2
        if step.standing:
            weight = math.sqrt(_STANDING_NOISE_S / dt)  # one independent observation a second
            self._observe(SPEED_ERROR, -step.wheel_m_s, _STANDING_SIGMA_M_S * weight)
            self._observe(ACCELERATION_ERROR, -inertial.acceleration_m_s2, _AT_REST_M_S2 * weight)
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
