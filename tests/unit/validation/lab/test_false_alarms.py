"""Importance sampling against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from camber.integrity.checks.chi2_test import chi2_limit, distances, upper_triangle
from camber.validation.lab.error_model import HEADLINE
from camber.validation.lab.false_alarms import WeightedRate, alarms_block, weighted_draws, weighted_rate
from camber.validation.lab.work_blocks import WorkBlock

SEED = 7


def _covariances(n: int, rng: np.random.Generator) -> np.ndarray:
    a = rng.normal(size=(n, 3, 3))
    return np.asarray(a @ a.transpose(0, 2, 1) + 0.1 * np.eye(3))


@pytest.mark.parametrize("probability", [1e-3, 1e-5, 1e-7])
def test_the_tail_of_a_normal_difference_is_that_of_chi_squared(probability: float) -> None:
    rng = np.random.default_rng(SEED)
    s = _covariances(400_000, rng)
    d, weights = weighted_draws(s, rng)
    rate = weighted_rate(weights, distances(tuple(d.T), upper_triangle(s)).joint > chi2_limit(probability, 3))
    assert rate.effective > 100.0
    sigma = np.sqrt(rate.squares) / rate.draws
    assert abs(rate.rate - probability) < 4.0 * sigma
    assert rate.rate < rate.upper < 1.3 * probability


def test_weights_are_one_in_the_mean_and_two_at_most() -> None:
    rng = np.random.default_rng(SEED)
    _, weights = weighted_draws(_covariances(200_000, rng), rng)
    assert weights.mean() == pytest.approx(1.0, abs=0.01)
    assert weights.max() <= 2.0


def test_a_rate_of_nothing_is_bounded_by_the_draws() -> None:
    assert WeightedRate(draws=600).upper == pytest.approx(0.01)
    assert WeightedRate(draws=600).effective == 0.0


def test_blocks_of_right_fixes_are_the_same_for_the_same_seed_and_differ_for_another() -> None:
    blocks = (WorkBlock(seed=seed, number=0, skies=20, repeats=3) for seed in (1, 1, 2))
    one, again, other = (alarms_block(block, HEADLINE[:1])[0] for block in blocks)
    assert one == again
    assert one != other
    assert one["all"].rate == pytest.approx(1.0, abs=0.5)
    assert one["false_alarm"].rate <= one["held_back"].rate
