"""The lab's bounds are the product's, and hold as often as closed forms say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.rules import Rules
from camber.validation.lab.bound_coverage import (
    ALERT_LIMITS_M,
    LEVEL_PARAMETERS,
    MODES,
    SCENE,
    VELOCITY_SIGMA_M_S,
    ClaimedPositions,
    bounds,
    claimed_growth,
    confirmed_claims,
    coverage_block,
    coverage_figures,
    prior_shares,
)
from camber.validation.lab.error_episodes import episodes
from camber.validation.lab.false_alarms import right_fixes
from camber.validation.lab.misleading_information import misleading_block, misleading_figures
from camber.validation.lab.work_blocks import WorkBlock

BLOCK = WorkBlock(seed=13, number=0, repeats=40)


def _claimed(error_m: np.ndarray, covariance_m2: np.ndarray) -> ClaimedPositions:
    n = len(error_m)
    return ClaimedPositions(
        error_m=error_m, weight=np.ones((n, 1)), mean_m=np.zeros((n, 1, 2)),
        covariance_m2=np.tile(covariance_m2, (n, 1, 1, 1)), lost=np.zeros(n),
    )  # fmt: skip


def _normal(n: int, sigma_m: float, times: float = 1.0) -> ClaimedPositions:
    error_m = times * sigma_m * np.random.default_rng(BLOCK.seed).normal(size=(n, 2))
    return _claimed(error_m, np.eye(2) * sigma_m**2)


def test_the_ellipse_of_a_normal_error_holds_what_its_margin_makes_of_it() -> None:
    claimed = bounds(_normal(10_000, 0.08))
    expected = 1.0 - 0.01 ** (LEVEL_PARAMETERS.horizontal_margin**2)
    inside = np.mean(np.hypot(*claimed.in_99.T) <= 1.0)
    assert inside == pytest.approx(expected, abs=4.0 * math.sqrt(0.0075 / 10_000))
    assert claimed.level_m[0] == pytest.approx(
        0.08
        * LEVEL_PARAMETERS.horizontal_margin
        * math.sqrt(-2.0 * math.log(LEVEL_PARAMETERS.integrity_risk)),
        rel=1e-3,
    )


def test_ellipses_turn_with_their_covariance() -> None:
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    covariance = turn @ np.diag([0.3**2, 0.05**2]) @ turn.T
    error = np.array([turn @ (0.9, 0.0), turn @ (0.0, 0.9)])
    length = np.hypot(*bounds(_claimed(error, covariance)).in_99.T)
    assert length[1] / length[0] == pytest.approx(6.0, rel=1e-3)


def test_the_sum_of_velocities_grows_as_an_integrated_gauss_markov_process() -> None:
    variances, sigma_m_s = claimed_growth()
    rules = LEVEL_PARAMETERS.doppler
    assert sigma_m_s == pytest.approx(
        math.hypot(rules.sigma_scale * VELOCITY_SIGMA_M_S, rules.sigma_floor_m_s)
    )
    at = 200  # 20 s
    t = 20.0 / rules.correlation_s
    closed = 2.0 * (sigma_m_s * rules.correlation_s) ** 2 * (t - 1.0 + math.exp(-t))
    assert variances[at] == pytest.approx(closed, rel=0.02)
    assert variances[0] == 0.0


def test_a_fix_that_is_far_from_its_pose_is_bounded_where_the_pose_is() -> None:
    """On loose limits, so that the far fix is confirmed too."""
    loose = ConsistencyParameters(tests=("height",))
    rules, shapes = replace(Rules(), determination=loose), right_fixes(BLOCK, "far")
    shapes = shapes.chosen(np.arange(2))
    difference = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    run = replace(
        episodes(shapes, SCENE, BLOCK.stream("far"), length=1),
        difference_m=difference,
        slope=np.zeros((2, 2)),
    )
    agreed, claimed = confirmed_claims(shapes, run, np.full(2, 0.1), rules)
    assert agreed.all()
    assert claimed.weight.sum(axis=1) == pytest.approx([1.0, 1.0])
    assert claimed.weight[0, 1] < 1e-3
    assert claimed.weight[1, 1] > 0.999
    near, far = bounds(claimed).level_m
    assert near < 0.4
    assert far > 2.0


def test_the_lab_draws_as_many_wrong_fixes_as_the_prior_of_their_satellites_says() -> None:
    shapes = right_fixes(replace(BLOCK, skies=100), "levels")
    shares = prior_shares(shapes)
    assert set(shares[shapes.satellites <= 7]) == {0.95}
    assert set(shares[(shapes.satellites > 7) & (shapes.satellites <= 12)]) == {0.3}
    assert set(shares[shapes.satellites > 12]) == {0.1}
    hazard = misleading_figures([misleading_block(BLOCK)])
    assert 0.1 < hazard["wrong_fix_prior"] < 0.95


def test_a_block_counts_every_mode_and_its_figures_are_shares_of_its_draws() -> None:
    block = coverage_block(BLOCK, 2_000)
    figures = coverage_figures([block])
    assert set(figures["modes"]) == set(MODES)
    for counts in figures["modes"].values():
        assert counts["inside_99"]["share"] <= counts["inside_999"]["share"]
        assert counts["inside_99"]["share"] > 0.985
        assert counts["available"] == sorted(counts["available"])
        assert len(counts["available"]) == len(ALERT_LIMITS_M)
        assert np.sum(counts["chart"]) == counts["draws"]
        assert counts["beyond_level"]["count"] == 0


def test_hazard_is_the_sum_of_its_parts_by_their_shares() -> None:
    figures = misleading_figures([misleading_block(BLOCK)])
    parts = figures["parts"]
    assert figures["upper_95"] == pytest.approx(sum(part["share"] * part["upper_95"] for part in parts))
    assert sum(part["share"] for part in parts) == pytest.approx(1.0)
    for part in parts:
        assert part["rate"] < part["upper_95"] < 3.0 * part["rate"]
        assert 1.0 <= part["effective"] <= part["draws"]
    coincidence = parts[3]
    assert 0.0 < coincidence["rate"] < coincidence["upper_95"] < 1e-2
