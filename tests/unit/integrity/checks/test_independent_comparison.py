"""A fix against the independent position: the same test as of the pose, but only this one is evidence of the place."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.checks.independent_position import compare_with_independent, offset_from_independent
from camber.integrity.protection.covariance_inflation import TrueSigma
from support.judging import at, fix, independent, place, pose

SIGMA, LIMITS = TrueSigma(), ConsistencyParameters().limits()
exactly = settings(derandomize=True, deadline=None)


def compared(the_fix, **changes):
    return compare_with_independent(the_fix, pose(independent=independent(**changes)), SIGMA, LIMITS)


@exactly
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(0.05, 2.0), st.floats(-0.9, 0.9))
def test_it_contradicts_beyond_chi_square_of_both_covariances(east_m, north_m, sigma_m, correlation):
    covariance = (sigma_m**2, correlation * sigma_m**2, sigma_m**2)
    result = compared(fix(east_m=east_m, north_m=north_m), covariance_east_north=covariance)
    fix_m2 = SIGMA.scale**2 * 2.5e-5 + SIGMA.horizontal_m**2
    along, across = (sigma_m**2 * (1 + sign * correlation) + fix_m2 for sign in (1, -1))
    squared = (east_m + north_m) ** 2 / 2 / along + (east_m - north_m) ** 2 / 2 / across
    limit = chi2.isf(1e-6 / 3, 2)  # three tests share the rate
    if abs(squared - limit) > 0.01 * limit:
        assert result.contradicts == (squared > limit)
    assert not (result.agrees and result.contradicts)


@pytest.mark.parametrize(("north_m", "contradicts"), [(1.4, False), (-1.4, True)])
def test_an_ellipse_that_is_aslant_reaches_farther_in_its_direction(north_m, contradicts):
    result = compared(fix(east_m=1.4, north_m=north_m), covariance_east_north=(0.25, 0.23, 0.25))
    assert result.contradicts == contradicts


def test_it_is_moved_on_to_the_north_where_the_vehicle_drives_there():
    there = fix(0, north_m=1.0)
    driving = pose(independent=independent(), yaw_rad=math.pi / 2.0)
    offset = offset_from_independent(there.latitude_rad, there.longitude_rad, driving, at(0.5))
    assert offset.difference_m == pytest.approx((0.0, 0.0), abs=1e-3)


def test_it_is_moved_on_to_the_time_of_the_fix_and_widened_by_acceleration():
    half = fix(0.5)  # 0.1 s later, 1 m farther on
    offset = offset_from_independent(
        half.latitude_rad, half.longitude_rad, pose(independent=independent(sigma_m=0.2)), half.time_ns
    )
    assert offset.difference_m == pytest.approx((0.0, 0.0), abs=1e-3)
    assert offset.covariance_m2 == pytest.approx((0.04 + 0.01**2, 0.0, 0.04 + 0.01**2))


def test_its_figures_say_how_old_the_evidence_is():
    result = compared(fix(north_m=3.0), sigma_m=0.3, basis="relief", distance_m=250.0)
    assert result.describe() == "3.00 m from the independent position of σ 0.30 m (relief, 250 m ago)"
    assert result.sigma_m == pytest.approx(0.3)


@pytest.mark.parametrize(
    "covariance",
    [(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 2.0, 1.0), (1.0, 1.0, 1.0)],
)
def test_what_is_no_covariance_is_no_evidence(covariance):
    assert compared(fix(), covariance_east_north=covariance) is None


def test_without_a_position_there_is_no_comparison():
    assert compare_with_independent(fix(), pose(), SIGMA, LIMITS) is None
    assert offset_from_independent(*place(0), pose(), at(0)) is None
    assert compared(fix(covariance_enu_m2=None)) is None


def test_the_wider_it_is_the_farther_agreement_reaches():
    reaches = [compared(fix(), sigma_m=sigma).acceptance_radius_m for sigma in (0.05, 0.1, 0.3, 1.0, 5.0)]
    assert reaches == sorted(reaches)
    assert all(math.isfinite(reach) for reach in reaches)
