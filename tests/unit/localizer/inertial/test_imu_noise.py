"""The localizer's noise classes against the errors of simulated units."""

from __future__ import annotations

from typing import get_args

import pytest

from camber.localizer.inertial.imu_noise import IMU_NOISE
from camber.schemas.motion import ImuClass
from camber.simulator.vehicle.imu import UNITS


@pytest.mark.parametrize("imu_class", get_args(ImuClass))
def test_a_unit_is_no_worse_than_its_class(imu_class: ImuClass) -> None:
    noise, unit = IMU_NOISE[imu_class], UNITS[imu_class]
    assert noise.angle_random_walk_rad_sqrt_s >= 0.99 * unit.gyro.noise_density
    assert noise.gyro_bias_sigma_rad_s >= 0.99 * unit.gyro.bias_sigma
    assert noise.gyro_scale_sigma >= unit.gyro.scale_sigma
    assert noise.velocity_random_walk_m_s_sqrt_s >= 0.99 * unit.accelerometer.noise_density
    assert noise.accelerometer_bias_sigma_m_s2 >= 0.99 * unit.accelerometer.bias_sigma
