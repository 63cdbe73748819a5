"""Strap-down integration of an inertial measurement unit: yaw rate, forward acceleration, roll and pitch of the body.

Samples are turned into the vehicle's axes and moved to its reference point: `f = f_imu − ω' × l − ω × (ω × l)` with the
lever arm l (Groves, 2nd ed., eq. 5.94). A step of `_STEP_NS` holds the turn about the vertical and the mean forward
acceleration without gravity. A vehicle whose rear axle does not slip has no other speed than forwards (non-holonomic
constraint), which is why the forward acceleration alone is integrated by the pose filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2
from camber.localizer.filter.odometry import InertialReading
from camber.localizer.inertial.imu_noise import ImuNoise
from camber.localizer.inertial.quiet_detection import QuietDetection
from camber.localizer.inertial.tilt_filter import LevelingForce, TiltFilter
from camber.localizer.matching.sweep_preparation import SensorMount
from camber.schemas.motion import Imu

_STEP_NS: Final = 20_000_000  # chosen: as motion samples of a vehicle; a turn of 1 rad/s is 0.02 rad in it
_GAP_NS: Final = 500_000_000  # as `MotionModel.max_step_s`
_LEVEL_NS: Final = 600_000_000  # chosen: a shorter time than a body swings on its springs is no use
_UNKNOWN_ACCELERATION_M_S2: Final = 1.0  # chosen: of traffic, 1 σ
_ACCELERATES_FOR_S: Final = 5.0  # chosen: correlation time of that
_SIDE_FORCE_M_S2: Final = 0.1  # chosen: side slip and camber of the road, and a share of the turn
_SIDE_FORCE_SHARE: Final = 0.05  # chosen: a wheelbase and a scale of the wheels that are off by so much
_LEAST_UP: Final = 0.5  # chosen: share of gravity along z; less is another mounting, or another unit of force
_Vector = tuple[float, float, float]


class ForwardSpeed(NamedTuple):
    """Speed of the vehicle by something other than the accelerometer, and its σ."""

    speed_m_s: float
    sigma_m_s: float


_AT_REST: Final = ForwardSpeed(0.0, 0.05)  # chosen: what is quiet when it is switched on stands


class InertialStep(NamedTuple):
    """Motion since the last step, up to `time_ns`: the turn about the vertical, and the rest in `reading`."""

    time_ns: int
    yaw_rate_rad_s: float
    reading: InertialReading
    tilt_sigma_rad: float


class StrapdownIntegration:
    """Integrates the samples of one unit. Call `add` with each."""

    def __init__(self, noise: ImuNoise, mount: SensorMount) -> None:
        self._noise = noise
        rotation = mount.vehicle_from_sensor[:3, :3]
        self._rotation = tuple(tuple(row) for row in rotation.tolist())
        self._lever_m: _Vector = (mount.x_m, mount.y_m, mount.z_m)
        self._tilt = TiltFilter(noise)
        self._last: tuple[int, _Vector, _Vector] | None = None  # time, rate and force of the last sample
        self._step = _StepIntegrals()
        self._leveling = _LevelingIntegrals()
        self._leveled_m_s2 = 0.0  # by levelling since the last step
        self._step_rate: _Vector | None = None  # mean rate of the last step, for the angular acceleration
        self._angular_acceleration: _Vector = (0.0, 0.0, 0.0)
        self._quiet = QuietDetection(noise)
        self._quiet_s = 0.0
        self.is_upright = True
        """Whether the force points up in the vehicle's axes, as the mounting says."""

    @property
    def time_ns(self) -> int | None:
        """Time of the last sample."""
        return None if self._last is None else self._last[0]

    def add(self, sample: Imu, speed: Callable[[], ForwardSpeed | None]) -> InertialStep | None:
        """Add a sample; return a step where one is complete. `speed` is asked for when the tilt is levelled.

        Samples are in order of time, as `ImuMotion.outcome` says; after a gap nothing before it counts.
        """
        rate, force = (
            self._in_vehicle(sample.angular_rate_rad_s),
            self._in_vehicle(sample.specific_force_m_s2),
        )
        last, self._last = self._last, (sample.time_ns, rate, force)
        if last is None or sample.time_ns - last[0] > _GAP_NS:
            self._restart()
            return None
        dt_s = (sample.time_ns - last[0]) * 1e-9
        mean_rate, measured = _mean(last[1], rate), _mean(last[2], force)
        mean_force = self._at_origin(mean_rate, measured)
        turned = self._tilt.rotate(mean_rate, dt_s)
        gravity_x = self._tilt.gravity_m_s2[0]
        self._step.add(mean_rate, measured, dt_s)
        self._step.turned_rad += turned
        self._step.speed_change_m_s += (mean_force[0] - gravity_x) * dt_s
        self._leveling.add(mean_rate, mean_force, dt_s)
        if self._step.duration_s * 1e9 < 0.999 * _STEP_NS:
            return None
        step = self._finish_step(sample.time_ns)
        if self._leveling.duration_s * 1e9 >= _LEVEL_NS:
            self._level(speed())
        return step

    def _finish_step(self, time_ns: int) -> InertialStep | None:
        step, self._step = self._step, _StepIntegrals()
        leveled, self._leveled_m_s2 = self._leveled_m_s2, 0.0
        duration = step.duration_s
        rate = step.mean_rate
        if self._step_rate is not None:
            before = self._step_rate
            x, y, z = ((now - then) / duration for now, then in zip(rate, before, strict=True))
            self._angular_acceleration = (x, y, z)
        self._step_rate = rate
        self._quiet_s = self._quiet.add(time_ns, step.mean_force, rate, step_s=duration)
        if not self._tilt.is_level or not self.is_upright:
            return None
        return InertialStep(
            time_ns=time_ns,
            yaw_rate_rad_s=step.turned_rad / duration,
            reading=InertialReading(
                acceleration_m_s2=step.speed_change_m_s / duration,
                roll_rad=self._tilt.roll_rad,
                pitch_rad=self._tilt.pitch_rad,
                leveled_m_s2=leveled,
                quiet_s=self._quiet_s,
            ),
            tilt_sigma_rad=self._tilt.sigma_rad,
        )

    def _level(self, speed: ForwardSpeed | None) -> None:
        """Level by the mean force since the last time, and note what that changes of the forward acceleration."""
        was_level, gravity_x = self._tilt.is_level, self._tilt.gravity_m_s2[0]
        force, up_m_s2 = self._leveling_force(speed)
        self.is_upright = up_m_s2 > _LEAST_UP * STANDARD_GRAVITY_M_S2
        if not self.is_upright:
            self._tilt.restart()
            return
        self._tilt.level(force, up_m_s2)
        if was_level:
            self._leveled_m_s2 += self._tilt.gravity_m_s2[0] - gravity_x

    def _leveling_force(self, speed: ForwardSpeed | None) -> tuple[LevelingForce, float]:
        """Return the mean force since the last time, less what the vehicle's acceleration has made of it, and its z."""
        sums, self._leveling = self._leveling, _LevelingIntegrals()
        t = sums.duration_s
        x, y, z = sums.mean_force
        begin, self._leveling.begin = sums.begin, speed
        if speed is None and not self._tilt.is_level and self._quiet_s > 0.0:
            speed = begin = _AT_REST
        # An unknown acceleration, correlated over τ: its mean over t weighs as much as t / (2 τ) independent ones.
        unknown = _UNKNOWN_ACCELERATION_M_S2 * math.sqrt(max(1.0, 2.0 * _ACCELERATES_FOR_S / t))
        ahead, left, sigma_ahead, sigma_left = 0.0, 0.0, unknown, unknown
        if speed is not None:
            turn_rad_s = sums.mean_rate[2]
            left = speed.speed_m_s * turn_rad_s
            # The turn has the bias of the gyro in it.
            unknown_turn_rad_s = abs(turn_rad_s) * _SIDE_FORCE_SHARE + self._noise.gyro_bias_sigma_rad_s
            sigma_left = _SIDE_FORCE_M_S2 + abs(speed.speed_m_s) * unknown_turn_rad_s
            sigma_left += speed.sigma_m_s * abs(turn_rad_s)
        if speed is not None and begin is not None:
            ahead = (speed.speed_m_s - begin.speed_m_s) / t
            sigma_ahead = math.sqrt(2.0) * speed.sigma_m_s / t
        force = LevelingForce(
            x_m_s2=x - ahead,
            y_m_s2=y - left,
            sigma_x_m_s2=sigma_ahead,
            sigma_y_m_s2=sigma_left,
            duration_s=t,
        )
        return force, z

    def _in_vehicle(self, vector: _Vector) -> _Vector:
        x, y, z = vector
        a, b, c = self._rotation
        return (
            a[0] * x + a[1] * y + a[2] * z,
            b[0] * x + b[1] * y + b[2] * z,
            c[0] * x + c[1] * y + c[2] * z,
        )

    def _at_origin(self, rate: _Vector, force: _Vector) -> _Vector:
        """Return the specific force at the vehicle's reference point."""
        by_turn = _cross(rate, _cross(rate, self._lever_m))
        by_acceleration = _cross(self._angular_acceleration, self._lever_m)
        x, y, z = (f - a - b for f, a, b in zip(force, by_turn, by_acceleration, strict=True))
        return x, y, z

    def _restart(self) -> None:
        self._tilt.restart()
        self._step, self._leveling, self._step_rate = _StepIntegrals(), _LevelingIntegrals(), None
        self._leveled_m_s2 = 0.0
        self._angular_acceleration = (0.0, 0.0, 0.0)
        self._quiet.forget()
        self._quiet_s = 0.0


class _Integrals:
    """Integrals of turn and force over an interval."""

    def __init__(self) -> None:
        self.duration_s = 0.0
        self._rate = [0.0, 0.0, 0.0]
        self._force = [0.0, 0.0, 0.0]

    def add(self, rate: _Vector, force: _Vector, dt_s: float) -> None:
        self.duration_s += dt_s
        for axis in range(3):
            self._rate[axis] += rate[axis] * dt_s
            self._force[axis] += force[axis] * dt_s

    @property
    def mean_rate(self) -> _Vector:
        x, y, z = (value / self.duration_s for value in self._rate)
        return x, y, z

    @property
    def mean_force(self) -> _Vector:
        x, y, z = (value / self.duration_s for value in self._force)
        return x, y, z


class _StepIntegrals(_Integrals):
    """Those of a step, the force as measured, and what the tilt makes of them."""

    def __init__(self) -> None:
        super().__init__()
        self.turned_rad = self.speed_change_m_s = 0.0


class _LevelingIntegrals(_Integrals):
    """Those since the tilt was last levelled, the force at the reference point, and the speed at their begin."""

    def __init__(self) -> None:
        super().__init__()
        self.begin: ForwardSpeed | None = None


def _mean(one: _Vector, other: _Vector) -> _Vector:
    return 0.5 * (one[0] + other[0]), 0.5 * (one[1] + other[1]), 0.5 * (one[2] + other[2])


def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
