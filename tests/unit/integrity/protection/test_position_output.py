"""What a pose alone gives consumers, that there is nothing without one, and the position within a verdict."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.epoch_inputs import EpochInputs
from camber.integrity.judgement import FixJudgement, verdict_of
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.integrity.protection.position_output import (
    PositionOutput,
    _distance2,
    unavailable_position,
)
from camber.integrity.rules import Rules
from support.judging import ALL, ANTENNA_M, ROAD_M, antenna, at, fix, pose

RULES = Rules()


def right(the_fix=None, **changes):
    return FixJudgement(
        fix=the_fix or fix(), verdict="confirmed", reason="height_agrees", pose=pose(), **changes
    )


# --- poses -------------------------------------------------------------------------------------------------------


def test_a_pose_stands_on_the_road_with_its_antenna():
    inputs = EpochInputs(pose=pose(), antenna=antenna(), alive=ALL)
    position = PositionOutput(RULES).at(at(0), inputs, 0.05)
    assert position.source == "sensors"
    assert position.height_m == pytest.approx(ROAD_M + ANTENNA_M + 0.05)
    assert position.fix_id is None
    assert position.covariance_enu_m2[5] == pytest.approx(0.03**2 + 0.02**2)


@pytest.mark.parametrize("reference", ["required", "assumed"])
def test_where_there_is_none_the_setting_is_there_all_the_same(reference):
    position = unavailable_position(at(0), "pose_missing", Rules(horizontal_reference=reference))
    assert (position.source, position.usable, position.reason) == ("none", False, "pose_missing")
    assert position.horizontal_reference == reference


# --- verdicts ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("verdict", ["unknown", "erroneous"])
def test_a_verdict_that_confirms_nothing_has_no_position(verdict):
    verdict = verdict_of(FixJudgement(fix=fix(), verdict=verdict, reason="none", pose=pose()), TrueSigma())
    assert (
        verdict.latitude_rad is verdict.longitude_rad is verdict.height_m is verdict.covariance_enu_m2 is None
    )
    assert verdict.surface_id == 7
    assert verdict.map_version == 3


def test_a_verdict_that_confirms_has_the_position_with_its_true_covariance():
    verdict = verdict_of(right(), TrueSigma())
    assert (verdict.latitude_rad, verdict.longitude_rad) == (fix().latitude_rad, fix().longitude_rad)
    assert verdict.height_m == fix().height_m
    assert verdict.covariance_enu_m2 == inflate_covariance(fix().covariance_enu_m2, TrueSigma())
    assert verdict.fix_id == fix().fix_id


def test_a_verdict_without_pose_or_covariance_says_so():
    verdict = verdict_of(
        FixJudgement(fix=fix(covariance_enu_m2=None), verdict="confirmed", reason="none"), TrueSigma()
    )
    assert verdict.surface_id is verdict.map_version is verdict.latitude_rad is None
    assert verdict.height_difference_m is verdict.tolerance_m is None


# --- two positions ------------------------------------------------------------------------------------------------

metres = st.floats(-5.0, 5.0)
errors = st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9)


@settings(derandomize=True, deadline=None)
@given(metres, metres, errors, errors)
def test_the_distance_of_two_positions_uses_both_horizontal_covariances_and_a_floor(
    east_m, north_m, one, other
):
    covariances = [np.reshape(root, (3, 3)) @ np.reshape(root, (3, 3)).T for root in (one, other)]
    plane = sum(covariances)[:2, :2] + 0.1**2 * np.eye(2)
    apart = np.array([east_m, north_m])
    result = _distance2(east_m, north_m, *(tuple(c[np.triu_indices(3)].tolist()) for c in covariances))
    assert result == pytest.approx(apart @ np.linalg.inv(plane) @ apart, rel=1e-6, abs=1e-9)
