"""Episodes of fixes and everything they are compared with, epoch by epoch: true errors and differences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers
from camber.road_map.map_error_model import process_noise_factors, state_transitions
from camber.simulator.satellites.wrong_fix_shapes import FixShapes
from camber.validation.lab.error_model import ASSUMPTIONS, Assumptions, Scene


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FaultOffsets:
    """Added to episodes, without a claim of it: to the pose (n, 2) east and north, to road or antenna height (n,), and
    to the fix (n, 3) by a base coordinate error. A scalar holds for all."""

    pose_m: Floats | float = 0.0
    height_m: Floats | float = 0.0
    fix_m: Floats | float = 0.0

    def __add__(self, other: FaultOffsets) -> FaultOffsets:
        """Both at once."""
        both = {name: getattr(self, name) + getattr(other, name) for name in self.__slots__}
        return FaultOffsets(**both)


NO_FAULT = FaultOffsets()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Episodes:
    """n episodes one after the other in m rows. `first` (n,) the row of each, `length` (n,), `episode` (m,).

    `difference_m` (m, 3): fix less pose, and fix less road and antenna at the fix's place. `error_m` (m, 3): of the
    fix. `pose_error_m` (m, 2). `slope` (n, 2).
    """

    first: Integers
    length: Integers
    episode: Integers
    difference_m: Floats
    error_m: Floats
    pose_error_m: Floats
    slope: Floats


def episodes(
    shapes: FixShapes, scene: Scene, rng: np.random.Generator, *,
    faults: FaultOffsets = NO_FAULT, length: int | None = None, assumed: Assumptions = ASSUMPTIONS,
) -> Episodes:  # fmt: skip
    """One of each shape. Durations are log-uniform unless a length in epochs is given."""
    n = len(shapes.sky)
    if length is None:
        seconds = np.exp(rng.uniform(np.log(assumed.shortest_s), np.log(assumed.longest_s), n))
        lengths = np.maximum(np.round(seconds * assumed.epochs_per_s), 1).astype(np.int64)
    else:
        lengths = np.full(n, length, np.int64)
    first = np.concatenate(([0], np.cumsum(lengths)[:-1]))
    rows = int(lengths.sum())
    speed = np.where(rng.random(n) < assumed.standing, 0.0, rng.uniform(2.0, 15.0, n))
    time_s = rng.uniform(*assumed.reflection_time_s, n)
    slope: Floats = assumed.slope_sigma * rng.normal(size=(n, 2))
    constant = np.sqrt(assumed.constant_variance_m2) * rng.normal(size=(n, 3)) + faults.fix_m
    spread = np.asarray(np.linalg.cholesky(shapes.reflected_m2 + 1e-12 * np.eye(3)), np.float64)
    step_m = speed / assumed.epochs_per_s
    map_memory = state_transitions(assumed.map_errors, step_m)
    map_gain = process_noise_factors(assumed.map_errors, step_m)
    map_start: Floats = np.sqrt(np.diag(assumed.map_errors.stationary_covariance))
    difference, error, pose = np.empty((rows, 3)), np.empty((rows, 3)), np.empty((rows, 2))
    _simulate(
        _EpisodeDraws(
            first=first,
            length=lengths,
            shift=shapes.shift_m,
            rate=shapes.rate_m_s,
            constant=constant,
            spread=spread,
            time_s=time_s,
            slope=slope,
            pose_fault=np.zeros((n, 2)) + faults.pose_m,
            height_fault=np.zeros(n) + faults.height_m,
        ),
        _ErrorProcesses(
            map_memory=map_memory,
            map_gain=map_gain,
            map_start=map_start,
            pose_sigma=scene.pose_sigma_m,
            map_sigma=scene.map_sigma_m,
            antenna_sigma=assumed.antenna_sigma_m,
            pose_time_s=assumed.pose_time_s,
            antenna_time_s=assumed.antenna_time_s,
            step_s=1.0 / assumed.epochs_per_s,
        ),
        rng,
        _EpochErrors(difference, error, pose),
    )
    return Episodes(
        first=first, length=lengths, episode=np.repeat(np.arange(n), lengths),
        difference_m=difference, error_m=error, pose_error_m=pose, slope=slope,
    )  # fmt: skip


class _EpisodeDraws(NamedTuple):
    """What differs between episodes, columns (episodes, …), see `Episodes`."""

    first: Integers
    length: Integers
    shift: Floats
    rate: Floats
    constant: Floats
    spread: Floats
    time_s: Floats
    slope: Floats
    pose_fault: Floats
    height_fault: Floats


class _ErrorProcesses(NamedTuple):
    """Processes of the map's error, and σ and correlation times of pose and antenna height."""

    map_memory: Floats
    map_gain: Floats
    map_start: Floats
    pose_sigma: float
    map_sigma: float
    antenna_sigma: float
    pose_time_s: float
    antenna_time_s: float
    step_s: float


class _EpochErrors(NamedTuple):
    """Errors of each epoch, to be filled."""

    difference: Floats
    error: Floats
    pose_error: Floats


@compiled
def _simulate(
    draws: _EpisodeDraws, model: _ErrorProcesses, rng: np.random.Generator, out: _EpochErrors
) -> None:
    first, length, shift, rate, constant = draws.first, draws.length, draws.shift, draws.rate, draws.constant
    spread, time_s, slope = draws.spread, draws.time_s, draws.slope
    pose_fault, height_fault = draws.pose_fault, draws.height_fault
    map_memory, map_gain, map_start = model.map_memory, model.map_gain, model.map_start
    pose_sigma, map_sigma, antenna_sigma = model.pose_sigma, model.map_sigma, model.antenna_sigma
    pose_time_s, antenna_time_s, step_s = model.pose_time_s, model.antenna_time_s, model.step_s
    difference, error, pose_error = out.difference, out.error, out.pose_error
    memory_pose, memory_antenna = np.exp(-step_s / pose_time_s), np.exp(-step_s / antenna_time_s)
    gain_pose, gain_antenna = np.sqrt(1.0 - memory_pose**2), np.sqrt(1.0 - memory_antenna**2)
    half = antenna_sigma * np.sqrt(0.5)
    white, pose, road, before, new = np.zeros(3), np.zeros(2), np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(first.size):
        memory_fix = np.exp(-step_s / time_s[k])
        gain_fix = np.sqrt(1.0 - memory_fix**2)
        for a in range(3):
            white[a] = rng.standard_normal()
        for a in range(2):
            pose[a] = rng.standard_normal()
        for a in range(3):
            road[a] = map_start[a] * rng.standard_normal()
        antenna, fixed = rng.standard_normal(), rng.standard_normal()
        for at in range(length[k]):
            if at > 0:
                for a in range(3):
                    white[a] = memory_fix * white[a] + gain_fix * rng.standard_normal()
                for a in range(2):
                    pose[a] = memory_pose * pose[a] + gain_pose * rng.standard_normal()
                if map_gain[k, 0, 0] > 0.0 or map_gain[k, 1, 1] > 0.0:
                    for a in range(3):
                        before[a], new[a] = road[a], rng.standard_normal()
                    for a in range(3):
                        road[a] = 0.0
                        for b in range(3):
                            road[a] += map_memory[k, a, b] * before[b] + map_gain[k, a, b] * new[b]
                antenna = memory_antenna * antenna + gain_antenna * rng.standard_normal()
            row = first[k] + at
            for a in range(3):
                moved = shift[k, a] + rate[k, a] * at * step_s + constant[k, a]
                for b in range(a + 1):
                    moved += spread[k, a, b] * white[b]
                error[row, a] = moved
            for a in range(2):
                pose_error[row, a] = pose_sigma * pose[a] + pose_fault[k, a]
                difference[row, a] = error[row, a] - pose_error[row, a]
            # The road below the fix's place is higher by slope · error than below the vehicle, and the map knows that.
            difference[row, 2] = (
                error[row, 2]
                - slope[k, 0] * error[row, 0]
                - slope[k, 1] * error[row, 1]
                - map_sigma * (road[0] + road[1])
                - half * (antenna + fixed)
                - height_fault[k]
            )
