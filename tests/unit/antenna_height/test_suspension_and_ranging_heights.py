"""Each method's height is the vertical one over the road's plane, whatever the body's tilt and the road's slope.

The oracle places a vehicle in space and follows rays and verticals down to a plane; it has no formula of JP7707657B2.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from camber.antenna_height.body_attitude import Arm, BodyAttitude, Slopes, Tilt, TiltRules
from camber.antenna_height.suspension_and_ranging_heights import (
    ImplausibleError,
    RangingGeometry,
    StrokeGeometry,
    height_from_sensor,
    ranging_height,
    stroke_height,
)
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.schemas.motion import Ranging, Suspension

exactly = settings(derandomize=True, deadline=None, max_examples=200)
angle = st.floats(-0.3, 0.3)
slope = st.floats(-0.2, 0.2)
ROADS = st.builds(Slopes, slope, slope)
TILTS = st.builds(Tilt, angle, angle)
RULES = TiltRules(
    body_pitch_sigma_rad=math.radians(0.5),
    body_roll_sigma_rad=math.radians(1.0),
    attitude_sigma_rad=math.radians(0.25),
    slope_sigma=0.004,
)
ORIGIN = Arm(0.0, 0.0, 0.0)


def points(low_m: float, high_m: float) -> st.SearchStrategy[Arm]:
    return st.builds(Arm, st.floats(-2.0, 4.0), st.floats(-1.0, 1.0), st.floats(low_m, high_m))


def exact(road: Slopes, body: Tilt) -> BodyAttitude:
    return BodyAttitude(road=road, body=body, pitch_sigma_rad=0.0, roll_sigma_rad=0.0)


LEVEL = exact(Slopes(0.0, 0.0), Tilt(0.0, 0.0))


def measured_distance(distance_m: float, beam_angle_rad: float, sigma_m: float = 0.0) -> Ranging:
    return Ranging.model_construct(
        time_ns=0, distance_m=distance_m, beam_angle_rad=beam_angle_rad, distance_sigma_m=sigma_m
    )


def beam(sensor: Arm, azimuth_rad: float, sigma_rad: float = 0.0) -> RangingGeometry:
    return RangingGeometry(sensor=sensor, beam_azimuth_rad=azimuth_rad, beam_sigma_rad=sigma_rad)


def measured_stroke(stroke_m: float, sigma_m: float = 0.0) -> Suspension:
    return Suspension.model_construct(time_ns=0, stroke_height_m=stroke_m, stroke_sigma_m=sigma_m)


class Scene:
    """A vehicle in level axes at (0, 0, 0.2) above a plane road through the origin."""

    def __init__(self, road: Slopes, body: Tilt) -> None:
        self.road = np.array([road.forward, road.left])
        self.turn = rotation_from_roll_pitch_yaw(body.roll_rad, body.pitch_rad, 0.0)

    def at(self, point: Arm) -> np.ndarray:
        return self.turn @ np.array(point) + [0.0, 0.0, 0.2]

    def height(self, point: np.ndarray) -> float:
        return float(point[2] - self.road @ point[:2])

    def along(self, start: np.ndarray, direction: np.ndarray) -> float:
        """Distance to the road, by bisection."""
        near, far = 0.0, 100.0
        if self.height(start) <= 0.0 or self.height(start + far * direction) >= 0.0:
            return math.nan
        for _ in range(80):
            middle = 0.5 * (near + far)
            near, far = (middle, far) if self.height(start + middle * direction) > 0.0 else (near, middle)
        return near


@exactly
@given(ROADS, TILTS, points(1.0, 3.0), points(0.3, 2.0), st.floats(0.6, 2.5), st.floats(-math.pi, math.pi))
def test_ranging_gives_the_vertical_height_for_any_tilt_and_slope(
    road: Slopes, body: Tilt, antenna: Arm, sensor: Arm, theta: float, azimuth: float
) -> None:
    scene = Scene(road, body)
    ray = [math.cos(theta) * math.cos(azimuth), math.cos(theta) * math.sin(azimuth), -math.sin(theta)]
    distance_m = scene.along(scene.at(sensor), scene.turn @ np.array(ray))
    assume(not math.isnan(distance_m))
    distance, geometry = measured_distance(distance_m, theta), beam(sensor, azimuth)
    try:
        height_m, *sigmas_m = ranging_height(distance, exact(road, body), geometry, antenna=antenna)
    except ImplausibleError:
        assume(False)
    assert height_m == pytest.approx(scene.height(scene.at(antenna)), abs=1e-9)
    assert sigmas_m == [0.0, 0.0, 0.0]


@exactly
@given(ROADS, TILTS, points(1.0, 3.0), points(0.3, 2.0))
def test_a_sensors_height_is_carried_to_the_antenna(
    road: Slopes, body: Tilt, antenna: Arm, lidar: Arm
) -> None:
    scene, arm = Scene(road, body), antenna.minus(lidar)
    over_road_m = scene.height(scene.at(lidar))
    height_m, *sigmas_m = height_from_sensor(over_road_m, 0.02, exact(road, body), sensor_to_antenna=arm)
    assert height_m == pytest.approx(scene.height(scene.at(antenna)), abs=1e-9)
    assert sigmas_m == [0.02, 0.0]


@exactly
@given(ROADS, TILTS, points(1.0, 3.0), points(0.3, 0.9), st.floats(0.2, 0.6))
def test_stroke_adds_what_pitch_and_roll_do_between_suspension_and_antenna(
    road: Slopes, body: Tilt, antenna: Arm, top: Arm, radius_m: float
) -> None:
    scene = Scene(road, body)
    normal = np.array([-road.forward, -road.left, 1.0]) / math.sqrt(1.0 + road.forward**2 + road.left**2)
    over_road_m = float(normal @ scene.at(top))  # the plane goes through the origin
    geometry = StrokeGeometry(
        suspension_to_antenna_m=antenna.z_m - top.z_m, tyre_radius_m=radius_m, suspension=top
    )
    stroke = measured_stroke(over_road_m - radius_m)
    height_m, *_ = stroke_height(stroke, exact(road, body), geometry, antenna=antenna)
    assert height_m == pytest.approx(scene.height(scene.at(antenna)), abs=1e-9)


def test_on_level_ground_the_heights_are_the_sums_of_jp7707657b2() -> None:
    """Eq. (1), and eq. (6) and (7)."""
    geometry = StrokeGeometry(suspension_to_antenna_m=0.92, tyre_radius_m=0.31)
    by_stroke = stroke_height(measured_stroke(0.45, 0.03), LEVEL, geometry, antenna=None)
    assert by_stroke == (pytest.approx(1.68), 0.03, 0.0)
    theta, antenna = math.radians(70.0), Arm(1.2, 0.0, 0.63)
    distance = measured_distance(2.0, theta, 0.01)
    height_m, *sigmas_m = ranging_height(distance, LEVEL, beam(ORIGIN, math.pi, 0.02), antenna=antenna)
    assert height_m == pytest.approx(2.0 * math.sin(theta) + 0.63)
    assert sigmas_m == pytest.approx([0.01 * math.sin(theta), 2.0 * 0.02 * math.cos(theta), 0.0])


@pytest.mark.parametrize("theta_deg", [0.0, 10.0, -45.0, 175.0, 250.0])
def test_a_beam_that_does_not_meet_the_road_is_implausible(theta_deg: float) -> None:
    distance = measured_distance(1.0, math.radians(theta_deg))
    with pytest.raises(ImplausibleError, match=r"expected one that meets the road at 15° or more"):
        ranging_height(distance, LEVEL, beam(ORIGIN, 0.0), antenna=Arm(0.0, 0.0, 0.6))


def spread(road: Slopes | None, body: Tilt | None, arm: Arm) -> tuple[float, float]:
    """The rise of a lever arm, and its σ."""
    attitude = BodyAttitude.of(road, body, RULES)
    return attitude.rise_m(arm), attitude.rise_sigma_m(arm)


def test_without_an_attitude_a_long_lever_arm_is_uncertain_by_what_a_body_can_tilt() -> None:
    for road, body in ((Slopes(0.05, 0.02), None), (None, Tilt(0.01, -0.03)), (None, None)):
        _, near = spread(road, body, Arm(0.0, 0.0, 0.6))
        _, far = spread(road, body, Arm(2.0, 0.0, 0.6))
        _, left = spread(road, body, Arm(0.0, 1.0, 0.6))
        assert far == pytest.approx(2.0 * math.hypot(RULES.body_pitch_sigma_rad, 0.004), rel=0.1)
        assert left == pytest.approx(math.hypot(RULES.body_roll_sigma_rad, 0.004), rel=0.1)
        assert near < 0.005


def test_a_measured_attitude_makes_it_surer_and_moves_it_towards_what_was_measured() -> None:
    road, arm = Slopes(0.0, 0.0), Arm(2.0, 0.0, 0.0)
    blind_m, blind_sigma = spread(road, None, arm)
    seen_m, seen_sigma = spread(road, Tilt(0.0, math.radians(-1.0)), arm)
    assert blind_m == 0.0
    assert seen_sigma < blind_sigma
    assert 0.5 * 2.0 * math.sin(math.radians(1.0)) < seen_m < 2.0 * math.sin(math.radians(1.0))


def test_an_attitude_that_means_nothing_leaves_what_was_known_before() -> None:
    vague = replace(RULES, attitude_sigma_rad=10.0)
    attitude = BodyAttitude.of(Slopes(0.03, 0.01), Tilt(0.2, 0.2), vague)
    blind = BodyAttitude.of(Slopes(0.03, 0.01), None, vague)
    assert attitude.body.pitch_rad == pytest.approx(blind.body.pitch_rad, abs=1e-3)
    assert attitude.pitch_sigma_rad == pytest.approx(blind.pitch_sigma_rad, rel=1e-2)


@exactly
@given(slope, slope, st.floats(-math.pi, math.pi))
def test_slopes_turn_with_the_heading(east: float, north: float, yaw: float) -> None:
    road = Slopes.along(east, north, yaw)
    along = (east + 1j * north) * cmath.exp(-1j * yaw)
    assert (road.forward, road.left) == pytest.approx((along.real, along.imag), abs=1e-12)
    assert road.steepness == pytest.approx(math.hypot(east, north), abs=1e-12)


@exactly
@given(ROADS)
def test_a_body_parallel_to_the_road_rises_nowhere_along_it(road: Slopes) -> None:
    body = Tilt.parallel_to(road)
    attitude = exact(road, body)
    assert attitude.rise_m(Arm(3.0, -1.0, 0.0)) == pytest.approx(0.0, abs=1e-12)
    assert attitude.rise_m(Arm(0.0, 0.0, 1.0)) == pytest.approx(attitude.vertical_per_normal, abs=1e-12)
    assumed = BodyAttitude.of(None, body, RULES)
    assert assumed.road.forward == pytest.approx(road.forward, abs=1e-12)
    assert assumed.road.left == pytest.approx(road.left, abs=1e-12)


@exactly
@given(ROADS, TILTS, points(0.5, 3.0), st.integers(0, 1))
def test_sigma_is_how_much_the_height_moves_with_the_bodys_angles(
    road: Slopes, body: Tilt, arm: Arm, which: int
) -> None:
    tiny = 1e-6
    moved = Tilt(body.roll_rad + tiny * which, body.pitch_rad + tiny * (1 - which))
    sigmas = {"pitch_sigma_rad": 1.0 * (1 - which), "roll_sigma_rad": 1.0 * which}
    attitude = replace(exact(road, body), **sigmas)
    rate = abs(exact(road, moved).rise_m(arm) - attitude.rise_m(arm)) / tiny
    # Of the roll only about the body's own x, which is off the level one by the pitch.
    assert attitude.rise_sigma_m(arm) == pytest.approx(rate, abs=0.15 * math.hypot(*arm) if which else 1e-5)
