"""A vehicle's measured tilt: an inertial unit's pitch and roll against gravity.

Such a unit takes gravity for what is left of the measured force after it has subtracted how the vehicle speeds up and
turns, as far as it knows that, and trusts its rate sensors for the seconds in between. So a share of the vehicle's
acceleration, averaged over its filter's time, stands in its angles: speeding up looks like a nose that is up, a curve
to the left like a left side that is up. Besides, its levelling is off by a constant, which wanders with the
temperature, and there is noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camber.compiled.decorator import compiled
from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2
from camber.simulator.random_processes import gauss_markov, memory_of
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats, Integers, Trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSensor:
    """Of the ordinary sort in a series vehicle. `leaking_share` of an acceleration that lasts longer than `leaking_s`
    is taken for gravity."""

    bias_sigma_rad: float = math.radians(0.2)
    wander_sigma_rad: float = math.radians(0.1)
    wander_s: float = 20.0
    noise_rad: float = math.radians(0.05)
    leaking_share: float = 0.03
    leaking_s: float = 3.0
    step_rad: float = math.radians(0.01)


def attitude_errors(
    trajectory: Trajectory, sensor: AttitudeSensor, true_ns: Integers, seed: int
) -> tuple[Floats, Floats]:
    """By how much pitch and roll [rad] are off at times (n,), before they are rounded."""
    leaking = _leaking(trajectory, sensor)
    known_s = (trajectory.time_ns - trajectory.time_ns[0]) / 1e9
    asked_s = (true_ns - trajectory.time_ns[0]) / 1e9
    memory = memory_of(np.diff(asked_s, prepend=asked_s[:1]), sensor.wander_s)
    errors = []
    for name, leak in zip(("pitch", "roll"), leaking, strict=True):
        bias = sensor.bias_sigma_rad * float(stream(seed, f"{name} bias").standard_normal())
        wander = gauss_markov(stream(seed, f"{name} wander").standard_normal((len(true_ns), 1)), memory)[:, 0]
        noise = stream(seed, f"{name} noise").standard_normal(len(true_ns))
        leaked = np.interp(asked_s, known_s, leak)
        errors.append(bias + sensor.wander_sigma_rad * wander + sensor.noise_rad * noise + leaked)
    return errors[0], errors[1]


def _leaking(trajectory: Trajectory, sensor: AttitudeSensor) -> tuple[Floats, Floats]:
    """What the vehicle's acceleration adds to pitch (nose down) and roll (left side up), at the trajectory's times."""
    time_s = (trajectory.time_ns - trajectory.time_ns[0]) / 1e9
    forward = np.gradient(trajectory.speed_m_s, time_s)
    left = trajectory.speed_m_s * trajectory.yaw_rate_rad_s
    keep = math.exp(-(time_s[1] - time_s[0]) / sensor.leaking_s)
    share = sensor.leaking_share
    pitch_rad, roll_rad = -share * forward / STANDARD_GRAVITY_M_S2, share * left / STANDARD_GRAVITY_M_S2
    return _averaged(pitch_rad, keep), _averaged(roll_rad, keep)


@compiled
def _averaged(value: Floats, keep: float) -> Floats:
    """First-order low-pass from zero."""
    out = np.empty_like(value)
    last = 0.0
    for k in range(len(value)):
        last = keep * last + (1.0 - keep) * value[k]
        out[k] = last
    return out
