"""What a recording has not got, made from its truth: wheel speed, yaw rate, steering, a given pose.

Everything is made at the truth's own epochs: nothing is invented between them, so a 5 Hz truth gives 5 Hz motion.
Biases and scales are drawn once a drive from the seed, noise is white. Each error has a random stream of its own,
drawn as standard normal numbers and then scaled: to change one parameter leaves the others' errors as they were.

The truth's point is the antenna. Wheel speed is the signed speed of that point along the vehicle's x and up; that
is the speed of the rear axle's middle where the antenna is not off to the side. It is negative where the vehicle
reverses, and carries its noise at a standstill too, where a real wheel would say exactly zero. Pitch and roll are
not made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camber.formats.drive.truth_csv import TruthTable
from camber.geodesy.angles import wrap_pi_array
from camber.replay.truth_interpolation import LONGEST_GAP_NS, plane_of
from camber.schemas.base import Float64, Int64
from camber.schemas.drive import InitialPose, Surrogates
from camber.schemas.motion import Motion
from camber.simulator.random_streams import stream

LEAST_STEERED_SPEED_M_S = 0.5
"""Below this speed the path says nothing of the front wheels, and steering is not known."""
_LARGEST_STEERING_RAD = 0.7  # chosen: 40°, the lock of a car's front wheels


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueMotion:
    """Motion of n epochs without errors; NaN in `steering_angle_rad` and `yaw_rate_rad_s` where there is none."""

    time_ns: Int64
    wheel_speed_m_s: Float64
    yaw_rate_rad_s: Float64
    steering_angle_rad: Float64


def true_motion(truth: TruthTable, wheelbase_m: float) -> TrueMotion:
    """Motion as the truth has it.

    The yaw rate is the central difference of the yaw, which stands for the rate *at* the epoch; one-sided beside a
    gap, absent for an epoch alone. Steering is that of the bicycle model, δ = atan(L ω / v).
    """
    speed_m_s = _signed_speed(truth)
    yaw_rate = _yaw_rate(truth)
    moving = np.abs(speed_m_s) >= LEAST_STEERED_SPEED_M_S
    steering = np.full(len(truth), np.nan)
    steering[moving] = np.arctan(wheelbase_m * yaw_rate[moving] / speed_m_s[moving])
    return TrueMotion(
        time_ns=truth.time_ns, wheel_speed_m_s=speed_m_s, yaw_rate_rad_s=yaw_rate,
        steering_angle_rad=np.clip(steering, -_LARGEST_STEERING_RAD, _LARGEST_STEERING_RAD),
    )  # fmt: skip


def make_motion(truth: TruthTable, errors: Surrogates) -> list[Motion]:
    """Samples of the sensors that `errors.inputs` names, one at each epoch; the others are None."""
    real = true_motion(truth, errors.wheelbase_m)
    n = len(truth)

    def once(name: str) -> float:
        return float(stream(errors.seed, name).standard_normal())

    def white(name: str) -> Float64:
        return stream(errors.seed, name).standard_normal(n)

    scale = 1.0 + errors.wheel_scale_sigma * once("wheel scale")
    wheel = real.wheel_speed_m_s * scale + errors.wheel_noise_m_s * white("wheel noise")
    yaw_rate = (
        real.yaw_rate_rad_s
        + errors.yaw_rate_bias_sigma_rad_s * once("yaw rate bias")
        + errors.yaw_rate_noise_rad_s * white("yaw rate noise")
    )
    steering = (
        real.steering_angle_rad
        + errors.steering_bias_sigma_rad * once("steering bias")
        + errors.steering_noise_rad * white("steering noise")
    )
    made = {"wheel_speed": wheel, "yaw_rate": yaw_rate, "steering": steering}
    columns = (_optional(values) if name in errors.inputs else [None] * n for name, values in made.items())
    return [
        Motion(time_ns=t, wheel_speed_m_s=w, yaw_rate_rad_s=r, steering_angle_rad=s)
        for t, w, r, s in zip(truth.time_ns.tolist(), *columns, strict=True)
    ]


def make_initial_pose(truth: TruthTable, errors: Surrogates) -> InitialPose:
    """A given pose at the first epoch, off by what the seed draws."""
    east, north, turn = stream(errors.seed, "initial pose").standard_normal(3)
    offset = np.array([[east, north]]) * errors.initial_pose_sigma_m
    latitude, longitude, _ = plane_of(truth).geodetic_from_east_north_array(offset, truth.height_m[:1] * 0.0)
    yaw_rad = wrap_pi_array(truth.yaw_rad[0] + turn * errors.initial_yaw_sigma_rad)
    return InitialPose(
        latitude_deg=math.degrees(latitude[0]),
        longitude_deg=math.degrees(longitude[0]),
        yaw_deg=math.degrees(float(yaw_rad)),
        horizontal_sigma_m=errors.initial_pose_sigma_m,
        yaw_sigma_deg=math.degrees(errors.initial_yaw_sigma_rad),
    )


def correlated_noise(
    distance_m: Float64, sigma_m: float, correlation_m: float, rng: np.random.Generator
) -> Float64:
    """A Gaussian process at ascending distances (n,), correlation exp(−|Δ| / correlation): first-order Gauss-Markov.

    Exact for any spacing: z₀ ~ N(0, σ²), zₖ = ρ zₖ₋₁ + σ √(1 − ρ²) wₖ with ρ = exp(−Δₖ / correlation).
    """
    white = rng.standard_normal(len(distance_m))
    rho = np.exp(-np.diff(distance_m, prepend=distance_m[:1]) / correlation_m)
    drive = np.sqrt(1.0 - rho**2) * white
    if len(drive):
        drive[0] = white[0]
    noise = np.empty_like(drive)
    last = 0.0
    for k, (share, new) in enumerate(zip(rho.tolist(), drive.tolist(), strict=True)):
        last = share * last + new
        noise[k] = last
    return sigma_m * noise


def _signed_speed(truth: TruthTable) -> Float64:
    velocity = truth.velocity_enu_m_s
    forward = velocity[:, 0] * np.cos(truth.yaw_rad) + velocity[:, 1] * np.sin(truth.yaw_rad)
    signed: Float64 = np.copysign(
        np.hypot(forward, np.where(np.abs(forward) > 0.1, velocity[:, 2], 0.0)), forward
    )
    return signed


def _yaw_rate(truth: TruthTable) -> Float64:
    """Central differences of the yaw [rad/s]; at the ends and beside gaps one-sided; NaN for an epoch alone."""
    step_s = np.diff(truth.time_ns) / 1e9
    turned = wrap_pi_array(np.diff(truth.yaw_rad))
    usable = np.diff(truth.time_ns) <= LONGEST_GAP_NS
    step_s, turned = np.where(usable, step_s, 0.0), np.where(usable, turned, 0.0)
    span_s = np.append(step_s, 0.0) + np.append(0.0, step_s)
    turn = np.append(turned, 0.0) + np.append(0.0, turned)
    rate: Float64 = np.divide(turn, span_s, out=np.full(len(truth), np.nan), where=span_s > 0.0)
    return rate


def _optional(values: Float64) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values.tolist()]
