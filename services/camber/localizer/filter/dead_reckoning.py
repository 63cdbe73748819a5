"""Dead reckoning from wheel speed and a rotation sensor, with its covariance.

Source: CN101360971 (system A), TUMSAT `x += V dt cos(yaw)`, `y += V dt sin(yaw)` (spec/reliability-index.md),
with midpoint integration. Beyond them: the errors that stay (bias, scale, side slip) are states, so that
whatever shows them later also corrects the pose they have spoilt.

What is missing is stated in `MotionStep.outcome` and covered by the covariance, never an exception:

- *missing rotation*: the rate is taken as zero with a sigma that grows in proportion to the time;
- *missing speed*: the last one is held with an acceleration of unknown sign;
- *gap in time*: speed and rate between the two ends are unknown by what the vehicle could have done;
- *repeated* or *backwards* samples change nothing.

At a standstill (wheel speed and rotation both quiet for a while) the pose is held, no noise is integrated,
and the rotation sensor reads its own bias. Wheels that turn too slowly to be counted look the same. Where they
read exactly zero in a dead zone, a stop hides a little way, always forward (0.25 m on average in the Nagoya
recording): `creep_m` and `creep_sigma_m` stand for it at the beginning and the end of a stop, `crawl_m_sqrt_s`
for moving up in the middle of it, `crawl_for_s` at most. Whoever crawls on below the dead zone is not seen.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.links.link_filter import Array

RateSensor: TypeAlias = Literal["yaw_rate", "steering"]
Outcome: TypeAlias = Literal["first", "applied", "gap", "repeated", "backwards"]

EAST: Final = 0
NORTH: Final = 1
YAW: Final = 2
BIAS_A: Final = 3  # of the rotation sensor that drives the pose: rad/s (yaw rate) or rad (steering)
BIAS_B: Final = 4  # of the other one
SCALE: Final = 5  # true speed = (1 + scale) * wheel speed
SIDE_SLIP: Final = 6  # drift angle = -side_slip * speed * yaw rate (rad s^2/m), the rear tyres' compliance
TURN_GAIN: Final = 7  # true rate = (1 + gain) * that of the sensor that drives the pose
WHEEL_LAG: Final = (
    8  # how old the wheels' speed is when it arrives (s): it is counted over a while, and waits
)
WHEEL_SLIP: Final = 9  # speed over ground less what the wheels say (m/s): zero but where they are in doubt
N_MOTION: Final = 10
_GAIN_CHANGES: Final = 0.3  # share of a gain's error that is not the same from one turn to the next


@dataclass(frozen=True, slots=True)
class MotionSample:
    """One reading of the vehicle's own sensors; None where a sensor gave nothing.

    Speed at the vehicle's reference point (the rear axle's middle), negative in reverse; yaw rate
    counter-clockwise from above; steering is the front wheel's angle, left positive. ValueError if not finite.
    """

    time_ns: int
    speed_m_s: float | None
    yaw_rate_rad_s: float | None = None
    steering_rad: float | None = None

    def __post_init__(self) -> None:
        for name in ("speed_m_s", "yaw_rate_rad_s", "steering_rad"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise ValueError(f"{name}: must be finite, or None where unknown; got {value}")


@dataclass(frozen=True, slots=True)
class MotionModel:
    """What the vehicle's sensors are worth. Noise is per reading, and held for `noise_hold_s`: the same
    noise read ten times as often does not average out."""

    a_rate_sensor: RateSensor = "yaw_rate"
    wheelbase_m: float = 2.7
    speed_scale_sigma: float = 0.005
    speed_scale_wander_per_sqrt_m: float = 5e-5
    speed_noise_m_s: float = 0.05
    wheel_lag_s: float = 0.05  # before anything is learnt: half of a counting time of 100 ms
    wheel_lag_sigma_s: float = 0.05
    wheel_lag_wander_s_sqrt_s: float = 5e-4  # clocks of control units drift against one another
    speed_dead_zone_m_s: float = 0.35
    yaw_rate_bias_sigma_rad_s: float = math.radians(0.05)
    yaw_rate_bias_wander_rad_s_sqrt_s: float = math.radians(0.0005)
    yaw_rate_noise_rad_s: float = math.radians(0.1)
    yaw_rate_scale_sigma: float = 0.002
    steering_bias_sigma_rad: float = math.radians(0.5)
    steering_bias_wander_rad_sqrt_s: float = math.radians(0.005)
    steering_noise_rad: float = math.radians(0.2)
    steering_scale_sigma: float = 0.02
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
        """The rotation sensor of system B: the one that A does not use."""
        return "steering" if self.a_rate_sensor == "yaw_rate" else "yaw_rate"

    def bias_sigma(self, sensor: RateSensor) -> float:
        """Sigma of the sensor's bias before anything is learnt: rad/s (yaw rate) or rad (steering)."""
        return self.yaw_rate_bias_sigma_rad_s if sensor == "yaw_rate" else self.steering_bias_sigma_rad

    def gain_sigma(self, sensor: RateSensor) -> float:
        """Sigma of the sensor's gain, a share of the rate."""
        return self.yaw_rate_scale_sigma if sensor == "yaw_rate" else self.steering_scale_sigma

    def bias_wander(self, sensor: RateSensor) -> float:
        """Random walk of that bias, per square root of a second."""
        if sensor == "yaw_rate":
            return self.yaw_rate_bias_wander_rad_s_sqrt_s
        return self.steering_bias_wander_rad_sqrt_s


class MotionStep(NamedTuple):
    """The motion between two samples: means of raw readings, and variances of what integrates from them."""

    outcome: Outcome
    dt_s: float
    standing: bool
    speed_m_s: float
    yaw_rate_rad_s: float | None
    steering_rad: float | None
    speed_sigma_m_s: float
    along_var_m2: float
    unknown_rate_var_rad2: float  # of the turn, were the rotation sensor missing or the step too long
    creep_m: float  # driven unseen where a stop begins or ends, and its variance
    creep_var_m2: float
    wheel_change_m_s: float = 0.0  # from the first sample to the second, and what the second said
    wheel_m_s: float = 0.0


class Rotation(NamedTuple):
    """Yaw rate by one sensor over a step, and how it hangs on that sensor's bias and gain and on the wheel scale."""

    rate_rad_s: float
    d_bias: float
    d_scale: float
    turn_var_rad2: float
    d_gain: float = 0.0


class WheelOdometry:
    """Remembers the last sample and turns a new one into the motion in between."""

    def __init__(self, model: MotionModel) -> None:
        self._model = model
        self._last: MotionSample | None = None
        self._held_speed_m_s: float | None = None
        self._blind_speed_s = 0.0
        self._blind_rate_s = 0.0
        self._quiet_s = 0.0
        self._standing = False
        self._direction = 1.0
        self._hidden = False  # whether the stop was read as exactly zero

    @property
    def time_ns(self) -> int | None:
        """Time of the last sample used."""
        return self._last.time_ns if self._last else None

    @property
    def standing(self) -> bool:
        """Whether the vehicle is taken to stand still."""
        return self._standing

    def advance(self, sample: MotionSample, yaw_rate_bias_rad_s: float) -> MotionStep:
        """Motion from the last sample to this one. The bias serves to tell a standstill only."""
        last = self._last
        if last is None:
            self._last, self._held_speed_m_s = sample, sample.speed_m_s
            return _no_motion("first")
        if sample.time_ns <= last.time_ns:
            return _no_motion("repeated" if sample.time_ns == last.time_ns else "backwards")
        dt = (sample.time_ns - last.time_ns) * 1e-9
        model = self._model
        bridged = dt > model.max_step_s
        was_standing, hidden = self._standing, self._hidden
        self._standing = self._is_standing(sample, dt, bridged, yaw_rate_bias_rad_s)
        hides = was_standing != self._standing and (hidden or self._hidden)
        along_var = self._along_variance(sample, last, dt, bridged, was_standing)
        before, after = self._speeds(sample, last)
        speed = 0.5 * (before + after)
        rate_var = self._unknown_rate_variance(sample, last, dt, bridged, speed)
        if abs(speed) > model.standstill_speed_m_s:
            self._direction = speed
        self._last = sample
        return MotionStep(
            outcome="gap" if bridged else "applied",
            dt_s=dt,
            standing=was_standing and self._standing,
            speed_m_s=speed,
            yaw_rate_rad_s=_mean(last.yaw_rate_rad_s, sample.yaw_rate_rad_s),
            steering_rad=_mean(last.steering_rad, sample.steering_rad),
            speed_sigma_m_s=self._speed_sigma(sample),
            along_var_m2=along_var,
            unknown_rate_var_rad2=rate_var,
            creep_m=math.copysign(model.creep_m, self._direction) if hides else 0.0,
            creep_var_m2=model.creep_sigma_m**2 if hides else 0.0,
            wheel_change_m_s=0.0 if bridged else after - before,
            wheel_m_s=after,
        )

    def _is_standing(self, sample: MotionSample, dt: float, bridged: bool, bias: float) -> bool:
        model = self._model
        speed, rate = sample.speed_m_s, sample.yaw_rate_rad_s
        quiet = speed is not None and abs(speed) <= model.standstill_speed_m_s
        if rate is not None and abs(rate - bias) > model.standstill_rate_rad_s:
            quiet = False
        self._hidden = quiet and model.speed_dead_zone_m_s > 0.0 and (speed == 0.0 or self._hidden)
        self._quiet_s = self._quiet_s + dt if quiet and not bridged else 0.0
        return self._quiet_s >= model.standstill_after_s

    def _speeds(self, sample: MotionSample, last: MotionSample) -> tuple[float, float]:
        before = last.speed_m_s if last.speed_m_s is not None else self._held_speed_m_s
        if sample.speed_m_s is not None:
            self._held_speed_m_s = sample.speed_m_s
        after = self._held_speed_m_s or 0.0
        return after if before is None else before, after

    def _along_variance(
        self, sample: MotionSample, last: MotionSample, dt: float, bridged: bool, was_standing: bool
    ) -> float:
        model = self._model
        if was_standing and self._standing:
            crawls = self._hidden and self._quiet_s <= model.crawl_for_s
            return model.crawl_m_sqrt_s**2 * dt if crawls else 0.0
        noise = self._speed_sigma(sample)
        variance = noise * noise * max(dt, model.noise_hold_s) * dt
        if sample.speed_m_s is None or last.speed_m_s is None:
            before = self._blind_along_sigma(self._blind_speed_s)
            self._blind_speed_s += dt
            variance += self._blind_along_sigma(self._blind_speed_s) ** 2 - before**2
        elif bridged:
            variance += min(0.25 * model.unknown_acceleration_m_s2 * dt, model.max_speed_m_s) ** 2 * dt * dt
        if sample.speed_m_s is not None:
            self._blind_speed_s = 0.0
        return variance

    def _speed_sigma(self, sample: MotionSample) -> float:
        """Sigma of one reading; wheels that hardly turn may read zero, or anything below the dead zone."""
        model, speed = self._model, sample.speed_m_s
        if speed is None or abs(speed) > model.speed_dead_zone_m_s:
            return model.speed_noise_m_s
        return max(model.speed_noise_m_s, model.speed_dead_zone_m_s / math.sqrt(3.0))

    def _blind_along_sigma(self, blind_s: float) -> float:
        model = self._model
        speed = 0.5 * model.unknown_acceleration_m_s2 * blind_s
        if self._held_speed_m_s is None:
            speed += model.unknown_speed_m_s
        return min(speed, model.max_speed_m_s) * blind_s

    def _unknown_rate_variance(
        self, sample: MotionSample, last: MotionSample, dt: float, bridged: bool, speed: float
    ) -> float:
        """Variance of the turn by not knowing the rate: coherent, so it grows with the time squared."""
        model = self._model
        if bridged:
            return min(0.5 * model.unknown_rate_rad_s * dt, math.pi) ** 2
        sensor = model.a_rate_sensor
        if _reading(sample, sensor) is not None and _reading(last, sensor) is not None:
            self._blind_rate_s = 0.0
            return 0.0
        before = self._blind_rate_s
        self._blind_rate_s += dt
        sigma = model.unknown_rate_rad_s * min(1.0, 0.1 + abs(speed))
        return sigma * sigma * (self._blind_rate_s**2 - before**2)


def _reading(sample: MotionSample, sensor: RateSensor) -> float | None:
    return sample.yaw_rate_rad_s if sensor == "yaw_rate" else sample.steering_rad


def _mean(before: float | None, after: float | None) -> float | None:
    return None if before is None or after is None else 0.5 * (before + after)


def _no_motion(outcome: Outcome) -> MotionStep:
    return MotionStep(outcome, 0.0, False, 0.0, None, None, 0.0, 0.0, 0.0, 0.0, 0.0)


def rotation(
    step: MotionStep,
    sensor: RateSensor,
    model: MotionModel,
    bias: float,
    scale: float,
    gain: float | None = None,
) -> Rotation | None:
    """Yaw rate over the step by one sensor (steering: bicycle model); None where it gave nothing.

    `gain`: what is known of the sensor's own; None where that is no state: its error is noise then.
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
        angle = max(-1.4, min(1.4, step.steering_rad - bias))
        per_wheelbase = step.speed_m_s / model.wheelbase_m
        d_scale = per_wheelbase * math.tan(angle)
        rate, d_bias = (1.0 + scale) * d_scale, -(1.0 + scale) * per_wheelbase / math.cos(angle) ** 2
        slow = step.speed_sigma_m_s * math.tan(angle) / model.wheelbase_m
        noise = math.hypot(d_bias * model.steering_noise_rad, slow)
    gain_sigma = model.gain_sigma(sensor) * (1.0 if gain is None else _GAIN_CHANGES)
    turn_var = noise * noise * held_s * dt + (gain_sigma * rate) ** 2 * max(dt, model.turn_hold_s) * dt
    if gain is None:
        return Rotation(rate, d_bias, d_scale, turn_var)
    more = 1.0 + gain
    return Rotation(more * rate, more * d_bias, more * d_scale, turn_var, rate)


def propagate(x: Array, p: Array, step: MotionStep, turn: Rotation | None, model: MotionModel) -> float:
    """Move state `x` (n >= 10) and covariance `p` (n, n), in place, by one step; the path length in m.

    Midpoint: the displacement points to the yaw in the middle of the turn. States beyond the tenth are
    untouched, their correlations kept. Standing, nothing moves and nothing grows but the sensors' own drift.
    A speed that is τ old misses τ times the change of speed.
    """
    dt = step.dt_s
    p[WHEEL_LAG, WHEEL_LAG] += model.wheel_lag_wander_s_sqrt_s**2 * dt
    for index, sensor in ((BIAS_A, model.a_rate_sensor), (BIAS_B, model.b_rate_sensor)):
        p[index, index] += model.bias_wander(sensor) ** 2 * dt
    if step.standing:
        if step.along_var_m2 > 0.0:
            _add_along(p, float(x[YAW]), step.along_var_m2)
        return 0.0
    rate, d_bias, d_scale, turn_var, d_gain = turn if turn else (0.0, 0.0, 0.0, 0.0, 0.0)
    turn_var += step.unknown_rate_var_rad2
    speed = speed_over_ground(x, step)
    slip = float(x[SIDE_SLIP])
    middle = float(x[YAW]) + 0.5 * rate * dt
    cos, sin = math.cos(middle), math.sin(middle)
    along, per_slip = speed * dt + step.creep_m, -speed * speed * rate * dt
    left = slip * per_slip
    east, north = along * cos - left * sin, along * sin + left * cos

    turn_bias, turn_scale, turn_gain = d_bias * dt, d_scale * dt, d_gain * dt
    left_bias = -slip * speed * speed * turn_bias
    left_gain = -slip * speed * speed * turn_gain
    along_scale = step.speed_m_s * dt
    left_scale = -slip * speed * (2.0 * along_scale * rate + speed * turn_scale)
    east_bias = -0.5 * north * turn_bias - left_bias * sin
    north_bias = 0.5 * east * turn_bias + left_bias * cos
    east_gain = -0.5 * north * turn_gain - left_gain * sin
    north_gain = 0.5 * east * turn_gain + left_gain * cos
    east_scale = along_scale * cos - left_scale * sin - 0.5 * north * turn_scale
    north_scale = along_scale * sin + left_scale * cos + 0.5 * east * turn_scale
    left_faster = -2.0 * slip * speed * rate * dt
    east_faster, north_faster = dt * cos - left_faster * sin, dt * sin + left_faster * cos
    # A lag is so much more speed over the step.
    change_m_s2 = step.wheel_change_m_s / dt if dt > 0.0 else 0.0
    lag, lagged = (1.0 + float(x[SCALE])) * change_m_s2, float(x[WHEEL_LAG]) * change_m_s2
    east_scale += lagged * east_faster
    north_scale += lagged * north_faster
    f = np.array(
        (
            (
                1.0, 0.0, -north, east_bias, 0.0, east_scale, -per_slip * sin, east_gain,
                lag * east_faster, east_faster,
            ),
            (
                0.0, 1.0, east, north_bias, 0.0, north_scale, per_slip * cos, north_gain,
                lag * north_faster, north_faster,
            ),
            (0.0, 0.0, 1.0, turn_bias, 0.0, turn_scale, 0.0, turn_gain, 0.0, 0.0),
        )
    )  # fmt: skip
    x[EAST] += east
    x[NORTH] += north
    x[YAW] += rate * dt
    rows = f @ p[:N_MOTION]
    p[:3, :] = rows
    p[:, :3] = rows.T
    p[:3, :3] = rows[:, :N_MOTION] @ f.T

    path = abs(along)
    along_var = step.along_var_m2 + step.creep_var_m2
    left_var = model.lateral_noise_m_sqrt_m**2 * path + 0.25 * turn_var * path * path
    cross = (along_var - left_var) * sin * cos
    half = 0.5 * turn_var * along
    p[:3, :3] += np.array(
        (
            (along_var * cos * cos + left_var * sin * sin, cross, -half * sin),
            (cross, along_var * sin * sin + left_var * cos * cos, half * cos),
            (-half * sin, half * cos, turn_var),
        )
    )
    p[SCALE, SCALE] += model.speed_scale_wander_per_sqrt_m**2 * path
    return path


def speed_over_ground(x: Array, step: MotionStep) -> float:
    """Mean speed (m/s) over a step by the wheels and what is known of their errors in state `x` (n >= 10)."""
    lag = float(x[WHEEL_LAG]) * step.wheel_change_m_s / step.dt_s if step.dt_s > 0.0 else 0.0
    return (1.0 + float(x[SCALE])) * (step.speed_m_s + lag) + float(x[WHEEL_SLIP])


def _add_along(p: Array, yaw_rad: float, variance_m2: float) -> None:
    ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    p[:2, :2] += np.outer(ahead, ahead * variance_m2)


class TrackPoint(NamedTuple):
    """A point of the track in its own frame: that of yaw zero at the beginning. Metres, radians.

    `wheel_m`, `wheel_m_s`: way and speed as the wheels say them, uncorrected.
    """

    east_m: float
    north_m: float
    yaw_rad: float
    path_m: float
    wheel_m: float = 0.0
    wheel_m_s: float = 0.0


class OverlayLag(NamedTuple):
    """How far behind a point of the track others lie in the mean: by the track, and by the wheels uncorrected."""

    path_m: float = 0.0
    wheel_m: float = 0.0
    wheel_change_m_s: float = 0.0


class RelativeTrack:
    """The dead-reckoned track of the last seconds in a frame of its own: what fixes are compared with where
    the heading is unknown, and how an anchor that comes late is brought to the present."""

    def __init__(self, keep_s: float = 120.0, extrapolate_s: float = 0.3) -> None:
        self._keep_ns, self._extrapolate_ns = round(keep_s * 1e9), round(extrapolate_s * 1e9)
        self._times_ns: list[int] = []
        self._points: list[TrackPoint] = []
        self._speed_m_s = self._rate_rad_s = 0.0

    def append(self, time_ns: int, step: MotionStep, speed_m_s: float, rate_rad_s: float) -> None:
        """Extend by a step at corrected speed and rate; times must increase."""
        here = self._points[-1] if self._points else TrackPoint(0.0, 0.0, 0.0, 0.0)
        wheel_m = here.wheel_m
        if step.standing:
            speed_m_s = rate_rad_s = 0.0
        else:
            wheel_m += step.speed_m_s * step.dt_s + step.creep_m
        moved = _moved(here, step.dt_s, speed_m_s * step.dt_s + step.creep_m, rate_rad_s)
        self._points.append(moved._replace(wheel_m=wheel_m, wheel_m_s=step.wheel_m_s))
        self._times_ns.append(time_ns)
        self._speed_m_s, self._rate_rad_s = speed_m_s, rate_rad_s
        if self._times_ns[0] < time_ns - 2 * self._keep_ns:
            first = bisect.bisect_left(self._times_ns, time_ns - self._keep_ns)
            del self._times_ns[:first], self._points[:first]

    def at(self, time_ns: int) -> TrackPoint | None:
        """Where the track was, interpolated; shortly ahead of its end, extrapolated; None outside."""
        times = self._times_ns
        if not times or time_ns < times[0]:
            return None
        ahead_ns = time_ns - times[-1]
        if ahead_ns >= 0:
            if ahead_ns > self._extrapolate_ns:
                return None
            ahead_s = ahead_ns * 1e-9
            ahead = _moved(self._points[-1], ahead_s, self._speed_m_s * ahead_s, self._rate_rad_s)
            return ahead._replace(wheel_m=ahead.wheel_m + ahead.wheel_m_s * ahead_s)
        after = bisect.bisect_right(times, time_ns)
        share = (time_ns - times[after - 1]) / (times[after] - times[after - 1])
        a, b = self._points[after - 1], self._points[after]
        return TrackPoint(*(u + share * (v - u) for u, v in zip(a, b, strict=True)))


def _moved(point: TrackPoint, dt_s: float, along_m: float, rate_rad_s: float) -> TrackPoint:
    middle = point.yaw_rad + 0.5 * rate_rad_s * dt_s
    return TrackPoint(
        point.east_m + along_m * math.cos(middle),
        point.north_m + along_m * math.sin(middle),
        point.yaw_rad + rate_rad_s * dt_s,
        point.path_m + abs(along_m),
        point.wheel_m,
        point.wheel_m_s,
    )
