"""Ambiguities, conditional fixes and the tests that a fix has to pass, against a slow second way."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import norm

from camber.gnss.ambiguity.ambiguity_resolution import RATIO_TOO_LOW, RESOLVED, UNLIKELY, resolve
from camber.gnss.ambiguity.fixed_solution import (
    CONTRADICTORY,
    FAR,
    IMPRECISE,
    NO_POSITION,
    Estimate,
    ambiguities,
    chi2_limit,
    estimate,
    phase_residuals,
)
from camber.gnss.position.engine_settings import EngineSettings
from camber.gnss.position.float_solution import NO_PRIOR, PositionPrior, float_position, float_with_prior
from support.single_difference_rows import double_differences, made_up_rows, slow_float

LIMITS = EngineSettings().fix_criteria()


def estimated(rows, usable=None, limits=LIMITS, prior=NO_PRIOR) -> Estimate:
    usable = np.ones(rows.group.size, np.bool_) if usable is None else usable
    return estimate(rows, usable, prior, limits)


def slow_estimate(rows, used):
    """Float ambiguities and position by one least squares of code and phase double differences."""
    of_code, of_phase = (rows.code_m, rows.code_variance_m2), (rows.phase_m, rows.phase_variance_m2)
    design_code, code, covariance_code, pairs = double_differences(rows, *of_code, used, last=False)
    design_phase, phase, covariance_phase, _ = double_differences(rows, *of_phase, used, last=False)
    m = len(pairs)
    wavelength = np.diag([rows.wavelength_m[i] for i, _ in pairs])
    design = np.block([[design_code, np.zeros((m, m))], [design_phase, wavelength]])
    weight = np.linalg.inv(block_diag(covariance_code, covariance_phase))
    covariance = np.linalg.inv(design.T @ weight @ design)
    state = covariance @ design.T @ weight @ np.concatenate((code, phase))
    return state, covariance, pairs


def slow_fixed(rows, used, integer):
    """Position from code and phase double differences whose integers are known."""
    metres = rows.phase_m - integer * rows.wavelength_m
    information, right = np.zeros((3, 3)), np.zeros(3)
    for measured in ((rows.code_m, rows.code_variance_m2), (metres, rows.phase_variance_m2)):
        design, value, covariance, _ = double_differences(rows, *measured, used, last=False)
        information += design.T @ np.linalg.solve(covariance, design)
        right += design.T @ np.linalg.solve(covariance, value)
    return np.linalg.solve(information, right), np.linalg.inv(information)


def calm(seed, **arguments):
    """Errors so small that χ² of the codes does not scale the covariance."""
    return made_up_rows(np.random.default_rng(seed), noise=0.5, **arguments)


@pytest.mark.parametrize("seed", range(5))
def test_ambiguities_and_their_covariances_are_those_of_one_least_squares(seed):
    rows = calm(seed, satellites=6).rows
    used = np.ones(rows.group.size, np.bool_)
    first = float_position(rows, used, NO_PRIOR, np.inf)
    assert first.chi2 < first.freedom
    fix = ambiguities(rows, used, first.dx_m, first.covariance_m2)
    state, covariance, pairs = slow_estimate(rows, used)
    # The references differ: the slow way's differences are turned into ours.
    members = np.array([member for member, _ in pairs])
    turn = (fix.row[:, None] == members) - 1.0 * (fix.reference[:, None] == members)
    np.testing.assert_allclose(fix.value, turn @ state[3:], atol=1e-5)
    np.testing.assert_allclose(fix.covariance, turn @ covariance[3:, 3:] @ turn.T, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(fix.position_covariance_m, covariance[:3, 3:] @ turn.T, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("seed", range(8))
def test_a_fix_is_the_least_squares_with_known_integers(seed):
    made = calm(seed, satellites=7)
    fix = estimated(made.rows)
    assert (fix.status, fix.fixed) == (RESOLVED, fix.ambiguities)
    used = np.ones(made.rows.group.size, np.bool_)
    dx, covariance = slow_fixed(made.rows, used, made.integer)
    np.testing.assert_allclose(fix.dx_m, dx, atol=1e-6)
    np.testing.assert_allclose(fix.covariance_m2, covariance, rtol=1e-4, atol=1e-12)
    for g in np.unique(made.rows.group):
        of_group = made.rows.group == g
        assert len(np.unique(fix.integer[of_group] - made.integer[of_group])) == 1


def test_ratio_and_success_rate_are_those_of_the_resolution_with_a_prior():
    made = calm(1, satellites=6, systems="G", bands=1)
    prior, used = PositionPrior(made.dx_m + 0.03, np.eye(3) / 0.15**2), np.ones(6, np.bool_)
    first = float_with_prior(made.rows, used, prior, LIMITS.code_outlier)
    unknown = ambiguities(made.rows, used, first.dx_m, first.covariance_m2)
    limits = LIMITS._replace(partial=False, least_success_rate=0.0)
    fix, resolution = estimated(made.rows, limits=limits, prior=prior), resolve(*unknown[:2], limits)
    assert (fix.ratio, fix.success_rate) == (resolution.ratio, resolution.success_rate)


def test_fixes_are_as_far_off_as_their_covariance_says():
    nees = []
    for seed in range(200):
        made = made_up_rows(np.random.default_rng(seed), satellites=7)
        fix = estimated(made.rows)
        if fix.status == RESOLVED and fix.fixed == fix.ambiguities:
            error = fix.dx_m - made.dx_m
            nees.append(error @ np.linalg.solve(fix.covariance_m2, error))
    assert len(nees) > 180
    assert 2.4 < np.mean(nees) < 3.6


@given(st.integers(0, 6), st.floats(-1e6, 1e6), st.floats(-1e5, 1e5))
@settings(derandomize=True, max_examples=25, deadline=None)
def test_a_clock_or_a_phase_delay_common_to_a_group_changes_nothing(seed, code_m, phase_m):
    rows = calm(seed).rows
    in_group = rows.group == rows.group[3]
    shifted = rows._replace(code_m=rows.code_m + code_m * in_group, phase_m=rows.phase_m + phase_m * in_group)
    before, after = estimated(rows), estimated(shifted)
    assert before.status == after.status == RESOLVED
    np.testing.assert_allclose(after.dx_m, before.dx_m, atol=1e-6)


@given(st.integers(0, 6), st.lists(st.integers(-10_000_000, 10_000_000), min_size=32, max_size=32))
@settings(derandomize=True, max_examples=25, deadline=None)
def test_whole_cycles_move_the_integers_and_nothing_else(seed, cycles):
    rows = calm(seed).rows
    more = np.array(cycles[: rows.group.size], np.float64)
    before = estimated(rows)
    after = estimated(rows._replace(phase_m=rows.phase_m + more * rows.wavelength_m))
    np.testing.assert_allclose(after.dx_m, before.dx_m, atol=1e-6)
    for g in np.unique(rows.group):
        of_group = rows.group == g
        moved = after.integer[of_group] - before.integer[of_group] - more[of_group]
        assert len(np.unique(moved)) == 1


def test_half_a_cycle_in_one_phase_is_no_fix_of_all():
    """A phase of half a cycle contradicts: all integers at once, or none."""
    whole = LIMITS._replace(partial=False)
    for seed in range(20):
        made = calm(seed)
        assert estimated(made.rows, limits=whole).status == RESOLVED
        phase = made.rows.phase_m.copy()
        phase[4] += 0.5 * made.rows.wavelength_m[4]
        fix = estimated(made.rows._replace(phase_m=phase), limits=whole)
        assert fix.status in (RATIO_TOO_LOW, CONTRADICTORY, UNLIKELY)


def test_a_wrong_phase_of_decimetres_never_makes_a_fix_of_decimetres():
    for seed in range(40):
        made = calm(seed, satellites=9)
        rng = np.random.default_rng(seed + 70)
        phase = made.rows.phase_m.copy()
        phase[rng.choice(phase.size, 3, replace=False)] += rng.uniform(-0.1, 0.1, 3)
        fix = estimated(made.rows._replace(phase_m=phase))
        if fix.status == RESOLVED:
            assert np.linalg.norm(fix.dx_m - made.dx_m) < 0.1


def test_without_phases_there_is_a_float_position_and_no_fix():
    made = calm(1)
    fix = estimated(made.rows._replace(phase_m=np.full(made.rows.group.size, np.nan)))
    assert (fix.status, fix.ambiguities) == (UNLIKELY, 0)
    assert np.linalg.norm(fix.float_dx_m - made.dx_m) < 2.0
    assert np.isnan(fix.integer).all()


def test_a_phase_without_its_group_resolves_nothing():
    """One phase of each group: there is no difference to be an integer."""
    rows = calm(2).rows
    phase = np.full(rows.group.size, np.nan)
    _, first = np.unique(rows.group, return_index=True)
    phase[first] = rows.phase_m[first]
    assert estimated(rows._replace(phase_m=phase)).ambiguities == 0


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_too_few_satellites_are_no_position(count):
    rows = made_up_rows(np.random.default_rng(3), satellites=count, systems="G").rows
    assert estimated(rows).status == NO_POSITION


def test_a_position_far_from_where_it_was_linearised_is_none():
    rows = made_up_rows(np.random.default_rng(4), dx_m=(150.0, 0.0, 0.0)).rows
    assert estimated(rows).status == FAR


def test_integers_that_leave_the_position_vague_are_no_fix():
    rows = calm(5).rows
    assert estimated(rows, limits=LIMITS._replace(largest_sigma_m=1e-3)).status == IMPRECISE


def test_a_code_that_misplaces_its_satellite_takes_the_phases_of_all_its_bands_along():
    made = calm(6)
    code, phase = made.rows.code_m.copy(), made.rows.phase_m.copy()
    satellite = made.rows.satellite[5]
    code[5] += 3.0e5
    phase[made.rows.satellite == satellite] += 0.11  # as the satellite's place is wrong
    fix = estimated(made.rows._replace(code_m=code, phase_m=phase))
    assert fix.status == RESOLVED
    assert fix.ambiguities == made.rows.group.size - 4 - 2
    assert np.isnan(fix.integer[made.rows.satellite == satellite]).all()
    np.testing.assert_allclose(fix.dx_m, made.dx_m, atol=0.03)


@pytest.mark.parametrize("freedom", [1, 2, 5, 20, 60])
@pytest.mark.parametrize("probability", [0.05, 1e-3, 1e-4])
def test_the_limit_of_chi_squared_is_its_quantile(freedom, probability):
    limit = chi2_limit(freedom, float(norm.isf(probability)))
    assert limit == pytest.approx(chi2_distribution.isf(probability, freedom), rel=0.08)


def test_residuals_of_right_phases_are_as_their_variances_say_and_of_wrong_ones_are_not():
    total, freedom = 0.0, 0
    for seed in range(400):
        made = made_up_rows(np.random.default_rng(seed))
        chi2, degrees = phase_residuals(made.rows, made.integer.astype(np.float64))
        total, freedom = total + chi2, freedom + degrees
        wrong = made.integer.astype(np.float64)
        wrong[3] += 1.0
        assert phase_residuals(made.rows, wrong)[0] > chi2_limit(degrees, 3.72)
    assert total / freedom == pytest.approx(1.0, abs=0.04)


def test_residuals_are_those_of_double_differences():
    made = made_up_rows(np.random.default_rng(9))
    metres = made.rows.phase_m - made.integer * made.rows.wavelength_m
    as_code = made.rows._replace(code_m=metres, code_variance_m2=made.rows.phase_variance_m2)
    _, _, chi2, freedom = slow_float(as_code, np.ones(metres.size, np.bool_))
    fix = phase_residuals(made.rows, made.integer.astype(np.float64))
    assert fix == (pytest.approx(chi2, rel=1e-3), freedom)


def test_too_few_phases_cannot_be_tested():
    made = made_up_rows(np.random.default_rng(10))
    integer = np.full(made.rows.group.size, np.nan)
    integer[:4:2] = made.integer[:4:2]
    assert phase_residuals(made.rows, integer) == (0.0, 0)
