"""Readings of a perfect inertial unit on an analytic motion: derivatives of positions and rotations, by differences.

Nothing of the product's strap-down equations is in it: the unit's position is differentiated twice, its rotation once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.schemas.motion import Imu

Floats = NDArray[np.float64]
GRAVITY_M_S2 = 9.80665
BEGIN_NS = 1_300_000_000_000_000_000
_H_S = 1e-4  # of the differences


@dataclass(frozen=True, kw_only=True)
class AnalyticMotion:
    """Roll, pitch, yaw [rad] and speed [m/s] over time [s]; the vehicle drives along its x axis."""

    angles: Callable[[float], tuple[float, float, float]]
    speed: Callable[[float], float]
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    vehicle_from_imu: Floats = field(default_factory=lambda: np.eye(3))

    def rotation(self, t: float) -> Floats:
        return np.asarray(rotation_from_roll_pitch_yaw(*self.angles(t)))

    def imu(self, t: float) -> Imu:
        """What the unit measures at a time."""
        before, now, after = self.rotation(t - _H_S), self.rotation(t), self.rotation(t + _H_S)
        skew = now.T @ (after - before) / (2.0 * _H_S)
        rate = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        velocity = [self.rotation(s) @ (self.speed(s), 0.0, 0.0) for s in (t - _H_S, t + _H_S)]
        acceleration = (velocity[1] - velocity[0]) / (2.0 * _H_S)
        arm = np.array(self.lever_m)
        acceleration = acceleration + (after @ arm - 2.0 * (now @ arm) + before @ arm) / _H_S**2
        force = now.T @ (acceleration + np.array([0.0, 0.0, GRAVITY_M_S2]))
        x, y, z = (self.vehicle_from_imu.T @ rate).tolist()
        fx, fy, fz = (self.vehicle_from_imu.T @ force).tolist()
        return Imu(
            time_ns=BEGIN_NS + round(t * 1e9), angular_rate_rad_s=(x, y, z), specific_force_m_s2=(fx, fy, fz)
        )
