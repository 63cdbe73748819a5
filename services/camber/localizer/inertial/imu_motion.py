"""Motion samples of an inertial unit and the vehicle's wheels together.

The unit gives the turns, the wheels the speed. Where the wheels are silent the accelerometer carries the speed on
(`inertial_speed`), and where the unit is silent the wheels go on without a yaw rate: the vehicle's sensor of it
has another bias than the one that the pose filter has learnt.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final, Literal, NamedTuple, TypeAlias

from camber.localizer.filter.odometry import InertialReading
from camber.localizer.filter.pose_estimate import PoseEstimate
from camber.localizer.filter.pose_model import AccelerationModel, PoseModel
from camber.localizer.inertial.imu_noise import IMU_NOISE, ImuNoise
from camber.localizer.inertial.strapdown import ForwardSpeed, StrapdownIntegration
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.schemas.motion import Imu, Motion

ImuOutcome: TypeAlias = Literal["applied", "repeated", "backwards"]

_FRESH_NS: Final = (
    100_000_000  # chosen: two samples of a wheel bus; later the accelerometer knows the speed better
)
_SILENT_NS: Final = 500_000_000  # as `MotionModel.max_step_s`
_SURE_TILT_RAD: Final = math.radians(0.5)  # chosen: beyond it overlaid sweeps are better aligned by the road
_VIBRATION_M_S_SQRT_S: Final = (
    0.02  # chosen: what the road shakes, and what scale and misalignment make of it
)
_WHEEL_SIGMA_M_S: Final = 0.05  # as `MotionModel.speed_noise_m_s`
_POSE_SIGMA_M_S: Final = (
    0.1  # chosen: while matches hold it; the pose states none that is less certain than 0.2
)
_LEVELLING_M_S2: Final = 0.5  # chosen: 3° of tilt by a force that was levelled without any speed


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuOptions:
    """Noise and mounting of an inertial unit."""

    noise: ImuNoise = IMU_NOISE["mems"]
    mount: SensorMount = field(default_factory=SensorMount)

    @property
    def acceleration(self) -> AccelerationModel:
        """Error of the forward acceleration."""
        noise = self.noise
        return AccelerationModel(
            noise_m_s_sqrt_s=math.hypot(noise.velocity_random_walk_m_s_sqrt_s, _VIBRATION_M_S_SQRT_S),
            error_sigma_m_s2=math.hypot(noise.accelerometer_bias_sigma_m_s2, _LEVELLING_M_S2),
        )


class InertialSample(NamedTuple):
    """A motion sample, and what a unit adds to it, if there is one."""

    motion: Motion
    reading: InertialReading | None


class ImuMotion:
    """Makes motion samples of a unit's, each with the newest wheel speed and steering angle."""

    def __init__(self, options: ImuOptions) -> None:
        self._strapdown = StrapdownIntegration(options.noise, options.mount)
        self._vehicle: Motion | None = None  # the newest sample of the vehicle's own sensors

    def outcome(self, imu: Imu) -> ImuOutcome:
        """Whether a sample is newer than the last one."""
        last_ns = self._strapdown.time_ns
        if last_ns is None or imu.time_ns > last_ns:
            return "applied"
        return "repeated" if imu.time_ns == last_ns else "backwards"

    def on_vehicle(self, motion: Motion) -> Motion | None:
        """Take a sample of the vehicle's own sensors; return it without its yaw rate where the unit is silent."""
        last_ns = self._strapdown.time_ns
        if self._vehicle is None or motion.time_ns > self._vehicle.time_ns:
            self._vehicle = motion
        if last_ns is not None and motion.time_ns - last_ns <= _SILENT_NS:
            return None
        return motion.model_copy(update={"yaw_rate_rad_s": None})

    def on_imu(self, imu: Imu, estimate: Callable[[], PoseEstimate | None]) -> InertialSample | None:
        """Take a sample of the unit; return one of the motion where due. `estimate` gives the pose, for its speed."""
        vehicle = self._fresh(imu.time_ns)
        step = self._strapdown.add(imu, lambda: _speed(vehicle, estimate))
        if step is None:
            return None
        has_tilt = vehicle is not None and vehicle.roll_rad is not None and vehicle.pitch_rad is not None
        tilt: tuple[float | None, float | None] = (None, None)
        if has_tilt and vehicle is not None:
            tilt = vehicle.roll_rad, vehicle.pitch_rad
        elif step.tilt_sigma_rad < _SURE_TILT_RAD:
            tilt = step.reading.roll_rad, step.reading.pitch_rad
        motion = Motion(
            time_ns=step.time_ns,
            wheel_speed_m_s=None if vehicle is None else vehicle.wheel_speed_m_s,
            yaw_rate_rad_s=step.yaw_rate_rad_s,
            steering_angle_rad=None if vehicle is None else vehicle.steering_angle_rad,
            roll_rad=tilt[0],
            pitch_rad=tilt[1],
        )
        return InertialSample(motion, step.reading)

    def _fresh(self, time_ns: int) -> Motion | None:
        vehicle = self._vehicle
        return vehicle if vehicle is not None and abs(time_ns - vehicle.time_ns) <= _FRESH_NS else None


def with_imu(model: PoseModel, options: ImuOptions) -> PoseModel:
    """Return the parameters of a pose filter that this unit drives."""
    return replace(model, motion=options.noise.motion_model(model.motion), acceleration=options.acceleration)


def _speed(vehicle: Motion | None, estimate: Callable[[], PoseEstimate | None]) -> ForwardSpeed | None:
    """Return the speed by the wheels, else that of the pose, which matches hold."""
    if vehicle is not None and vehicle.wheel_speed_m_s is not None:
        return ForwardSpeed(vehicle.wheel_speed_m_s, _WHEEL_SIGMA_M_S)
    pose = estimate()
    if pose is None or pose.speed_m_s is None:
        return None
    return ForwardSpeed(pose.speed_m_s, _POSE_SIGMA_M_S)
