"""Shares of epochs that hang together, and how sure they are."""

from __future__ import annotations

import numpy as np

from camber.validation.block_bootstrap import share_interval, share_of


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
