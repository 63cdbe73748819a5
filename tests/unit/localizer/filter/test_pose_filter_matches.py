"""Scan matches in the localizer's pose: late, vague, repeated, wrong; against slipping wheels, anchors and fixes."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from camber.localizer.filter.dead_reckoning_time_update import SCALE
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.filter.start_from_fixes import StartFromFixes
from camber.localizer.links.link_matching import LinkLine
from support.pose_inputs import link_match, sample
from support.pose_vehicle import FIX, MATCH, RIGHT, PoseVehicle

SLIP = (1.05, 1.1, 1.2, 1.25, 1.3)


class Vehicle(PoseVehicle):
    """It stands for a second; then matches hold it, unless a test wants others or none."""

    def __init__(self, seed=1, model=None):
        super().__init__(seed, model)
        super().drive(1.0, 0.0)

    def drive(self, seconds, speed, rate=0.0, **more):
        return super().drive(seconds, speed, rate, **{"matches": {}} | more)

    def link(self):
        """Couple with a link that lies two metres right of the vehicle and means its heading."""
        yaw = self.truth[2]
        line = LinkLine(yaw, 2.0 - LinkLine(yaw, 0.0).offset_m(*self.truth[:2]))
        return self.filter.couple_link(link_match(line, station_m=self.path_m))


def matched_vehicle(**more):
    vehicle = Vehicle(**more)
    vehicle.filter.start(vehicle.given())
    assert set(vehicle.drive(30.0, 8.0)) == {"accepted"}
    return vehicle


def state_of(pose_filter):
    e = pose_filter.estimate()
    return (e.mode, e.provenance, e.east_m, e.north_m, e.yaw_rad, e.covariance.tobytes())


def test_a_match_holds_the_pose_and_its_age_is_reported():
    vehicle = matched_vehicle()
    e = vehicle.filter.estimate()
    assert (e.mode, e.provenance) == ("scan_match", "given")
    assert e.match_time_ns == vehicle.time_ns - 3 * 10**8
    assert vehicle.distance() < 0.1
    vehicle.drive(1.0, 8.0, matches=None)
    assert vehicle.filter.mode == "dead_reckoning"
    assert vehicle.filter.estimate().match_time_ns == e.match_time_ns


def test_a_match_degenerate_along_the_road_updates_but_gives_no_position():
    """Between two walls: across it is centimetres, along it says nothing, so it supports no distance."""
    vehicle = matched_vehicle()
    before = vehicle.filter.estimate()
    for _ in range(10):
        vehicle.step(8.0)
        ahead = np.array([math.cos(vehicle.truth[2]), math.sin(vehicle.truth[2]), 0.0])
        assert vehicle.match(covariance=MATCH + 100.0 * np.outer(ahead, ahead)).outcome == "accepted"
    e = vehicle.filter.estimate()
    assert e.mode == "dead_reckoning"
    assert e.match_time_ns == before.match_time_ns
    vehicle.step(8.0)
    vehicle.match(covariance=MATCH + 0.04 * np.outer(ahead, ahead))
    assert vehicle.filter.mode == "scan_match", "two decimetres along are a place"


def test_poses_held_by_matches_lie_where_the_covariance_says():
    """20 drives with curves, a map that errs over 15 m, matches 0.2 s late; without tuning of the filter."""
    nees = []
    for seed in range(20):
        vehicle = Vehicle(seed=seed)
        vehicle.filter.start(vehicle.given())
        vehicle.drive(15.0, 8.0, 0.05)
        vehicle.drive(5.0, 6.0, -0.3)
        nees.append(vehicle.nees())
    assert np.mean(nees) < stats.chi2.ppf(0.999, 60) / 20
    assert np.mean(nees) > 0.5, "sigmas several times too large help nobody"


def test_a_late_match_is_carried_to_the_present_in_a_curve():
    vehicle = matched_vehicle(seed=3)
    vehicle.drive(4.0, 8.0, 0.4)
    vehicle.drive(0.5, 8.0, 0.4, matches=None)
    assert set(vehicle.drive(3.0, 8.0, 0.4, matches={"steps_late": 5})) == {"accepted"}
    assert vehicle.distance() < 0.15
    assert abs(vehicle.error()[2]) < math.radians(0.5)


def test_a_thousand_matches_at_a_standstill_do_not_make_a_millimetre():
    vehicle = matched_vehicle()
    vehicle.drive(5.0, 0.0)
    vehicle.drive(200.0, 0.0)
    e = vehicle.filter.estimate()
    assert e.horizontal_sigma_m > 0.015
    assert math.sqrt(e.covariance[2, 2]) > math.radians(0.02)


@pytest.mark.parametrize("vague_m2", [1e4, 1e8])
def test_a_degenerate_direction_keeps_its_covariance(vague_m2):
    vehicle = Vehicle(seed=5)
    vehicle.filter.start(vehicle.given(sigma_m=0.5))
    for _ in range(200):
        vehicle.step(8.0)
        ahead = np.array([*rotated(vehicle.truth[2], 1.0, 0.0), 0.0])
        vehicle.match(covariance=MATCH + vague_m2 * np.outer(ahead, ahead))
    covariance = vehicle.filter.estimate().covariance
    along = float(ahead @ covariance @ ahead)
    across = float(np.array([-ahead[1], ahead[0], 0]) @ covariance @ np.array([-ahead[1], ahead[0], 0]))
    assert math.sqrt(across) < 0.05
    assert math.sqrt(along) > 0.5
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    assert vehicle.nees() < 16.3


@pytest.mark.parametrize("name", ["east_m", "north_m", "yaw_rad", "covariance"])
def test_a_match_that_is_not_finite_is_refused_by_name(name):
    vehicle = matched_vehicle()
    arguments = {"east_m": 0.0, "north_m": 0.0, "yaw_rad": 0.0, "covariance": MATCH}
    arguments[name] = arguments[name] * math.nan
    covariance = arguments.pop("covariance")
    with pytest.raises(ValueError, match=f"^{name}:"):
        vehicle.filter.match(vehicle.time_ns, tuple(arguments.values()), covariance, unique=True)


def test_matches_without_a_pose_too_old_repeated_or_ahead_change_nothing():
    vehicle = Vehicle()
    assert vehicle.filter.match(vehicle.time_ns, (0.0, 0.0, 0.0), MATCH, unique=True).outcome == "no_pose"
    vehicle = matched_vehicle()
    before = state_of(vehicle.filter)
    now = vehicle.time_ns
    late_ns = vehicle.past[-4][0]
    for time_ns, outcome in ((now - 2 * 10**9, "too_old"), (late_ns, "too_old"), (now + 10**9, "ahead")):
        assert vehicle.filter.match(time_ns, tuple(vehicle.truth), MATCH, unique=True).outcome == outcome
    assert state_of(vehicle.filter) == before


def test_a_unique_match_determines_an_unknown_heading():
    vehicle = Vehicle()
    vehicle.filter.start(replace(vehicle.given(), yaw_rad=None))
    assert vehicle.match(steps_late=0, unique=False).outcome == "outside_gate"
    assert not vehicle.filter.estimate().yaw_known
    assert vehicle.match(steps_late=0).outcome == "accepted"
    assert vehicle.filter.estimate().yaw_known
    assert abs(vehicle.error()[2]) < math.radians(1.0)


def test_the_pose_is_predicted_ahead_and_interpolated_back():
    vehicle = matched_vehicle()
    vehicle.drive(3.0, 8.0, 0.3)
    time_ns, at = vehicle.past[-6]
    back, now = vehicle.filter.prediction_at(time_ns), vehicle.filter.estimate()
    assert math.hypot(back.east_m - at[0], back.north_m - at[1]) < 0.15
    assert abs(back.yaw_rad - at[2]) < math.radians(1.0)
    assert np.linalg.eigvalsh(back.covariance)[0] > 0.0
    here = vehicle.filter.prediction_at(vehicle.time_ns)
    assert here[1:4] == pytest.approx((now.east_m, now.north_m, now.yaw_rad))
    assert vehicle.filter.prediction_at(vehicle.time_ns + 200_000_000) is not None
    assert vehicle.filter.prediction_at(vehicle.time_ns + 10**9) is None
    assert Vehicle().filter.prediction_at(vehicle.time_ns) is None


def silent(vehicle, seconds, missing):
    """Drive on in a wide curve while a sensor, or its clock, says nothing."""
    vehicle.step(8.0, 0.1)
    predict, stopped_ns = vehicle.filter.predict, vehicle.time_ns
    changes = {
        "speed": {"wheel_speed_m_s": None},
        "yaw rate": {"yaw_rate_rad_s": None},
        "clock": {"time_ns": stopped_ns},
    }
    vehicle.filter.predict = lambda reading: predict(reading.model_copy(update=changes[missing]))
    vehicle.drive(seconds, 6.0, 0.1, matches=None)
    vehicle.filter.predict = predict
    vehicle.step(6.0, 0.1)


@pytest.mark.parametrize("missing", ["speed", "yaw rate", "clock"])
@pytest.mark.parametrize("seconds", [1.0, 4.0])
def test_a_missing_sensor_shows_in_covariance_and_ages(missing, seconds):
    vehicle = matched_vehicle(seed=6)
    vehicle.drive(2.0, 8.0, 0.1)
    before = vehicle.filter.estimate().horizontal_sigma_m
    silent(vehicle, seconds, missing)
    e = vehicle.filter.estimate()
    assert e.mode == "dead_reckoning"
    assert vehicle.time_ns - e.match_time_ns > seconds * 1e9
    assert e.horizontal_sigma_m > before + 0.1 * seconds
    assert vehicle.nees() < 16.3


def test_matches_ahead_of_a_stopped_motion_clock_are_refused():
    vehicle = matched_vehicle()
    stopped_ns = vehicle.time_ns
    for k in range(1, 20):
        assert vehicle.filter.predict(sample(stopped_ns, 8.0)) == "repeated"
        at_ns = stopped_ns + k * 100_000_000
        result = vehicle.filter.match(at_ns, tuple(vehicle.truth), MATCH, unique=True)
        assert result.outcome == "ahead" or k <= 3


@pytest.mark.parametrize(
    "off", [(0.0, 3.0, 0.0), (2.0, 0.0, 0.0), (-3.0, 0.0, 0.0), (0.0, 0.0, 0.3), (0.0, 0.5, 0.0)]
)
def test_one_wrong_match_is_refused(off):
    vehicle = matched_vehicle()
    before = state_of(vehicle.filter)
    assert vehicle.match(off=off).outcome == "outside_gate"
    assert state_of(vehicle.filter) == before
    assert set(vehicle.drive(2.0, 8.0)) == {"accepted"}


def test_a_match_after_a_rejected_one_does_not_update_the_sensors():
    vehicle = matched_vehicle()
    scale = vehicle.filter.state.x[SCALE]
    assert vehicle.match(off=(3.0, 0.0, 0.0)).outcome == "outside_gate"
    vehicle.step(8.0)
    before = vehicle.filter.estimate()
    assert vehicle.match(off=(0.1, 0.0, 0.0), steps_late=0).outcome == "accepted"
    assert vehicle.filter.estimate().east_m != before.east_m
    # Between the two readings of it the scale has driven a metre of the 20 km after which it is another one.
    assert vehicle.filter.state.x[SCALE] == pytest.approx(scale, rel=1e-4)
    vehicle.drive(3.0, 8.0)
    assert vehicle.filter.state.x[SCALE] != scale


@pytest.mark.parametrize(
    ("speed", "wrong"),
    [
        (8.0, {"off": (0.0, 3.0, 0.0)}),
        (8.0, {"off": (0.0, 3.0, 0.0), "unique": False}),
        (0.0, {"off": (0.0, 1.0, 0.0)}),
    ],
)
def test_wrong_matches_in_a_row_do_not_capture_the_pose_and_the_covariance_covers_both(speed, wrong):
    vehicle = matched_vehicle()
    vehicle.drive(5.0, speed)
    outcomes = vehicle.drive(4.0, speed, matches=wrong)
    assert set(outcomes) == {"outside_gate"}
    e = vehicle.filter.estimate()
    assert vehicle.distance() < 0.5
    assert e.mode == "dead_reckoning"
    if wrong.get("unique", True):
        assert e.conflict == "matches"
        off = np.array(rotated(vehicle.truth[2], *wrong["off"][:2]))
        assert off @ np.linalg.solve(e.covariance[:2, :2], off) < 9.21
    vehicle.drive(4.0, speed)
    e = vehicle.filter.estimate()
    assert (e.mode, e.conflict) == ("scan_match", None)
    assert vehicle.distance() < 0.1


def test_a_vague_pose_takes_only_unique_matches_where_they_are_sharp():
    vehicle = Vehicle(seed=2)
    vehicle.filter.start(vehicle.given(sigma_m=3.0))
    before = state_of(vehicle.filter)
    assert vehicle.match(off=(2.0, 0.0, 0.0), steps_late=0, unique=False).outcome == "outside_gate"
    assert state_of(vehicle.filter) == before
    assert vehicle.match(steps_late=0).outcome == "accepted"
    assert vehicle.filter.estimate().horizontal_sigma_m < 0.1


def test_wrong_matches_that_do_not_follow_the_track_are_never_believed():
    vehicle = matched_vehicle()
    outcomes = Counter()
    for k in range(400):
        vehicle.step(8.0, 0.02)
        outcomes[vehicle.match(off=(0.0, 3.0 if k % 8 < 4 else -3.0, 0.0)).outcome] += 1
    assert set(outcomes) == {"outside_gate"}


def test_unique_matches_that_agree_over_a_distance_bring_back_a_pose_that_was_wrong():
    vehicle = Vehicle(seed=4)
    vehicle.filter.start(vehicle.given(off=(0.0, 1.5)))
    vehicle.drive(3.0, 0.0)
    assert vehicle.drive(30.0, 0.0)["recovered"] == 0, "not at a standstill"
    outcomes = vehicle.drive(30.0, 8.0)
    assert outcomes["recovered"] == 1
    assert vehicle.filter.mode == "scan_match"
    assert vehicle.distance() < 0.15
    assert vehicle.nees() < 16.3


def slipping(vehicle, slips, speed=8.0, matches=True):
    """Whether the slip was suspected on the way, and how far off the pose was at most."""
    suspected, worst_m = False, 0.0
    for slip in slips:
        vehicle.step(speed, slip=slip)
        if matches:
            vehicle.match()
        suspected |= vehicle.filter.estimate().wheel_slip_suspected
        worst_m = max(worst_m, vehicle.distance())
    return suspected, worst_m


def test_slip_is_detected_matches_hold_the_pose_and_the_scale_is_not_learnt():
    for seed in range(5, 10):
        vehicle = matched_vehicle(seed=seed)
        scale = vehicle.filter.state.x[SCALE]
        suspected, worst_m = slipping(vehicle, (*SLIP, *[1.3] * 50, *SLIP[::-1]))
        assert suspected
        assert worst_m < 0.5, "without matches it would be 12 m"
        vehicle.drive(5.0, 8.0)
        e = vehicle.filter.estimate()
        assert not e.wheel_slip_suspected
        assert abs(vehicle.filter.state.x[SCALE] - scale) < 0.002
        assert vehicle.distance() < 0.1


@pytest.mark.parametrize(("ending", "seconds"), [((1.2, 1.1), 3.0), ((1.24, 1.18, 1.12, 1.06), 1.5)])
def test_slip_without_another_source_is_detected_by_an_impossible_acceleration_and_ends(ending, seconds):
    vehicle = matched_vehicle()
    slipping(vehicle, (1.1, 1.2, 1.3, *[1.3] * 40, *ending), matches=None)
    assert vehicle.filter.estimate().wheel_slip_suspected
    vehicle.drive(seconds, 8.0, matches=None)
    assert vehicle.distance() > 1.0
    e = vehicle.filter.estimate()
    assert not e.wheel_slip_suspected
    assert e.speed_m_s == pytest.approx(8.0, abs=0.3)
    assert vehicle.nees() < 16.3


def test_locked_wheels_do_not_stop_the_pose_at_once():
    vehicle = matched_vehicle()
    slipping(vehicle, (0.5, *[0.35] * 20, 0.7))
    assert vehicle.distance() < 0.3
    vehicle.drive(3.0, 8.0)
    assert vehicle.distance() < 0.1


def test_slow_slip_is_detected_by_matches():
    suspected, worst_m = slipping(matched_vehicle(), [1.0 + min(0.01 * k, 0.2) for k in range(60)])
    assert suspected
    assert worst_m < 0.5, "without matches it would be 8 m"


def test_matches_with_the_same_offset_as_before_raise_no_suspicion_of_slip():
    for seed in range(3):
        vehicle = matched_vehicle(seed=seed)
        for k in range(150):
            vehicle.step(8.0 if k < 80 else 0.0)
            result = vehicle.match(off=(min(0.004 * k, 0.3), 0.0, 0.0))
            assert result.outcome == "accepted"
            assert not vehicle.filter.estimate().wheel_slip_suspected


def test_locked_wheels_bring_a_sliding_vehicle_to_rest():
    vehicle = matched_vehicle()
    slipping(vehicle, (0.4, *[0.0] * 20), speed=0.0, matches=None)
    assert vehicle.speed > 1.0
    assert vehicle.filter.estimate().wheel_slip_suspected
    assert vehicle.nees() < 16.3
    vehicle.drive(3.5, 0.0, matches=None)
    e = vehicle.filter.estimate()
    assert not e.wheel_slip_suspected
    assert e.speed_m_s == pytest.approx(0.0, abs=0.1)
    assert vehicle.nees() < 16.3
    assert vehicle.distance() < 8.0


@pytest.mark.parametrize(("share", "least_m", "most_m"), [(0.3, 0.4, 0.5), (0.0, 0.0, 0.35)])
def test_links_that_all_lie_off_to_one_side_are_no_better_known_for_being_many(share, least_m, most_m):
    lane = {"lane_sigma_m": 0.01, "lane_turn_sigma_m": 0.0, "lane_wander_m_sqrt_m": 0.0}
    vehicle = Vehicle(model=PoseModel(link_shift_share=share, deviation_length_m=1.0, **lane))
    vehicle.filter.start(vehicle.given(sigma_m=5.0))
    coupled = 0
    for _ in range(1000):
        vehicle.step(8.0)
        coupled += vehicle.link() == "coupled"
    assert coupled > 100
    left = np.array([-math.sin(vehicle.truth[2]), math.cos(vehicle.truth[2])])
    sigma_m = math.sqrt(left @ vehicle.filter.estimate().covariance[:2, :2] @ left)
    assert least_m < sigma_m < most_m


def test_anchors_that_contradict_the_matches_are_a_conflict():
    vehicle = matched_vehicle()
    vehicle.drive(10.0, 8.0, anchors=(0.0, 2.0))
    e = vehicle.filter.estimate()
    assert (e.mode, e.conflict, e.provenance) == ("dead_reckoning", "anchors", "given")
    assert vehicle.distance() < 0.15
    off = np.array(rotated(vehicle.truth[2], 0.0, 2.0))
    assert off @ np.linalg.solve(e.covariance[:2, :2], off) < 9.21
    vehicle.drive(3.0, 8.0)
    e = vehicle.filter.estimate()
    assert (e.mode, e.conflict) == ("scan_match", None)


def test_matches_that_contradict_the_anchors_are_a_conflict():
    vehicle = Vehicle()
    vehicle.filter.start(vehicle.given())
    vehicle.drive(20.0, 8.0, matches=None, anchors=RIGHT)
    outcomes = vehicle.drive(20.0, 8.0, matches={"off": (0.0, 2.0, 0.0)}, anchors=RIGHT)
    assert set(outcomes) == {"outside_gate"}
    e = vehicle.filter.estimate()
    assert (e.mode, e.conflict, e.provenance) == ("dead_reckoning", "matches", "confirmed")
    assert vehicle.distance() < 0.15


def test_the_only_source_left_is_believed_in_the_end():
    vehicle = matched_vehicle()
    vehicle.drive(4.0, 8.0, anchors=(0.0, 2.0))
    vehicle.drive(4.0, 8.0, matches=None, anchors=(0.0, 2.0))
    e = vehicle.filter.estimate()
    assert (e.mode, e.conflict) == ("anchored", None)
    assert vehicle.distance() == pytest.approx(2.0, abs=0.2)


def test_anchors_and_matches_that_agree_hold_the_pose_together():
    vehicle = matched_vehicle()
    assert set(vehicle.drive(20.0, 8.0, anchors=RIGHT)) == {"accepted"}
    e = vehicle.filter.estimate()
    assert (e.mode, e.provenance, e.conflict) == ("scan_match", "confirmed", None)


def test_unique_matches_that_agree_over_a_distance_support_a_provisional_pose():
    vehicle = Vehicle()
    vehicle.filter.start(vehicle.given(off=(1.0, 2.0), provenance="fixes"))
    seen = []
    for _ in range(60):
        vehicle.step(8.0)
        seen.append(vehicle.match().outcome)
        assert (vehicle.filter.mode == "provisional") == (set(seen) == {"provisional"})
    assert Counter(seen)["supported"] == 1
    assert vehicle.filter.estimate().provenance == "scan_match"
    assert vehicle.distance() < 0.15
    assert vehicle.nees() < 16.3


def test_at_a_standstill_unique_matches_support_by_their_time():
    vehicle = Vehicle()
    vehicle.filter.start(vehicle.given(off=(1.0, 0.0), provenance="fixes"))
    assert vehicle.drive(4.0, 0.0)["supported"] == 0
    assert vehicle.drive(4.0, 0.0)["supported"] == 1


@pytest.mark.parametrize("matches", [{"unique": False}, {"covariance": MATCH + np.diag([1.0, 1.0, 0.0])}])
def test_matches_that_are_not_unique_or_vague_support_nothing(matches):
    vehicle = Vehicle()
    vehicle.filter.start(vehicle.given(provenance="fixes"))
    assert set(vehicle.drive(20.0, 8.0, matches=matches)) == {"provisional"}
    assert vehicle.filter.mode == "provisional"


def test_matches_that_do_not_yet_support_a_provisional_pose_change_nothing():
    poses = []
    for matches in (True, False):
        vehicle = Vehicle(seed=8)
        vehicle.rng = np.random.default_rng(1)
        vehicle.filter.start(vehicle.given(provenance="fixes"))
        for _ in range(4):
            vehicle.step(1.0)
            state = vehicle.rng.bit_generator.state
            if matches:
                assert vehicle.match(steps_late=0).outcome == "provisional"
            vehicle.rng.bit_generator.state = state
        poses.append(state_of(vehicle.filter))
    assert poses[0] == poses[1]


def supported_after(fixes_off, seed):
    """The pose after matches have supported it, begun and begun again by fixes that are off by these metres."""
    vehicle, start = Vehicle(seed=seed), StartFromFixes()
    fixes = np.random.default_rng(seed + 1000)
    poses, coupled = [], 0
    for k in range(150):
        vehicle.step(0.0 if k < 20 else 6.0, 0.05)
        coupled += vehicle.link() == "coupled"
        if vehicle.filter.accepts_fixes:
            at = vehicle.truth[:2] + fixes_off + fixes.normal(0, 0.02, 2)
            pose = start.add(vehicle.time_ns, tuple(at), FIX, vehicle.filter.track)
            if pose is not None:
                vehicle.filter.start(pose)
        if k >= 100:
            vehicle.match()
        poses.append(None if vehicle.filter.mode in ("none", "provisional") else state_of(vehicle.filter))
    assert coupled > 3
    return poses


@pytest.mark.parametrize("seed", [11, 12])
def test_a_supported_pose_does_not_depend_on_the_fixes_that_started_it(seed):
    right, wrong = supported_after((0.0, 0.0), seed), supported_after((3.0, -2.0), seed)
    assert right[-1] is not None
    assert right == wrong


def test_a_given_pose_and_matches_do_not_depend_on_earlier_fixes():
    poses = []
    for fixes in (True, False):
        vehicle = Vehicle(seed=21)
        if fixes:
            vehicle.filter.start(vehicle.given(off=(2.0, 2.0), provenance="fixes"))
        for _ in range(40):
            vehicle.step(6.0)
        vehicle.filter.start(vehicle.given())
        vehicle.drive(3.0, 6.0)
        poses.append(state_of(vehicle.filter))
    assert poses[0] == poses[1]


@pytest.mark.parametrize("matches", [{}, None])
def test_no_unconfirmed_fix_changes_a_pose_that_was_given(matches):
    vehicle = Vehicle()
    vehicle.filter.start(vehicle.given())
    vehicle.drive(5.0, 7.0, 0.1, matches=matches)
    before = state_of(vehicle.filter)
    assert not vehicle.filter.start(vehicle.given(off=(0.3, 0.0), provenance="fixes"))
    assert state_of(vehicle.filter) == before
