"""The verdict that is published says all that the judgement rests on, and a position only where it is confirmed."""

import numpy as np
import pytest

from camber.integrity.checks.fix_comparison import FixComparison
from camber.integrity.checks.height_model import RoadPoint
from camber.integrity.judgement import FixJudgement, verdict_of
from camber.integrity.protection.covariance_inflation import TrueSigma
from support.judging import ROAD_M, at, fix, pose, road

SIGMA = TrueSigma(scale=2.0, horizontal_m=0.03, vertical_m=0.04)
COMPARISON = FixComparison(
    difference_m=np.array([0.3, -0.1, 0.15]),
    covariance_m2=np.eye(3),
    outcome=3,
    position=0,
    height_m=-0.15,
    height_sigma_m=0.06,
    tolerance_m=0.2,
    acceptance_radius_m=0.5,
    joint_distance2=4.5,
    joint_limit=16.3,
)


def judgement(verdict="erroneous", **changes):
    return FixJudgement(fix=fix(3), verdict=verdict, reason="height_disagrees", **changes)


def test_the_verdict_is_of_the_fix_and_has_the_comparison():
    verdict = verdict_of(
        judgement(
            detail="height -0.15 m",
            evidence=("phase_residuals",),
            comparison=COMPARISON,
            correction_m=0.02,
            cause="road",
            trials=21,
        ),
        SIGMA,
    )
    assert (verdict.time_ns, verdict.fix_id) == (at(3), fix(3).fix_id)
    assert (verdict.verdict, verdict.reason, verdict.detail) == (
        "erroneous",
        "height_disagrees",
        "height -0.15 m",
    )
    assert verdict.evidence == ("phase_residuals",)
    assert (verdict.height_difference_m, verdict.tolerance_m) == (-0.15, 0.2)
    assert verdict.position_difference_m == (0.3, -0.1)
    assert (verdict.joint_distance2, verdict.joint_limit) == (4.5, 16.3)
    assert (verdict.cause, verdict.correction_m, verdict.trials) == ("road", 0.02, 21)


def test_where_nothing_was_compared_there_are_no_figures():
    verdict = verdict_of(judgement(), SIGMA)
    assert (verdict.height_difference_m, verdict.tolerance_m) == (None, None)
    assert (verdict.position_difference_m, verdict.joint_distance2, verdict.joint_limit) == (None, None, None)
    assert (verdict.surface_id, verdict.map_version) == (None, None)


def test_its_surface_is_the_one_under_the_fix_else_the_one_under_the_pose():
    under_the_fix = judgement(
        pose=pose(road=road(surface_id=7)), road=RoadPoint(elevation_m=ROAD_M, sigma_m=0.03, surface_id=8)
    )
    under_the_pose = judgement(pose=pose(road=road(surface_id=7)))
    assert verdict_of(under_the_fix, SIGMA).surface_id == 8
    assert verdict_of(under_the_pose, SIGMA).surface_id == 7
    assert verdict_of(under_the_pose, SIGMA).map_version == 3


@pytest.mark.parametrize("verdict", ["confirmed", "confirmed_after_verification"])
def test_a_confirmed_one_has_the_position_of_the_fix_with_its_true_sigma(verdict):
    verdict = verdict_of(judgement(verdict), SIGMA)
    assert (verdict.latitude_rad, verdict.longitude_rad, verdict.height_m) == (
        fix(3).latitude_rad,
        fix(3).longitude_rad,
        fix(3).height_m,
    )
    expected = (4 * 2.5e-5 + 9e-4, 0.0, 0.0, 4 * 2.5e-5 + 9e-4, 0.0, 4 * 1e-4 + 16e-4)
    assert verdict.covariance_enu_m2 == pytest.approx(expected)


@pytest.mark.parametrize("verdict", ["erroneous", "unknown"])
def test_another_has_none(verdict):
    verdict = verdict_of(judgement(verdict), SIGMA)
    assert (verdict.latitude_rad, verdict.longitude_rad, verdict.height_m) == (None, None, None)
    assert verdict.covariance_enu_m2 is None


@pytest.mark.parametrize("reference", ["required", "assumed"])
def test_it_has_the_setting_that_it_follows(reference):
    assert verdict_of(judgement(), SIGMA, reference).horizontal_reference == reference
