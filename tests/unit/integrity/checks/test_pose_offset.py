"""How far a fix is from the pose, and how wide both claim to be."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.checks.pose_offset import can_move_on, claimed_sigma_m, offset_from_pose, pose_sigma_m
from support.judging import SPEED_M_S, at, place, pose

variance = st.floats(1e-6, 1e4)


def test_the_pose_is_moved_on_to_the_time_of_the_fix():
    east_m, north_m = offset_from_pose(*place(1, 0.5, -0.3), pose(0), at(1))
    assert (east_m, north_m) == (pytest.approx(0.5, abs=1e-3), pytest.approx(-0.3, abs=1e-3))


def test_the_pose_is_moved_on_in_its_heading():
    yaw_rad = math.radians(120.0)
    travelled_m = 0.2 * SPEED_M_S
    there = place(0, travelled_m * math.cos(yaw_rad), travelled_m * math.sin(yaw_rad))
    offset_m = offset_from_pose(*there, pose(0, yaw_rad=yaw_rad), at(1))
    assert offset_m == (pytest.approx(0.0, abs=1e-3), pytest.approx(0.0, abs=1e-3))


@pytest.mark.parametrize("changes", [{"speed_m_s": None}, {"yaw_rad": None}])
def test_one_that_does_not_say_how_it_moves_stays(changes):
    offset_m = offset_from_pose(*place(1), pose(0, **changes), at(1))
    assert offset_m == pytest.approx((0.2 * SPEED_M_S, 0.0), abs=1e-3)


@pytest.mark.parametrize(
    ("changes", "can"),
    [
        ({}, True),
        ({"speed_m_s": 0.0, "yaw_rad": None}, True),
        ({"yaw_rad": None}, False),
        ({"speed_m_s": None}, False),
    ],
)
def test_moving_on_needs_a_speed_and_a_direction(changes, can):
    assert can_move_on(pose(**changes)) is can


@pytest.mark.parametrize("name", ["latitude_rad", "longitude_rad"])
def test_there_is_no_offset_from_a_pose_without_a_place(name):
    with pytest.raises(ValueError, match=r"^the pose has no position$"):
        offset_from_pose(*place(0), pose(**{name: None}), at(0))


def test_the_sigma_of_a_pose_is_that_of_its_worst_direction():
    assert pose_sigma_m(pose(covariance_east_north_yaw=(5.0, 4.0, 0.0, 5.0, 0.0, 0.0))) == pytest.approx(3.0)


@pytest.mark.parametrize("covariance", [None, (1.0, 2.0, 0.0, 1.0, 0.0, 0.0)])
def test_without_a_covariance_it_is_infinite(covariance):
    assert pose_sigma_m(pose(covariance_east_north_yaw=covariance)) == math.inf


def test_what_a_fix_claims_is_its_worst_direction_upwards_too():
    assert claimed_sigma_m((5.0, 4.0, 0.0, 5.0, 0.0, 1.0)) == pytest.approx(3.0)
    assert claimed_sigma_m((0.01, 0.0, 0.0, 0.01, 0.0, 4.0)) == pytest.approx(2.0)


@pytest.mark.parametrize(
    "covariance",
    [(1.0, 2.0, 0.0, 1.0, 0.0, 1.0), (1.0, 0.0, 0.0, 1.0, 0.0, -1.0), (1.0, 0.0, 0.0, 1.0, 0.0, math.nan)],
)
def test_a_claim_that_is_no_covariance_is_infinite(covariance):
    assert claimed_sigma_m(covariance) == math.inf


@given(variance, variance, variance)
def test_a_larger_variance_is_never_claimed_as_less(ee, nn, more):
    claimed = claimed_sigma_m((ee, 0.0, 0.0, nn, 0.0, 0.0))
    assert claimed_sigma_m((ee + more, 0.0, 0.0, nn, 0.0, 0.0)) >= claimed * (1.0 - 1e-9)
