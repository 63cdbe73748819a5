"""All ways side by side: which is passed on, what stands in for it, and words for every input that is of no use."""

from __future__ import annotations

import math
from typing import Any

import pytest

from camber.antenna_height.body_attitude import Slopes
from camber.antenna_height.estimator import Antenna, Said
from camber.antenna_height.flatness import Flatness, FlatRules
from camber.antenna_height.settings import AntennaHeightSettings
from camber.schemas.antenna import AntennaHeight
from camber.schemas.codec import encode
from camber.schemas.motion import Motion, Ranging, Suspension
from camber.schemas.pose import Pose, Road, ScanMatch

START_NS = 1_450_000_000 * 1_000_000_000
NS = 1_000_000_000
STEP_NS = NS // 10
CAR: dict[str, Any] = {
    "antenna": {"x_m": 0.3, "y_m": 0.4, "z_m": 1.58},
    "suspension": {"x_m": 0.0, "y_m": 0.7, "z_m": 0.74},
    "ranging": {"x_m": -0.9, "y_m": 0.4, "z_m": 0.95},
    "lidar": {"x_m": 1.1, "y_m": 0.0, "z_m": 1.95},
    "beam_azimuth_deg": 180.0,
    "suspension_to_antenna_m": 0.84,
    "tyre_radius_m": 0.32,
    "fixed_height_m": 1.58,
}
THETA_RAD = math.radians(70.0)


def road(forward: float) -> Road:
    return Road(status="known", slope_east=forward, slope_north=0.0)


class Vehicle:
    """Drives to the east at 10 m/s, a step of 0.1 s at a time, on a road of some slope; sensors may be left out."""

    def __init__(self, **settings: Any) -> None:
        self.antenna = Antenna(AntennaHeightSettings(**(CAR | settings)).options())
        self.now_ns = START_NS

    def drive(self, seconds: float, slope: float = 0.0, **left_out: Any) -> AntennaHeight:
        """What is said at the end. `stroke_m`, `distance_m`, `theta_rad`, `match`, `road`, `pitch_rad`: other values;
        None: nothing comes."""
        for _ in range(round(seconds * 10)):
            self.now_ns += STEP_NS
            self.hear(slope, **left_out)
            said = self.antenna.height(self.now_ns)
        return self.checked(said)

    def hear(self, slope: float, **other: Any) -> None:
        t, upright = self.now_ns, math.sqrt(1.0 + slope**2)
        pitch_rad = other.get("pitch_rad", -math.atan(slope))
        self.antenna.hear_motion(Motion(time_ns=t, wheel_speed_m_s=10.0, pitch_rad=pitch_rad, roll_rad=0.0))
        self.antenna.hear_pose(pose(t, other.get("road", road(slope))))
        stroke_m, distance_m = (
            other.get("stroke_m", 0.42),
            other.get("distance_m", 0.95 / math.sin(THETA_RAD)),
        )
        if stroke_m is not None:
            self.antenna.hear_suspension(
                Suspension(time_ns=t, stroke_height_m=stroke_m, stroke_sigma_m=0.003)
            )
        if distance_m is not None:
            theta_rad = other.get("theta_rad", THETA_RAD)
            self.antenna.hear_ranging(
                Ranging(time_ns=t, distance_m=distance_m, beam_angle_rad=theta_rad, distance_sigma_m=0.004)
            )
        match = other.get("match", {"sensor_height_m": 1.95 * upright, "sensor_height_sigma_m": 0.01})
        if match is not None:
            match = {"roll_pitch_yaw_rad": (0.0, -math.atan(slope), 0.0), "status": "converged"} | match
            match = {"road_slope_forward": slope, "road_slope_left": 0.0} | match
            self.antenna.hear_match(ScanMatch(time_ns=t, **match))

    def checked(self, said: Said) -> AntennaHeight:
        encode(said.height)
        self.problems = said.problems
        return said.height


def pose(time_ns: int, below: Road, sigma_m: float = 0.3) -> Pose:
    return Pose(
        time_ns=time_ns,
        mode="anchored",
        provenance="given",
        latitude_rad=0.6,
        longitude_rad=2.4,
        yaw_rad=0.0,
        covariance_east_north_yaw=(sigma_m**2, 0.0, 0.0, sigma_m**2, 0.0, 1e-4),
        speed_m_s=10.0,
        road=below,
    )


@pytest.mark.parametrize("slope", [0.0, 0.10, -0.10])
@pytest.mark.parametrize("way", ["fixed", "stroke", "ranging", "scan_matching"])
def test_every_way_knows_the_height_on_any_grade_and_has_the_others_beside_it(way: str, slope: float) -> None:
    height = Vehicle(way=way).drive(5.0, slope)
    assert (height.status, height.way, height.reason) == ("known", way, "")
    assert height.height_m == pytest.approx(1.58 * math.sqrt(1.0 + slope**2), abs=2e-3)
    assert height.sigma_m is not None
    assert height.sigma_m < 0.025
    assert {other.way for other in height.others} == {"fixed", "stroke", "ranging", "scan_matching"} - {way}


def test_the_lidars_own_returns_stand_in_for_a_ranging_sensor_that_is_not_there() -> None:
    seen = {"status": "lost", "ground_height_m": 1.95, "ground_height_sigma_m": 0.01}
    height = Vehicle(way="ranging", ranging=None).drive(1.0, match=seen)
    assert (height.status, height.way) == ("known", "ranging")
    assert height.height_m == pytest.approx(1.58, abs=1e-6)
    blind = Vehicle(way="ranging", ranging=None).drive(1.0, match={"status": "lost"})
    assert blind.reason == "no ranging sensor, and the sweep shows no road near the vehicle"


def test_automatic_ranges_on_flat_road_and_matches_on_a_grade() -> None:
    vehicle = Vehicle(way="automatic")
    assert vehicle.drive(5.0).way == "ranging"
    assert vehicle.drive(5.0, slope=0.08).way == "scan_matching"
    assert vehicle.drive(5.0).way == "ranging"


def test_automatic_says_why_another_way_stands_in() -> None:
    vehicle = Vehicle(way="automatic")
    height = vehicle.drive(5.0, distance_m=None)
    assert (height.status, height.way) == ("known", "scan_matching")
    assert height.reason.startswith(
        "road flat: slope 0.000, uneven by 0.000 m; no fresh distance to the road"
    )
    assert height.reason.endswith("scan_matching instead")
    height = vehicle.drive(5.0, slope=0.08, match={"status": "lost"})
    assert height.way == "ranging"
    assert "road not flat: slope 0.080" in height.reason
    assert "scan match lost: ranging instead" in height.reason
    nothing = Vehicle(way="automatic", fixed_height_m=None, tyre_radius_m=None)
    height = nothing.drive(1.0, distance_m=None, match=None)
    assert (height.status, height.way) == ("unknown", None)
    assert height.reason.endswith("no fresh distance to the road")


def test_automatic_without_a_road_says_so() -> None:
    height = Vehicle(way="automatic").drive(1.0, road=Road(status="unknown", reason="no_surface"))
    assert (height.way, height.reason) == ("ranging", "road not known")


@pytest.mark.parametrize(
    ("way", "other", "words"),
    [
        ("stroke", {"stroke_m": None}, "no fresh stroke height"),
        (
            "stroke",
            {"stroke_m": 2.4},
            "stroke is implausible: the antenna 3.560 m above the road, expected 1.580 m",
        ),
        ("ranging", {"distance_m": None}, "no fresh distance to the road"),
        ("ranging", {"distance_m": 0.0}, "expected 1.580 m at rest, give or take 0.5 m"),
        ("ranging", {"distance_m": 40.0}, "ranging is implausible: the antenna 38.2"),
        (
            "ranging",
            {"theta_rad": 0.05},
            "a beam 2.9° below the vehicle's horizontal, expected one that meets",
        ),
        ("ranging", {"theta_rad": -1.2}, "a beam -68.8° below the vehicle's horizontal"),
        ("scan_matching", {"match": None}, "no fresh scan match"),
        ("scan_matching", {"match": {"status": "ambiguous"}}, "scan match ambiguous"),
        ("scan_matching", {"match": {}}, "the scan match gives no height of the sensor"),
        (
            "scan_matching",
            {"match": {"sensor_height_m": 9.0, "sensor_height_sigma_m": 0.01}},
            "scan_matching is implausible: the antenna 8.630 m above the road",
        ),
    ],
)
def test_a_way_that_was_named_is_taken_or_none_and_the_reason_says_why(
    way: str, other: dict[str, Any], words: str
) -> None:
    vehicle = Vehicle(way=way)
    height = vehicle.drive(1.0, **other)
    assert (height.status, height.height_m) == ("unknown", None)
    assert words in height.reason
    assert len(height.others) == 3
    assert bool(vehicle.problems) == ("implausible" in height.reason)


@pytest.mark.parametrize(
    ("way", "missing", "words"),
    [
        ("fixed", {"fixed_height_m": None}, "fixed_height_m is not set"),
        ("automatic", {"lidar": None}, ""),
        ("stroke", {"antenna": None, "ranging": None}, ""),
        ("stroke", {"suspension": None}, ""),
    ],
)
def test_places_that_nobody_measured_are_words_or_a_larger_sigma(
    way: str, missing: dict[str, Any], words: str
) -> None:
    height = Vehicle(way=way, **missing).drive(1.0)
    assert height.reason == words
    if way == "stroke":
        measured = Vehicle(way=way).drive(1.0)
        assert height.sigma_m > measured.sigma_m


def test_a_measurement_that_is_too_old_is_none_and_an_attitude_that_is_too_old_only_costs_sigma() -> None:
    vehicle = Vehicle(way="ranging")
    fresh = vehicle.drive(1.0)
    vehicle.now_ns += 2 * NS
    assert vehicle.checked(vehicle.antenna.height(vehicle.now_ns)).status == "unknown"
    ranging = Ranging(
        time_ns=vehicle.now_ns,
        distance_m=0.95 / math.sin(THETA_RAD),
        beam_angle_rad=THETA_RAD,
        distance_sigma_m=0.004,
    )
    vehicle.antenna.hear_ranging(ranging)
    alone = vehicle.checked(vehicle.antenna.height(vehicle.now_ns))
    assert alone.status == "known"
    assert alone.sigma_m > fresh.sigma_m


def test_an_older_message_does_not_replace_a_newer_one() -> None:
    vehicle = Vehicle(way="stroke")
    vehicle.drive(1.0)
    late = Suspension(time_ns=vehicle.now_ns - STEP_NS, stroke_height_m=0.5, stroke_sigma_m=0.003)
    vehicle.antenna.hear_suspension(late)
    height = vehicle.checked(vehicle.antenna.height(vehicle.now_ns))
    assert height.height_m == pytest.approx(1.58, abs=1e-3)


def test_after_a_clock_was_far_ahead_the_right_time_is_heard_again() -> None:
    vehicle = Vehicle(way="stroke")
    ahead = Suspension(time_ns=START_NS + 3600 * NS, stroke_height_m=0.5, stroke_sigma_m=0.003)
    vehicle.antenna.hear_suspension(ahead)
    assert vehicle.drive(1.0).status == "known"


def test_an_attitude_of_a_vehicle_that_lies_on_its_side_is_not_used() -> None:
    upset = Vehicle(way="ranging").drive(1.0, pitch_rad=1.4)
    assert (upset.status, upset.height_m) == ("known", pytest.approx(1.58, abs=1e-6))


def test_a_pose_that_is_too_uncertain_says_nothing_of_the_slope() -> None:
    vehicle = Vehicle(way="fixed")
    vehicle.drive(1.0, slope=0.10)
    assert vehicle.antenna.height(vehicle.now_ns).height.height_m == pytest.approx(1.588, abs=1e-3)
    vehicle.antenna.hear_pose(pose(vehicle.now_ns, road(0.10), sigma_m=5.0))
    vehicle.antenna.hear_motion(Motion(time_ns=vehicle.now_ns))
    assert vehicle.antenna.height(vehicle.now_ns).height.height_m == 1.58


def test_a_tyre_that_loses_air_is_told_with_both_numbers() -> None:
    vehicle = Vehicle(way="stroke")
    assert vehicle.drive(60.0).status == "known"
    height = vehicle.drive(30.0, distance_m=0.935 / math.sin(THETA_RAD), match=None)
    assert (height.status, height.height_m) == ("disagreement", None)
    assert "stroke 1.580 m, ranging 1.565 m" in height.reason
    assert "stroke less ranging is +0.015 m from what it was, for " in height.reason
    assert [other.way for other in height.others] == ["stroke", "fixed", "ranging"]
    assert vehicle.drive(30.0).status == "known"


# Flat or not


class Along:
    """Poses 1 m apart along a road."""

    def __init__(self, **rules: Any) -> None:
        self.flatness = Flatness(FlatRules(**rules), reach_m=2.0)
        self.now_ns = START_NS

    def hear(self, *slopes: float | None) -> bool | None:
        for slope in slopes:
            self.now_ns += STEP_NS
            self.flatness.hear(self.now_ns, None if slope is None else Slopes(slope, 0.0), 10.0)
        return self.flatness.flat


def test_nothing_is_flat_before_the_road_is_known_and_an_unknown_one_leaves_the_last_word() -> None:
    along = Along()
    assert along.hear(None, None) is None
    assert along.hear(0.0) is True
    assert along.hear(*[None] * 50) is True


def test_between_the_two_thresholds_the_last_word_stands() -> None:
    along = Along(dwell_s=0.0)
    assert along.hear(*[0.045] * 20) is True
    assert along.hear(*[0.055] * 20) is False
    assert along.hear(*[0.045] * 20) is False
    assert along.hear(*[0.035] * 20) is True


def test_a_road_does_not_change_its_mind_before_it_has_dwelt() -> None:
    along = Along(dwell_s=2.0)
    along.hear(*[0.0] * 30)
    assert along.hear(*[0.08] * 1) is False
    assert along.hear(*[0.0] * 18) is False
    assert along.hear(*[0.0] * 5) is True


def test_a_bend_of_the_road_below_the_beam_is_not_flat() -> None:
    along = Along(dwell_s=0.0)
    assert along.hear(*[0.0] * 20) is True
    assert along.hear(0.01, 0.02, 0.02) is False
    assert "uneven by 0.040 m" in along.flatness.reason
    assert along.hear(*[0.02] * 10) is True
