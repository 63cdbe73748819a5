"""Heights of surfaces: the biweight and its standard error, a vehicle once, the day on which a road changed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize

from camber.map_update.fusion.robust_surface_heights import (
    TUNING,
    FusedHeights,
    VoteColumns,
    biweight_location,
    estimate_heights,
)

SIGMA_M = 0.014


def heights(
    values_m: NDArray[np.float64],
    voter: NDArray[np.int64] | None = None,
    session: NDArray[np.int64] | None = None,
    weight: NDArray[np.float64] | None = None,
) -> FusedHeights:
    n = len(values_m)
    votes = VoteColumns(
        voter=np.arange(n) if voter is None else voter,
        session=np.arange(n) % 3 if session is None else session,
        value_m=values_m,
        weight=np.ones(n) if weight is None else weight,
    )
    return estimate_heights(np.array([0, n]), votes, known=np.ones(n, bool), vote_sigma_m=SIGMA_M)


def test_the_location_is_the_root_of_psi_nearest_the_median() -> None:
    rng = np.random.default_rng(1)
    x = np.append(rng.normal(0.05, SIGMA_M, 30), [0.4, 0.5, -0.3])
    location_m, _, _, scale_m = biweight_location(x, np.ones(len(x)), SIGMA_M)

    def psi(t: float) -> float:
        u = (x - t) / (TUNING * scale_m)
        return float(np.sum(np.where(np.abs(u) < 1.0, u * (1.0 - u * u) ** 2, 0.0)))

    middle = float(np.median(x))
    assert location_m == pytest.approx(optimize.brentq(psi, middle - 0.01, middle + 0.01), abs=2e-6)


@pytest.mark.parametrize("n", [5, 8, 20, 100])
def test_the_standard_error_is_that_of_the_location(n: int) -> None:
    """Of 2,000 samples: their scatter over the standard error they state, to 8 % (2 % by chance, more of few votes)."""
    rng = np.random.default_rng(n)
    x = rng.normal(0.0, SIGMA_M, (2000, n))
    location_m, error_m, _, _ = np.transpose([biweight_location(row, np.ones(n), SIGMA_M) for row in x])
    assert location_m.std() / np.sqrt(np.mean(error_m**2)) == pytest.approx(1.0, abs=0.08)
    # 95 % of the mean's efficiency.
    assert location_m.std() == pytest.approx(SIGMA_M / np.sqrt(0.95 * n), rel=0.08)


def test_the_standard_error_follows_a_larger_scatter() -> None:
    rng = np.random.default_rng(4)
    x = rng.normal(0.0, 3.0 * SIGMA_M, (500, 30))
    location_m, error_m, _, _ = np.transpose([biweight_location(row, np.ones(30), SIGMA_M) for row in x])
    assert 0.75 <= location_m.std() / np.sqrt(np.mean(error_m**2)) <= 1.25


@pytest.mark.parametrize("lie_m", [0.04, 0.06, 0.10, 0.25, 10.0])
def test_a_coalition_of_a_fifth_moves_the_height_by_less_than_a_spread(lie_m: float) -> None:
    rng = np.random.default_rng(5)
    x = rng.normal(0.0, SIGMA_M, 100)
    x[:20] += lie_m
    result = heights(x)
    assert abs(result.location_m[0]) < 0.6 * SIGMA_M
    # Without the highest fifth nothing of the lie is left, whatever its size.
    assert result.without_highest_m[0] < 0.3 * SIGMA_M
    assert result.agreement[0] >= 0.75


def test_a_weak_vote_counts_for_less_and_one_without_weight_for_nothing() -> None:
    x = np.array([0.0, 0.0, 0.03, 0.03])
    even, drawn, alone = (heights(x, weight=np.array([1.0, 1.0, w, w])) for w in (1.0, 0.25, 0.0))
    assert even.location_m[0] == pytest.approx(0.015)
    assert drawn.location_m[0] == pytest.approx(0.006, abs=2e-3)
    assert alone.location_m[0] == 0.0
    assert alone.voters[0] == 2


def test_each_vehicle_counts_once() -> None:
    x = np.concatenate((np.full(10, 0.03), np.zeros(4)))
    voter = np.concatenate((np.zeros(10, np.int64), np.arange(1, 5)))
    session = np.concatenate((np.arange(10), np.arange(4)))
    result = heights(x, voter, session)
    assert result.location_m[0] < 0.01
    assert (result.voters[0], result.votes[0], result.days[0]) == (5, 14, 10)


def changing(seed: int, before: int, after: int, by_m: float) -> FusedHeights:
    rng = np.random.default_rng(seed)
    x = rng.normal(0.0, SIGMA_M, before + after)
    x[before:] += by_m
    session = np.concatenate((rng.integers(0, 40, before), rng.integers(40, 44, after)))
    return heights(x, session=session)


def test_a_changed_road_is_the_new_one_though_most_votes_are_of_the_old() -> None:
    result = changing(1, 200, 60, 0.08)
    assert result.location_m[0] == pytest.approx(0.08, abs=0.01)
    assert result.first_session[0] == 40
    assert result.voters[0] == 60
    # 52 of the 260 vehicles might be lying: the other eight say the same.
    assert result.without_highest_m[0] == pytest.approx(0.07, abs=0.02)


def test_a_few_new_vehicles_are_no_change_and_more_are() -> None:
    """Of 100 vehicles of the last three weeks 20 may be lying, and five must be left."""
    result = changing(2, 200, 18, 0.08)
    assert result.first_session[0] < 3
    assert abs(result.location_m[0]) < 0.01
    assert changing(2, 200, 60, 0.08).first_session[0] == 40


@pytest.mark.parametrize("seed", range(20))
def test_a_road_that_did_not_change_has_no_day_of_change(seed: int) -> None:
    result = changing(seed, 150, 40, 0.0)
    assert result.first_session[0] < 3


def test_without_votes_there_is_no_height_and_one_is_uncertain() -> None:
    empty = heights(np.zeros(0))
    assert np.isnan(empty.location_m[0])
    assert empty.voters[0] == 0
    one = heights(np.array([0.2]))
    assert one.standard_error_m[0] >= SIGMA_M
    assert np.isnan(one.without_highest_m[0])
