"""All fixes off by one vector: the level reaches as far as the independent position cannot exclude; none without.

Base coordinate, fixes led away and a captured pose have one shape: candidate and pose agree, and only the independent
position is elsewhere. So the errors drawn here are of that shape, for candidates of fixes, Doppler and pose alike.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from camber.integrity.epoch_inputs import EpochInputs
from camber.integrity.protection.common_fault import with_common_fault
from camber.integrity.protection.common_fault_probability import (
    CommonFaultRules,
    common_fault_odds,
    likelihood_ratio,
)
from camber.integrity.protection.position_bounds import ErrorMixture, LevelRules, MixtureComponent, bounds_of
from camber.integrity.protection.position_candidates import PositionCandidate
from camber.integrity.protection.position_output import PositionOutput
from camber.integrity.rules import Rules
from support.judging import ALL, SettlingJudge, antenna, at, fix, independent, place, pose

RULES, LEVELS, FAULTS = Rules(), LevelRules(), CommonFaultRules()
exactly = settings(derandomize=True, deadline=None)


def candidate(source="rtk", sigma_m=0.05, east_m=0.0, north_m=0.0):
    m2 = sigma_m**2
    return PositionCandidate(
        source=source,
        time_ns=at(0),
        geodetic=(*place(0, east_m, north_m), 41.8),
        covariance_enu_m2=(m2, 0.0, 0.0, m2, 0.0, m2),
        yaw_rad=0.0,
        mixture=ErrorMixture((MixtureComponent(weight=1.0, horizontal_m2=(m2, 0.0, m2), up_m2=m2),), 1e-9),
        wrong=None,
        up_by_road_m=(0.1, 0.01),
    )


def level_m(one, sigma_m=0.1, rules=LEVELS, **changes):
    bounded = with_common_fault(one, pose(independent=independent(sigma_m=sigma_m, **changes)), rules)
    return bounds_of([bounded.mixture], rules)[0].horizontal_level_m


# --- the odds ----------------------------------------------------------------------------------------------------


def odds_at(squared, sigma_m=0.2):
    m2 = sigma_m**2
    return common_fault_odds((sigma_m * math.sqrt(squared), 0.0), (m2, 0.0, m2), FAULTS)


@exactly
@given(st.floats(0.0, 55.0))
def test_the_odds_are_those_of_the_covariance_that_fits_best(squared):
    d, best = np.array([math.sqrt(squared), 0.0]), 0.0
    for scale in np.geomspace(1.0, 100.0, 400):
        best = max(best, multivariate_normal(cov=scale * np.eye(2)).pdf(d))
    ratio = best / multivariate_normal(cov=np.eye(2)).pdf(d)
    assert odds_at(squared).alone == pytest.approx(FAULTS.prior_odds * ratio, rel=1e-3)


@exactly
@given(st.floats(0.0, 30.0), st.floats(0.0, 5.0), st.floats(0.0, 3.0))
def test_two_faults_of_different_causes_agree_no_oftener_than_stated_whatever_vector_the_fixes_have(
    squared, bias_m, spread_m
):
    """Of fixes off by N(bias, spread²) and the independent position by its own vector."""
    sigma_m, m2 = 0.2, FAULTS.independent_sigma_m**2
    d = np.array([sigma_m * math.sqrt(squared), 0.0])
    both = multivariate_normal(mean=[bias_m, 0.0], cov=(sigma_m**2 + m2 + spread_m**2) * np.eye(2)).pdf(d)
    ratio = both / multivariate_normal(cov=sigma_m**2 * np.eye(2)).pdf(d)
    stated = odds_at(squared, sigma_m).with_independent
    assert stated >= FAULTS.prior_odds * FAULTS.independent_prior * ratio * (1.0 - 1e-9)


@pytest.mark.parametrize("squared", [1e6, math.inf, math.nan])
def test_what_is_far_off_or_no_number_is_a_fault(squared):
    assert odds_at(squared).alone > 1e7
    assert math.isfinite(odds_at(squared).with_independent)


@pytest.mark.parametrize("covariance", [(0.0, 0.0, 0.0), (math.nan, 0.0, 1.0), (1.0, 2.0, 1.0)])
def test_without_a_covariance_everything_is_a_fault(covariance):
    odds = common_fault_odds((0.1, 0.1), covariance, FAULTS)
    assert min(odds.alone, odds.with_independent) > 1e6
    one = (1.0, 0.0, 1.0)
    assert likelihood_ratio((0.1, 0.1), covariance, (0.1, 0.1), one) > 1e12
    assert likelihood_ratio((0.1, 0.1), one, (0.1, 0.1), covariance) > 1e12


@exactly
@given(st.floats(-2.0, 2.0), st.floats(0.1, 2.0), st.floats(-0.9, 0.9))
def test_the_ratio_is_that_of_two_normal_densities(east_m, sigma_m, correlation):
    def density(at_m, ee, en, nn):
        return multivariate_normal(cov=[[ee, en], [en, nn]]).pdf([at_m, 0.3])

    wrong = (1.0 + sigma_m**2, correlation * sigma_m, 1.0 + sigma_m**2)
    right = (sigma_m**2, 0.0, 0.5)
    expected = min(density(east_m + 0.2, *wrong) / density(east_m, *right), math.exp(30.0))
    assert likelihood_ratio((east_m + 0.2, 0.3), wrong, (east_m, 0.3), right) == pytest.approx(
        expected, rel=1e-6
    )


def test_the_prior_is_the_sum_of_the_faults_and_never_a_certainty():
    assert CommonFaultRules(base_prior=0.1, drift_prior=0.02, captured_prior=0.003).prior == pytest.approx(
        0.123
    )
    assert CommonFaultRules(base_prior=0.9).prior == 0.5
    assert CommonFaultRules(base_prior=0.9).prior_odds == 1.0


# --- the level ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("source", ["rtk", "doppler", "sensors", "scan_match"])
@pytest.mark.parametrize("bias_m", [0.0, 0.3, 1.7, 12.0])
def test_errors_of_a_common_fault_stay_within_the_level(source, bias_m):
    """The vehicle is where it is, all fixes `bias_m` beside it, the independent position off by its own error."""
    rng = np.random.default_rng(20)
    beyond, n, sigma_m = 0, 400, 0.3
    for _ in range(n):
        angle, off = rng.uniform(0.0, 2.0 * math.pi), rng.normal(0.0, sigma_m, 2)
        east_m, north_m = bias_m * math.cos(angle), bias_m * math.sin(angle)
        one = candidate(source, 0.05, east_m, north_m)
        beyond += level_m(one, sigma_m, east_m=off[0], north_m=off[1]) < bias_m
    # 1.2e-3 of prior: a share of 1e-7 / 1.2e-3 of the faulted epochs may be beyond it.
    assert beyond == 0


@exactly
@given(st.floats(0.05, 3.0), st.floats(1.01, 2.0), st.floats(0.0, 3.0))
def test_the_level_grows_with_the_error_of_odometry_since_the_last_evidence(sigma_m, factor, east_m):
    one = candidate(east_m=east_m)
    # Where the difference is many σ of the narrower one, that one is surer of the fault.
    if east_m < 2.0 * sigma_m:
        assert level_m(one, sigma_m) <= level_m(one, factor * sigma_m) * (1.0 + 1e-3)


@exactly
@given(st.floats(0.05, 1.0), st.floats(0.0, 3.0), st.floats(0.01, 1.0))
def test_it_grows_with_the_distance_and_reaches_beyond_it_where_it_counts(sigma_m, east_m, more_m):
    near, far = (
        level_m(candidate(east_m=east_m), sigma_m),
        level_m(candidate(east_m=east_m + more_m), sigma_m),
    )
    assert far >= near * (1.0 - 1e-3)
    assert near >= east_m


def test_nothing_that_is_suspected_costs_nothing_and_agreement_argues_against_nothing():
    none = replace(LEVELS, common_fault=CommonFaultRules(base_prior=0.0, drift_prior=0.0, captured_prior=0.0))
    alone = bounds_of([candidate().mixture], LEVELS)[0].horizontal_level_m
    assert level_m(candidate(), rules=none) == pytest.approx(alone, rel=1e-5), "found to 1e-4 of the risk"
    assert level_m(candidate(), 0.1) > 4.0 * 0.1  # 1e-7 / 1.2e-3 of Rayleigh's: 4.3 σ


def test_a_shifted_map_counts_alone_only_for_what_the_map_gives():
    likely = replace(LEVELS, common_fault=replace(FAULTS, map_shift_prior=1e-4, map_shift_sigma_m=2.0))
    of_fixes, of_map = (level_m(candidate(source), 0.1, likely) for source in ("rtk", "scan_match"))
    assert of_fixes < 2.0 < of_map


def test_the_weights_make_one_and_the_height_is_that_of_the_road():
    for source in ("rtk", "sensors"):
        bounded = with_common_fault(candidate(source, east_m=0.4), pose(independent=independent()), LEVELS)
        assert sum(part.weight for part in bounded.mixture.parts) == pytest.approx(1.0)
        last = bounded.mixture.parts[-3]  # on a shifted map, where the road has changed
        assert last.mean_m == pytest.approx((0.4, 0.0, 0.1), abs=1e-3)
        assert last.up_m2 == pytest.approx(0.01 + LEVELS.changed_road_sigma_m**2)


def with_latent(one, odds, sigma_m):
    """The candidate, if a wrong fix that has passed may have taken fixes and pose along."""
    right = one.mixture.parts[0]
    pulled = right._replace(
        weight=odds / (1.0 + odds), horizontal_m2=(sigma_m**2, 0.0, sigma_m**2), is_latent=True
    )
    return replace(one, mixture=ErrorMixture((right.weighed(1.0 / (1.0 + odds)), pulled), one.mixture.lost))


def weights_with_latent(odds, latent_sigma_m, sigma_m=0.1, source="rtk", **changes):
    """Weights of the right part, and of the latent fault alone and with a fault of the independent position."""
    one = with_latent(candidate(source), odds, latent_sigma_m)
    bounded = with_common_fault(one, pose(independent=independent(sigma_m=sigma_m, **changes)), LEVELS)
    assert sum(part.weight for part in bounded.mixture.parts) == pytest.approx(1.0)
    alone, both = (part.weight for part in bounded.mixture.parts if part.is_latent)
    return bounded.mixture.parts[0].weight, alone, both


@pytest.mark.parametrize("odds", [1e-3, 1.0, 1e10])
def test_a_latent_fault_counts_by_how_likely_it_passes_the_comparison(odds):
    """N(d; 0, G + C) / N(d; 0, P + C) at d = 0, 0.3 m: (0.05² + 0.1²) / (1 + 0.1²) and more."""
    right, alone, both = weights_with_latent(odds, 1.0)
    assert alone / right == pytest.approx(odds * 0.0125 / 1.01, rel=1e-6)
    assert both / right == pytest.approx(odds * 1e-3 * 0.0125 / 2.01, rel=1e-6)
    right, apart, _ = weights_with_latent(odds, 1.0, east_m=0.3)
    more = math.exp(0.5 * 0.09 * (1.0 / 0.0125 - 1.0 / 1.01))
    assert apart / right == pytest.approx(odds * 0.0125 / 1.01 * more, rel=1e-3)


def test_one_that_is_smaller_than_the_independent_position_shows_is_as_likely_as_before():
    right, alone, _ = weights_with_latent(0.01, 0.05, sigma_m=1.0)
    assert alone / right == pytest.approx(0.01, rel=1e-2)


def test_a_latent_fault_reaches_as_far_as_the_independent_position_lets_it_however_far_it_may_be_off():
    near, far = (level_m(with_latent(candidate(), 1e-2, sigma_m), 0.1) for sigma_m in (1.0, 10.0))
    assert near < 0.5
    assert far < 0.5
    assert bounds_of([with_latent(candidate(), 1e-2, 1.0).mixture], LEVELS)[0].horizontal_level_m > 4.0


@exactly
@given(st.floats(0.0, 0.99), st.floats(0.05, 2.0), st.floats(0.05, 2.0))
def test_of_positions_that_share_errors_no_correlation_makes_a_latent_fault_wider_than_stated(
    rho, pose_m, sigma_m
):
    """The conditional variance of the error, of any correlation of own error and that of the independent position."""
    g, c, r = 1.0 + pose_m**2, sigma_m**2, rho * pose_m * sigma_m
    exactly_m2 = g - (g - r) ** 2 / (g + c - 2.0 * r)
    one = with_latent(candidate("sensors", pose_m), 1e-3, math.sqrt(g))
    bounded = with_common_fault(one, pose(independent=independent(sigma_m=sigma_m)), LEVELS)
    stated_m2 = next(part for part in bounded.mixture.parts if part.is_latent).horizontal_m2[0]
    assert stated_m2 >= exactly_m2 * (1.0 - 1e-6)


def test_drawn_latent_faults_stay_within_the_level():
    """Half of the candidates are off by N(0, 1 m²), with the pose; the level is that of what is drawn."""
    rng, seed = np.random.default_rng(2011), 2011
    sigma_m, beyond, n, risk = 0.3, 0, 4000, 0.02
    faults = CommonFaultRules(
        base_prior=0.0, drift_prior=0.0, captured_prior=0.0, map_shift_prior=0.0, independent_prior=0.0
    )
    rules = replace(LEVELS, integrity_risk=risk, common_fault=faults, horizontal_margin=1.0)
    for _ in range(n):
        wrong = rng.random() < 0.5
        east_m, north_m = rng.normal(0.0, 1.0 if wrong else 0.05, 2)
        off = rng.normal(0.0, sigma_m, 2)
        one = with_latent(candidate("rtk", 0.05, east_m, north_m), 1.0, 1.0)
        bounded = with_common_fault(
            one, pose(independent=independent(sigma_m=sigma_m, east_m=off[0], north_m=off[1])), rules
        )
        beyond += bounds_of([bounded.mixture], rules)[0].horizontal_level_m < math.hypot(east_m, north_m)
    # 80 expected at most, 107 at three σ.
    assert beyond <= 107, f"seed {seed}: {beyond} of {n}"


def test_an_independent_position_that_may_be_wrong_too_widens_the_level_where_it_is_wide():
    sure = replace(LEVELS, common_fault=replace(FAULTS, independent_prior=0.0))
    assert level_m(candidate(), 0.1) == pytest.approx(level_m(candidate(), 0.1, sure), rel=0.05)
    doubted = replace(LEVELS, common_fault=replace(FAULTS, independent_prior=0.1))
    assert level_m(candidate(), 0.5, doubted) > 1.05 * level_m(candidate(), 0.5, sure)


def test_without_an_independent_position_there_is_nothing_to_bound_by():
    assert with_common_fault(candidate(), None, LEVELS) is None
    assert with_common_fault(candidate(), pose(), LEVELS) is None


# --- positions ---------------------------------------------------------------------------------------------------


def positions_of(the_pose, rules=RULES, the_fix=None):
    judge = SettlingJudge(rules)
    judge.latest.add_pose(the_pose)
    judge.latest.set_antenna_height(antenna())
    judgement = replace(judge.examine(the_fix or fix(), ALL), verdict="confirmed")
    inputs = EpochInputs(pose=the_pose, antenna=antenna(), alive=ALL)
    output = PositionOutput(rules)
    return output.confirmed(judgement, 0.0, inputs), output.at(at(0), inputs, 0.0)


MATCHED = {"mode": "scan_match", "provenance": "scan_match"}


def test_no_position_vouches_for_itself():
    for position in positions_of(pose(**MATCHED)):
        assert (position.usable, position.reason) == (False, "no_independent_position")
        assert position.horizontal_protection_level_m is None
        assert position.vertical_protection_level_m is not None
        assert position.semi_major_99_m is not None
        assert position.horizontal_reference == "required"


def test_with_an_independent_position_it_is_usable_as_long_as_that_is_narrow():
    for position in positions_of(pose(**MATCHED, independent=independent(sigma_m=0.1))):
        assert (position.usable, position.reason) == (True, "none")
    for position in positions_of(pose(**MATCHED, independent=independent(sigma_m=1.0))):
        assert position.horizontal_protection_level_m > position.alert_limit_m
        assert not position.usable


def test_the_same_position_under_the_assumption_says_so():
    assumed = replace(RULES, horizontal_reference="assumed")
    for with_it, without in zip(
        positions_of(pose(**MATCHED, independent=independent(sigma_m=9.0)), assumed),
        positions_of(pose(**MATCHED), assumed),
        strict=True,
    ):
        assert with_it == without
        assert with_it.usable
        assert with_it.horizontal_reference == "assumed"


def test_a_pose_too_old_gives_no_reference():
    old = pose(**MATCHED, independent=independent())
    output = PositionOutput(RULES)
    judge = SettlingJudge(RULES)
    judge.latest.add_pose(old)
    judge.latest.set_antenna_height(antenna())
    judgement = replace(judge.examine(fix(), ALL), verdict="confirmed")
    position = output.confirmed(
        judgement, 0.0, EpochInputs(pose=pose(-5, **MATCHED), antenna=antenna(), alive=ALL)
    )
    assert position.reason == "no_independent_position"
