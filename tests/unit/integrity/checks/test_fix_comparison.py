"""A fix is compared with road and antenna where it is, and with the pose when it is; covariances add up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.checks.fix_comparison import compare
from camber.integrity.checks.height_model import HeightModel, RoadPoint
from camber.integrity.protection.covariance_inflation import TrueSigma
from support.judging import ANTENNA_M, ROAD_M, fix, pose

SIGMA = TrueSigma(scale=2.0, horizontal_m=0.03, vertical_m=0.04)
COVARIANCE = (2e-4, 1e-5, 2e-5, 3e-4, 3e-5, 5e-4)
ROAD = RoadPoint(elevation_m=ROAD_M, sigma_m=0.03, slope_east=0.1, slope_north=-0.05, surface_id=7)
HEIGHT = HeightModel(antenna_m=ANTENNA_M, correction_m=-0.02, sigma_m=0.025)


def compared(the_fix=None, *, the_pose=None, road=ROAD, height=HEIGHT, **rules):
    limits = ConsistencyParameters(**rules).limits()
    the_fix = the_fix or fix(covariance_enu_m2=COVARIANCE)
    return compare(the_fix, the_pose or pose(), road, height, SIGMA, limits)


def test_the_difference_is_that_from_the_pose_and_from_road_antenna_and_correction():
    result = compared(fix(east_m=0.3, north_m=-0.1, up_m=0.15))
    assert result.difference_m == pytest.approx([0.3, -0.1, 0.17], abs=1e-3)
    assert result.position_m == pytest.approx((0.3, -0.1), abs=1e-3)
    assert result.height_m == pytest.approx(-0.17)


def test_the_covariance_is_that_of_fix_pose_road_and_antenna_with_the_slope():
    result = compared(the_pose=pose(covariance_east_north_yaw=(0.01, 0.002, 9.0, 0.02, 9.0, 9.0)))
    fix_m2 = 4.0 * np.array([[2e-4, 1e-5, 2e-5], [1e-5, 3e-4, 3e-5], [2e-5, 3e-5, 5e-4]])
    fix_m2 += np.diag([9e-4, 9e-4, 16e-4])
    j = np.array([[1, 0, 0], [0, 1, 0], [-0.1, 0.05, 1]])
    expected = j @ fix_m2 @ j.T
    expected[:2, :2] += [[0.01, 0.002], [0.002, 0.02]]
    expected[2, 2] += 0.03**2 + 0.025**2
    assert result.covariance_m2 == pytest.approx(expected)
    assert result.height_sigma_m == pytest.approx(math.sqrt(expected[2, 2]))
    assert result.position_sigma_m == pytest.approx(math.sqrt(np.linalg.eigvalsh(expected[:2, :2])[1]))


def test_a_pose_that_was_moved_on_is_as_much_wider_as_a_car_may_have_accelerated():
    now, before = (compared(the_pose=pose(k)).covariance_m2[:2, :2] for k in (0, -1.5))
    assert before - now == pytest.approx(np.diag([0.09**2] * 2))  # ½ · 2 m/s² · (0.3 s)²


@pytest.mark.parametrize("unknown", ["road", "height"])
def test_without_road_or_antenna_the_height_is_infinitely_far_off_too(unknown):
    result, without = compared(**{unknown: None}), compared(road=None, height=None)
    assert math.isnan(result.difference_m[2])
    assert (result.covariance_m2 == without.covariance_m2).all()


def test_without_a_road_the_height_is_infinitely_far_off_and_the_position_is_still_compared():
    result = compared(fix(east_m=0.3), road=None, height=None)
    assert result.position_m == pytest.approx((0.3, 0.0), abs=1e-3)
    assert (result.height_m, result.joint_distance2) == (None, None)
    assert result.outcome != 0
    assert compared(road=None, height=None, tests=("position",)).outcome == 0


def test_where_the_height_is_not_tested_there_is_no_height_and_no_tolerance():
    result = compared(tests=("position",))
    assert (result.height_m, result.tolerance_m, result.joint_limit) == (None, None, None)


def test_the_description_has_all_figures():
    text = compared(fix(east_m=0.3, up_m=0.15)).describe(0.1)
    assert "height -0.17 m of σ" in text
    assert "0.30 m from the pose of σ 0.10 m" in text
    assert "together " in text
    assert len(text) <= 200
    assert compared(tests=("position",)).describe(0.1).startswith("0.00 m from the pose")


def test_the_outcomes_are_those_of_the_figures():
    result = replace(
        compared(),
        difference_m=np.array([0.3, -0.4, 0.15]),
        height_m=-0.15,
        height_sigma_m=0.061,
        tolerance_m=0.2,
        acceptance_radius_m=0.55,
        joint_distance2=4.52,
        joint_limit=16.27,
    )
    assert result.describe(0.123) == (
        "height -0.15 m of σ 0.06 m, 0.20 m would agree; "
        "0.50 m from the pose of σ 0.12 m, 0.55 m would agree; together 4.5 of 16.3"
    )
    assert replace(result, joint_limit=None).describe(0.1) == replace(result, joint_distance2=None).describe(
        0.1
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"the_fix": fix(covariance_enu_m2=None)},
        {"the_pose": pose(covariance_east_north_yaw=None)},
        {"the_pose": pose(latitude_rad=None)},
    ],
)
def test_what_has_no_covariance_or_no_place_cannot_be_compared(changes):
    with pytest.raises(ValueError, match=r"^a covariance is missing$|no position"):
        compared(**changes)
