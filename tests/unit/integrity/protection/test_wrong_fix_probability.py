"""The probability that a fix that has passed is wrong: against draws, and what must always hold."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from camber.integrity.checks.chi2_test import chi2_limit
from camber.integrity.protection.wrong_fix_probability import (
    WrongFixRules,
    log_odds,
    missed_detection_probability,
    probability,
)

RULES = WrongFixRules()
S = np.diag([0.0125, 0.0125, 0.0075])
sigma = st.floats(0.02, 3.0)
metres = st.floats(-5.0, 5.0)
exactly = settings(derandomize=True, deadline=None)


MANY = 20


def odds(d, s=S, rules=RULES, trials=1, satellites=MANY):
    prior = rules.prior_log_odds(satellites)
    return float(log_odds(np.array([d], float), np.asarray(s, float)[None], rules, prior, trials)[0])


def test_the_share_of_wrong_fixes_among_draws_is_the_mean_of_the_probabilities():
    rng = np.random.default_rng(11)
    n = 400_000
    wrong = rng.random(n) < RULES.prior
    far = rng.random(n) < RULES.far_share
    near = np.array([RULES.near_horizontal_m, RULES.near_horizontal_m, RULES.near_vertical_m])
    size = np.where(far[:, None], RULES.far_m, near)
    d = rng.normal(size=(n, 3)) * np.sqrt(np.diag(S)) + np.where(
        wrong[:, None], rng.normal(size=(n, 3)) * size, 0
    )
    p = probability(log_odds(d, np.broadcast_to(S, (n, 3, 3)), RULES, RULES.prior_log_odds(MANY)))
    passed = np.einsum("ni,ij,nj->n", d, np.linalg.inv(S), d) <= chi2_limit(1e-3, 3)
    for low, high in [(0.0, 1e-3), (1e-3, 1e-2), (1e-2, 0.5), (0.5, 1.0)]:
        chosen = (p >= low) & (p <= high)
        spread = math.sqrt(p[chosen].sum())
        assert abs(wrong[chosen].sum() - p[chosen].sum()) <= 4.0 * spread + 1.0
    missed = wrong & passed
    rate = missed_detection_probability(S[None], chi2_limit(1e-3, 3), RULES)[0]
    assert missed.sum() <= rate * wrong.sum() + 4.0 * math.sqrt(rate * wrong.sum())
    assert missed.sum() >= 0.7 * rate * wrong.sum() - 4.0 * math.sqrt(rate * wrong.sum())


@exactly
@given(st.tuples(metres, metres, metres), st.tuples(sigma, sigma, sigma), st.floats(1.0, 5.0))
def test_a_larger_contradiction_never_lowers_it(d, sigmas, factor):
    s = np.diag(np.square(sigmas))
    assert odds(np.multiply(d, factor), s) >= odds(d, s) - 1e-9


@exactly
@given(st.tuples(metres, metres, metres), st.integers(1, 1000), st.floats(0.01, 0.5))
def test_trials_and_prior_never_lower_it(d, trials, prior):
    assert odds(d, trials=trials) == pytest.approx(odds(d) + math.log(trials))
    assert odds(d, rules=replace(RULES, prior=prior)) <= odds(d, rules=replace(RULES, prior=prior * 1.5))


@exactly
@given(st.tuples(sigma, sigma, sigma), sigma)
def test_with_full_agreement_a_blunter_test_says_less(sigmas, more):
    s = np.diag(np.square(sigmas))
    assert odds((0, 0, 0), s + more**2 * np.eye(3)) >= odds((0, 0, 0), s)
    assert odds((0, 0, 0), s) <= RULES.prior_log_odds(MANY)


@exactly
@given(st.integers(0, 60), st.integers(0, 60), st.tuples(metres, metres, metres))
def test_fewer_satellites_never_make_a_fix_surer_and_an_unknown_number_is_the_fewest(one, other, d):
    few, many = sorted((one, other))
    assert odds(d, satellites=few) >= odds(d, satellites=many)
    assert odds(d, satellites=None) == odds(d, satellites=0)
    assert RULES.prior <= RULES.prior_of(many) <= RULES.prior_of(None) < 1.0


def test_the_prior_is_at_least_that_of_many_satellites():
    rules = replace(RULES, prior=0.2, of_few=((5, 0.1), (7, 0.6), (12, 0.9)))
    assert [rules.prior_of(count) for count in (5, 7, 8, 12, 13)] == [0.9, 0.9, 0.9, 0.9, 0.2]
    assert replace(rules, of_few=()).prior_of(None) == 0.2


def test_the_prior_is_no_smaller_than_what_was_recorded_and_simulated():
    # Nagoya, a receiver's fixes: satellites at least and at most, wrong ones, all.
    recorded = ((0, 5, 52, 53), (6, 7, 34, 36), (8, 9, 7, 26), (10, 12, 14, 49), (13, 15, 7, 244))
    for least, most, wrong, fixes in (*recorded, (16, 60, 0, 1391)):
        prior = RULES.prior_of(most)
        assert prior >= wrong / fixes - 0.05, (least, most)


@pytest.mark.parametrize(
    ("d", "s"),
    [
        ((math.nan, 0, 0), S),
        ((0, math.inf, 0), S),
        ((0, 0, 0), np.full((3, 3), math.nan)),
        ((0, 0, 0), np.diag([1.0, -1.0, 1.0])),
        ((0, 0, 0), np.zeros((3, 3))),
    ],
)
def test_what_cannot_be_evaluated_counts_as_wrong(d, s):
    assert odds(d, s) == math.inf
    assert probability(np.array([odds(d, s)]))[0] == 1.0
    if np.isfinite(d).all():
        assert missed_detection_probability(np.asarray(s, float)[None], 10.0, RULES)[0] == 1.0


def test_no_number_is_certainly_wrong_and_the_ends_are_reached():
    assert probability(np.array([math.nan, -math.inf, 0.0, math.inf])) == pytest.approx([1.0, 0.0, 0.5, 1.0])


def test_a_vague_test_lets_all_pass_and_trials_add_up_to_at_most_one():
    rules = replace(RULES, far_share=0.0)
    insufficient_power = missed_detection_probability(1e6 * np.eye(3)[None], chi2_limit(1e-3, 3), rules)[0]
    assert insufficient_power == pytest.approx(0.999, abs=1e-3)
    once = missed_detection_probability(S[None], 16.27, RULES)[0]
    assert missed_detection_probability(S[None], 16.27, RULES, 5)[0] == pytest.approx(5 * once)
    assert missed_detection_probability(S[None], 16.27, RULES, 10**6)[0] == 1.0


def test_a_sharp_test_lets_through_its_volume_times_the_density_at_the_middle():
    sharp = missed_detection_probability(
        1e-6 * np.eye(3)[None], 9.0, WrongFixRules(near_vertical_m=1.0, far_share=0.0)
    )
    volume = 4.0 / 3.0 * math.pi * (3.0 * 1e-3) ** 3
    assert sharp[0] == pytest.approx(volume / math.sqrt(2.0 * math.pi) ** 3, rel=1e-4)


@pytest.mark.parametrize("scale", [0.3, 1.0, 3.0, 30.0])
def test_where_a_wrong_fix_is_as_wide_in_all_directions_it_is_what_a_chi_square_says(scale):
    rules = WrongFixRules(near_horizontal_m=scale, near_vertical_m=scale, far_share=0.0)
    missed = missed_detection_probability(np.eye(3)[None], 9.0, rules)[0]
    assert missed == pytest.approx(chi2.cdf(9.0 / (1.0 + scale**2), 3), rel=1e-2)


def test_a_part_of_the_wrong_fixes_is_never_missed_oftener_than_there_are_such():
    """The bound is loose where the test is sharp in one direction alone: it must not count the near ones twice."""
    sharp_in_one = np.diag([0.01, 1e4, 1e4])[None]
    rules = WrongFixRules(near_vertical_m=1.0, far_m=1e4, far_share=0.5)
    assert missed_detection_probability(sharp_in_one, 16.27, rules)[0] <= 0.51


def test_many_at_once_give_the_results_of_each_alone():
    many = np.stack([S, np.full((3, 3), math.nan), 4.0 * S, np.diag([1.0, -1.0, 1.0])])
    missed = missed_detection_probability(many, 16.27, RULES)
    alone = [missed_detection_probability(one[None], 16.27, RULES)[0] for one in many]
    assert missed.tolist() == alone
    assert missed[0] < missed[2] < missed[1] == missed[3] == 1.0


def test_the_mean_square_of_wrong_fixes_is_that_of_both_parts():
    horizontal, up = WrongFixRules(
        near_horizontal_m=1, near_vertical_m=2, far_m=10, far_share=0.25
    ).second_moment_m2
    assert (horizontal, up) == (0.75 + 25.0, 3.0 + 25.0)
