"""Noise of inertial measurement units, by Allan parameters (IEEE Std 952 for gyros, IEEE Std 1293 for accelerometers).

Three classes cover what vehicles carry. Figures are of data sheets: Bosch BMI160 (BST-BMI160-DS000), Analog Devices
ADIS16465, Sensonor STIM300; what a data sheet leaves out is chosen on the large side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2
from camber.localizer.filter.odometry import MotionModel
from camber.schemas.motion import ImuClass

_DEG_PER_HOUR: Final = math.radians(1.0) / 3600.0
_INSTABILITY_TIME_S: Final = (
    100.0  # chosen: the Allan deviation of MEMS gyros is lowest between 10 s and 1000 s
)
_BOUND_SIGMAS: Final = 5.0  # chosen: an estimate beyond is a fault and not a bias


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuNoise:
    """Allan parameters of each axis. The bias of the gyro includes the Earth's rotation, 15 °/h at a pole."""

    angle_random_walk_rad_sqrt_s: float
    gyro_bias_sigma_rad_s: float
    gyro_instability_rad_s: float
    gyro_scale_sigma: float
    velocity_random_walk_m_s_sqrt_s: float
    accelerometer_bias_sigma_m_s2: float

    @property
    def gyro_bias_time_s(self) -> float:
        """Correlation time of the bias as a Gauss-Markov process of its σ: after `_INSTABILITY_TIME_S` it has walked
        by the in-run instability, σ √(2 t / τ)."""
        return 2.0 * _INSTABILITY_TIME_S * (self.gyro_bias_sigma_rad_s / self.gyro_instability_rad_s) ** 2

    def motion_model(self, vehicle: MotionModel) -> MotionModel:
        """Return the error model of a vehicle's sensors with this gyro as the rotation sensor of system A."""
        return replace(
            vehicle,
            a_rate_sensor="yaw_rate",
            yaw_rate_bias_sigma_rad_s=self.gyro_bias_sigma_rad_s,
            yaw_rate_bias_time_s=self.gyro_bias_time_s,
            yaw_rate_bias_bound_rad_s=_BOUND_SIGMAS * self.gyro_bias_sigma_rad_s,
            yaw_rate_noise_rad_s=self.angle_random_walk_rad_sqrt_s / math.sqrt(vehicle.noise_hold_s),
            yaw_rate_scale_sigma=self.gyro_scale_sigma,
            yaw_rate_scale_bound=_BOUND_SIGMAS * self.gyro_scale_sigma,
        )


IMU_NOISE: Final[dict[ImuClass, ImuNoise]] = {
    # BMI160: 0.007 °/s/√Hz, ± 3 °/s that the phone's calibration at rest reduces; 180 µg/√Hz, ± 40 mg.
    "phone": ImuNoise(
        angle_random_walk_rad_sqrt_s=math.radians(0.007),
        gyro_bias_sigma_rad_s=math.radians(0.5),  # chosen: a sixth of the zero-rate offset
        gyro_instability_rad_s=20.0 * _DEG_PER_HOUR,  # chosen: the data sheet gives none
        gyro_scale_sigma=0.01,
        velocity_random_walk_m_s_sqrt_s=180e-6 * STANDARD_GRAVITY_M_S2,
        accelerometer_bias_sigma_m_s2=0.04 * STANDARD_GRAVITY_M_S2,
    ),
    # ADIS16465: 0.15 °/√h, 2 °/h in-run; 0.012 m/s/√h.
    "mems": ImuNoise(
        angle_random_walk_rad_sqrt_s=math.radians(0.15) / 60.0,
        gyro_bias_sigma_rad_s=math.radians(0.2),  # not calibrated after switching on
        gyro_instability_rad_s=2.0 * _DEG_PER_HOUR,
        gyro_scale_sigma=0.003,  # chosen: over temperature
        velocity_random_walk_m_s_sqrt_s=0.012 / 60.0,
        accelerometer_bias_sigma_m_s2=0.0015 * STANDARD_GRAVITY_M_S2,
    ),
    # STIM300: 0.15 °/√h, 0.5 °/h in-run, ± 250 °/h at switching on, 500 ppm; 0.06 m/s/√h, 2 mg over temperature.
    "tactical": ImuNoise(
        angle_random_walk_rad_sqrt_s=math.radians(0.15) / 60.0,
        gyro_bias_sigma_rad_s=250.0 / 3.0 * _DEG_PER_HOUR,  # ± 250 °/h as three sigma
        gyro_instability_rad_s=0.5 * _DEG_PER_HOUR,
        gyro_scale_sigma=0.0005,
        velocity_random_walk_m_s_sqrt_s=0.06 / 60.0,
        accelerometer_bias_sigma_m_s2=0.002 * STANDARD_GRAVITY_M_S2,
    ),
}
