"""The independent position: its evidence, and heights of the road as such."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.localizer.filter.dead_reckoning_time_update import EAST, NORTH
from camber.localizer.filter.independent_position import IndependentPoseFilter
from camber.schemas.motion import Motion
from support.pose_inputs import line_through, link_match, sample, start_pose

NS = 1_000_000_000
SIGMA = np.diag([0.05**2, 0.05**2, math.radians(0.2) ** 2])
VAGUE = np.diag([0.05**2, 10.0**2, math.radians(0.2) ** 2])


class Vehicle:
    """It drives east at 10 m/s from the origin, with faultless sensors."""

    def __init__(self, extra_states: int = 0) -> None:
        self.position = IndependentPoseFilter(extra_states=extra_states)
        self.tenth = 0
        self.position.predict(self.motion())

    @property
    def time_ns(self) -> int:
        return 10**18 + self.tenth * NS // 10

    def motion(self) -> Motion:
        return sample(self.time_ns, 10.0, 0.0)

    def drive(self, tenths: int) -> None:
        for _ in range(tenths):
            self.tenth += 1
            self.position.predict(self.motion())

    def start(self, east_m: float = 0.0, north_m: float = 0.0, sigma_m: float = 0.3) -> None:
        place = (self.tenth + east_m, north_m, 0.0)
        assert self.position.start(start_pose(self.time_ns, place, sigma_m), "given")

    def match(self, north_m: float = 0.0, covariance: np.ndarray = SIGMA, **how: bool) -> str:
        here = (float(self.tenth), north_m, 0.0)
        return self.position.match(
            self.time_ns,
            here,
            covariance,
            unique=how.get("unique", True),
            predicted_here=how.get("here", True),
        ).outcome


def test_without_evidence_there_is_no_position() -> None:
    vehicle = Vehicle()
    vehicle.drive(50)
    assert vehicle.position.evidence is None
    assert vehicle.position.estimate() is None
    assert (
        vehicle.position.update_height(vehicle.time_ns, 0.0, (0.1, 0.0), variance_m2=1.0).outcome == "no_pose"
    )


def test_a_pose_from_fixes_starts_none() -> None:
    vehicle = Vehicle()
    from_fixes = start_pose(vehicle.time_ns, (0.0, 0.0, 0.0), provenance="fixes")
    assert not vehicle.position.start(from_fixes, "given")
    assert vehicle.position.estimate() is None


def test_the_distance_since_the_last_evidence_is_driven_distance() -> None:
    vehicle = Vehicle()
    vehicle.start()
    vehicle.drive(100)
    assert vehicle.position.evidence is not None
    assert (vehicle.position.evidence.basis, vehicle.position.evidence.time_ns) == ("given", 10**18)
    assert vehicle.position.distance_m == pytest.approx(100.0, abs=0.6)
    assert vehicle.match() == "accepted"
    assert vehicle.position.evidence.basis == "scan_match"
    vehicle.drive(30)
    assert vehicle.position.distance_m == pytest.approx(30.0, abs=0.2)


def test_a_match_that_leaves_a_direction_open_is_no_evidence_of_the_position() -> None:
    vehicle = Vehicle()
    vehicle.start()
    vehicle.drive(10)
    assert vehicle.match(covariance=VAGUE) == "accepted"
    assert vehicle.position.evidence is not None
    assert vehicle.position.evidence.basis == "given"


def test_one_match_around_another_pose_starts_nothing_and_several_that_agree_do() -> None:
    vehicle = Vehicle()
    outcomes = []
    for _ in range(6):
        vehicle.drive(10)
        outcomes.append(vehicle.match(here=False))
    assert outcomes[:4] == ["provisional"] * 4
    assert outcomes[4] == "supported"
    estimate = vehicle.position.estimate()
    assert estimate is not None
    assert math.hypot(estimate.east_m - vehicle.tenth, estimate.north_m) < 0.1


def test_matches_around_another_pose_that_are_not_unique_start_nothing() -> None:
    vehicle = Vehicle()
    for _ in range(30):
        vehicle.drive(10)
        assert vehicle.match(here=False, unique=False) == "provisional"
    assert vehicle.position.estimate() is None


def test_matches_around_another_pose_do_not_move_a_position_out_of_its_covariance() -> None:
    vehicle = Vehicle()
    vehicle.start()
    for _ in range(20):
        vehicle.drive(10)
        assert vehicle.match(north_m=12.0, here=False) == "outside_gate"
    estimate = vehicle.position.estimate()
    assert estimate is not None
    assert abs(estimate.north_m) < 1.0


@pytest.mark.parametrize("slope", [(0.08, 0.0), (0.0, -0.05), (0.06, 0.06)])
def test_a_height_is_the_update_of_kalman_along_the_slope(slope: tuple[float, float]) -> None:
    vehicle = Vehicle()
    vehicle.start(sigma_m=2.0)
    state = vehicle.position.state
    x, p = state.x.copy(), state.p.copy()
    h = np.zeros((1, len(x)))
    h[0, [EAST, NORTH]] = slope
    noise, residual_m = 0.03**2, 0.05
    gain = p @ h.T / float((h @ p @ h.T)[0, 0] + noise)
    outcome = vehicle.position.update_height(vehicle.time_ns, residual_m, slope, variance_m2=noise)
    assert outcome.outcome == "accepted"
    np.testing.assert_allclose(state.x, x + gain[:, 0] * residual_m, atol=1e-9)
    np.testing.assert_allclose(state.p, p - gain @ h @ p, atol=1e-9)


def test_a_flat_road_moves_nothing_and_makes_nothing_more_certain() -> None:
    vehicle = Vehicle()
    vehicle.start(sigma_m=2.0)
    state = vehicle.position.state
    x, p = state.x.copy(), state.p.copy()
    for _ in range(50):
        vehicle.position.update_height(vehicle.time_ns, 0.02, (0.0, 0.0), variance_m2=0.01**2)
    np.testing.assert_allclose(state.x, x, atol=1e-12)
    np.testing.assert_allclose(state.p, p, atol=1e-12)


def test_a_late_height_observes_the_place_of_its_time() -> None:
    """A vehicle that drives north of its heading by the yaw error has a height that shows it at the past place only."""
    now, late = Vehicle(), Vehicle()
    for vehicle in (now, late):
        vehicle.start(sigma_m=1.0)
        vehicle.drive(20)
    now.position.update_height(now.time_ns, 0.04, (0.05, 0.05), variance_m2=0.02**2)
    now.drive(5)
    past_ns = late.time_ns
    late.drive(5)
    assert late.position.update_height(past_ns, 0.04, (0.05, 0.05), variance_m2=0.02**2).outcome == "accepted"
    np.testing.assert_allclose(now.position.state.x[:3], late.position.state.x[:3], atol=0.02)
    np.testing.assert_allclose(
        now.position.state.p[:2, :2], late.position.state.p[:2, :2], rtol=0.05, atol=1e-3
    )


def test_a_height_outside_the_gate_or_too_late_changes_nothing() -> None:
    vehicle = Vehicle()
    vehicle.start(sigma_m=1.0)
    first_ns = vehicle.time_ns
    vehicle.drive(20)
    before = vehicle.position.state.x.copy()
    far = vehicle.position.update_height(vehicle.time_ns, 2.0, (0.05, 0.0), variance_m2=0.02**2)
    late = vehicle.position.update_height(first_ns, 0.0, (0.05, 0.0), variance_m2=0.02**2)
    ahead = vehicle.position.update_height(vehicle.time_ns + NS, 0.0, (0.05, 0.0), variance_m2=0.02**2)
    assert (far.outcome, late.outcome, ahead.outcome) == ("outside_gate", "too_old", "ahead")
    np.testing.assert_array_equal(vehicle.position.state.x, before)


def test_slopes_that_change_separate_the_place_from_a_constant_offset_of_the_height() -> None:
    """One extra state, an offset b of all heights: unobservable apart from the place on one slope, not on two."""
    off_m, b_m = (0.8, -0.6), 0.25
    vehicle = Vehicle(extra_states=1)
    vehicle.start(*off_m, sigma_m=1.5)
    state = vehicle.position.state
    state.p[state.extra, state.extra] = 0.5**2

    def observe(slope: tuple[float, float], count: int = 40) -> None:
        for _ in range(count):
            vehicle.drive(1)
            estimate = vehicle.position.estimate()
            assert estimate is not None
            away = vehicle.tenth - estimate.east_m, -estimate.north_m
            residual_m = slope[0] * away[0] + slope[1] * away[1] + b_m
            outcome = vehicle.position.update_height(
                vehicle.time_ns, residual_m, slope, variance_m2=0.02**2, extra=(1.0,)
            )
            assert outcome.outcome == "accepted"

    observe((0.08, 0.0))
    assert state.p[EAST, EAST] > 1.0
    for slope in ((-0.08, 0.0), (0.0, 0.08), (0.0, -0.08)):
        observe(slope)
    estimate = vehicle.position.estimate()
    assert estimate is not None
    assert float(state.x[state.extra][0]) == pytest.approx(b_m, abs=0.03)
    assert math.hypot(estimate.east_m - vehicle.tenth, estimate.north_m) < 0.3
    assert math.sqrt(state.p[EAST, EAST]) < 0.5


def test_links_and_their_memory_leave_the_extra_states_alone() -> None:
    vehicle = Vehicle(extra_states=2)
    vehicle.start()
    state = vehicle.position.state
    state.x[state.extra] = (0.3, -0.1)
    for k in range(60):
        vehicle.drive(10)
        match = link_match(line_through((0.0, 0.0), (1.0, 0.0)), station_m=float(10 * k))
        vehicle.position.filter.couple_link(match)
    assert len(state.x) > state.extra.stop
    np.testing.assert_array_equal(state.x[state.extra], (0.3, -0.1))
