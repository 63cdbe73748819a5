"""What is missing for a verdict is named, the nearest to the cause first."""

import typing

import pytest

from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.decision_table import TEST_RULES
from camber.integrity.epoch_inputs import ANTENNA_CHECKS, POSE_CHECKS, ROAD_CHECKS, EpochInputs, age_s
from camber.integrity.rules import Rules
from camber.schemas.pose import RoadReason
from support.judging import ALL, antenna, at, pose, road

RULES = Rules()
NO_COVARIANCE = (1.0, 2.0, 0.0, 1.0, 0.0, 0.0)
UNKNOWN_ROAD = {"status": "unknown", "reason": "no_surface"}

# In the order in which they are asked: what is missing, and the reason that is given.
ROWS = [
    ({"pose": None, "alive": ALL - {"localizer"}}, "localizer_absent"),
    ({"pose": pose(-2), "alive": ALL - {"localizer"}}, "localizer_absent"),
    ({"pose": None}, "pose_missing"),
    ({"pose": pose(-1.6)}, "pose_stale"),
    ({"pose": pose(1.6)}, "pose_stale"),
    ({"pose": pose(mode="none")}, "pose_missing"),
    ({"pose": pose(provenance="none")}, "pose_missing"),
    ({"pose": pose(latitude_rad=None)}, "pose_missing"),
    ({"pose": pose(longitude_rad=None)}, "pose_missing"),
    ({"pose": pose(covariance_east_north_yaw=None)}, "pose_missing"),
    ({"pose": pose(-1, yaw_rad=None)}, "pose_stale"),
    ({"pose": pose(-1, speed_m_s=None)}, "pose_stale"),
    ({"pose": pose(sigma_m=15.1)}, "pose_too_uncertain"),
    ({"pose": pose(covariance_east_north_yaw=NO_COVARIANCE)}, "pose_too_uncertain"),
    ({"antenna": None, "alive": ALL - {"antenna_height"}}, "antenna_height_absent"),
    ({"antenna": antenna(-11), "alive": ALL - {"antenna_height"}}, "antenna_height_absent"),
    ({"antenna": None}, "antenna_height_missing"),
    ({"antenna": antenna(-11)}, "antenna_height_stale"),
    ({"antenna": antenna(11)}, "antenna_height_stale"),
    ({"antenna": antenna(status="disagreement")}, "antenna_height_disagrees"),
    ({"antenna": antenna(status="unknown")}, "antenna_height_missing"),
    ({"antenna": antenna(height_m=None)}, "antenna_height_missing"),
    ({"antenna": antenna(sigma_m=None)}, "antenna_height_missing"),
    ({"pose": pose(road=road(**UNKNOWN_ROAD))}, "road_unknown"),
    ({"pose": pose(road=road(elevation_m=None))}, "road_unknown"),
    ({"pose": pose(road=road(sigma_m=None))}, "road_unknown"),
    ({"pose": pose(road=road(datum=None))}, "datum_mismatch"),
]


def missing(**changes):
    known = {"pose": pose(), "antenna": antenna(), "alive": ALL} | changes
    return EpochInputs(**known).missing(at(0), RULES)


def test_with_all_there_nothing_is_missing():
    assert missing() is None


def test_every_rule_and_check_of_the_table_is_explained():
    entries = (*TEST_RULES, *POSE_CHECKS, *ANTENNA_CHECKS, *ROAD_CHECKS)
    assert [entry.reason for entry in entries if not entry.explanation] == []


def test_without_a_test_of_the_height_neither_road_nor_antenna_is_needed():
    by_position = Rules(determination=ConsistencyParameters(tests=("position",)))
    inputs = EpochInputs(pose=pose(road=road(**UNKNOWN_ROAD)), antenna=None, alive=ALL)
    assert inputs.missing(at(0), by_position) is None
    assert inputs.missing(at(0), RULES) == "antenna_height_missing"


@pytest.mark.parametrize(
    ("changes", "reason"), ROWS, ids=[f"{i} {reason}" for i, (_, reason) in enumerate(ROWS)]
)
def test_what_is_missing_is_named(changes, reason):
    assert missing(**changes) == reason


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"pose": None}, {"antenna": None}),
        ({"pose": pose(sigma_m=99.0)}, {"antenna": antenna(status="disagreement")}),
        ({"antenna": None}, {"pose": pose(road=road(**UNKNOWN_ROAD))}),
    ],
)
def test_of_two_that_are_missing_the_one_nearer_to_the_cause_is_named(first, second):
    assert missing(**{**second, **first}) == missing(**first)
    assert missing(**second) is not None


@pytest.mark.parametrize("reason", typing.get_args(RoadReason))
def test_every_reason_of_an_unknown_road_is_passed_on_or_road_unknown(reason):
    expected = {
        "no_pose": "pose_missing",
        "pose_too_uncertain": "pose_too_uncertain",
        "levels_ambiguous": "levels_ambiguous",
        "map_server_absent": "map_server_absent",
        "datum_mismatch": "datum_mismatch",
    }
    result = missing(pose=pose(road=road(status="unknown", reason=reason)))
    assert result == expected.get(reason, "road_unknown")


def test_without_a_pose_there_is_no_road():
    assert EpochInputs(pose=None, antenna=antenna(), alive=ALL).missing_road(at(0), RULES) == "pose_missing"


def test_a_service_that_just_left_is_still_believed_within_its_age_limit():
    assert missing(alive=frozenset()) is None


@pytest.mark.parametrize("offset_s", [0.3, -0.3])
def test_ages_at_the_limit_are_believed(offset_s):
    assert missing(pose=pose(offset_s / 0.2)) is None


def test_a_pose_that_stands_needs_no_direction():
    assert missing(pose=pose(-1, yaw_rad=None, speed_m_s=0.0)) is None


def test_ages_count_forwards():
    assert age_s(at(0), at(1)) == pytest.approx(0.2)
    assert age_s(at(1), at(0)) == pytest.approx(-0.2)
