"""An inertial unit with the vehicle's wheels, and what happens where one of them is silent."""

from __future__ import annotations

import math

import pytest

from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.inertial.imu_motion import (
    ImuMotion,
    ImuOptions,
    InertialSample,
    with_imu,
)
from camber.localizer.inertial.imu_noise import IMU_NOISE
from camber.schemas.motion import Imu, Motion
from support.imu_truth import BEGIN_NS, AnalyticMotion
from support.pose_inputs import start_pose

OPTIONS = ImuOptions(noise=IMU_NOISE["mems"])
CIRCLE = AnalyticMotion(angles=lambda t: (0.0, 0.0, 0.2 * t), speed=lambda t: 5.0)


class Vehicle:
    """Drives a circle; unit and wheels may fall silent."""

    def __init__(self) -> None:
        self.inertial, self.samples, self.alone = (
            ImuMotion(OPTIONS),
            list[InertialSample](),
            list[Motion](),
        )
        self.t_s = 0.0

    def run(self, seconds: float, *, imu: bool = True, wheels: bool = True) -> None:
        for _ in range(round(seconds * 100)):
            self.t_s += 0.01
            time_ns = BEGIN_NS + round(self.t_s * 1e9)
            if wheels and round(self.t_s * 100) % 2 == 0:
                vehicle = Motion(
                    time_ns=time_ns, wheel_speed_m_s=5.0, yaw_rate_rad_s=1.0, steering_angle_rad=0.1
                )
                alone = self.inertial.on_vehicle(vehicle)
                if alone is not None:
                    self.alone.append(alone)
            if imu:
                sample = self.inertial.on_imu(CIRCLE.imu(self.t_s), lambda: None)
                if sample is not None:
                    self.samples.append(sample)


def test_the_unit_gives_the_turn_and_the_vehicle_speed_and_steering() -> None:
    vehicle = Vehicle()
    vehicle.run(3.0)
    motion = vehicle.samples[-1].motion
    assert motion.yaw_rate_rad_s == pytest.approx(0.2, abs=1e-3)
    assert motion.wheel_speed_m_s == 5.0
    assert motion.steering_angle_rad == 0.1
    assert len(vehicle.samples) == pytest.approx(50 * 2.4, abs=2)  # once levelled


def test_a_silent_unit_leaves_the_wheels_without_a_yaw_rate() -> None:
    vehicle = Vehicle()
    vehicle.run(3.0)
    assert [motion.time_ns for motion in vehicle.alone if motion.time_ns > BEGIN_NS + 10**9] == []
    vehicle.run(2.0, imu=False)
    assert len(vehicle.alone) >= 70
    assert vehicle.alone[-1].yaw_rate_rad_s is None
    assert vehicle.alone[-1].wheel_speed_m_s == 5.0


def test_silent_wheels_leave_the_speed_to_the_accelerometer() -> None:
    vehicle = Vehicle()
    vehicle.run(3.0)
    vehicle.run(1.0, wheels=False)
    motion, reading = vehicle.samples[-1]
    assert motion.wheel_speed_m_s is None
    assert reading is not None
    assert reading.acceleration_m_s2 == pytest.approx(0.0, abs=0.05)


def test_an_old_sample_is_named_by_its_kind() -> None:
    vehicle = Vehicle()
    vehicle.run(1.0)
    assert vehicle.inertial.outcome(CIRCLE.imu(1.0)) == "repeated"
    assert vehicle.inertial.outcome(CIRCLE.imu(0.5)) == "backwards"
    assert vehicle.inertial.outcome(CIRCLE.imu(1.01)) == "newer"


@pytest.mark.parametrize("imu", ["phone", "mems", "tactical"])
def test_the_filter_has_the_noise_of_the_unit(imu: str) -> None:
    """White noise of the rate integrates to the angle random walk, whatever the rate of samples."""
    noise = IMU_NOISE[imu]  # type: ignore[index]
    motion = noise.motion_model(MotionModel())
    pose_filter = PoseFilter(with_imu(PoseModel(), ImuOptions(noise=noise)))
    assert pose_filter.model.motion == motion
    for k in range(501):
        pose_filter.predict(
            Motion(time_ns=BEGIN_NS + k * 20_000_000, wheel_speed_m_s=0.5, yaw_rate_rad_s=0.0)
        )
        if k == 0:
            pose_filter.start(start_pose(BEGIN_NS, (0.0, 0.0, 0.0), sigma_m=0.1, yaw_deg=1e-6))
    walked = noise.angle_random_walk_rad_sqrt_s**2 * 10.0
    by_bias = (noise.gyro_bias_sigma_rad_s * 10.0) ** 2
    assert float(pose_filter.state.p[2, 2]) == pytest.approx(walked + by_bias, rel=0.05)


def test_samples_with_another_axis_down_are_turned_by_the_mount() -> None:
    down = Imu(
        time_ns=BEGIN_NS, angular_rate_rad_s=(0.0, 0.0, -0.2), specific_force_m_s2=(0.0, -1.0, -9.80665)
    )
    mount = OPTIONS.mount.__class__(roll_rad=math.pi)
    inertial, made = ImuMotion(ImuOptions(noise=IMU_NOISE["mems"], mount=mount)), []
    for k in range(200):
        sample = inertial.on_imu(down.model_copy(update={"time_ns": BEGIN_NS + k * 10_000_000}), lambda: None)
        if sample is not None:
            made.append(sample)
    assert made[-1].motion.yaw_rate_rad_s == pytest.approx(0.2, abs=0.01)
