"""Roll and pitch of the body against gravity, by a gyro and the specific force: a Kalman filter of six states.

The gyro carries the angles; means of the specific force, less what the vehicle's own acceleration makes of it, level
them. States: roll, pitch [rad], biases of the gyro about x and y [rad/s], of the accelerometer along x and y [m/s²].
Tilt and accelerometer bias can be separated only where the vehicle turns: the tilt is never surer than that bias.

Source: P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., 5.3
(attitude in Euler angles), 14.2 (levelling). Axes: x forward, y left, z up; rotation `Rz(yaw) Ry(pitch) Rx(roll)`, so
that pitch is positive with the nose down and roll with the left side up.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2
from camber.localizer.arrays import Floats
from camber.localizer.inertial.imu_noise import ImuNoise

_START_SIGMA_RAD: Final = 0.1  # chosen: a vehicle that brakes with 1 m/s² while the filter starts
_GYRO_BIAS_X, _GYRO_BIAS_Y, _FORCE_BIAS_X, _FORCE_BIAS_Y = 2, 3, 4, 5
_BIAS_TIME_S: Final = 3600.0  # chosen: an accelerometer's bias follows the temperature of the unit
_GATE: Final = 18.42  # chi-square, 2 degrees of freedom, 99.99 %
_DOUBTED_AFTER: Final = 10  # chosen: 6 s; no vehicle brakes or slips for so long
_MAX_PITCH_RAD: Final = 1.2  # chosen: road vehicles do not climb 70°; there Euler angles fail


class LevelingForce(NamedTuple):
    """Mean specific force along x and y over a time, less the vehicle's acceleration, with the σ of the latter."""

    x_m_s2: float
    y_m_s2: float
    sigma_x_m_s2: float
    sigma_y_m_s2: float
    duration_s: float


class TiltFilter:
    """Estimates roll and pitch. Call `rotate` with every sample, `level` with the mean force of half a second."""

    def __init__(self, noise: ImuNoise) -> None:
        self._noise = noise
        self.roll_rad = self.pitch_rad = 0.0
        self._bias_x_rad_s = self._bias_y_rad_s = 0.0
        self._force_bias_m_s2: Floats = np.zeros(2)
        self._p: Floats = np.zeros((6, 6))
        self._turned_rad = self._turning_s = 0.0  # since the covariance was propagated
        self._rejections = 0  # consecutive ones
        self.is_level = False

    @property
    def sigma_rad(self) -> float:
        """The larger σ of roll and pitch; infinite before the first force."""
        return math.sqrt(max(self._p[0, 0], self._p[1, 1])) if self.is_level else math.inf

    @property
    def gravity_m_s2(self) -> tuple[float, float, float]:
        """Specific force at rest in the body's axes."""
        cos_pitch = math.cos(self.pitch_rad)
        return (
            -STANDARD_GRAVITY_M_S2 * math.sin(self.pitch_rad),
            STANDARD_GRAVITY_M_S2 * cos_pitch * math.sin(self.roll_rad),
            STANDARD_GRAVITY_M_S2 * cos_pitch * math.cos(self.roll_rad),
        )

    def restart(self) -> None:
        """Doubt roll and pitch: the samples had a gap, or the force has contradicted them. Biases stay."""
        if self.is_level:
            self._p[:2] = self._p[:, :2] = 0.0
            self._p[0, 0] = self._p[1, 1] = _START_SIGMA_RAD**2
        self._turned_rad = self._turning_s = 0.0
        self._rejections = 0

    def rotate(self, rate_rad_s: tuple[float, float, float], dt_s: float) -> float:
        """Turn the body by its angular rate for a time; return the change of yaw [rad].

        The bias about z is not subtracted: it is the pose filter's.
        """
        p, q, r = rate_rad_s[0] - self._bias_x_rad_s, rate_rad_s[1] - self._bias_y_rad_s, rate_rad_s[2]
        sin, cos = math.sin(self.roll_rad), math.cos(self.roll_rad)
        yaw_rate = (q * sin + r * cos) / math.cos(self.pitch_rad)
        self.pitch_rad += (q * cos - r * sin) * dt_s
        self.roll_rad += (p + yaw_rate * math.sin(self.pitch_rad)) * dt_s
        self.pitch_rad = max(-_MAX_PITCH_RAD, min(_MAX_PITCH_RAD, self.pitch_rad))
        self._turned_rad += yaw_rate * dt_s
        self._turning_s += dt_s
        return yaw_rate * dt_s

    def level(self, force: LevelingForce, up_m_s2: float) -> None:
        """Update by a force; the first one sets roll and pitch. `up_m_s2`: its mean along z."""
        if not self.is_level:
            self._start(force, up_m_s2)
            return
        self._propagate()
        sin_roll, cos_roll = math.sin(self.roll_rad), math.cos(self.roll_rad)
        sin_pitch, cos_pitch = math.sin(self.pitch_rad), math.cos(self.pitch_rad)
        h = np.zeros((2, 6))
        h[0, 1], h[0, _FORCE_BIAS_X] = -STANDARD_GRAVITY_M_S2 * cos_pitch, 1.0
        h[1, 0] = STANDARD_GRAVITY_M_S2 * cos_pitch * cos_roll
        h[1, 1] = -STANDARD_GRAVITY_M_S2 * sin_pitch * sin_roll
        h[1, _FORCE_BIAS_Y] = 1.0
        expected_x, expected_y, _ = self.gravity_m_s2
        bias_x, bias_y = self._force_bias_m_s2.tolist()
        innovation = np.array((force.x_m_s2 - expected_x - bias_x, force.y_m_s2 - expected_y - bias_y))
        white = self._noise.velocity_random_walk_m_s_sqrt_s**2 / force.duration_s
        noise = np.diag((force.sigma_x_m_s2**2 + white, force.sigma_y_m_s2**2 + white))
        ph = self._p @ h.T
        inverse = np.linalg.inv(h @ ph + noise)
        if self._is_rejected(float(innovation @ inverse @ innovation)):
            return
        gain = ph @ inverse
        dx = (gain @ innovation).tolist()
        keep = np.eye(6) - gain @ h
        self._p = keep @ self._p @ keep.T + gain @ noise @ gain.T
        self.roll_rad += dx[0]
        self.pitch_rad += dx[1]
        self._bias_x_rad_s += dx[_GYRO_BIAS_X]
        self._bias_y_rad_s += dx[_GYRO_BIAS_Y]
        self._force_bias_m_s2 = self._force_bias_m_s2 + np.array(dx[_FORCE_BIAS_X:])

    def _is_rejected(self, nis: float) -> bool:
        """Whether a force is left out: wheels that slip or lock are no acceleration. Many in a row are right."""
        if nis <= _GATE:
            self._rejections = 0
            return False
        self._rejections += 1
        if self._rejections >= _DOUBTED_AFTER:
            self.restart()
        return True

    def _start(self, force: LevelingForce, up_m_s2: float) -> None:
        up = max(up_m_s2, 0.5 * STANDARD_GRAVITY_M_S2)  # less is free fall
        x, y = force.x_m_s2 - float(self._force_bias_m_s2[0]), force.y_m_s2 - float(self._force_bias_m_s2[1])
        self.roll_rad, self.pitch_rad = math.atan2(y, up), math.atan2(-x, math.hypot(y, up))
        noise = self._noise
        bias = noise.accelerometer_bias_sigma_m_s2
        gyro = noise.gyro_bias_sigma_rad_s
        if self._p[_FORCE_BIAS_X, _FORCE_BIAS_X] == 0.0:
            self._p = np.diag((0.0, 0.0, gyro**2, gyro**2, bias**2, bias**2))
        # The tilt is measured with the bias in it: roll is off by −1 / g of the bias along y, pitch by 1 / g along x.
        by_bias = np.zeros((2, 4))
        by_bias[0, _FORCE_BIAS_Y - 2] = -1.0 / STANDARD_GRAVITY_M_S2
        by_bias[1, _FORCE_BIAS_X - 2] = 1.0 / STANDARD_GRAVITY_M_S2
        by_force = [
            min(sigma / STANDARD_GRAVITY_M_S2, _START_SIGMA_RAD)
            for sigma in (force.sigma_y_m_s2, force.sigma_x_m_s2)
        ]
        biases = self._p[2:, 2:]
        self._p[:2, 2:] = by_bias @ biases
        self._p[2:, :2] = self._p[:2, 2:].T
        self._p[:2, :2] = by_bias @ biases @ by_bias.T + np.diag(np.square(by_force))
        self._turned_rad = self._turning_s = 0.0
        self.is_level = True

    def _propagate(self) -> None:
        """Propagate the covariance by the time and the turn since the last one: a tilt keeps its direction in space."""
        dt, turned = self._turning_s, self._turned_rad
        noise = self._noise
        f = np.eye(6)
        cos, sin = math.cos(turned), math.sin(turned)
        f[0, :2] = cos, sin
        f[1, :2] = -sin, cos
        f[0, _GYRO_BIAS_X] = f[1, _GYRO_BIAS_Y] = -dt
        keep = math.exp(-dt / _BIAS_TIME_S)
        f[_FORCE_BIAS_X, _FORCE_BIAS_X] = f[_FORCE_BIAS_Y, _FORCE_BIAS_Y] = keep
        self._force_bias_m_s2 = keep * self._force_bias_m_s2
        walk = noise.angle_random_walk_rad_sqrt_s**2 * dt
        drift = 2.0 * noise.gyro_bias_sigma_rad_s**2 * dt / noise.gyro_bias_time_s
        renewed = (1.0 - keep * keep) * noise.accelerometer_bias_sigma_m_s2**2
        self._p = f @ self._p @ f.T + np.diag((walk, walk, drift, drift, renewed, renewed))
        self._turned_rad = self._turning_s = 0.0
