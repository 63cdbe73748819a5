"""Each way's height is the vertical one over the road's plane, whatever the body's tilt and the road's slope.

The oracle places a vehicle in space and follows rays and verticals down to a plane; it knows no formula of H.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from camber.antenna_height.body_attitude import Arm, Slopes, Stance, Tilt, TiltRules
from camber.antenna_height.height_methods import (
    ImplausibleError,
    fixed_height,
    height_from_sensor,
    ranging_height,
    stroke_height,
)
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw

exactly = settings(derandomize=True, deadline=None, max_examples=200)
angle = st.floats(-0.3, 0.3)
slope = st.floats(-0.2, 0.2)
RULES = TiltRules(math.radians(0.5), math.radians(1.0), math.radians(0.25), 0.004)


def points(low_m: float, high_m: float) -> st.SearchStrategy[Arm]:
    return st.builds(Arm, st.floats(-2.0, 4.0), st.floats(-1.0, 1.0), st.floats(low_m, high_m))


def exact(road: Slopes, body: Tilt) -> Stance:
    return Stance(road, body, 0.0, 0.0)


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
@given(
    slope,
    slope,
    angle,
    angle,
    points(1.0, 3.0),
    points(0.3, 2.0),
    st.floats(0.6, 2.5),
    st.floats(-math.pi, math.pi),
)
def test_ranging_sees_the_vertical_height_through_any_tilt_and_slope(
    forward: float,
    left: float,
    roll: float,
    pitch: float,
    antenna: Arm,
    sensor: Arm,
    theta: float,
    azimuth: float,
) -> None:
    scene = Scene(road := Slopes(forward, left), body := Tilt(roll, pitch))
    beam = [math.cos(theta) * math.cos(azimuth), math.cos(theta) * math.sin(azimuth), -math.sin(theta)]
    distance_m = scene.along(scene.at(sensor), scene.turn @ np.array(beam))
    assume(not math.isnan(distance_m))
    try:
        way = ranging_height(
            distance_m,
            0.0,
            theta,
            exact(road, body),
            sensor_to_antenna=antenna.minus(sensor),
            beam_azimuth_rad=azimuth,
            beam_sigma_rad=0.0,
            stored_sigma_m=0.0,
        )
    except ImplausibleError:
        assume(False)
    assert way.way == "ranging"
    assert way.height_m == pytest.approx(scene.height(scene.at(antenna)), abs=1e-9)
    assert way.sigma_m == 0.0


@exactly
@given(slope, slope, angle, angle, points(1.0, 3.0), points(0.3, 2.0))
def test_a_sensors_own_height_is_carried_to_the_antenna(
    forward: float, left: float, roll: float, pitch: float, antenna: Arm, lidar: Arm
) -> None:
    scene = Scene(road := Slopes(forward, left), body := Tilt(roll, pitch))
    way = height_from_sensor(
        "scan_matching",
        scene.height(scene.at(lidar)),
        0.0,
        exact(road, body),
        sensor_to_antenna=antenna.minus(lidar),
        stored_sigma_m=0.0,
    )
    assert way.height_m == pytest.approx(scene.height(scene.at(antenna)), abs=1e-9)


@exactly
@given(slope, slope, angle, angle, points(1.0, 3.0), points(0.3, 0.9), st.floats(0.2, 0.6))
def test_stroke_adds_what_pitch_and_roll_do_between_suspension_and_antenna(
    forward: float, left: float, roll: float, pitch: float, antenna: Arm, top: Arm, radius_m: float
) -> None:
    scene = Scene(road := Slopes(forward, left), body := Tilt(roll, pitch))
    square = np.array([-forward, -left, 1.0]) / math.sqrt(1.0 + forward**2 + left**2)
    over_road_m = float(square @ scene.at(top))  # the plane goes through the origin
    way = stroke_height(
        over_road_m - radius_m,
        0.0,
        exact(road, body),
        suspension_to_antenna_m=antenna.z_m - top.z_m,
        tyre_radius_m=radius_m,
        arm=antenna.minus(top),
        stored_sigma_m=0.0,
    )
    assert way.height_m == pytest.approx(scene.height(scene.at(antenna)), abs=1e-9)


def test_on_level_ground_the_ways_are_the_sums_of_h() -> None:
    level = exact(Slopes(0.0, 0.0), Tilt(0.0, 0.0))
    way = stroke_height(
        0.45, 0.03, level, suspension_to_antenna_m=0.92, tyre_radius_m=0.31, arm=None, stored_sigma_m=0.04
    )
    assert (way.way, way.height_m, way.sigma_m) == ("stroke", pytest.approx(1.68), pytest.approx(0.05))
    theta, sensor_to_antenna = math.radians(70.0), Arm(1.2, 0.0, 0.63)
    way = ranging_height(
        1.0, 0.01, theta, level, sensor_to_antenna=sensor_to_antenna, beam_azimuth_rad=math.pi,
        beam_sigma_rad=0.0, stored_sigma_m=0.0,
    )  # fmt: skip
    assert way.height_m == pytest.approx(1.0 * math.sin(theta) + 0.63)
    assert way.sigma_m == pytest.approx(0.01 * math.sin(theta))


def test_a_fixed_height_is_as_it_was_measured_and_upright_on_a_slope() -> None:
    way = fixed_height(1.8, 0.02)
    assert (way.way, way.height_m, way.sigma_m) == ("fixed", 1.8, 0.02)
    on_slope = Stance.of(Slopes(0.10, 0.0), None, RULES)
    assert fixed_height(1.8, 0.02, on_slope).height_m == pytest.approx(1.8 / math.cos(math.atan(0.10)))


@pytest.mark.parametrize("theta_deg", [0.0, 10.0, -45.0, 175.0, 250.0])
def test_a_beam_that_does_not_meet_the_road_is_refused_in_words(theta_deg: float) -> None:
    level = exact(Slopes(0.0, 0.0), Tilt(0.0, 0.0))
    with pytest.raises(ImplausibleError, match=r"expected one that meets the road at 15° or more"):
        ranging_height(
            1.0, 0.0, math.radians(theta_deg), level, sensor_to_antenna=Arm(0.0, 0.0, 0.6),
            beam_azimuth_rad=0.0, beam_sigma_rad=0.0, stored_sigma_m=0.0,
        )  # fmt: skip


# What is not known of the stance grows σ as it moves the height


def spread(road: Slopes | None, body: Tilt | None, arm: Arm) -> tuple[float, float]:
    """What a stance says a lever arm rises, and how sure it is."""
    stance = Stance.of(road, body, RULES)
    return stance.rise_m(arm), stance.rise_sigma_m(arm)


def test_without_an_attitude_a_long_lever_arm_is_uncertain_by_what_a_body_can_tilt() -> None:
    for road, body in ((Slopes(0.05, 0.02), None), (None, Tilt(0.01, -0.03)), (None, None)):
        _, near = spread(road, body, Arm(0.0, 0.0, 0.6))
        _, far = spread(road, body, Arm(2.0, 0.0, 0.6))
        _, aside = spread(road, body, Arm(0.0, 1.0, 0.6))
        assert far == pytest.approx(2.0 * math.hypot(RULES.body_pitch_sigma_rad, 0.004), rel=0.1)
        assert aside == pytest.approx(math.hypot(RULES.body_roll_sigma_rad, 0.004), rel=0.1)
        assert near < 0.005


def test_a_measured_attitude_makes_it_surer_and_moves_it_towards_what_was_measured() -> None:
    road, arm = Slopes(0.0, 0.0), Arm(2.0, 0.0, 0.0)
    blind_m, blind_sigma = spread(road, None, arm)
    seen_m, seen_sigma = spread(road, Tilt(0.0, math.radians(-1.0)), arm)
    assert blind_m == 0.0
    assert seen_sigma < blind_sigma
    assert 0.5 * 2.0 * math.sin(math.radians(1.0)) < seen_m < 2.0 * math.sin(math.radians(1.0))


def test_an_attitude_that_means_nothing_leaves_what_was_known_before() -> None:
    vague = TiltRules(RULES.body_pitch_sigma_rad, RULES.body_roll_sigma_rad, 10.0, RULES.slope_sigma)
    stance = Stance.of(Slopes(0.03, 0.01), Tilt(0.2, 0.2), vague)
    blind = Stance.of(Slopes(0.03, 0.01), None, vague)
    assert stance.body.pitch_rad == pytest.approx(blind.body.pitch_rad, abs=1e-3)
    assert stance.pitch_sigma_rad == pytest.approx(blind.pitch_sigma_rad, rel=1e-2)


@exactly
@given(slope, slope, st.floats(-math.pi, math.pi))
def test_slopes_turn_with_the_heading(east: float, north: float, yaw: float) -> None:
    road = Slopes.along(east, north, yaw)
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    left = np.array([-math.sin(yaw), math.cos(yaw)])
    assert road.forward == pytest.approx(float(np.dot([east, north], ahead)), abs=1e-12)
    assert road.left == pytest.approx(float(np.dot([east, north], left)), abs=1e-12)
    assert road.steepness == pytest.approx(math.hypot(east, north), abs=1e-12)


@exactly
@given(slope, slope)
def test_a_body_parallel_to_the_road_rises_nowhere_along_it(forward: float, left: float) -> None:
    road = Slopes(forward, left)
    for body in (Tilt.parallel_to(road),):
        stance = exact(road, body)
        assert stance.rise_m(Arm(3.0, -1.0, 0.0)) == pytest.approx(0.0, abs=1e-12)
        assert stance.rise_m(Arm(0.0, 0.0, 1.0)) == pytest.approx(stance.upright, abs=1e-12)
        assumed = Stance.of(None, body, RULES)
        assert assumed.road.forward == pytest.approx(forward, abs=1e-12)
        assert assumed.road.left == pytest.approx(left, abs=1e-12)


@exactly
@given(slope, slope, angle, angle, points(0.5, 3.0), st.integers(0, 1))
def test_sigma_is_how_much_the_height_moves_with_the_bodys_angles(
    forward: float, left: float, roll: float, pitch: float, arm: Arm, which: int
) -> None:
    road, tiny = Slopes(forward, left), 1e-6
    moved = Tilt(roll + tiny * which, pitch + tiny * (1 - which))
    stance = Stance(road, Tilt(roll, pitch), 1.0 * (1 - which), 1.0 * which)
    rate = abs(exact(road, moved).rise_m(arm) - stance.rise_m(arm)) / tiny
    # Of the roll only about the body's own x, which is off the level one by the pitch.
    assert stance.rise_sigma_m(arm) == pytest.approx(rate, abs=0.15 * math.hypot(*arm) if which else 1e-5)
