"""The carried position along drives that turn, climb, stop and start; where exactly it is used, and from when on."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.carried_position import CarriedPosition, CarriedRules, odds_of
from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.checks.fix_comparison import compare
from camber.integrity.checks.height_model import HeightModel, road_at
from camber.integrity.protection.covariance_inflation import TrueSigma
from camber.integrity.protection.wrong_fix_probability import WrongFixRules
from camber.schemas.pose import RoadPatch
from support.judging import ANTENNA_M, FRAME, ROAD_M, at, fix, pose, road

RULES, SIGMA, LIMITS = CarriedRules(), TrueSigma(), ConsistencyParameters().limits()
FIX_M2 = SIGMA.scale**2 * 2.5e-5 + SIGMA.horizontal_m**2
EPOCH_S = 0.2
SLOPE_EAST, SLOPE_NORTH = 0.25, -0.3


class Route:
    """Places of the epochs of a drive with a speed and a heading at each, by the mean of the velocities of both."""

    def __init__(self, speeds_m_s, yaws_rad, sloping=False):
        self.speeds_m_s, self.yaws_rad, self.sloping = speeds_m_s, yaws_rad, sloping
        velocities = [
            (v * math.cos(yaw or 0.0), v * math.sin(yaw or 0.0))
            for v, yaw in zip(speeds_m_s, yaws_rad, strict=True)
        ]
        self.metres = [(0.0, 0.0)]
        for then, now in itertools.pairwise(velocities):
            east_m, north_m = self.metres[-1]
            self.metres.append(
                (
                    east_m + 0.5 * EPOCH_S * (then[0] + now[0]),
                    north_m + 0.5 * EPOCH_S * (then[1] + now[1]),
                )
            )

    def fix(self, k, east_m=0.0, north_m=0.0):
        e, n = self.metres[k][0] + east_m, self.metres[k][1] + north_m
        latitude_rad, longitude_rad = FRAME.geodetic_from_east_north(e, n, ROAD_M + ANTENNA_M)[:2]
        up_m = (SLOPE_EAST * e + SLOPE_NORTH * n) if self.sloping else 0.0
        return fix(k, latitude_rad=latitude_rad, longitude_rad=longitude_rad, up_m=up_m)

    def pose(self, k, **changes):
        there = self.fix(k)
        slopes = {"slope_east": SLOPE_EAST, "slope_north": SLOPE_NORTH} if self.sloping else {}
        fields = {
            "latitude_rad": there.latitude_rad,
            "longitude_rad": there.longitude_rad,
            "yaw_rad": self.yaws_rad[k],
            "speed_m_s": self.speeds_m_s[k],
            "road": road(**slopes),
        }
        return pose(k, **fields | changes)


STRAIGHT = [10.0] * 30
ROUTES = {
    "north_east": Route(STRAIGHT, [0.9] * 30),
    "south_west": Route(STRAIGHT, [-2.2] * 30),
    "climbing": Route(STRAIGHT, [0.9] * 30, sloping=True),
    "turning": Route(STRAIGHT, [0.15 * k for k in range(30)]),
    "starting": Route([0.0] * 8 + [0.6 * k for k in range(22)], [None] * 8 + [2.0] * 22),
    "standing": Route([0.0] * 30, [None] * 30),
}


def carrying(confirmed=range(1), odds=1e-4, rules=RULES, route=None):
    carried = CarriedPosition(rules, SIGMA, WrongFixRules())
    for k in confirmed:
        # As wide as the poses after it: what is carried widens with them.
        wide = {"sigma_m": 9.0}
        one, there = (fix(k), pose(k, **wide)) if route is None else (route.fix(k), route.pose(k, **wide))
        carried.settle(one, there, odds)
    return carried


def metres_between(one, other):
    return east_north_between(one.latitude_rad, one.longitude_rad, other.latitude_rad, other.longitude_rad)


@pytest.mark.parametrize("name", ROUTES)
def test_runs_off_by_whatever_vectors_carry_the_position_along_any_route(name):
    route = ROUTES[name]
    carried = carrying(range(3), route=route)
    for k in range(3, 28):
        east_m, north_m = ((1.3, -0.8), (-0.9, 1.6), (0.7, 2.1))[k // 10]
        carried.settle(route.fix(k, east_m, north_m), route.pose(k, sigma_m=9.0), None)
        given = route.pose(k + 1, sigma_m=9.0)
        given = given.model_copy(update={"latitude_rad": given.latitude_rad + 1e-6})  # 6 m
        better = carried.improve(given)
        assert metres_between(better, route.fix(k + 1)) == pytest.approx((0.0, 0.0), abs=2e-3)
        same_run = route.fix(k + 1, east_m, north_m)
        assert carried.began_elsewhere(same_run, route.pose(k + 1), LIMITS)
        assert carried.off_road_since_ns(same_run, route.pose(k + 1), off_road=True) == at(k // 10 * 10 or 3)


# --- how wide it is ----------------------------------------------------------------------------------------------


def test_a_pose_older_than_the_fix_that_begins_a_run_is_wider_by_what_a_car_may_have_accelerated():
    carried = carrying()
    carried.settle(fix(9, north_m=2.0), pose(7, sigma_m=0.01, anchor_time_ns=at(0)), None)
    carried.settle(fix(10, north_m=2.0), pose(10, sigma_m=3.0), None)
    better = carried.improve(pose(10, sigma_m=3.0))
    unsteady_m2 = (0.5 * 2.0 * 0.4**2) ** 2
    v = 0.01**2 + unsteady_m2 + FIX_M2 + RULES.odometry_m**2
    assert better.covariance_east_north_yaw == pytest.approx((v, 0.0, 0.0, v, 0.0, 1e-4), abs=1e-6)


@pytest.mark.parametrize(("factor", "moved"), [(1.01, True), (0.99, False)])
def test_the_pose_is_moved_wherever_it_is_wider_than_the_carried_position(factor, moved):
    carried = carrying()
    carried.settle(fix(1, north_m=2.0), pose(1, sigma_m=3.0), None)
    v = FIX_M2 + RULES.odometry_m**2 + FIX_M2 + RULES.odometry_m**2
    given = pose(1, sigma_m=factor * math.sqrt(v))
    assert (carried.improve(given) is not given) == moved


def test_a_pose_without_one_of_its_coordinates_stays_as_it_is():
    carried = carrying()
    carried.settle(fix(1, north_m=2.0), pose(1, sigma_m=3.0), None)
    for missing in ("latitude_rad", "longitude_rad"):
        nowhere = pose(1, sigma_m=3.0, **{missing: None})
        assert carried.improve(nowhere) is nowhere


def test_where_the_pose_was_better_than_a_run_and_is_lost_then_nothing_is_carried():
    """What the run had carried before is not what the run of now has moved from."""
    carried = carrying()
    carried.settle(fix(1, north_m=2.0), pose(1), None)
    carried.settle(fix(2, north_m=2.0), pose(2, sigma_m=0.01, anchor_time_ns=at(0)), None)
    carried.settle(fix(3, north_m=2.0), pose(3), None)
    wide = pose(3, sigma_m=3.0)
    assert carried.improve(wide) is wide


def test_after_a_pause_no_later_fix_is_carried_to():
    carried = carrying()
    for k in (30, 31, 32):
        carried.settle(fix(k, north_m=2.0), pose(k, sigma_m=3.0), None)
        wide = pose(k, sigma_m=3.0)
        assert carried.improve(wide) is wide
        assert not carried.began_elsewhere(fix(k + 1, north_m=2.0), pose(k + 1), LIMITS)


def test_a_pose_later_than_two_minutes_stays_even_just_after_a_fix_within_them():
    rules = replace(RULES, longest_s=2.0)
    carried = carrying(rules=rules)
    for k in range(1, 11):
        carried.settle(fix(k, north_m=2.0), pose(k, sigma_m=3.0), None)
    assert carried.improve(pose(10, sigma_m=3.0)) != pose(10, sigma_m=3.0)
    assert carried.improve(pose(11, sigma_m=3.0)) == pose(11, sigma_m=3.0)


# --- whether it is right -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("factor", "used"), [(0.99, True), (1.01, False)])
@pytest.mark.parametrize("epochs", [(0,), (0, 50, 400, 5000)])
def test_fixes_that_are_all_as_doubtful_leave_it_as_doubtful_as_one(factor, used, epochs):
    """Whatever time is between them."""
    assert is_used(carrying(epochs, odds=factor * RULES.most_odds), epochs[-1]) == used


def test_it_is_used_up_to_the_odds_themselves():
    assert is_used(carrying(odds=RULES.most_odds), 0)


def is_used(carried, confirmed):
    carried.settle(fix(confirmed + 1, north_m=2.0), pose(confirmed + 1), None)
    return carried.began_elsewhere(fix(confirmed + 2, north_m=2.0), pose(confirmed + 2), LIMITS)


def test_an_offset_has_returned_where_it_began_five_seconds_before_a_run_that_was_held_back():
    carried = carrying(range(3))
    for k in range(3, 51):
        carried.settle(fix(k, north_m=2.0), pose(k), None)
    for k in (51, 52):
        carried.settle(fix(k), pose(k), 1e-4)

    def returned(begun_ns):
        return carried.has_returned_since(begun_ns - 5 * 10**9, at(53))

    assert [returned(at(2) + ns) for ns in (0, 1)] == [False, True], "with the last before the run"
    assert [returned(at(51) + ns) for ns in (0, 1)] == [True, False], "with the first after it"
    assert [returned(at(52) + ns) for ns in (0, 1)] == [False, True], "with the last of all"


def test_a_height_that_is_not_tested_leaves_the_odds_of_the_place_whichever_number_is_missing():
    wrong, model = WrongFixRules(), HeightModel(antenna_m=1.8, correction_m=0.0, sigma_m=0.05)
    the_pose = pose()
    whole = compare(fix(), the_pose, road_at(the_pose.road, 0.0, 0.0), model, SIGMA, LIMITS)
    alone = odds_of(compare(fix(), the_pose, None, None, SIGMA, LIMITS), wrong, 14, 1)
    east_m, north_m, _ = whole.difference_m.tolist()
    unsure = whole.covariance_m2.copy()
    unsure[2, 2] = math.inf
    for one in (
        replace(whole, difference_m=np.array([east_m, north_m, math.nan])),
        replace(whole, covariance_m2=unsure),
    ):
        assert odds_of(one, wrong, 14, 1) == pytest.approx(alone, rel=1e-3)


# --- the road ----------------------------------------------------------------------------------------------------


def test_the_road_is_seen_from_the_moved_pose_in_both_directions():
    patch = RoadPatch(
        reach_m=1.0,
        surface_id=np.array([7]),
        east_m=np.array([1.0]),
        north_m=np.array([3.0]),
        elevation_m=np.array([39.5]),
        sigma_m=np.full(1, 0.03),
        slope_east=np.zeros(1),
        slope_north=np.zeros(1),
    )
    carried = carrying()
    carried.settle(fix(1, east_m=1.0), pose(1, sigma_m=3.0), None)
    there = fix(1, east_m=3.0, north_m=-4.0)
    place = {"latitude_rad": there.latitude_rad, "longitude_rad": there.longitude_rad}

    def seen(**changes):
        return carried.improve(pose(1, sigma_m=3.0, road=road(**changes), **place)).road

    better = seen(slope_east=0.1, slope_north=0.2, patch=patch)
    assert better.elevation_m == pytest.approx(ROAD_M - 0.1 * 3.0 + 0.2 * 4.0, abs=1e-3)
    assert better.patch.east_m == pytest.approx(np.array([4.0]), abs=1e-3)
    assert better.patch.north_m == pytest.approx(np.array([-1.0]), abs=1e-3)
    unknown = {"elevation_m": None, "slope_east": None, "slope_north": None}
    for missing in ("elevation_m", "slope_east", "slope_north"):
        for changes in ({missing: None}, unknown | {missing: 0.1}):
            assert seen(**changes) == road(**changes)
