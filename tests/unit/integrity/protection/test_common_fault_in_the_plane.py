"""Common and latent faults where covariances are those of ellipses and priors are large enough to see each part."""

import math
from collections import defaultdict

import numpy as np
import pytest

from camber.integrity.protection.common_fault import with_common_fault
from camber.integrity.protection.common_fault_probability import (
    MOST_LOG_ODDS,
    CommonFaultRules,
    common_fault_odds,
    likelihood_ratio,
)
from camber.integrity.protection.position_bounds import ErrorMixture, LevelRules, MixtureComponent
from camber.integrity.protection.position_candidates import PositionCandidate
from support.judging import at, independent, place, pose

FAULTS = CommonFaultRules(
    base_prior=0.1,
    map_shift_prior=0.2,
    map_shift_sigma_m=0.5,
    independent_prior=0.25,
    independent_sigma_m=0.7,
)
LEVELS = LevelRules(common_fault=FAULTS)
POSE_M2, INDEPENDENT_M2 = (0.04, 0.015, 0.09), (0.2, -0.1, 0.3)
DIFFERENCE_M = (0.6, -0.5)
LATENT = (
    ((1.0, 0.4, 2.0), (0.3, -0.2, 0.05), 0.02),
    ((3.0, -1.0, 1.0), (-0.4, 0.5, 0.0), 0.01),
)


def matrix(covariance_m2):
    ee, en, nn = covariance_m2
    return np.array([[ee, en], [en, nn]])


def triangle(covariance_m2):
    return covariance_m2[0, 0], covariance_m2[0, 1], covariance_m2[1, 1]


def density(difference_m, covariance_m2):
    d = np.array(difference_m)
    squared = float(d @ np.linalg.solve(covariance_m2, d))
    return math.exp(-0.5 * squared) / (2.0 * math.pi * math.sqrt(float(np.linalg.det(covariance_m2))))


def candidate(source):
    """Of two parts, two latent faults, and one that is no more possible."""
    ee, en, nn = POSE_M2
    latent = [
        MixtureComponent(weight=weight, horizontal_m2=m2, up_m2=0.01, mean_m=mean_m, is_latent=True)
        for m2, mean_m, weight in (*LATENT, (LATENT[0][0], LATENT[0][1], 0.0))
    ]
    parts = [
        MixtureComponent(weight=0.9, horizontal_m2=POSE_M2, up_m2=0.01),
        MixtureComponent(weight=0.05, horizontal_m2=(0.5, 0.1, 0.5), up_m2=0.02),
        MixtureComponent(weight=0.02, horizontal_m2=(0.7, 0.1, 0.7), up_m2=0.03),
    ]
    return PositionCandidate(
        source=source,
        time_ns=at(0),
        geodetic=(*place(0, *DIFFERENCE_M), 41.8),
        covariance_enu_m2=(ee, en, 0.0, nn, 0.0, 0.01),
        yaw_rad=0.0,
        mixture=ErrorMixture((*parts, *latent), 1e-9),
        wrong=None,
        up_by_road_m=(0.1, 0.01),
    )


def bounded(source):
    return with_common_fault(
        candidate(source), pose(independent=independent(covariance_east_north=INDEPENDENT_M2)), LEVELS
    ).mixture.parts


S = matrix(POSE_M2) + matrix(INDEPENDENT_M2)
OTHER = FAULTS.independent_sigma_m**2 * np.eye(2)
SHIFT = FAULTS.map_shift_sigma_m**2 * np.eye(2)


@pytest.mark.parametrize(
    ("source", "scale"), [("rtk", 1.0), ("doppler", 1.0), ("sensors", 2.0), ("scan_match", 2.0)]
)
def test_each_latent_fault_has_the_likelihood_of_its_ellipse_and_its_bound(source, scale):
    """Relative to the part that is nowhere wider than what is compared: the second."""
    parts = bounded(source)
    assert sum(part.weight for part in parts) == pytest.approx(1.0)
    of_one = parts[1].weight / 0.05
    latent = [part for part in parts if part.is_latent]
    assert len(latent) == 4
    right = density(DIFFERENCE_M, S)
    for k, (m2, mean_m, weight) in enumerate(LATENT):
        alone, both = latent[k], latent[k + 2]
        off_m = np.array(DIFFERENCE_M) - np.array(mean_m[:2])
        wrong_m2 = matrix(m2) + matrix(INDEPENDENT_M2)
        expected = weight * density(off_m, wrong_m2) / right
        assert alone.weight / of_one == pytest.approx(expected, rel=1e-4)
        assert alone.mean_m == pytest.approx((*DIFFERENCE_M, mean_m[2]), abs=1e-4)
        conditional_m2 = np.linalg.inv(np.linalg.inv(matrix(m2)) + np.linalg.inv(matrix(INDEPENDENT_M2)))
        assert alone.horizontal_m2 == pytest.approx(triangle(scale * conditional_m2))
        expected = FAULTS.independent_prior * weight * density(off_m, wrong_m2 + OTHER) / right
        assert both.weight / of_one == pytest.approx(expected, rel=1e-4)
        assert (both.mean_m, both.horizontal_m2) == (mean_m, m2), "as wide as before"


@pytest.mark.parametrize("source", ["rtk", "doppler", "sensors", "scan_match"])
def test_what_only_the_independent_position_shows_is_as_wide_as_that_or_a_shifted_map_or_a_fault_of_it(
    source,
):
    parts = [part for part in bounded(source) if not part.is_latent]
    of_one = parts[1].weight / 0.05
    odds = common_fault_odds(DIFFERENCE_M, triangle(S), FAULTS)
    rest, share = 0.97, FAULTS.map_shift_prior
    weights = defaultdict(float)
    for part in parts:
        if part.mean_m != (0.0, 0.0, 0.0):
            assert part.mean_m == pytest.approx((*DIFFERENCE_M, 0.1), abs=1e-4)
            weights[tuple(round(m2, 6) for m2 in part.horizontal_m2)] += part.weight / (rest * of_one)
    expected = {
        INDEPENDENT_M2: (1.0 - share) * odds.alone,
        triangle(matrix(INDEPENDENT_M2) + SHIFT): share * odds.alone,
        triangle(matrix(INDEPENDENT_M2) + OTHER): odds.with_independent,
    }
    assert len(weights) == 3
    for m2, weight in expected.items():
        assert weights[tuple(round(float(m), 6) for m in m2)] == pytest.approx(weight, rel=1e-4)


@pytest.mark.parametrize(
    ("source", "by_map"), [("rtk", False), ("doppler", False), ("sensors", True), ("scan_match", True)]
)
def test_only_what_the_map_gives_is_shifted_with_it(source, by_map):
    parts = [part for part in bounded(source) if not part.is_latent and part.mean_m == (0.0, 0.0, 0.0)]
    of_one = parts[1].weight / 0.05
    rows = [(0.9, POSE_M2), (0.05, (0.5, 0.1, 0.5)), (0.02, (0.7, 0.1, 0.7))]
    if by_map:
        rows = [(0.72, POSE_M2), *rows[1:], (0.18, triangle(matrix(POSE_M2) + SHIFT))]
    assert [part.weight / of_one for part in parts] == pytest.approx([weight for weight, _ in rows])
    for part, (_, m2) in zip(parts, rows, strict=True):
        assert part.horizontal_m2 == pytest.approx(m2)


# --- the odds ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("covariance_m2", [triangle(S), (0.04, 0.035, 0.05), (4.0, -1.0, 2.0)])
def test_two_faults_are_as_likely_as_the_peak_of_the_wider_ellipse(covariance_m2):
    narrow = matrix(covariance_m2)
    for difference_m in ((0.1, 0.0), (0.2, -0.1), (0.1, 0.3)):
        peak = density((0.0, 0.0), narrow + OTHER) / density(difference_m, narrow)
        odds = common_fault_odds(difference_m, covariance_m2, FAULTS)
        assert odds.with_independent == pytest.approx(FAULTS.prior_odds * FAULTS.independent_prior * peak)


def test_agreement_argues_for_no_fault_and_disagreement_by_the_best_scale():
    for squared, ratio in (
        (0.0, 1.0),
        (1.9, 1.0),
        (2.0, 1.0),
        (3.0, math.exp(0.5) / 1.5),
        (8.0, math.exp(3.0) / 4.0),
    ):
        odds = common_fault_odds((math.sqrt(squared), 0.0), (1.0, 0.0, 1.0), FAULTS)
        assert odds.alone == pytest.approx(FAULTS.prior_odds * ratio)


@pytest.mark.parametrize("covariance_m2", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1e200, 0.0, 1e200)])
def test_without_a_peak_two_faults_are_as_likely_as_can_be(covariance_m2):
    odds = common_fault_odds((0.0, 0.0), covariance_m2, FAULTS)
    expected = FAULTS.prior_odds * FAULTS.independent_prior * math.exp(MOST_LOG_ODDS)
    assert odds.with_independent == pytest.approx(expected)


@pytest.mark.parametrize(
    "none", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (math.inf, 0.0, math.inf), (0.1, 0.0, -0.1)]
)
def test_what_is_no_covariance_makes_the_ratio_the_most_there_is(none):
    one, most = (0.01, 0.0, 0.01), math.exp(MOST_LOG_ODDS)
    assert likelihood_ratio((0.1, 0.1), none, (0.1, 0.1), one) == pytest.approx(most)
    assert likelihood_ratio((0.1, 0.1), one, (0.1, 0.1), none) == pytest.approx(most)
    assert likelihood_ratio((0.0, 0.0), one, (0.0, 0.0), one) == 1.0
