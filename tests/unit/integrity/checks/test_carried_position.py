"""A confirmed position is carried on while wrong fixes last, so that they are contradicted to their end."""

import math
from dataclasses import replace

import numpy as np
import pytest

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.carried_position import CarriedPosition, CarriedRules, odds_of
from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.checks.fix_comparison import compare
from camber.integrity.checks.height_model import HeightModel, road_at
from camber.integrity.learning.height_correction import Learning
from camber.integrity.learning.offset_causes import NO_OFFSET, Diagnosis
from camber.integrity.protection.covariance_inflation import TrueSigma
from camber.integrity.protection.wrong_fix_probability import WrongFixRules
from camber.integrity.rules import Rules
from camber.schemas.pose import Road, RoadPatch
from support.judging import ALL, SettlingJudge, antenna, at, fix, independent, pose, road

RULES, SIGMA, LIMITS = CarriedRules(), TrueSigma(), ConsistencyParameters().limits()
MANY = {"satellites": 14}
SURE = 1e-4  # odds of a fix that a narrow pose confirms
FIX_M = math.sqrt(SIGMA.scale**2 * 2.5e-5 + SIGMA.horizontal_m**2)
LOSES_M_S = 0.03  # chosen: σ of simulated poses grows by 1 to 3 m in 100 s without fixes


class Vehicle:
    """A judge whose pose is anchored by confirmed fixes and otherwise drifts, as its σ says."""

    def __init__(self, rules, north_m_s=0.0, learning=None):
        self.judge, self.since, self.north_m_s = SettlingJudge(rules, learning), 0, north_m_s

    def epoch(self, k, *, sigma_m=None, **off):
        lost_m = (k - self.since) * 0.2 * LOSES_M_S
        there = fix(k, north_m=self.north_m_s * (k - self.since) * 0.2)
        place = {"latitude_rad": there.latitude_rad, "longitude_rad": there.longitude_rad}
        sigma_m = math.hypot(0.06, lost_m) if sigma_m is None else sigma_m
        known = independent(k, sigma_m=0.3)
        self.judge.latest.add_pose(
            pose(k, sigma_m=sigma_m, anchor_time_ns=at(self.since), independent=known, **place)
        )
        self.judge.latest.set_antenna_height(antenna(k))
        self.judge.latest.add_wheel_speed(at(k), 10.0)
        judgement = self.judge.judge(fix(k, **MANY, **off), at(k), ALL)
        self.since = k if judgement.confirmed else self.since
        return judgement


def verdicts(vehicle, epochs, **off):
    return [vehicle.epoch(k, **off).verdict for k in epochs]


@pytest.mark.parametrize("reference", ["assumed", "required"])
@pytest.mark.parametrize("north_m", [0.6, 1.0, 2.5])
def test_a_wrong_run_with_the_height_of_the_road_is_contradicted_to_its_end(reference, north_m):
    """A pose that has lost 3 m in 100 s would agree with it long before."""
    vehicle = Vehicle(Rules(horizontal_reference=reference))
    verdicts(vehicle, range(150))
    wrong = verdicts(vehicle, range(150, 650), north_m=north_m)
    assert {"confirmed", "confirmed_after_verification"}.isdisjoint(wrong)


@pytest.mark.parametrize("up_m", [0.0, 1.5])
def test_right_fixes_are_confirmed_at_once_after_it_wherever_the_pose_has_drifted(up_m):
    vehicle = Vehicle(Rules(horizontal_reference="assumed"), north_m_s=0.02)
    verdicts(vehicle, range(150))
    verdicts(vehicle, range(150, 650), east_m=1.0, up_m=up_m)
    back = vehicle.epoch(650)
    assert back.confirmed
    assert "position" in back.evidence  # not by its height alone, as under the pose of 3 m
    assert math.hypot(*back.comparison.position_m) < 0.01


def test_another_wrong_run_that_follows_is_contradicted_too():
    vehicle = Vehicle(Rules(horizontal_reference="assumed"))
    verdicts(vehicle, range(150))
    verdicts(vehicle, range(150, 500), east_m=0.9, up_m=2.0)
    second = verdicts(vehicle, range(500, 600), north_m=-0.9)
    assert set(second) <= {"erroneous", "unknown"}


def test_a_position_confirmed_by_height_alone_under_a_wide_pose_is_not_held_against_others():
    """Held, a wrong one would reject right fixes for two minutes; so the pose decides, and loses itself as ever."""
    rules = Rules(horizontal_reference="assumed")
    vehicle = Vehicle(rules)
    assert vehicle.epoch(0, sigma_m=2.0, north_m=1.2).confirmed
    right = verdicts(vehicle, range(1, 300))
    assert right.index("confirmed") * 0.2 < 15.0


# --- the parts ---------------------------------------------------------------------------------------------------


def lost(k, **changes):
    """A pose of σ 3 m: that of the localizer at the fixes and between them."""
    return pose(k, **{"sigma_m": 3.0, **changes})


def carrying(confirmed=range(3), odds=SURE, rules=RULES):
    carried = CarriedPosition(rules, SIGMA, WrongFixRules())
    for k in confirmed:
        carried.settle(fix(k), lost(k, anchor_time_ns=at(k - 1)), odds)
    return carried


def off(carried, k, **changes):
    """Metres from the truth of the pose of an epoch, 5 m off, as it is improved; and its σ."""
    given = lost(k, sigma_m=3.0, east_m=5.0, **changes)
    better, right = carried.improve(given), fix(k)
    metres = east_north_between(
        right.latitude_rad, right.longitude_rad, better.latitude_rad, better.longitude_rad
    )
    return metres, math.sqrt(better.covariance_east_north_yaw[0])


def test_the_pose_is_moved_to_where_the_run_carries_the_position_and_is_as_wide_as_that():
    carried = carrying()
    for k in range(3, 103):
        carried.settle(fix(k, north_m=2.0), lost(k, sigma_m=3.0, east_m=5.0), None)
    metres, sigma_m = off(carried, 103)
    assert metres == pytest.approx((0.0, 0.0), abs=1e-3)
    drift_m = RULES.drift_per_s * 2.0 * 99 * 0.2
    first_m2 = FIX_M**2 + RULES.odometry_m**2
    assert sigma_m**2 == pytest.approx(first_m2 + FIX_M**2 + drift_m**2 + RULES.odometry_m**2)


def test_errors_of_a_position_carried_by_drifting_runs_are_as_wide_as_it_says():
    rng, runs, seconds = np.random.default_rng(3), 200, 60
    squares = []
    for _ in range(runs):
        carried, shift_m = carrying(), rng.normal(0.0, 1.5, 2)
        rate_m_s = rng.normal(0.0, RULES.drift_per_s, 2) * np.hypot(*shift_m)
        for k in range(3, 3 + 5 * seconds, 5):
            east_m, north_m = shift_m + rate_m_s * (k - 3) * 0.2 + rng.normal(0.0, FIX_M, 2)
            carried.settle(fix(k, east_m=east_m, north_m=north_m), lost(k), None)
        metres, sigma_m = off(carried, k)
        squares.append(np.hypot(*metres) ** 2 / sigma_m**2 / 2)
    # The first fix's error is that of the carried position for the rest of the run.
    assert 0.3 < np.mean(squares) < 1.3


def test_the_pose_stays_where_it_is_narrower_or_has_just_been_anchored():
    carried = carrying()
    wide = lost(2.5, sigma_m=3.0)
    assert carried.improve(wide) is wide  # all fixes were confirmed
    carried.settle(fix(3, north_m=2.0), lost(3, sigma_m=3.0), None)
    narrow = lost(3.5, sigma_m=0.05)
    assert carried.improve(narrow) is narrow
    nowhere = lost(3.5, latitude_rad=None)
    assert carried.improve(nowhere) is nowhere


def test_a_pose_that_the_last_confirmed_fix_has_anchored_begins_a_run_where_it_is_narrower():
    carried = carrying()
    carried.settle(fix(3, north_m=2.0), lost(3, sigma_m=0.01, anchor_time_ns=at(2)), None)
    carried.settle(fix(4, north_m=2.0), lost(4, anchor_time_ns=at(2)), None)
    _, sigma_m = off(carried, 4)
    assert sigma_m**2 == pytest.approx(0.01**2 + FIX_M**2 + RULES.odometry_m**2, rel=1e-3)


def test_wheels_that_slip_make_it_as_wide_as_the_pose_and_a_run_that_begins_meanwhile_too():
    """Fixes of one run that a slip breaks into many: each begins where the wheels say, metres off in the end."""
    carried = carrying()
    for k in range(3, 28):
        slipped_m = 0.5 * (k - 2)
        carried.settle(fix(k, north_m=slipped_m), lost(k, sigma_m=3.0 + slipped_m), None)
    _, sigma_m = off(carried, 27)
    assert sigma_m == 3.0, "the pose is not improved by it"
    better = carried.improve(lost(27, sigma_m=15.5))
    assert math.sqrt(better.covariance_east_north_yaw[0]) == pytest.approx(12.5, abs=0.2)


def test_where_the_pose_is_narrower_than_what_a_run_carries_it_is_what_is_carried():
    carried = carrying()
    carried.settle(fix(3, north_m=2.0), lost(3), None)
    carried.settle(fix(4, north_m=2.0), lost(4, sigma_m=0.01, anchor_time_ns=at(2)), None)
    wide = lost(4, sigma_m=3.0)
    assert carried.improve(wide) is wide  # until a run is better again
    carried.settle(fix(5, north_m=2.0), lost(5, sigma_m=3.0, anchor_time_ns=at(2)), None)
    assert carried.improve(lost(5, sigma_m=3.0)) != lost(5, sigma_m=3.0)


@pytest.mark.parametrize(
    ("next_fix", "next_pose", "same"),
    [
        (fix(4, north_m=2.0), lost(4, sigma_m=0.01), True),
        (fix(4, north_m=2.0 + 0.9 * RULES.step_m), lost(4, sigma_m=0.01), True),
        (fix(4, north_m=2.0 + 1.1 * RULES.step_m), lost(4, sigma_m=0.01), False),
        (fix(4, north_m=2.0, up_m=0.9 * RULES.step_m), lost(4, sigma_m=0.01), True),
        (fix(4, north_m=2.0, up_m=1.1 * RULES.step_m), lost(4, sigma_m=0.01), False),
        (fix(4, north_m=2.0, up_m=0.6), lost(4, sigma_m=0.01, road=road(slope_east=0.3)), True),
        (fix(4, north_m=2.0), lost(4, sigma_m=0.01, yaw_rad=None), False),
        (fix(9, north_m=2.0), lost(9, sigma_m=0.01), False),
    ],
)
def test_a_run_goes_on_while_fixes_move_as_the_vehicle_does(next_fix, next_pose, same):
    carried = carrying()
    carried.settle(fix(3, north_m=2.0), lost(3), None)
    assert carried.began_elsewhere(next_fix, next_pose, LIMITS) == same


STEP_M = 0.6


@pytest.mark.parametrize("sigma_m", [0.15, 0.5, 3.0])
def test_a_step_from_confirmed_fixes_is_elsewhere_though_the_pose_has_become_wide(sigma_m):
    carried = carrying()
    assert carried.began_elsewhere(fix(3, north_m=STEP_M), lost(3, sigma_m=sigma_m), LIMITS)
    assert not carried.began_elsewhere(fix(3, north_m=0.1), lost(3, sigma_m=sigma_m), LIMITS)


def test_a_pose_that_is_known_better_is_compared_alone():
    assert not carrying().began_elsewhere(fix(3, north_m=STEP_M), lost(3, sigma_m=0.05), LIMITS)


def test_the_same_integers_as_before_are_no_step_to_others():
    same, others = (fix(3, north_m=STEP_M, ambiguity_continuity=c) for c in ("continuous", "broken"))
    assert not carrying().began_elsewhere(same, lost(3), LIMITS)
    assert carrying().began_elsewhere(others, lost(3), LIMITS)


def test_wheels_that_are_off_by_their_bound_are_no_step():
    """Of 25 m in a second 0.5 m; a tenth of the way is one."""
    driving = {"speed_m_s": 25.0}
    for share, elsewhere in ((0.02, False), (0.1, True)):
        carried = CarriedPosition(RULES, SIGMA, WrongFixRules())
        carried.settle(fix(0), lost(0, **driving), SURE)
        next_fix = fix(5, east_m=25.0 * (1.0 + share) - 10.0)  # of which epochs have 2 m each
        assert carried.began_elsewhere(next_fix, lost(5, **driving), LIMITS) == elsewhere


def test_a_step_from_a_position_that_may_be_wrong_itself_is_not_held_against_the_fix():
    doubtful = carrying(range(1), odds=0.5)
    assert not doubtful.began_elsewhere(fix(1, north_m=STEP_M), lost(1), LIMITS)


@pytest.mark.parametrize("reference", ["assumed", "required"])
def test_a_wrong_fix_with_the_height_of_the_road_is_not_confirmed_when_the_pose_becomes_wide(reference):
    """As when a sensor leaves its bounds: from 6 cm to 0.6 m, a second before the fixes step by as much."""
    vehicle = Vehicle(Rules(horizontal_reference=reference))
    verdicts(vehicle, range(150))
    assert {"confirmed"} == set(verdicts(vehicle, range(150, 155), sigma_m=0.6))
    wrong = verdicts(vehicle, range(155, 215), sigma_m=0.6, north_m=STEP_M)
    assert {"confirmed", "confirmed_after_verification"}.isdisjoint(wrong)
    assert vehicle.epoch(215, sigma_m=0.6).confirmed


def test_a_run_that_began_where_the_position_was_carried_began_nowhere_else():
    carried = carrying()
    carried.settle(fix(3, north_m=0.02), lost(3), None)
    assert not carried.began_elsewhere(fix(4), lost(4), LIMITS)


def test_odds_of_the_position_fade_with_confirmed_fixes_and_what_is_doubtful_is_not_used():
    doubtful = carrying(range(1), odds=0.5)
    doubtful.settle(fix(1, north_m=2.0), lost(1), None)
    assert not doubtful.began_elsewhere(fix(2, north_m=2.0), lost(2), LIMITS)
    assert off(doubtful, 2)[1] == 3.0
    episode = WrongFixRules().episode_s * 5  # epochs in which they fade by e
    for epochs, used in ((3.0 * episode, False), (5.0 * episode, True)):
        carried = carrying(range(1), odds=0.5)
        for k in range(1, round(epochs)):
            carried.settle(fix(k), lost(k), SURE)
        carried.settle(fix(round(epochs), north_m=2.0), lost(round(epochs)), None)
        assert (off(carried, round(epochs))[1] < 1.0) == used


def test_with_carried_integers_the_odds_of_the_position_do_not_fade():
    """Right or wrong, all of them are: what the first left behind is what the last does."""
    chain = {"ambiguity_mode": "carried", "ambiguity_continuity": "continuous", "continuous_since_ns": at(0)}
    epochs = round(WrongFixRules().episode_s * 5 * 5.0)
    carried = carrying(range(1), odds=0.5)
    for k in range(1, epochs):
        carried.settle(fix(k, **chain), lost(k), SURE)
    carried.settle(fix(epochs, north_m=2.0), lost(epochs), None)
    assert off(carried, epochs)[1] == 3.0


def test_it_is_carried_for_two_minutes_and_no_longer():
    carried = carrying()
    last = 2 + round(RULES.longest_s * 5)
    for k in range(3, last + 5):
        carried.settle(fix(k, north_m=2.0), lost(k, sigma_m=3.0, east_m=5.0), None)
        assert (off(carried, k)[1] < 1.0) == (k <= last)


def test_nothing_is_carried_before_a_fix_is_confirmed_or_where_nothing_carries_it():
    empty = CarriedPosition(RULES, SIGMA, WrongFixRules())
    empty.settle(fix(0), lost(0), None)
    assert not empty.began_elsewhere(fix(1), lost(1), LIMITS)
    assert off(empty, 1)[1] == 3.0
    carried = carrying()
    carried.settle(fix(30, north_m=2.0), lost(30, sigma_m=3.0), None)  # after a pause, and anchored by others
    assert off(carried, 30)[1] == 3.0


def test_a_run_is_off_the_road_since_its_begin_once_a_height_of_it_is():
    carried = carrying()
    assert carried.off_road_since_ns(fix(3, north_m=2.0), lost(3), off_road=False) is None
    assert carried.off_road_since_ns(fix(3, north_m=2.0), lost(3), off_road=True) == at(3)
    carried.settle(fix(3, north_m=2.0), lost(3), None)
    assert carried.off_road_since_ns(fix(4, north_m=2.0), lost(4), off_road=False) is None
    carried.settle(fix(4, north_m=2.0), lost(4), None, off_road=True)
    assert carried.off_road_since_ns(fix(5, north_m=2.0), lost(5), off_road=False) == at(3)
    assert carried.off_road_since_ns(fix(5), lost(5), off_road=False) is None


def test_what_is_dated_ahead_is_dropped():
    carried = carrying()
    carried.forget_after(at(2))
    carried.settle(fix(3, north_m=2.0), lost(3), None)
    assert carried.began_elsewhere(fix(4, north_m=2.0), lost(4), LIMITS)
    carried.forget_after(at(2))
    assert not carried.began_elsewhere(fix(4, north_m=2.0), lost(4), LIMITS)


def test_the_road_is_seen_from_the_place_to_which_the_pose_is_moved():
    patch = RoadPatch(
        reach_m=1.0,
        surface_id=np.array([7, 7]),
        east_m=np.array([-5.0, 0.0]),
        north_m=np.zeros(2),
        elevation_m=np.array([39.5, 40.0]),
        sigma_m=np.full(2, 0.03),
        slope_east=np.full(2, 0.1),
        slope_north=np.zeros(2),
    )
    carried = carrying()
    carried.settle(fix(3, north_m=2.0), lost(3), None)
    for given, expected_m in (
        (road(slope_east=0.1, slope_north=-0.2), 39.5),
        (road(patch=patch), 39.5),
        (Road(status="unknown", reason="no_surface"), None),
    ):
        better = carried.improve(lost(3, sigma_m=3.0, east_m=5.0, road=given))
        here = road_at(better.road, 0.0, 0.0)
        assert (here is None) == (expected_m is None)
        assert here is None or here.elevation_m == pytest.approx(expected_m, abs=0.01)


def test_odds_of_a_fix_without_a_tested_height_are_those_of_its_place_alone():
    wrong = WrongFixRules()
    model = HeightModel(antenna_m=1.8, correction_m=0.0, sigma_m=0.05)
    the_pose = pose()
    with_height = compare(fix(), the_pose, road_at(the_pose.road, 0.0, 0.0), model, SIGMA, LIMITS)
    without = compare(fix(), the_pose, None, None, SIGMA, LIMITS)
    assert odds_of(with_height, wrong, 14, 1) < 0.1 * odds_of(without, wrong, 14, 1) < 0.1
    assert odds_of(without, wrong, 14, 3) == pytest.approx(3.0 * odds_of(without, wrong, 14, 1))
    assert odds_of(without, wrong, 7, 1) > 100.0 * odds_of(without, wrong, 14, 1)


# --- an offset of all fixes that has ended -----------------------------------------------------------------------


class Naming(Learning):
    """A learning that names a cause that the test has set."""

    named = NO_OFFSET

    def diagnosis(self, surface_id):
        return self.named


def naming(begun, rules):
    """A vehicle after a wrong run of 40 s that began at epoch 100, and a base named, of an offset begun at another."""
    learning = Naming(rules.learning)
    vehicle = Vehicle(rules, learning=learning)
    verdicts(vehicle, range(100))
    verdicts(vehicle, range(100, 300), north_m=1.0)
    learning.named = Diagnosis(cause="base", onset_ns=at(begun), east_north_m=(0.0, 1.0))
    return vehicle


def test_a_base_named_by_a_wrong_run_holds_back_no_fix_after_it():
    vehicle = naming(100, Rules())
    judgements = [vehicle.epoch(k) for k in range(300, 320)]
    assert {judgement.cause for judgement in judgements} == {"none"}
    assert all(judgement.confirmed for judgement in judgements)


def test_a_base_that_is_wrong_since_before_a_run_holds_back_all():
    vehicle = naming(20, Rules())
    judgements = [vehicle.epoch(k) for k in range(300, 320)]
    assert {(judgement.reason, judgement.cause) for judgement in judgements} == {("common_offset", "base")}


def test_so_does_one_while_its_fixes_go_on():
    vehicle = naming(100, Rules())
    assert {vehicle.epoch(k, north_m=1.0).reason for k in range(300, 310)} == {"common_offset"}


def test_or_where_the_position_is_not_carried_any_more():
    vehicle = naming(100, Rules(carried=replace(RULES, longest_s=10.0)))
    assert {vehicle.epoch(k).reason for k in range(300, 310)} == {"common_offset"}


def test_or_where_the_height_alone_has_named_it():
    vehicle = naming(100, Rules())
    vehicle.judge.learning.named = replace(vehicle.judge.learning.named, east_north_m=None)
    assert {vehicle.epoch(k).reason for k in range(300, 310)} == {"common_offset"}
