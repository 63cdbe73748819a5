"""Fusion: heights of all surfaces beside numpy one surface at a time, and a whole batch beside the goal."""

from __future__ import annotations

import time

import numpy as np
from figure import Figure, higher, least_s
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.robust_surface_heights import (
    PRIOR_VOTES,
    TUNING,
    VoteColumns,
    biweight_location,
    estimate_heights,
)
from camber.map_update.fusion.surface_shape import shape_spread, shape_variance_m2
from camber.map_update.fusion.vehicle_bias import estimate_biases

Floats = NDArray[np.float64]

GOAL_VOTES_PER_S = 300_000.0
SURFACES, VEHICLES, SESSIONS, EACH = 8_000, 4_000, 2, 100
VOTE_M = 0.014


def batch() -> tuple[NDArray[np.int64], ...]:
    """Surfaces, voters, sessions of votes in the order of their keys: each drive is a stretch of 100 surfaces."""
    rng = np.random.default_rng(1)
    voter = np.repeat(np.arange(VEHICLES), SESSIONS * EACH)
    session = np.repeat(rng.integers(0, 21, VEHICLES * SESSIONS), EACH)
    surface = (
        np.repeat(rng.integers(0, SURFACES, VEHICLES * SESSIONS), EACH)
        + np.tile(np.arange(EACH), VEHICLES * SESSIONS)
    ) % SURFACES
    order = np.lexsort((session, voter, surface))
    return surface[order], voter[order], session[order]


def plain_biweight(x: Floats) -> float:
    """Tukey's biweight of one surface, as one writes it in numpy."""
    share = PRIOR_VOTES / (PRIOR_VOTES + 0.37 * (len(x) - 1))
    location = np.median(x)
    mad = 1.4826 * np.median(np.abs(x - location))
    scale = np.sqrt(share * VOTE_M**2 + (1.0 - share) * mad**2)
    for _ in range(30):
        u = (x - location) / (TUNING * scale)
        weight = np.where(np.abs(u) < 1.0, (1.0 - u * u) ** 2, 0.0)
        step = np.sum(weight * (x - location)) / np.sum(weight)
        location += step
        if abs(step) < 1e-6:
            break
    return float(location)


@compiled_without_gil
def locations_m(values_m: Floats, weights: Floats, begins: NDArray[np.int64], sigma_m: float) -> Floats:
    """Location of each group of values, rows `begins[i]` to `begins[i + 1]`."""
    located_m = np.empty(len(begins) - 1)
    for i in range(len(located_m)):
        a, b = begins[i], begins[i + 1]
        located_m[i] = biweight_location(values_m[a:b], weights[a:b], sigma_m).location_m
    return located_m


def figures() -> list[Figure]:
    surface, voter, session = batch()
    rng = np.random.default_rng(2)
    begins = np.append(np.searchsorted(surface, np.arange(SURFACES)), len(surface))
    value_m = rng.normal(0.0, 0.02, VEHICLES)[voter] + rng.normal(0.0, VOTE_M, len(voter))
    value_m[rng.random(len(voter)) < 0.03] += 0.8
    ones, sigma_m = np.ones(len(voter)), np.full(len(voter), 0.02)

    def whole() -> None:
        shape_m2 = shape_variance_m2(shape_spread(begins, np.full(len(voter), 1e-4)))
        biases = estimate_biases(
            begins,
            block=surface // 40,
            voter=voter,
            session=session,
            value_m=value_m,
            sigma_m=sigma_m,
            shape_m2=shape_m2,
        )
        votes = VoteColumns(
            voter=voter, session=session, value_m=value_m - biases.bias_m, weight=biases.weight
        )
        estimate_heights(begins, votes, known=biases.known, vote_sigma_m=biases.components.vote_m)

    ours_m = locations_m(value_m, ones, begins, VOTE_M)
    ours_s = least_s(lambda: locations_m(value_m, ones, begins, VOTE_M))
    some = np.arange(0, SURFACES, 8)
    began = time.process_time()
    peer_m = [plain_biweight(value_m[begins[i] : begins[i + 1]]) for i in some]
    peer_s = time.process_time() - began
    np.testing.assert_allclose(ours_m[some], peer_m, atol=1e-5)
    votes_of_peer = int((begins[some + 1] - begins[some]).sum())
    whole()
    batch_s = least_s(whole, rounds=3)
    return [
        higher(
            "robust heights of surfaces",
            "votes/s",
            len(voter) / ours_s,
            votes_of_peer / peer_s,
            "numpy, one surface at a time, the same heights",
        ),
        higher(
            f"fusion of {len(voter)} votes: biases, heights, changes",
            "votes/s",
            len(voter) / batch_s,
            GOAL_VOTES_PER_S,
            "the goal",
        ),
    ]
