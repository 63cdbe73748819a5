"""Physical bounds of the sensors' lasting errors: what leaves them is a fault, not a calibration.

A state that leaves its bound is projected onto it: `x − P dᵀ (d P dᵀ)⁻¹ (d x − b)`, D. Simon, "Kalman filtering with
state constraints", IET Control Theory & Applications 4 (2010), eq. (27). What it has been learnt from or the sensor is
wrong, so its variance becomes the square of what it had been estimated to be, without correlations: dead reckoning
covers both. Positions that keep pulling it out lead the pose away from the path that odometry allows; `departure_m` is
how far they have done so, those of the last minute before the fault included.
"""

from __future__ import annotations

import math
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.dead_reckoning_time_update import BIAS_A, BIAS_B, SCALE, TURN_GAIN
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import MotionModel

SensorError: TypeAlias = Literal["wheel_scale", "yaw_rate_bias", "steering_offset", "turn_gain"]

_LASTS_S: Final = 10.0  # chosen: a fault ends when no estimate has left its bound for as long
_FADES_S: Final = 60.0  # chosen: the time in which anchors teach the wheel scale what they do to the pose


class SensorFault(NamedTuple):
    """An error that was estimated beyond its bound: without unit (scale, gain), rad/s or rad."""

    error: SensorError
    estimate: float
    bound: float


class SensorBounds:
    """Keeps the sensors' errors within what is physically possible."""

    def __init__(self, state: FilterState, motion: MotionModel) -> None:
        self._state = state
        biases: tuple[tuple[SensorError, float], ...] = (
            ("yaw_rate_bias", motion.yaw_rate_bias_bound_rad_s),
            ("steering_offset", motion.steering_bias_bound_rad),
        )
        a, b = biases if motion.a_rate_sensor == "yaw_rate" else biases[::-1]
        gain_bound = motion.gain_bound(motion.a_rate_sensor)
        self._bounds: tuple[tuple[int, SensorError, float], ...] = (
            (SCALE, "wheel_scale", motion.speed_scale_bound),
            (BIAS_A, *a),
            (BIAS_B, *b),
            (TURN_GAIN, "turn_gain", gain_bound),
        )
        self.departure_m: Floats = np.zeros(2)
        """Sum of the moves of the pose by positions and the wheel scale, east and north; without a fault it fades."""
        self._fault: SensorFault | None = None
        self._time_ns = self._moved_ns = 0

    def fault(self, now_ns: int | None) -> SensorFault | None:
        """Return the fault that lasts now."""
        lasts = now_ns is not None and now_ns - self._time_ns <= _LASTS_S * 1e9
        return self._fault if lasts else None

    def forget(self) -> None:
        """End the fault: the pose is another one."""
        self._fault, self.departure_m = None, np.zeros(2)

    def note_move(self, now_ns: int, moved_m: Floats) -> None:
        """Add a move (2,) of the pose by a position and by the wheel scale since the last one, east and north."""
        fades_s = 0.0 if self.fault(now_ns) is not None else (now_ns - self._moved_ns) * 1e-9
        self.departure_m = math.exp(-fades_s / _FADES_S) * self.departure_m + moved_m
        self._moved_ns = now_ns

    def enforce(self, now_ns: int) -> None:
        """Project what has left its bound; what that moves beyond another bound as well."""
        for _ in self._bounds:
            for index, error, bound in self._bounds:
                estimate = float(self._state.x[index])
                if abs(estimate) > bound:
                    self._fault, self._time_ns = SensorFault(error, estimate, bound), now_ns
                    self._project(index, bound if estimate > 0.0 else -bound)

    def _project(self, index: int, onto: float) -> None:
        state, estimate = self._state, float(self._state.x[index])
        variance = float(state.p[index, index])
        if variance > 0.0:
            state.x = state.x + state.p[:, index] * ((onto - estimate) / variance)
        state.x[index] = onto
        state.set_independent(index, estimate * estimate)
