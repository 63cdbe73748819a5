"""Dead reckoning: propagation of pose and sensor errors, with their covariance.

CN101360971 (system A); Kikuchi (TUMSAT), reliability index: `x += V dt cos(yaw)`, `y += V dt sin(yaw)`, here with
midpoint integration. Beyond them, lasting errors (bias, scale, side slip) are states, so that what reveals them
later also corrects the pose that they have distorted.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.filter.odometry import MotionModel, MotionStep, YawRate

# Indices of the states; `filter_state` appends more.
EAST: Final = 0
NORTH: Final = 1
YAW: Final = 2
BIAS_A: Final = 3  # of the rotation sensor of system A: rad/s (yaw rate) or rad (steering)
BIAS_B: Final = 4  # of the other rotation sensor
SCALE: Final = 5  # true speed = (1 + scale) * wheel speed
SIDE_SLIP: Final = 6  # drift angle = -side_slip * speed * yaw rate (rad s^2/m): compliance of the rear tyres
TURN_GAIN: Final = 7  # true yaw rate = (1 + gain) * that of the sensor of system A
WHEEL_LAG: Final = 8  # age of the wheel speed when it arrives (s): it is counted over an interval, and queued
# Speed over ground less the odometer's (m/s): wheel slip while it is suspected, or the error of an integrated speed.
SPEED_ERROR: Final = 9
ACCELERATION_ERROR: Final = 10  # true acceleration less the one that is integrated (m/s²): levelling and bias
N_MOTION: Final = 11
_N_POSE: Final = 10  # states on which the pose after a step depends
_NO_YAW_RATE: Final = YawRate()


class _StepDisplacement(NamedTuple):
    """Motion of the pose over a step, and its Jacobian (3, 10) by the motion states."""

    along_m: float
    east_m: float
    north_m: float
    cos: float
    sin: float
    jacobian: Floats


def propagate(x: Floats, p: Floats, step: MotionStep, *, turn: YawRate | None, model: MotionModel) -> float:
    """Propagate state `x` (n >= 10) and covariance `p` (n, n) in place by one step; return the path length in m.

    States beyond the tenth stay, with their correlations. At a standstill only the drift of the sensors grows.
    """
    dt = step.dt_s
    p[WHEEL_LAG, WHEEL_LAG] += model.wheel_lag_wander_s_sqrt_s**2 * dt
    if step.standing:
        if step.along_var_m2 > 0.0:
            _add_along(p, float(x[YAW]), step.along_var_m2)
        _renew_biases(x, p, dt, model)
        return 0.0
    turn = turn or _NO_YAW_RATE
    moved = _displacement(x, step, turn)
    x[EAST] += moved.east_m
    x[NORTH] += moved.north_m
    x[YAW] += turn.rate_rad_s * dt
    f = moved.jacobian
    rows = f @ p[:_N_POSE]
    p[:3, :] = rows
    p[:, :3] = rows.T
    p[:3, :3] = rows[:, :_N_POSE] @ f.T
    path = abs(moved.along_m)
    turn_var = turn.turn_var_rad2 + step.unknown_rate_var_rad2
    # Where in a gap the vehicle has turned is unknown too: Δ (L − s), s uniform over L, has the variance Δ² L² / 12.
    per_turn = 0.25 + (1.0 / 12.0 if step.outcome == "gap" else 0.0)
    p[:3, :3] += _process_noise(
        moved,
        along_var=step.along_var_m2 + step.creep_var_m2,
        left_var=model.lateral_noise_m_sqrt_m**2 * path + per_turn * turn_var * path * path,
        turn_var=turn_var,
    )
    keep = math.exp(-abs(step.speed_m_s) * dt / model.speed_scale_length_m)
    _renew(x, p, SCALE, keep=keep, sigma=model.speed_scale_sigma)
    _renew_biases(x, p, dt, model)
    return path


def _renew_biases(x: Floats, p: Floats, dt_s: float, model: MotionModel) -> None:
    for index, sensor in ((BIAS_A, model.a_rate_sensor), (BIAS_B, model.b_rate_sensor)):
        _renew(x, p, index, keep=math.exp(-dt_s / model.bias_time_s(sensor)), sigma=model.bias_sigma(sensor))


def _renew(x: Floats, p: Floats, index: int, *, keep: float, sigma: float) -> None:
    """Advance a Gauss-Markov process of this sigma, of which the share `keep` remains."""
    x[index] *= keep
    p[index] *= keep
    p[:, index] *= keep
    p[index, index] += (1.0 - keep * keep) * sigma * sigma


def _displacement(x: Floats, step: MotionStep, turn: YawRate) -> _StepDisplacement:
    """Integrate with the yaw in the middle of the turn. A wheel speed of age τ misses τ times its change."""
    dt, rate = step.dt_s, turn.rate_rad_s
    speed = speed_over_ground(x, step)
    slip = float(x[SIDE_SLIP])
    middle = float(x[YAW]) + 0.5 * rate * dt
    cos, sin = math.cos(middle), math.sin(middle)
    along, per_slip = speed * dt + step.creep_m, -speed * speed * rate * dt
    left = slip * per_slip
    east, north = along * cos - left * sin, along * sin + left * cos

    turn_bias, turn_scale, turn_gain = turn.d_bias * dt, turn.d_scale * dt, turn.d_gain * dt
    left_bias = -slip * speed * speed * turn_bias
    left_gain = -slip * speed * speed * turn_gain
    along_scale = 0.0 if step.is_integrated else step.speed_m_s * dt
    left_scale = -slip * speed * (2.0 * along_scale * rate + speed * turn_scale)
    east_bias = -0.5 * north * turn_bias - left_bias * sin
    north_bias = 0.5 * east * turn_bias + left_bias * cos
    east_gain = -0.5 * north * turn_gain - left_gain * sin
    north_gain = 0.5 * east * turn_gain + left_gain * cos
    east_scale = along_scale * cos - left_scale * sin - 0.5 * north * turn_scale
    north_scale = along_scale * sin + left_scale * cos + 0.5 * east * turn_scale
    left_faster = -2.0 * slip * speed * rate * dt
    east_faster, north_faster = dt * cos - left_faster * sin, dt * sin + left_faster * cos
    change_m_s2 = step.wheel_change_m_s / dt if dt > 0.0 else 0.0
    lag, lagged = (1.0 + float(x[SCALE])) * change_m_s2, float(x[WHEEL_LAG]) * change_m_s2
    east_scale += lagged * east_faster
    north_scale += lagged * north_faster
    jacobian = np.array(
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
    return _StepDisplacement(along_m=along, east_m=east, north_m=north, cos=cos, sin=sin, jacobian=jacobian)


def _process_noise(moved: _StepDisplacement, *, along_var: float, left_var: float, turn_var: float) -> Floats:
    """Return the covariance (3, 3) of what the step adds along, across and in yaw."""
    cos, sin = moved.cos, moved.sin
    cross = (along_var - left_var) * sin * cos
    half = 0.5 * turn_var * moved.along_m
    return np.array(
        (
            (along_var * cos * cos + left_var * sin * sin, cross, -half * sin),
            (cross, along_var * sin * sin + left_var * cos * cos, half * cos),
            (-half * sin, half * cos, turn_var),
        )
    )


def speed_over_ground(x: Floats, step: MotionStep) -> float:
    """Return the mean speed over ground (m/s) of a step: the odometer's, corrected by the state `x` (n >= 10)."""
    if step.is_integrated:
        return step.speed_m_s + float(x[SPEED_ERROR])
    lag = float(x[WHEEL_LAG]) * step.wheel_change_m_s / step.dt_s if step.dt_s > 0.0 else 0.0
    return (1.0 + float(x[SCALE])) * (step.speed_m_s + lag) + float(x[SPEED_ERROR])


def _add_along(p: Floats, yaw_rad: float, variance_m2: float) -> None:
    ahead = np.array([math.cos(yaw_rad), math.sin(yaw_rad)])
    p[:2, :2] += np.outer(ahead, ahead * variance_m2)
