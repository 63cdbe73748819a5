"""Wheel odometry: vehicle sensor readings become the motion between them, with its variance.

What is missing is stated in `MotionStep.outcome` and covered by the variance; nothing raises:

- *missing yaw rate*: taken as zero, with a σ that grows in proportion to the time;
- *missing speed*: the last one is held, with an acceleration of unknown sign;
- *gap in time*: speed and yaw rate in between are unknown within what the vehicle can do;
- *repeated* or *backwards* samples are ignored.

At a standstill (wheel speed and yaw rate both quiet for a while) nothing is integrated. Wheel sensors have a dead zone:
they read exactly zero while the vehicle still creeps, always forward, 0.25 m per stop on average in the Nagoya
recording. `creep_m` and `creep_sigma_m` cover this at the beginning and the end of a stop, `crawl_m_sqrt_s` during
it, for `crawl_for_s` at most. A vehicle that crawls longer below the dead zone is not detected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

from camber.schemas.motion import Motion

RateSensor: TypeAlias = Literal["yaw_rate", "steering"]
SampleOutcome: TypeAlias = Literal["first", "applied", "gap", "repeated", "backwards"]

_MAX_STEERING_RAD: Final = 1.4  # chosen: beyond it the tangent of the bicycle model runs away
_GAIN_NOISE_SHARE: Final = 0.3  # chosen: share of a gain's error that changes from one turn to the next


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionModel:
    """Error model of the vehicle's sensors.

    The numbers are those of production cars; docs/theory/odometry.md has their sources. The consistency tests (NEES) of
    `tests/unit/localizer/filter` and `support.tunnel_statistics` check what follows from them. Noise is per reading and
    held for `noise_hold_s`: reading ten times as often does not average it out. Lasting errors are Gauss-Markov
    processes of their initial σ, so that they cannot walk away; beyond its bound an error is a fault (`sensor_bounds`).
    """

    a_rate_sensor: RateSensor = "yaw_rate"
    wheelbase_m: float = 2.7
    speed_scale_sigma: float = 0.005
    speed_scale_length_m: float = 20_000.0  # pressure and radius follow the tyre's temperature
    speed_scale_bound: float = 0.02  # wear 1 %, pressure 0.3 %, load and temperature 0.2 %, calibration 0.5 %
    speed_noise_m_s: float = 0.05
    wheel_lag_s: float = 0.05  # initial value: half of a counting interval of 100 ms
    wheel_lag_sigma_s: float = 0.05
    wheel_lag_wander_s_sqrt_s: float = 5e-4  # clocks of control units drift against one another
    speed_dead_zone_m_s: float = 0.35
    yaw_rate_bias_sigma_rad_s: float = math.radians(0.05)
    yaw_rate_bias_time_s: float = 20_000.0
    yaw_rate_bias_bound_rad_s: float = math.radians(3.75)  # of an ESP sensor over life and temperature
    yaw_rate_noise_rad_s: float = math.radians(0.1)
    yaw_rate_scale_sigma: float = 0.01  # sensitivity and non-linearity of an ESP sensor
    yaw_rate_scale_bound: float = 0.04
    steering_bias_sigma_rad: float = math.radians(0.5)
    steering_bias_time_s: float = 20_000.0
    steering_bias_bound_rad: float = math.radians(
        1.5
    )  # 24° of the steering wheel: no wheel alignment is so far off
    steering_noise_rad: float = math.radians(0.2)
    steering_scale_sigma: float = 0.02
    steering_scale_bound: float = 0.1
    side_slip_sigma_rad_s2_m: float = 0.005
    lateral_noise_m_sqrt_m: float = 0.01
    noise_hold_s: float = 0.2
    turn_hold_s: float = 5.0
    max_step_s: float = 0.5
    max_bridge_s: float = 60.0
    unknown_acceleration_m_s2: float = 1.5
    unknown_rate_rad_s: float = 0.35
    unknown_speed_m_s: float = 10.0
    max_speed_m_s: float = 40.0
    standstill_speed_m_s: float = 0.15
    standstill_rate_rad_s: float = math.radians(1.0)
    standstill_after_s: float = 0.6
    creep_m: float = 0.1
    creep_sigma_m: float = 0.2
    crawl_m_sqrt_s: float = 0.02
    crawl_for_s: float = 120.0

    @property
    def b_rate_sensor(self) -> RateSensor:
        """The rotation sensor of system B: the one that system A does not use."""
        return "steering" if self.a_rate_sensor == "yaw_rate" else "yaw_rate"

    def bias_sigma(self, sensor: RateSensor) -> float:
        """Return the initial σ of the sensor's bias: rad/s (yaw rate) or rad (steering)."""
        return self.yaw_rate_bias_sigma_rad_s if sensor == "yaw_rate" else self.steering_bias_sigma_rad

    def gain_sigma(self, sensor: RateSensor) -> float:
        """Return the σ of the sensor's gain, relative to the yaw rate."""
        return self.yaw_rate_scale_sigma if sensor == "yaw_rate" else self.steering_scale_sigma

    def gain_bound(self, sensor: RateSensor) -> float:
        """Return the largest error of the sensor's gain, relative to the yaw rate."""
        return self.yaw_rate_scale_bound if sensor == "yaw_rate" else self.steering_scale_bound

    def bias_time_s(self, sensor: RateSensor) -> float:
        """Return the correlation time of that bias."""
        return self.yaw_rate_bias_time_s if sensor == "yaw_rate" else self.steering_bias_time_s


class MotionStep(NamedTuple):
    """The motion between two samples: means of raw readings, and variances of what integrates from them."""

    outcome: SampleOutcome
    dt_s: float = 0.0
    standing: bool = False
    speed_m_s: float = 0.0
    yaw_rate_rad_s: float | None = None
    steering_rad: float | None = None
    speed_sigma_m_s: float = 0.0
    along_var_m2: float = 0.0
    unknown_rate_var_rad2: float = 0.0  # of the turn, where the yaw rate is missing or the step too long
    creep_m: float = 0.0  # driven undetected where a stop begins or ends
    creep_var_m2: float = 0.0
    wheel_change_m_s: float = 0.0  # change of wheel speed over the step
    wheel_m_s: float = 0.0  # wheel speed at its end
    is_integrated: bool = False  # the speed is integrated from an accelerometer, as the wheels gave none


class InertialReading(NamedTuple):
    """What an inertial unit adds to a motion sample: mean forward acceleration since the last one, without gravity,
    and the body's roll and pitch. The yaw rate of such a sample is the mean since the last one, too.

    `leveled_m_s2`: by how much that acceleration is less because the tilt was levelled since the last sample, which is
    no acceleration. `quiet_s`: how long neither force nor rate has changed.
    """

    acceleration_m_s2: float
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    leveled_m_s2: float = 0.0
    quiet_s: float = 0.0


class YawRate(NamedTuple):
    """Yaw rate by one sensor over a step, and its derivatives by that sensor's bias and gain and by the wheel scale."""

    rate_rad_s: float = 0.0
    d_bias: float = 0.0
    d_scale: float = 0.0
    turn_var_rad2: float = 0.0
    d_gain: float = 0.0


class _Interval(NamedTuple):
    """Two consecutive samples; `is_gap` where too much time lies between them to interpolate."""

    last: Motion
    sample: Motion
    dt_s: float
    is_gap: bool


class WheelOdometry:
    """Keeps the last sample and computes the motion up to the next one."""

    def __init__(self, model: MotionModel) -> None:
        self._model = model
        self._last: Motion | None = None
        self._integrates = False  # the last speed was integrated
        self._held_speed_m_s: float | None = None
        self._speed_missing_s = 0.0
        self._rate_missing_s = 0.0
        self._quiet_s = 0.0
        self.standing = False
        self._direction = 1.0
        self._in_dead_zone = False  # the wheels have read exactly zero during this stop

    @property
    def time_ns(self) -> int | None:
        """Time of the last sample used."""
        return self._last.time_ns if self._last else None

    def advance(
        self,
        sample: Motion,
        yaw_rate_bias_rad_s: float,
        inertial: InertialReading | None = None,
        *,
        may_stand: bool = False,
    ) -> MotionStep:
        """Return the motion since the last sample. The bias is used for standstill detection only.

        Where the wheels give no speed, the accelerometer of `inertial` carries the last one on; `may_stand`: by that
        speed and by the unit's quiet the vehicle stands, unless it turns.
        """
        last = self._last
        if last is None:
            self._last, self._held_speed_m_s = sample, sample.wheel_speed_m_s
            return MotionStep("first")
        if sample.time_ns <= last.time_ns:
            return MotionStep("repeated" if sample.time_ns == last.time_ns else "backwards")
        model, dt = self._model, (sample.time_ns - last.time_ns) * 1e-9
        interval = _Interval(last, sample, dt, dt > model.max_step_s)
        if sample.wheel_speed_m_s is None and inertial is not None and not interval.is_gap:
            rate = sample.yaw_rate_rad_s
            turns = rate is not None and abs(rate - yaw_rate_bias_rad_s) > model.standstill_rate_rad_s
            return self._integrate(interval, inertial, standing=may_stand and not turns)
        was_standing, was_in_dead_zone = self.standing, self._in_dead_zone
        self.standing = self._detect_standstill(interval, yaw_rate_bias_rad_s)
        creeps = was_standing != self.standing and (was_in_dead_zone or self._in_dead_zone)
        along_var = self._along_variance(interval, was_standing)
        before, after = self._speeds(interval)
        speed = 0.5 * (before + after)
        rate_var = self._unknown_rate_variance(interval, speed)
        if abs(speed) > model.standstill_speed_m_s:
            self._direction = speed
        self._last = sample
        return MotionStep(
            outcome="gap" if interval.is_gap else "applied",
            dt_s=dt,
            standing=was_standing and self.standing,
            speed_m_s=speed,
            yaw_rate_rad_s=(
                _mean(last.yaw_rate_rad_s, sample.yaw_rate_rad_s)
                if inertial is None
                else sample.yaw_rate_rad_s
            ),
            steering_rad=_mean(last.steering_angle_rad, sample.steering_angle_rad),
            speed_sigma_m_s=self._speed_sigma(sample),
            along_var_m2=along_var,
            unknown_rate_var_rad2=rate_var,
            creep_m=math.copysign(model.creep_m, self._direction) if creeps else 0.0,
            creep_var_m2=model.creep_sigma_m**2 if creeps else 0.0,
            wheel_change_m_s=0.0 if interval.is_gap else after - before,
            wheel_m_s=after,
        )

    def _integrate(self, interval: _Interval, inertial: InertialReading, *, standing: bool) -> MotionStep:
        """Return the motion of a step by the accelerometer; the error of its speed is a state of the filter."""
        dt, sample = interval.dt_s, interval.sample
        before = self._held_speed_m_s or 0.0
        after = before if standing else before + inertial.acceleration_m_s2 * dt
        was_standing, self.standing = self.standing, standing
        self._in_dead_zone, self._quiet_s, self._speed_missing_s = False, 0.0, 0.0
        self._held_speed_m_s, self._last, self._integrates = after, sample, True
        speed = 0.5 * (before + after)
        crawls = was_standing and standing
        return MotionStep(
            outcome="applied",
            dt_s=dt,
            standing=was_standing and self.standing,
            speed_m_s=speed,
            yaw_rate_rad_s=sample.yaw_rate_rad_s,
            steering_rad=_mean(interval.last.steering_angle_rad, sample.steering_angle_rad),
            along_var_m2=self._model.crawl_m_sqrt_s**2 * dt if crawls else 0.0,
            unknown_rate_var_rad2=self._unknown_rate_variance(interval, speed),
            wheel_m_s=after,
            is_integrated=True,
        )

    def _detect_standstill(self, interval: _Interval, bias: float) -> bool:
        model = self._model
        speed, rate = interval.sample.wheel_speed_m_s, interval.sample.yaw_rate_rad_s
        quiet = speed is not None and abs(speed) <= model.standstill_speed_m_s
        if rate is not None and abs(rate - bias) > model.standstill_rate_rad_s:
            quiet = False
        has_dead_zone = model.speed_dead_zone_m_s > 0.0
        self._in_dead_zone = quiet and has_dead_zone and (speed == 0.0 or self._in_dead_zone)
        self._quiet_s = self._quiet_s + interval.dt_s if quiet and not interval.is_gap else 0.0
        return self._quiet_s >= model.standstill_after_s

    def _speeds(self, interval: _Interval) -> tuple[float, float]:
        last_m_s, now_m_s = interval.last.wheel_speed_m_s, interval.sample.wheel_speed_m_s
        before = last_m_s if last_m_s is not None else self._held_speed_m_s
        if now_m_s is not None:
            self._held_speed_m_s = now_m_s
        after = self._held_speed_m_s or 0.0
        if now_m_s is not None and self._integrates:
            self._integrates, before = (
                False,
                after,
            )  # an integrated speed and the wheels' differ by no acceleration
        return after if before is None else before, after

    def _along_variance(self, interval: _Interval, was_standing: bool) -> float:
        model, dt = self._model, interval.dt_s
        if was_standing and self.standing:
            crawls = self._in_dead_zone and self._quiet_s <= model.crawl_for_s
            return model.crawl_m_sqrt_s**2 * dt if crawls else 0.0
        noise = self._speed_sigma(interval.sample)
        variance = noise * noise * max(dt, model.noise_hold_s) * dt
        if interval.sample.wheel_speed_m_s is None or interval.last.wheel_speed_m_s is None:
            before = self._missing_speed_sigma_m()
            self._speed_missing_s += dt
            variance += self._missing_speed_sigma_m() ** 2 - before**2
        elif interval.is_gap:
            variance += min(0.25 * model.unknown_acceleration_m_s2 * dt, model.max_speed_m_s) ** 2 * dt * dt
        if interval.sample.wheel_speed_m_s is not None:
            self._speed_missing_s = 0.0
        return variance

    def _speed_sigma(self, sample: Motion) -> float:
        """Return σ of one reading; below the dead zone the wheels may read zero or anything."""
        model, speed = self._model, sample.wheel_speed_m_s
        if speed is None or abs(speed) > model.speed_dead_zone_m_s:
            return model.speed_noise_m_s
        return max(model.speed_noise_m_s, model.speed_dead_zone_m_s / math.sqrt(3.0))

    def _missing_speed_sigma_m(self) -> float:
        """Return σ of the distance driven since the speed went missing."""
        model = self._model
        speed = 0.5 * model.unknown_acceleration_m_s2 * self._speed_missing_s
        if self._held_speed_m_s is None:
            speed += model.unknown_speed_m_s
        return min(speed, model.max_speed_m_s) * self._speed_missing_s

    def _unknown_rate_variance(self, interval: _Interval, speed: float) -> float:
        """Return the variance of the turn where the yaw rate is unknown: coherent, so it grows with time squared."""
        model, dt = self._model, interval.dt_s
        if interval.is_gap:
            return min(0.5 * model.unknown_rate_rad_s * dt, math.pi) ** 2
        sensor = model.a_rate_sensor
        if reading(interval.sample, sensor) is not None and reading(interval.last, sensor) is not None:
            self._rate_missing_s = 0.0
            return 0.0
        before = self._rate_missing_s
        self._rate_missing_s += dt
        sigma = model.unknown_rate_rad_s * min(1.0, 0.1 + abs(speed))
        return sigma * sigma * (self._rate_missing_s**2 - before**2)


def reading(sample: Motion, sensor: RateSensor) -> float | None:
    """Return what a rotation sensor gave."""
    return sample.yaw_rate_rad_s if sensor == "yaw_rate" else sample.steering_angle_rad


def _mean(before: float | None, after: float | None) -> float | None:
    return None if before is None or after is None else 0.5 * (before + after)


def yaw_rate(
    step: MotionStep,
    sensor: RateSensor,
    model: MotionModel,
    *,
    bias: float,
    scale: float,
    gain: float | None = None,
) -> YawRate | None:
    """Return the yaw rate over a step by one sensor (steering: bicycle model); None where it gave none.

    `gain` is the estimate of the sensor's gain; None where it is no state: then its error counts as noise.
    """
    dt, held_s = step.dt_s, max(step.dt_s, model.noise_hold_s)
    if sensor == "yaw_rate":
        if step.yaw_rate_rad_s is None:
            return None
        rate, d_bias, d_scale = step.yaw_rate_rad_s - bias, -1.0, 0.0
        noise = model.yaw_rate_noise_rad_s
    else:
        if step.steering_rad is None:
            return None
        angle = max(-_MAX_STEERING_RAD, min(_MAX_STEERING_RAD, step.steering_rad - bias))
        per_wheelbase = step.speed_m_s / model.wheelbase_m
        d_scale = per_wheelbase * math.tan(angle)
        rate, d_bias = (1.0 + scale) * d_scale, -(1.0 + scale) * per_wheelbase / math.cos(angle) ** 2
        by_speed = step.speed_sigma_m_s * math.tan(angle) / model.wheelbase_m
        noise = math.hypot(d_bias * model.steering_noise_rad, by_speed)
    gain_sigma = model.gain_sigma(sensor) * (1.0 if gain is None else _GAIN_NOISE_SHARE)
    turn_var = noise * noise * held_s * dt + (gain_sigma * rate) ** 2 * max(dt, model.turn_hold_s) * dt
    if gain is None:
        return YawRate(rate, d_bias, d_scale, turn_var)
    more = 1.0 + gain
    return YawRate(
        rate_rad_s=more * rate,
        d_bias=more * d_bias,
        d_scale=more * d_scale,
        turn_var_rad2=turn_var,
        d_gain=rate,
    )
