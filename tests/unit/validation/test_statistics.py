"""Bounds of rates and shares against closed forms and a second implementation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from camber.validation.statistics import clopper_pearson, incomplete_beta, share_interval, share_of


@pytest.mark.parametrize("a", [0.5, 1.0, 3.0, 40.0])
@pytest.mark.parametrize("b", [0.7, 2.0, 1000.0])
@pytest.mark.parametrize("x", [1e-6, 1e-3, 0.2, 0.5, 0.99])
def test_the_incomplete_beta_function_is_the_beta_distribution(x: float, a: float, b: float) -> None:
    assert incomplete_beta(x, a, b) == pytest.approx(float(stats.beta.cdf(x, a, b)), rel=1e-9, abs=1e-14)


@pytest.mark.parametrize(
    ("events", "trials"), [(1, 10), (3, 1000), (17, 1_000_000), (999, 1000), (2.5, 700.5)]
)
def test_bounds_are_those_of_clopper_and_pearson(events: float, trials: float) -> None:
    low, high = clopper_pearson(events, trials)
    assert low == pytest.approx(float(stats.beta.ppf(0.05, events, trials - events + 1)), rel=1e-8)
    assert high == pytest.approx(float(stats.beta.ppf(0.95, events + 1, trials - events)), rel=1e-8)


def test_without_events_the_bound_is_three_by_the_trials() -> None:
    low, high = clopper_pearson(0, 1_000_000)
    assert low == 0.0
    assert high == pytest.approx(3.0e-6, rel=0.01)


def test_certain_events_and_no_trials_at_all_have_bounds_too() -> None:
    assert clopper_pearson(20, 20)[1] == 1.0
    assert clopper_pearson(20, 20)[0] == pytest.approx(0.05 ** (1 / 20), rel=1e-8)
    assert clopper_pearson(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("events", "trials"), [(3, 2), (-1, 2)])
def test_more_events_than_trials_are_refused(events: int, trials: int) -> None:
    with pytest.raises(ValueError, match="events of"):
        clopper_pearson(events, trials)


def test_a_share_is_hits_by_trials_over_all_blocks() -> None:
    assert share_of(np.array([3.0, 0.0, 5.0]), np.array([4.0, 0.0, 6.0])) == 0.8
    assert share_of(np.zeros(0), np.zeros(0)) is None


def test_nothing_counted_has_no_interval() -> None:
    assert share_interval(np.zeros(3), np.zeros(3), seed=1) is None


def test_independent_blocks_give_the_interval_of_a_binomial() -> None:
    rng = np.random.default_rng(8)
    hits = (rng.random(4000) < 0.9).astype(float)
    low, high = share_interval(hits, np.ones(4000), seed=1) or (0.0, 0.0)
    expected = 1.96 * np.sqrt(0.9 * 0.1 / 4000)
    assert abs((high - low) / 2 - expected) < 0.1 * expected
    assert low < share_of(hits, np.ones(4000)) < high


def test_epochs_that_fail_together_make_the_interval_wider_than_single_epochs_would() -> None:
    trials = np.full(100, 50.0)
    together = np.where(np.arange(100) % 10 == 0, 0.0, 50.0)
    low, high = share_interval(together, trials, seed=1) or (0.0, 0.0)
    alone = np.sqrt(0.9 * 0.1 / 5000)
    assert (high - low) / 2 > 5.0 * alone


def test_the_same_seed_gives_the_same_interval_and_another_one_nearly() -> None:
    rng = np.random.default_rng(9)
    trials = np.full(200, 10.0)
    hits = rng.binomial(10, 0.95, 200).astype(float)
    first, again, other = (share_interval(hits, trials, seed=seed) for seed in (1, 1, 2))
    assert first == again
    assert first != other
    assert np.allclose(first, other, atol=0.005)
