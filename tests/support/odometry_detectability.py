"""Smallest drift of positions, along and across the way, that their comparison with the path by odometry detects.

PYTHONPATH=tests python -m support.odometry_detectability
PYTHONPATH=tests python -m support.odometry_detectability --monte-carlo 400

The drift begins with the second part of a window, on a straight road at constant speed, and lasts. From the covariance
of `path_comparison` alone: noncentrality λ of T for a drift of 1 m/s, then the rate at which T exceeds the threshold of
1e-6 with the power stated. Beside it the comparison of a fix with a position that odometry has carried over a distance
since the last independent evidence: there, all errors since count.
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np
from scipy import optimize, stats

from camber.localizer.arrays import Floats
from camber.localizer.contradictions.path_comparison import (
    FIRST_PART_S,
    SEGMENT_S,
    THRESHOLD,
    WINDOWS_S,
    PathSegment,
    PathTest,
    PathWindow,
    PlacedPosition,
    SegmentOdometry,
    rotation,
    turned_left,
)
from camber.localizer.filter.dead_reckoning_time_update import BIAS_A, SCALE, WHEEL_LAG
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import MotionModel, WheelOdometry
from camber.localizer.filter.pose_model import PoseModel
from support.pose_inputs import sample

FIX_SIGMA_M = math.hypot(0.05, 0.04)
"""Floor of an anchor and the error common to consecutive ones, `PoseModel`."""
STEP_S = 0.1
SPEEDS_M_S = (5.0, 10.0, 20.0)
KNOWN_BIAS_RAD_S = math.radians(0.01)
"""After a standstill of some seconds."""
FALSE_ALARMS = 1e-6


def sensors_known(*, scale: float | None = None, bias_rad_s: float | None = KNOWN_BIAS_RAD_S) -> FilterState:
    """A priori, or with σ of the wheel scale and of the yaw-rate bias from independent evidence."""
    state = FilterState(PoseModel())
    for index, sigma in ((SCALE, scale), (BIAS_A, bias_rad_s)):
        if sigma is not None:
            state.set_independent(index, sigma**2)
    return state


def driven_window(
    state: FilterState, readings: list[tuple[float, float]], first_s: float, positions: list[Floats]
) -> PathWindow:
    """The window of readings of wheel speed and yaw rate, one a step, whose first part lasts `first_s`."""
    motion, noise = MotionModel(), np.eye(2) * FIX_SIGMA_M**2
    odometer, segment = WheelOdometry(motion), SegmentOdometry(motion, state)
    parts: tuple[list[PathSegment], list[PathSegment]] = ([], [])
    for k, (speed, rate) in enumerate(readings):
        step = odometer.advance(sample(round(k * STEP_S * 1e9), speed, rate), 0.0)
        if k:
            segment.advance(step)
        is_first = k <= round(first_s / STEP_S)
        if k and (k % round(SEGMENT_S / STEP_S) == 0 or k in (round(first_s / STEP_S), len(readings) - 1)):
            parts[0 if is_first else 1].append(segment.close())
            segment = SegmentOdometry(motion, state)
    begin, middle, end = (PlacedPosition(position, noise) for position in positions)
    sensors = slice(BIAS_A, WHEEL_LAG + 1)
    return PathWindow(parts, (begin, middle, end), state.p[sensors, sensors])


def straight_window(state: FilterState, speed_m_s: float, first_s: float, second_s: float) -> PathWindow:
    """Straight on at constant speed; positions are at the truth."""
    readings = [(speed_m_s, 0.0)] * (round((first_s + second_s) / STEP_S) + 1)
    positions = [np.array((speed_m_s * t, 0.0)) for t in (0.0, first_s, first_s + second_s)]
    return driven_window(state, readings, first_s, positions)


def noncentrality(window: PathWindow, second_s: float) -> tuple[float, float]:
    """λ of a drift of 1 m/s along and across that begins with the second part."""
    path, odometry = _with_sensors(window)
    one = np.eye(2) * FIX_SIGMA_M**2
    weight = np.linalg.inv(odometry + np.block([[2.0 * one, -one], [-one, 2.0 * one]]))
    slope = turned_left(path)
    free = weight - np.outer(weight @ slope, weight @ slope) / float(slope @ weight @ slope)
    along, across = np.array((0.0, 0.0, second_s, 0.0)), np.array((0.0, 0.0, 0.0, second_s))
    return float(along @ free @ along), float(across @ free @ across)


def _with_sensors(window: PathWindow) -> tuple[Floats, Floats]:
    """Both displacements (4,), and their covariance (4, 4) with that by the sensors."""
    path, by_sensors, noise = window.displacements(np.zeros(len(window.sensors_p)))
    return path, by_sensors @ window.sensors_p @ by_sensors.T + noise


def detectable(noncentrality_of_1_m_s: float, power: float, freedom: int = 3) -> float:
    """The rate [m/s] that is detected with this power."""
    threshold = stats.chi2.isf(FALSE_ALARMS, freedom)
    needed = optimize.brentq(lambda value: stats.ncx2.sf(threshold, freedom, value) - power, 1e-3, 500.0)
    return math.sqrt(needed / noncentrality_of_1_m_s)


def rates(speed_m_s: float, second_s: float, *, scale: float | None, power: float) -> tuple[float, float]:
    """Smallest detectable rates along and across [m/s]."""
    window = straight_window(sensors_known(scale=scale), speed_m_s, min(second_s, FIRST_PART_S), second_s)
    along, across = noncentrality(window, second_s)
    return detectable(along, power), detectable(across, power)


def carried(
    speed_m_s: float, since_m: float, second_s: float, *, scale: float | None, power: float
) -> tuple[float, float]:
    """The same by fix less independent position: evidence of σ 0.1 m and 0.2° has been had `since_m` before the drift
    began, and odometry has carried it since; two degrees of freedom."""
    for_s = since_m / speed_m_s + second_s
    window = straight_window(sensors_known(scale=scale), speed_m_s, 0.0, for_s)
    _, covariance = _with_sensors(window)
    p = covariance[2:, 2:] + np.diag((0.1**2, 0.1**2 + (math.radians(0.2) * speed_m_s * for_s) ** 2))
    weight = np.linalg.inv(p + np.eye(2) * FIX_SIGMA_M**2) * second_s**2
    return detectable(float(weight[0, 0]), power, 2), detectable(float(weight[1, 1]), power, 2)


def simulated(
    rng: np.random.Generator,
    speed_m_s: float,
    second_s: float,
    drift_m_s: tuple[float, float],
    scale: float | None,
) -> PathTest:
    """One drive whose sensors have errors of the model's sizes, and the comparison at its end."""
    motion, state = MotionModel(), sensors_known(scale=scale)
    wheel = rng.normal(0.0, math.sqrt(state.p[SCALE, SCALE]))
    bias = rng.normal(0.0, math.sqrt(state.p[BIAS_A, BIAS_A]))
    first_s = min(second_s, FIRST_PART_S)
    steps = round((first_s + second_s) / STEP_S)
    held = round(motion.noise_hold_s / STEP_S)

    def noise(sigma: float) -> Floats:
        return np.repeat(rng.normal(0.0, sigma, steps // held + 2), held)[: steps + 1]

    speed = speed_m_s / (1.0 + wheel) + noise(motion.speed_noise_m_s)
    rate = bias + noise(motion.yaw_rate_noise_rad_s)
    walk = rng.normal(0.0, motion.lateral_noise_m_sqrt_m * math.sqrt(speed_m_s * STEP_S), steps)
    across, turn = np.append(0.0, np.cumsum(walk)), rotation(rng.uniform(-math.pi, math.pi))
    positions = []
    for k in (0, round(first_s / STEP_S), steps):
        led = np.array(drift_m_s) * max(0.0, k * STEP_S - first_s)
        place = np.array((speed_m_s * k * STEP_S, across[k])) + led + rng.normal(0.0, FIX_SIGMA_M, 2)
        positions.append(turn @ place)
    test = driven_window(
        state, list(zip(speed.tolist(), rate.tolist(), strict=True)), first_s, positions
    ).compare()
    assert test is not None
    return test


def table(power: float) -> list[str]:
    """Rows in Markdown."""
    rows = ["| speed | known wheel scale | " + " | ".join(f"{s:.0f} s" for s in WINDOWS_S) + " |"]
    rows.append("|---" * (2 + len(WINDOWS_S)) + "|")
    for scale in (None, 0.001):
        for speed in SPEEDS_M_S:
            cells = [rates(speed, s, scale=scale, power=power) for s in WINDOWS_S]
            known = "0.5 %, a priori" if scale is None else f"{100.0 * scale:.1f} %"
            rows.append(
                f"| {speed:.0f} m/s | {known} | " + " | ".join(f"{a:.2f}, {c:.2f}" for a, c in cells) + " |"
            )
    return rows


def carried_table(power: float) -> list[str]:
    """Rows in Markdown: windows against an independent position carried for a while, at 10 m/s."""
    rows = [
        "| comparison | " + " | ".join(f"{s:.0f} s" for s in WINDOWS_S) + " |",
        "|---" * (1 + len(WINDOWS_S)) + "|",
    ]
    cells = [rates(10.0, s, scale=None, power=power) for s in WINDOWS_S]
    rows.append(
        "| with the path over the window | " + " | ".join(f"{a:.2f}, {c:.2f}" for a, c in cells) + " |"
    )
    for since_m in (0.0, 300.0, 1_000.0, 3_000.0):
        cells = [carried(10.0, since_m, s, scale=None, power=power) for s in WINDOWS_S]
        name = f"with a position, evidence {since_m:.0f} m before"
        rows.append(f"| {name} | " + " | ".join(f"{a:.2f}, {c:.2f}" for a, c in cells) + " |")
    return rows


def monte_carlo(drives: int, seed: int) -> list[str]:
    """Share of drives whose statistic exceeds thresholds without a drift, and the power at the rates computed."""
    rng, lines = np.random.default_rng(seed), [f"seed {seed}, {drives} drives each, 10 m/s"]
    for second_s in (10.0, 30.0, 100.0):
        quiet = np.array([simulated(rng, 10.0, second_s, (0.0, 0.0), None).statistic for _ in range(drives)])
        shares = ", ".join(f"{np.mean(quiet > stats.chi2.isf(q, 3)):.3f} for {q}" for q in (0.1, 0.01))
        powers = []
        for axis in (0, 1):
            rate = rates(10.0, second_s, scale=None, power=0.5)[axis]
            drift = (rate, 0.0) if axis == 0 else (0.0, rate)
            detected = [simulated(rng, 10.0, second_s, drift, None).contradicts for _ in range(drives)]
            powers.append(float(np.mean(detected)))
        lines.append(
            f"{second_s:.0f} s: mean {quiet.mean():.2f} of 3, beyond {shares}; power along {powers[0]:.2f}, across "
            f"{powers[1]:.2f}, computed 0.50"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--monte-carlo", type=int, default=0, metavar="DRIVES")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--power", type=float, default=0.5)
    chosen: Any = parser.parse_args()
    assert math.isclose(THRESHOLD, stats.chi2.isf(FALSE_ALARMS, 3), rel_tol=1e-4)
    print("\n".join([*table(chosen.power), "", *carried_table(chosen.power)]))
    if chosen.monte_carlo:
        print("\n".join(monte_carlo(chosen.monte_carlo, chosen.seed)))


if __name__ == "__main__":
    main()
