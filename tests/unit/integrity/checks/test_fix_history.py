"""What right fixes leave for those to come: where they were, how the road rose, which integers they had."""

import numpy as np
import pytest

from camber.integrity.checks.fix_comparison import FixComparison
from camber.integrity.checks.fix_history import FixHistory, is_precise
from camber.integrity.checks.height_model import RoadPoint
from camber.integrity.checks.verification import VerificationRules
from camber.integrity.judgement import FixJudgement
from camber.integrity.protection.covariance_inflation import TrueSigma
from camber.integrity.rules import Rules
from support.judging import ROAD_M, at, fix, place, pose, provisional

SPEED_M_S = 10.0
CHAIN = {"ambiguity_continuity": "continuous", "continuous_since_ns": at(0)}


def right(epoch=0, verdict="confirmed", reason="height_agrees", **changes):
    fields = {
        "fix": fix(epoch, **CHAIN),
        "road": RoadPoint(elevation_m=ROAD_M, sigma_m=0.03),
        "pose": pose(epoch),
    }
    return FixJudgement(verdict=verdict, reason=reason, **fields | changes)


def after(*judgements):
    before = FixHistory(Rules())
    for judgement in judgements:
        before.settle(judgement, SPEED_M_S)
    return before


def displaced_pose(epoch, east_m=0.0, north_m=0.0):
    """A pose that far from where the vehicle is."""
    latitude_rad, longitude_rad = place(epoch, east_m, north_m)
    return pose(epoch, latitude_rad=latitude_rad, longitude_rad=longitude_rad)


# --- the chain of right ones --------------------------------------------------------------------------------------


def test_a_fix_that_moved_as_the_pose_did_continues_wherever_the_pose_is():
    assert after(right()).is_consistent_with_previous(
        fix(1), displaced_pose(0, 3.0, -2.0), displaced_pose(1, 3.0, -2.0)
    )


@pytest.mark.parametrize("drift_m", [(0.2, 0.0), (-0.2, 0.0), (0.0, 0.2), (0.0, -0.2)])
def test_one_that_moved_against_the_pose_does_not(drift_m):
    now = displaced_pose(1, 3.0 + drift_m[0], -2.0 + drift_m[1])
    assert not after(right()).is_consistent_with_previous(fix(1), displaced_pose(0, 3.0, -2.0), now)


@pytest.mark.parametrize(("up_m", "does"), [(0.1, True), (0.21, True), (0.23, False), (-0.03, False)])
def test_where_the_road_climbs_to_the_east_the_fix_has_to(up_m, does):
    before = after(
        right(road=RoadPoint(elevation_m=ROAD_M, sigma_m=0.03, slope_east=0.05, slope_north=0.0))
    )  # and the vehicle went 2 m there
    assert before.is_consistent_with_previous(fix(1, up_m=up_m), pose(0), pose(1)) is does


@pytest.mark.parametrize(("up_m", "does"), [(-0.2, True), (0.0, False)])
def test_where_it_falls_to_the_north_too(up_m, does):
    before = after(right(road=RoadPoint(elevation_m=ROAD_M, sigma_m=0.03, slope_east=0.0, slope_north=-0.1)))
    assert (
        before.is_consistent_with_previous(
            fix(1, north_m=2.0, up_m=up_m), pose(0), displaced_pose(1, 0.0, 2.0)
        )
        is does
    )


def test_nothing_is_continued_without_a_right_fix_and_the_poses_of_both_times():
    assert not after().is_consistent_with_previous(fix(1), pose(0), pose(1))
    assert not after(right()).is_consistent_with_previous(fix(1), None, pose(1))
    assert not after(right()).is_consistent_with_previous(fix(1), pose(0), None)


@pytest.mark.parametrize(
    "changes",
    [
        {"verdict": "erroneous"},
        {"verdict": "unknown"},
        {"road": None},
        {"fix": fix(0, covariance_enu_m2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01))},
    ],
    ids=["erroneous", "unknown", "no road", "wide"],
)
def test_only_a_right_and_sharp_one_over_a_road_is_continued(changes):
    assert after(right(**changes)).chain is None


def test_a_confirmed_one_begins_the_chain_and_a_verified_one_is_a_link_of_it():
    verdicts = ["confirmed", "confirmed_after_verification", "confirmed_after_verification", "confirmed"]
    chain_length = [
        after(*(right(k, verdict) for k, verdict in enumerate(verdicts[:n]))).chain.chain_length
        for n in (1, 2, 3, 4)
    ]
    assert chain_length == [0, 1, 2, 0]


def test_what_is_dated_ahead_is_forgotten_and_what_is_of_now_is_not():
    before = after(right())
    before.forget_after(at(0))
    assert (before.chain.time_ns, before.integers.last_ns) == (at(0), at(0))
    before.forget_after(at(0) - 1)
    assert (before.chain, before.integers.confirmed) == (None, 0)


def test_sharp_is_what_is_so_with_its_true_sigma():
    rules = Rules(
        true_sigma=TrueSigma(scale=2.0, horizontal_m=0.0, vertical_m=0.0),
        verification=VerificationRules(fix_sigma_m=0.5),
    )
    assert is_precise(fix(covariance_enu_m2=(0.0625, 0.0, 0.0, 0.01, 0.0, 0.01)), rules)
    assert not is_precise(fix(covariance_enu_m2=(0.063, 0.0, 0.0, 0.01, 0.0, 0.01)), rules)
    assert not is_precise(fix(covariance_enu_m2=(0.01, 0.0, 0.0, 0.01, 0.0, 0.063)), rules)


# --- integers and start -------------------------------------------------------------------------------------------


def test_integers_are_confirmed_by_the_height_of_the_fix_of_the_engine():
    assert after(right(0), right(1)).integers.confirmed == 2
    assert after(right(0), right(1, trials=21)).integers.confirmed == 1
    assert after(right(0), right(1, "confirmed_after_verification")).integers.confirmed == 1


def test_integers_that_contradict_them_are_remembered_as_such():
    other = fix(1, ambiguity_continuity="broken", continuous_since_ns=at(1))
    before = after(right(0), right(1, "unknown", "continuity_disagrees", fix=other))
    assert before.integers.disputed_ns == at(1)
    assert after(right(0), right(1, "unknown", "height_unverified", fix=other)).integers.disputed_ns is None


@pytest.mark.parametrize(
    ("changes", "fixes"),
    [
        ({}, 4),
        ({"verdict": "unknown", "reason": "starting"}, 4),
        ({"verdict": "unknown", "reason": "height_unverified"}, 1),
        ({"verdict": "confirmed_after_verification"}, 1),
        ({"pose": pose(2)}, 1),
        ({"pose": None}, 1),
    ],
    ids=str,
)
def test_only_agreeing_ones_above_a_provisional_pose_count_at_the_start(changes, fixes):
    starting = {"verdict": "unknown", "reason": "starting"}
    drive = [right(k, pose=provisional(k), **starting) for k in (0, 1)]
    before = after(*drive, right(2, **{"pose": provisional(2)} | changes))
    assert before.start_after(fix(3), SPEED_M_S).fixes == fixes


def test_the_start_counts_what_went_as_far_as_the_wheels_did():
    before = after(right(0, pose=provisional(0)))
    assert before.start_after(fix(1), SPEED_M_S).fixes == 2
    assert before.start_after(fix(1), 2.0 * SPEED_M_S).fixes == 1
    assert before.start_after(fix(1), None).fixes == 1


# --- the hypothesis of a captured pose ----------------------------------------------------------------------------

COMPARED = FixComparison(
    difference_m=np.array([2.0, -1.0, 0.0]),
    covariance_m2=np.eye(3),
    outcome=0,
    position=0,
    height_m=0.0,
    height_sigma_m=0.05,
    tolerance_m=0.2,
    acceptance_radius_m=0.5,
    joint_distance2=None,
    joint_limit=None,
)


def test_a_fix_that_is_erroneous_is_rejected_and_one_that_is_held_back_contradicts_the_pose():
    rejected = after(right(3, "erroneous", "position_disagrees", comparison=COMPARED)).captured
    assert (rejected.rejected_runs, rejected.rival) == (1, None)
    assert (rejected.rejected.first_ns, rejected.rejected.offset_m) == (at(3), (2.0, -1.0))
    held_back = after(right(3, "unknown", "position_disagrees", comparison=COMPARED)).captured
    assert (held_back.rejected_runs, held_back.won) == (0, False)
    assert held_back.rival.first_ns == at(3)
    confirmed = after(right(3, "confirmed", "position_disagrees", comparison=COMPARED)).captured
    assert confirmed.won is True


def test_a_hypothesis_of_now_is_kept_and_one_dated_ahead_is_not():
    before = after(right(3, "unknown", "position_disagrees", comparison=COMPARED))
    before.forget_after(at(3))
    assert before.captured.rival is not None
    before.forget_after(at(3) - 1)
    assert before.captured.rival is None


@pytest.mark.parametrize("satellites", [None, 5, 14])
def test_the_odds_of_a_run_are_those_of_its_number_of_satellites(satellites):
    share = Rules().levels.wrong_fix.prior_of(satellites)
    run = after().run_of(fix(satellites=satellites), (0.0, 0.0))
    assert run.odds / (1.0 + run.odds) == pytest.approx(share)
    assert (
        after().run_of(fix(satellites=5), (0.0, 0.0)).odds
        > after().run_of(fix(satellites=14), (0.0, 0.0)).odds
    )
