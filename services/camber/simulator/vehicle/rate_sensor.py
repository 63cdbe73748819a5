"""A yaw-rate sensor: what it reads besides the turn of the body about its axis.

Error model of a MEMS gyro (IEEE Std 952, annex C): constant bias, bias instability (here a Gauss–Markov process), rate
random walk, noise, scale, misalignment of the axis, quantisation; beyond it the bias that changes as the unit warms up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from camber.simulator.random_processes import gauss_markov, memory_of
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats, Trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class RateSensor:
    """Sizes of the errors, by default without instability, warming and misalignment."""

    bias_sigma_rad_s: float = math.radians(0.05)
    walk_rad_s_sqrt_s: float = math.radians(0.0005)
    noise_rad_s: float = math.radians(0.1)
    scale_sigma: float = 0.002
    step_rad_s: float = math.radians(0.01)
    instability_rad_s: float = 0.0
    instability_s: float = 100.0
    warming_sigma_rad_s: float = 0.0
    warming_s: float = 600.0
    misalignment_sigma_rad: float = 0.0


AUTOMOTIVE_YAW_RATE: Final = RateSensor(
    bias_sigma_rad_s=math.radians(0.05),
    walk_rad_s_sqrt_s=math.radians(0.0005),
    noise_rad_s=math.radians(0.1),
    scale_sigma=0.01,  # non-linearity of an ESP sensor, Hyundai shop manual: ± 1 %
    step_rad_s=math.radians(0.05),  # chosen: a CAN signal's last digit
    instability_rad_s=math.radians(0.007),  # ADXRS450, null offset stability: 25 °/h
    warming_sigma_rad_s=math.radians(
        0.05
    ),  # chosen: 20 K at a tenth of 3.75 °/s over 125 K, the same manual's limit
    misalignment_sigma_rad=math.radians(1.0),  # chosen: a bracket's tolerance
)


def additional_errors(
    trajectory: Trajectory, sensor: RateSensor, asked_s: Floats, seed: int
) -> Floats | None:
    """Return the errors [rad/s] at times (n,) since the beginning by instability, warming and misalignment; None
    without any."""
    errors = []
    if sensor.instability_rad_s > 0.0:
        white = stream(seed, "yaw rate instability").standard_normal((len(asked_s), 1))
        memory = memory_of(np.diff(asked_s, prepend=asked_s[:1]), sensor.instability_s)
        errors.append(sensor.instability_rad_s * gauss_markov(white, memory)[:, 0])
    if sensor.warming_sigma_rad_s > 0.0:
        by_s = float(stream(seed, "yaw rate warming").standard_normal()) * sensor.warming_sigma_rad_s
        errors.append(by_s * -np.expm1(-asked_s / sensor.warming_s))
    if sensor.misalignment_sigma_rad > 0.0:
        known_s = (trajectory.time_ns - trajectory.time_ns[0]) / 1e9
        tilts = sensor.misalignment_sigma_rad * stream(seed, "yaw rate axis").standard_normal(2)
        for tilt, angle in zip(tilts.tolist(), (trajectory.roll_rad, trajectory.pitch_rad), strict=True):
            errors.append(tilt * np.interp(asked_s, known_s, np.gradient(angle, known_s)))
    return sum(errors[1:], errors[0]) if errors else None
