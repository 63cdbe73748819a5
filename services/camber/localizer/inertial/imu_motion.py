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
from camber.localizer.filter.pose_model import AccelerationModel, PoseModel
from camber.localizer.inertial.imu_noise import IMU_NOISE, ImuNoise
from camber.localizer.inertial.strapdown import ForwardSpeed, StrapdownIntegration
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.schemas.motion import Imu, Motion

SampleOrder: TypeAlias = Literal["newer", "repeated", "backwards"]

_FRESH_NS: Final = 250_000_000  # chosen: two samples of a bus of 10 Hz, and its latency
_SILENT_NS: Final = (
    300_000_000  # chosen: less than a gap of `MotionModel.max_step_s`, so that the wheels go on
)
_SURE_TILT_RAD: Final = math.radians(0.5)  # chosen: beyond it overlaid sweeps are better aligned by the road
_VIBRATION_M_S_SQRT_S: Final = (
    0.02  # chosen: what the road shakes, and what scale and misalignment make of it
)
_WHEEL_SIGMA_M_S: Final = 0.05  # as `MotionModel.speed_noise_m_s`
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
        self._step_ns: int | None = None  # time of the last sample that was made

    @property
    def is_upright(self) -> bool:
        """Whether gravity points where the unit's mounting says."""
        return self._strapdown.is_upright

    def outcome(self, sample: Imu | Motion) -> SampleOrder:
        """Whether a sample is newer than the last one of its kind."""
        if isinstance(sample, Imu):
            last_ns = self._strapdown.time_ns
        else:
            last_ns = None if self._vehicle is None else self._vehicle.time_ns
        if last_ns is None or sample.time_ns > last_ns:
            return "newer"
        return "repeated" if sample.time_ns == last_ns else "backwards"

    def on_vehicle(self, motion: Motion) -> Motion | None:
        """Take a sample of the vehicle's own sensors; return it without its yaw rate where the unit is silent."""
        self._vehicle = motion
        if self._step_ns is not None and motion.time_ns - self._step_ns <= _SILENT_NS:
            return None
        return motion.model_copy(update={"yaw_rate_rad_s": None})

    def on_imu(
        self, imu: Imu, speed: Callable[[], ForwardSpeed | None], *, wheels_slip: bool = False
    ) -> InertialSample | None:
        """Take a sample of the unit; return one of the motion where due.

        The tilt is levelled by the wheels' speed, unless they slip, else by `speed`, which no fix may have a part in.
        """
        vehicle = self._fresh(imu.time_ns)
        wheel_m_s = None if vehicle is None or wheels_slip else vehicle.wheel_speed_m_s
        by_wheels = None if wheel_m_s is None else ForwardSpeed(wheel_m_s, _WHEEL_SIGMA_M_S)
        step = self._strapdown.add(imu, lambda: speed() if by_wheels is None else by_wheels)
        if step is None:
            return None
        self._step_ns = step.time_ns
        tilt: tuple[float | None, float | None] = (None, None)
        if vehicle is not None and vehicle.roll_rad is not None and vehicle.pitch_rad is not None:
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
