"""The localizer's pose: anchors, gaps, links, and the law that unconfirmed fixes stay outside."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from camber.localizer.filter.filter_state import DEVIATION, LANE
from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from camber.localizer.links.link_matching import LinkLine, LinkMatch, LinkMatcher, LinkNetwork, RoadLink
from support.pose_inputs import line_through, link_match, sample, start_pose
from support.pose_vehicle import FIX, RIGHT, PoseVehicle

STEP_S = 0.2


def agile(yaw=0.0, **more):
    return PoseVehicle(at=(0.0, 0.0, yaw), step_s=STEP_S, agile=True, **more)


def anchored_vehicle(**more):
    vehicle = agile(**more)
    vehicle.drive(10.0, 0.0, anchors=RIGHT)
    vehicle.drive(10.0, 8.0, anchors=RIGHT)
    return vehicle


def test_anchors_and_motion_determine_the_heading():
    vehicle = agile(yaw=2.0)
    vehicle.drive(2.0, 0.0, anchors=RIGHT)
    e = vehicle.filter.estimate()
    assert not e.yaw_known
    assert e.covariance[2, 2] == pytest.approx(math.pi**2)
    vehicle.drive(5.0, 5.0, anchors=RIGHT)
    e = vehicle.filter.estimate()
    assert (e.mode, e.provenance, e.yaw_known) == ("anchored", "confirmed", True)
    assert abs(vehicle.error()[2]) < 4.0 * math.sqrt(e.covariance[2, 2]) < math.radians(5.0)


def test_anchored_becomes_dead_reckoning_when_anchors_stop():
    vehicle = anchored_vehicle()
    assert vehicle.filter.mode == "anchored"
    vehicle.drive(2.0, 8.0)
    assert vehicle.filter.mode == "dead_reckoning"
    assert vehicle.filter.estimate().anchor_time_ns == vehicle.time_ns - 2 * 10**9


def test_the_antennas_lever_arm_is_taken_into_account():
    model = PoseModel(antenna_x_m=1.5, antenna_y_m=-0.6)
    vehicle = anchored_vehicle(model=model, yaw=-1.0)
    vehicle.drive(5.0, 5.0, 0.3, anchors=RIGHT)
    assert np.abs(vehicle.error()[:2]).max() < 0.2


def test_a_thousand_anchors_at_a_standstill_do_not_make_a_millimetre():
    vehicle = anchored_vehicle()
    vehicle.drive(3.0, 0.0, anchors=RIGHT)
    vehicle.drive(200.0, 0.0, anchors=RIGHT)
    assert vehicle.filter.estimate().horizontal_sigma_m > 0.01
    assert vehicle.nees() < 16.3


def test_a_late_anchor_gives_almost_the_same_update():
    prompt, late = (anchored_vehicle(seed=7, noise=0.0) for _ in range(2))
    for vehicle in (prompt, late):
        vehicle.drive(20.0, 8.0, 0.05)
    then = late.time_ns
    place = prompt.antenna()
    assert prompt.filter.anchor(then, *place, FIX).accepted
    for vehicle in (prompt, late):
        vehicle.drive(1.0, 8.0, 0.2)
    result = late.filter.anchor(then, *place, FIX)
    assert result.accepted
    a, b = prompt.filter.estimate(), late.filter.estimate()
    assert math.hypot(a.east_m - b.east_m, a.north_m - b.north_m) < 0.05
    np.testing.assert_allclose(np.diag(a.covariance), np.diag(b.covariance), rtol=0.5)


def test_anchors_too_old_or_ahead_of_the_motion_are_refused():
    vehicle = anchored_vehicle()
    before = vehicle.filter.estimate()
    assert vehicle.anchor(time_ns=vehicle.time_ns - 10 * 10**9).outcome == "too_old"
    assert vehicle.anchor(time_ns=vehicle.time_ns + 10 * 10**9).outcome == "ahead"
    assert vehicle.filter.estimate().east_m == before.east_m


def test_one_anchor_outside_the_gate_is_refused_several_in_a_row_are_believed():
    vehicle = anchored_vehicle()
    before = vehicle.filter.estimate()
    result = vehicle.anchor((0.0, 5.0))
    assert result.outcome == "outside_gate"
    assert result.nis > 18.0
    assert vehicle.filter.estimate().north_m == before.north_m
    outcomes = []
    for _ in range(6):
        vehicle.drive(STEP_S, 8.0)
        outcomes.append(vehicle.anchor((0.0, 5.0)).outcome)
    assert "recovered" in outcomes
    assert abs(vehicle.error()[1] - 5.0) < 0.5


@pytest.mark.parametrize("name", ["east_m", "north_m", "covariance"])
def test_an_anchor_that_is_not_finite_is_refused_by_name(name):
    vehicle = anchored_vehicle()
    arguments = {"east_m": 0.0, "north_m": 0.0, "covariance": FIX}
    arguments[name] = arguments[name] * math.nan
    with pytest.raises(ValueError, match=f"^{name}:"):
        vehicle.filter.anchor(vehicle.time_ns, **arguments)


def test_first_anchors_after_long_gaps_lie_where_the_covariance_says():
    """25 drives: anchored, then 100 s and 800 m with turns and a stop, then a right fix."""
    nis = []
    for seed in range(25):
        vehicle = anchored_vehicle(seed=seed)
        for leg in ((30, 8, 0), (5, 5, 0.3), (30, 8, 0.02), (20, 0, 0), (5, 5, -0.3), (30, 8, 0)):
            vehicle.drive(*leg)
        nis.append(vehicle.anchor().nis)
    assert np.mean(nis) < stats.chi2.ppf(0.999, 50) / 25
    assert np.mean(nis) > 0.4, "sigmas several times too large help nobody"
    assert max(nis) < 13.82


CORNERS = {
    "a corner": [(0.6, 9.0, 0.0), (1.4, 9.0, 0.5), (0.6, 9.0, 0.0)],
    "its begin": [(1.6, 9.0, 0.0), (1.0, 9.0, 0.5)],
    "its end": [(1.0, 9.0, -0.5), (1.6, 9.0, 0.0)],
    "none": [(2.6, 9.0, 0.0)],
}


def unseen(vehicle, legs):
    """Drive while no motion reaches the filter; return the time and the antenna's place of the last fix but one."""
    vehicle.sense = lambda slip: None
    for leg in legs:
        vehicle.drive(*leg)
    late = vehicle.time_ns, vehicle.antenna()
    vehicle.step(9.0)
    del vehicle.sense
    vehicle.step(9.0)
    return late


@pytest.mark.parametrize("legs", CORNERS.values(), ids=CORNERS)
def test_after_a_gap_with_a_corner_the_pose_is_where_the_covariance_says(legs):
    nees = []
    for seed in range(20):
        vehicle = anchored_vehicle(seed=seed)
        time_ns, antenna = unseen(vehicle, legs)
        assert vehicle.filter.anchor(time_ns, *antenna, FIX).outcome == "too_old", "no motion carries it here"
        nees.append(vehicle.nees())
        for _ in range(10):
            vehicle.drive(STEP_S, 9.0, anchors=RIGHT)
            nees.append(vehicle.nees())
        assert vehicle.distance() < 0.3
    assert max(nees) < stats.chi2.ppf(1.0 - 1e-6, 3)


def test_what_was_measured_before_a_gap_gives_no_heading_after_it():
    vehicle = agile(yaw=2.0)
    vehicle.drive(1.0, 9.0)
    vehicle.anchor()
    unseen(vehicle, [(0.2, 9.0, 5.0), (1.0, 9.0, 0.0)])
    vehicle.anchor()
    assert not vehicle.filter.estimate().yaw_known
    vehicle.drive(3.0, 5.0, anchors=RIGHT)
    assert abs(vehicle.error()[2]) < 4.0 * math.sqrt(vehicle.filter.estimate().covariance[2, 2]) < 0.2


def test_a_long_stop_is_no_gap_in_the_track():
    vehicle = agile()
    begin_ns = vehicle.filter.track.begin_ns
    vehicle.drive(300.0, 0.0)
    assert vehicle.filter.track.begin_ns == begin_ns
    unseen(vehicle, [(2.0, 9.0)])
    assert vehicle.filter.track.begin_ns == vehicle.time_ns


def test_the_yaw_rate_bias_is_learnt_at_a_standstill():
    after, before = (agile(seed=3) for _ in range(2))
    for vehicle, wait_s in ((before, 0.0), (after, 60.0)):
        vehicle.filter.start(vehicle.given())
        vehicle.drive(wait_s, 0.0)
        vehicle.drive(60.0, 8.0)
    assert after.filter.estimate().covariance[2, 2] < 0.5 * before.filter.estimate().covariance[2, 2]
    assert abs(after.error()[2]) < 4.0 * math.sqrt(after.filter.estimate().covariance[2, 2])


def test_a_standstill_keeps_the_pose_and_couples_nothing():
    vehicle = anchored_vehicle()
    vehicle.drive(2.0, 0.0)
    e = vehicle.filter.estimate()
    for _ in range(200):
        vehicle.drive(STEP_S, 0.0)
        assert vehicle.filter.couple_link(link_match(LinkLine(0.0, 0.0))) == "standing"
    later = vehicle.filter.estimate()
    np.testing.assert_allclose(later.covariance[:2, :2], e.covariance[:2, :2], rtol=1e-2)
    assert later.speed_m_s is not None


def test_a_gap_longer_than_can_be_bridged_loses_the_pose():
    vehicle = anchored_vehicle()
    vehicle.time_ns += 120 * 10**9
    vehicle.sense()
    assert vehicle.filter.mode == "none"
    assert vehicle.filter.accepts_fixes


def test_without_readings_speed_and_yaw_rate_are_unknown():
    vehicle = anchored_vehicle()
    vehicle.time_ns += 2 * 10**8
    vehicle.filter.predict(sample(vehicle.time_ns, None, None))
    e = vehicle.filter.estimate()
    assert e.speed_m_s is None
    assert e.yaw_rate_rad_s is None
    assert not e.rotation_read


def couple_along(vehicle, offsets, seconds, speed=8.0, sigma_m=1.0):
    """Drive east along the x axis; the link is off by the offset of the place, one every 5 m."""
    for _ in range(round(seconds / STEP_S)):
        vehicle.drive(STEP_S, speed)
        offset = offsets[int(vehicle.truth[0] / 5.0)]
        vehicle.filter.couple_link(link_match(LinkLine(0.0, -offset), sigma_m))


def test_coupling_with_a_link_that_deviates_slowly_stays_honest_and_helps():
    model = PoseModel()
    nees, across = [], {True: [], False: []}
    for seed in range(16):
        for couple in (True, False):
            vehicle = agile(seed=seed, model=replace(model, couple_links=couple))
            vehicle.filter.start(vehicle.given())
            keep = math.exp(-5.0 / model.deviation_length_m)  # a Gauss-Markov process along the way
            offsets = [vehicle.rng.normal(0, 1.0)]
            while len(offsets) < 400:
                offsets.append(keep * offsets[-1] + math.sqrt(1 - keep**2) * vehicle.rng.normal(0, 1.0))
            couple_along(vehicle, offsets, 120.0)
            across[couple].append(vehicle.error()[1])
            if couple:
                nees.append(vehicle.nees())
    assert np.mean(nees) < stats.chi2.ppf(0.999, 48) / 16
    assert np.std(across[True]) < 0.6 * np.std(across[False])


def test_a_thousand_couplings_do_not_average_a_coarse_link():
    vehicle = agile()
    vehicle.filter.start(vehicle.given(sigma_m=10.0, yaw_deg=1.0))
    couple_along(vehicle, [0.0] * 2000, 600.0, sigma_m=2.0)
    sigma = math.sqrt(vehicle.filter.estimate().covariance[1, 1])
    assert sigma > 2.0 / math.sqrt(4800.0 / 40.0), "not better than one look per correlation length"
    assert sigma > 2.0, "the lane is not known either"


def test_the_offset_from_the_link_is_measured_by_anchors_and_kept_when_they_stop():
    vehicle = agile()
    vehicle.drive(5.0, 0.0, anchors=RIGHT)
    for steps, anchors, within_m in ((100, RIGHT, 0.3), (500, None, 1.5)):
        for _ in range(steps):
            vehicle.drive(STEP_S, 8.0, anchors=anchors)
            vehicle.filter.couple_link(link_match(LinkLine(0.0, 3.0), 0.5))
        assert vehicle.filter.state.x[[LANE, DEVIATION]].sum() == pytest.approx(3.0, abs=within_m)
    assert abs(vehicle.error()[1]) < 1.5


def test_links_are_coupled_at_intervals_of_distance_only():
    vehicle = anchored_vehicle()
    vehicle.drive(0.4, 6.5)
    outcomes = []
    for _ in range(50):
        vehicle.drive(STEP_S, 5.0)
        outcomes.append(vehicle.filter.couple_link(link_match(LinkLine(0.0, 0.0))))
    assert 9 <= outcomes.count("coupled") <= 11
    assert set(outcomes) == {"coupled", "too_soon"}


def test_links_without_a_meaningful_direction_are_not_coupled():
    vehicle = anchored_vehicle()
    line = LinkLine(0.0, 0.0)
    couple = vehicle.filter.couple_link
    assert couple(LinkMatch(status="none")) == "not_matched"
    assert couple(replace(link_match(line), status="ambiguous")) == "not_matched"
    assert couple(link_match(LinkLine(0.6, 0.0))) == "not_parallel"
    assert couple(replace(link_match(line), to_sharp_m=5.0)) == "near_bend"
    assert couple(link_match(line)) == "coupled"


def test_a_link_far_off_is_refused_first_and_taken_for_a_change_of_lane_then():
    vehicle = anchored_vehicle()
    for _ in range(20):
        vehicle.drive(1.0, 8.0)
        vehicle.filter.couple_link(link_match(LinkLine(0.0, 0.0), 0.3))
    before = vehicle.filter.estimate()
    outcomes = []
    for _ in range(5):
        vehicle.drive(1.0, 8.0)
        outcomes.append(vehicle.filter.couple_link(link_match(LinkLine(0.0, 30.0), 0.3)))
    assert outcomes[:2] == ["rejected", "rejected"]
    assert "coupled" in outcomes[2:]
    assert abs(vehicle.filter.estimate().north_m - before.north_m) < 3.0


def test_a_turn_onto_another_link_determines_the_position_along_the_first():
    network = LinkNetwork(
        [
            RoadLink(link_id=k, start_node=a, end_node=b, vertices_m=np.array(ends), sigma_m=0.5)
            for k, a, b, ends in (
                (1, "a", "b", [[-50.0, 0.0], [1030.0, 0.0]]),
                (2, "b", "c", [[1030.0, 0.0], [1030.0, 900.0]]),
            )
        ]
    )
    vehicle = agile(seed=5)
    vehicle.filter.start(vehicle.given())
    matcher, along = LinkMatcher(network), []
    for seconds, rate in ((125.0, 0.0), (math.pi / 2 / 0.2667, 0.2667), (60.0, 0.0)):
        for _ in range(round(seconds / STEP_S)):
            vehicle.drive(STEP_S, 8.0, rate)
            e = vehicle.filter.estimate()
            place = (e.east_m, e.north_m, e.yaw_rad)
            match = matcher.step(place, e.covariance, travelled_m=vehicle.filter.travelled_m)
            vehicle.filter.couple_link(match)
        along.append(vehicle.filter.estimate().covariance[0, 0])
    assert (match.link_id, match.status) == (2, "matched")
    assert along[-1] < along[0]
    assert vehicle.nees() < 16.3


def test_a_common_heading_error_stays_unobserved():
    vehicle = agile(both_sensors=True)
    vehicle.filter.start(vehicle.given(yaw_deg=5.0))
    vehicle.drive(60.0, 8.0)
    vehicle.filter.couple_rotation()
    assert math.sqrt(vehicle.filter.estimate().covariance[2, 2]) > math.radians(5.0)


def test_two_rotation_sensors_are_better_than_one_and_consistent():
    nees, errors = [], {True: [], False: []}
    motion = replace(PoseModel().motion, steering_noise_rad=2e-3, steering_scale_sigma=0.002)
    motion = replace(motion, yaw_rate_bias_sigma_rad_s=math.radians(0.2), steering_bias_sigma_rad=1e-4)
    for seed in range(30):
        for both in (True, False):
            vehicle = agile(seed=seed, model=PoseModel(motion=motion), both_sensors=both)
            vehicle.filter.start(vehicle.given(yaw_deg=0.1))
            for rate in (0.0, 0.1, -0.2, 0.0, 0.1):
                vehicle.drive(12.0, 8.0, rate)
                vehicle.filter.couple_link(LinkMatch(status="none"))
            errors[both].append(vehicle.error()[2])
            if both:
                nees.append(vehicle.nees())
    assert np.std(errors[True]) < 0.5 * np.std(errors[False])
    assert np.mean(nees) < stats.chi2.ppf(0.999, 90) / 30


def test_the_sensors_may_swap_systems():
    """The same two sensors weighed the other way round: the same pose."""
    estimates = []
    for sensor in ("yaw_rate", "steering"):
        model = PoseModel(motion=MotionModel(a_rate_sensor=sensor))
        vehicle = agile(seed=11, model=model, both_sensors=True)
        vehicle.filter.start(vehicle.given())
        for rate in (0.0, 0.1, -0.1, 0.0):
            vehicle.drive(1.0, 8.0, rate)
            for _ in range(9):
                vehicle.drive(1.0, 8.0, rate)
                vehicle.filter.couple_rotation()
        estimates.append(vehicle.filter.estimate())
    a, b = estimates
    assert math.hypot(a.east_m - b.east_m, a.north_m - b.north_m) < 0.5
    assert a.covariance[2, 2] == pytest.approx(b.covariance[2, 2], rel=0.2)


def test_fixes_may_restart_a_pose_whose_sigma_says_it_has_drifted():
    vehicle = agile(model=PoseModel(restart_sigma_m=5.0))
    vehicle.filter.start(vehicle.given(yaw_deg=3.0))
    vehicle.drive(60.0, 8.0)
    assert vehicle.filter.estimate().horizontal_sigma_m > 5.0
    assert vehicle.filter.start(vehicle.given(provenance="fixes"))
    assert vehicle.filter.mode == "provisional"


def test_a_provisional_pose_stays_provisional_until_a_confirmed_fix():
    vehicle = agile()
    vehicle.filter.start(vehicle.given(provenance="fixes"))
    vehicle.drive(20.0, 8.0)
    assert vehicle.filter.mode == "provisional"
    assert vehicle.anchor().accepted
    assert vehicle.filter.mode == "anchored"


def test_a_confirmed_fix_overrules_a_provisional_pose():
    vehicle = agile()
    vehicle.filter.start(replace(vehicle.given(provenance="fixes"), north_m=8.0))
    vehicle.drive(2.0, 8.0)
    assert vehicle.anchor().outcome == "recovered"
    assert np.abs(vehicle.error()[:2]).max() < 0.5


def test_a_standing_start_by_fixes_learns_the_heading_from_a_later_one():
    vehicle = agile(yaw=1.0)
    pose = vehicle.given(provenance="fixes")
    assert vehicle.filter.start(replace(pose, yaw_rad=None))
    vehicle.drive(4.0, 5.0)
    e = vehicle.filter.estimate()
    assert not e.yaw_known
    assert math.hypot(*vehicle.error()[:2]) < math.sqrt(13.82) * e.horizontal_sigma_m
    assert vehicle.filter.start(vehicle.given(provenance="fixes"))
    assert vehicle.filter.estimate().yaw_known
    standing = replace(vehicle.given(provenance="fixes"), yaw_rad=None)
    assert not vehicle.filter.start(standing), "the heading is not thrown away"


def test_a_heading_that_is_lost_is_reported_as_unknown():
    vehicle = anchored_vehicle()
    for _ in range(100):
        vehicle.time_ns += 2 * 10**8
        vehicle.filter.predict(sample(vehicle.time_ns, 8.0, None))
    e = vehicle.filter.estimate()
    assert not e.yaw_known
    assert vehicle.filter.mode == "dead_reckoning"
    assert e.horizontal_sigma_m > 50.0


def test_nothing_depends_on_the_origin():
    seeds = {}
    for shift in (0.0, 5000.0):
        vehicle = anchored_vehicle(seed=9)
        vehicle.filter.shift_origin(shift, -shift)
        vehicle.truth[:2] -= (shift, -shift)
        line = line_through((-shift, shift - 2.0), (100.0 - shift, shift - 2.0))
        for _ in range(50):
            vehicle.drive(1.0, 8.0)
            vehicle.filter.couple_link(link_match(line))
        vehicle.anchor()
        e = vehicle.filter.estimate()
        seeds[shift] = (e.east_m + shift, e.north_m - shift, e.covariance)
    assert seeds[0.0][:2] == pytest.approx(seeds[5000.0][:2], abs=1e-6)
    np.testing.assert_allclose(seeds[0.0][2], seeds[5000.0][2], rtol=1e-6, atol=1e-9)


def test_the_estimate_does_not_change_afterwards():
    vehicle = anchored_vehicle()
    e = vehicle.filter.estimate()
    kept = e.covariance.copy()
    vehicle.drive(10.0, 8.0, anchors=RIGHT)
    np.testing.assert_array_equal(e.covariance, kept)


EVENTS = st.lists(
    st.one_of(
        st.tuples(
            st.just("motion"),
            st.integers(-200, 5000),
            st.none() | st.floats(-10, 30),
            st.none() | st.floats(-2, 2),
        ),
        st.tuples(st.just("anchor"), st.integers(-3000, 500), st.floats(-20, 20), st.floats(-20, 20)),
        st.tuples(st.just("match"), st.integers(-1500, 500), st.floats(-20, 20), st.floats(-4, 4)),
        st.tuples(st.just("vague match"), st.integers(-400, 0), st.floats(-3, 3), st.floats(-0.1, 0.1)),
        st.tuples(st.just("link"), st.floats(-3, 3), st.floats(-20, 20), st.floats(0.1, 10)),
        st.tuples(st.just("given"), st.none() | st.floats(-3, 3), st.floats(0.01, 50), st.floats(0.001, 3)),
        st.tuples(st.just("shift"), st.floats(-1000, 1000), st.floats(-1000, 1000), st.just(0)),
    ),
    max_size=60,
)


@settings(max_examples=150, deadline=None)
@given(EVENTS, st.sampled_from(["yaw_rate", "steering"]))
def test_any_sequence_of_events_leaves_a_covariance(events, sensor):
    pose_filter = PoseFilter(PoseModel(motion=MotionModel(a_rate_sensor=sensor), antenna_x_m=1.0))
    now = 10**15
    pose_filter.predict(sample(now, 0.0, 0.0, 0.0))
    for kind, a, b, c in events:
        if kind == "motion":
            now += a * 1_000_000
            pose_filter.predict(sample(now, b, c, c))
        elif kind == "anchor":
            pose_filter.anchor(now + a * 1_000_000, b, c, FIX)
        elif kind == "match":
            pose_filter.match(now + a * 1_000_000, (b, c, 0.1 * c), np.eye(3) * 1e-4, unique=b > 0)
        elif kind == "vague match":
            covariance = np.diag([1e-4, 1e-4, 1e-5])
            covariance[:2, :2] += 1e4 * np.outer([math.cos(b), math.sin(b)], [math.cos(b), math.sin(b)])
            pose_filter.match(now + a * 1_000_000, (b, c, c), covariance, unique=True)
        elif kind == "link":
            pose_filter.couple_link(link_match(LinkLine(a, b), c))
        elif kind == "given":
            provenance = "fixes" if b > 25.0 else "given"
            pose_filter.start(start_pose(now, (0.0, 0.0, a), b, math.degrees(c), provenance))
        else:
            pose_filter.shift_origin(a, b)
        e = pose_filter.estimate()
        if e is None:
            continue
        np.testing.assert_allclose(e.covariance, e.covariance.T, rtol=1e-9, atol=1e-15)
        scale = np.sqrt(np.diag(e.covariance))
        assert np.linalg.eigvalsh(e.covariance / np.outer(scale, scale))[0] > 0.0
        assert np.isfinite(pose_filter.state.x).all()
