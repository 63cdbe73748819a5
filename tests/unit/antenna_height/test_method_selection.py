"""Which method is published, what replaces it, and the reason for every input that cannot be used."""

from __future__ import annotations

import math
from typing import Any

import pytest

from camber.antenna_height.body_attitude import Slopes
from camber.antenna_height.estimator import AntennaHeightEstimator
from camber.antenna_height.method_selection import Flatness, FlatRules
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
DISTANCE_M = 0.95 / math.sin(THETA_RAD)
ALL = {"fixed", "stroke", "ranging", "scan_matching"}


def road(forward: float) -> Road:
    return Road(status="known", slope_east=forward, slope_north=0.0)


class Vehicle:
    """Drives to the east at 10 m/s, a step of 0.1 s at a time, on a road of some slope; sensors may be left out."""

    def __init__(self, **settings: Any) -> None:
        self.estimator = AntennaHeightEstimator(AntennaHeightSettings(**(CAR | settings)).options())
        self.handlers = self.estimator.handlers()
        self.now_ns = START_NS

    def drive(self, seconds: float, slope: float = 0.0, **left_out: Any) -> AntennaHeight:
        """Return the last height. `stroke_m`, `distance_m`, `theta_rad`, `match`, `road`, `pitch_rad`: other values;
        None: no message."""
        for _ in range(round(seconds * 10)):
            self.now_ns += STEP_NS
            self.receive(slope, **left_out)
            height = self.height()
        return height

    def receive(self, slope: float, **other: Any) -> None:
        t, upright = self.now_ns, math.sqrt(1.0 + slope**2)
        pitch_rad = other.get("pitch_rad", -math.atan(slope))
        self.handlers["motion"](Motion(time_ns=t, wheel_speed_m_s=10.0, pitch_rad=pitch_rad, roll_rad=0.0))
        self.handlers["pose"](pose(t, other.get("road", road(slope))))
        stroke_m, distance_m = other.get("stroke_m", 0.42), other.get("distance_m", DISTANCE_M)
        if stroke_m is not None:
            self.measure_stroke(stroke_m)
        if distance_m is not None:
            self.measure_distance(distance_m, other.get("theta_rad", THETA_RAD))
        match = other.get("match", {"sensor_height_m": 1.95 * upright, "sensor_height_sigma_m": 0.01})
        if match is not None:
            match = {"roll_pitch_yaw_rad": (0.0, -math.atan(slope), 0.0), "status": "converged"} | match
            match = {"road_slope_forward": slope, "road_slope_left": 0.0} | match
            self.handlers["scan_match"](ScanMatch(time_ns=t, **match))

    def measure_stroke(self, stroke_m: float, *, later_ns: int = 0) -> None:
        time_ns = self.now_ns + later_ns
        message = Suspension(time_ns=time_ns, stroke_height_m=stroke_m, stroke_sigma_m=0.003)
        self.handlers["suspension"](message)

    def measure_distance(self, distance_m: float, theta_rad: float = THETA_RAD) -> None:
        distance = {"distance_m": distance_m, "distance_sigma_m": 0.004}
        self.handlers["ranging"](Ranging(time_ns=self.now_ns, beam_angle_rad=theta_rad, **distance))

    def height(self) -> AntennaHeight:
        height, self.problems = self.estimator.height(self.now_ns)
        encode(height)
        return height


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
@pytest.mark.parametrize("method", ["fixed", "stroke", "ranging", "scan_matching"])
def test_every_method_gives_the_height_on_any_grade_and_the_others(method: str, slope: float) -> None:
    height = Vehicle(way=method).drive(5.0, slope)
    assert (height.status, height.way, height.reason) == ("known", method, "")
    assert height.height_m == pytest.approx(1.58 * math.sqrt(1.0 + slope**2), abs=2e-3)
    assert height.sigma_m < 0.025
    assert {other.way for other in height.others} == ALL - {method}


def test_the_lidars_ground_returns_replace_an_absent_ranging_sensor() -> None:
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


def test_automatic_gives_the_reason_for_another_method() -> None:
    vehicle = Vehicle(way="automatic")
    height = vehicle.drive(1.0, road=Road(status="unknown", reason="no_surface"))
    assert (height.way, height.reason) == ("ranging", "road not known")
    height = vehicle.drive(5.0, distance_m=None)
    assert (height.status, height.way) == ("known", "scan_matching")
    flat = "road flat: slope 0.000, uneven by 0.000 m"
    assert height.reason == f"{flat}; no fresh distance to the road: scan_matching instead"
    height = vehicle.drive(5.0, slope=0.08, match={"status": "lost"})
    assert height.way == "ranging"
    assert "road not flat: slope 0.080" in height.reason
    assert "scan match lost: ranging instead" in height.reason
    nothing = Vehicle(way="automatic", fixed_height_m=None, tyre_radius_m=None)
    height = nothing.drive(1.0, distance_m=None, match=None)
    assert (height.status, height.way) == ("unknown", None)
    assert height.reason.endswith("no fresh distance to the road")


@pytest.mark.parametrize(
    ("method", "other", "reason"),
    [
        ("stroke", {"stroke_m": None}, "no fresh stroke height"),
        ("stroke", {"stroke_m": 2.4}, "stroke is implausible: the antenna 3.560 m above the road, expected 1.580 m"),
        ("ranging", {"distance_m": None}, "no fresh distance to the road"),
        ("ranging", {"distance_m": 0.0}, "expected 1.580 m at rest, give or take 0.5 m"),
        ("ranging", {"distance_m": 40.0}, "ranging is implausible: the antenna 38.2"),
        ("ranging", {"theta_rad": 0.05}, "a beam 2.9° below the vehicle's horizontal, expected one that meets"),
        ("ranging", {"theta_rad": -1.2}, "a beam -68.8° below the vehicle's horizontal"),
        ("scan_matching", {"match": None}, "no fresh scan match"),
        ("scan_matching", {"match": {"status": "ambiguous"}}, "scan match ambiguous"),
        ("scan_matching", {"match": {}}, "the scan match gives no height of the sensor"),
        (
            "scan_matching", {"match": {"sensor_height_m": 9.0, "sensor_height_sigma_m": 0.01}},
            "scan_matching is implausible: the antenna 8.630 m above the road",
        ),
    ],
)  # fmt: skip
def test_a_configured_method_has_no_substitute_and_the_reason_is_given(
    method: str, other: dict[str, Any], reason: str
) -> None:
    vehicle = Vehicle(way=method)
    height = vehicle.drive(1.0, **other)
    assert (height.status, height.height_m) == ("unknown", None)
    assert reason in height.reason
    assert len(height.others) == 3
    assert bool(vehicle.problems) == ("implausible" in height.reason)


@pytest.mark.parametrize(
    ("method", "missing", "reason"),
    [
        ("fixed", {"fixed_height_m": None}, "fixed_height_m is not set"),
        ("automatic", {"lidar": None}, ""),
        ("stroke", {"antenna": None, "ranging": None}, ""),
        ("stroke", {"suspension": None}, ""),
    ],
)
def test_dimensions_that_are_not_measured_are_a_reason_or_a_larger_sigma(
    method: str, missing: dict[str, Any], reason: str
) -> None:
    height = Vehicle(way=method, **missing).drive(1.0)
    assert height.reason == reason
    assert method != "stroke" or height.sigma_m > Vehicle(way=method).drive(1.0).sigma_m


def test_a_stale_measurement_gives_no_height_and_a_stale_attitude_a_larger_sigma() -> None:
    vehicle = Vehicle(way="ranging")
    fresh = vehicle.drive(1.0)
    vehicle.now_ns += 2 * NS
    assert vehicle.height().status == "unknown"
    vehicle.measure_distance(DISTANCE_M)
    alone = vehicle.height()
    assert alone.status == "known"
    assert alone.sigma_m > fresh.sigma_m


def test_a_message_of_the_far_future_is_replaced_by_present_ones_and_these_by_no_older_one() -> None:
    vehicle = Vehicle(way="stroke")
    vehicle.measure_stroke(0.5, later_ns=3600 * NS)
    assert vehicle.drive(1.0).status == "known"
    vehicle.measure_stroke(0.5, later_ns=-STEP_NS)
    assert vehicle.height().height_m == pytest.approx(1.58, abs=1e-3)


def test_an_attitude_of_a_vehicle_that_lies_on_its_side_is_not_used() -> None:
    upset = Vehicle(way="ranging").drive(1.0, pitch_rad=1.4)
    assert (upset.status, upset.height_m) == ("known", pytest.approx(1.58, abs=1e-6))


def test_of_a_pose_that_is_too_uncertain_the_slope_is_not_used() -> None:
    vehicle = Vehicle(way="fixed")
    vehicle.drive(1.0, slope=0.10)
    assert vehicle.height().height_m == pytest.approx(1.588, abs=1e-3)
    vehicle.handlers["pose"](pose(vehicle.now_ns, road(0.10), sigma_m=5.0))
    vehicle.handlers["motion"](Motion(time_ns=vehicle.now_ns))
    assert vehicle.height().height_m == 1.58


def test_a_tyre_that_loses_air_is_a_disagreement_with_both_heights() -> None:
    vehicle = Vehicle(way="stroke")
    assert vehicle.drive(60.0).status == "known"
    height = vehicle.drive(30.0, distance_m=DISTANCE_M - 0.015 / math.sin(THETA_RAD), match=None)
    assert (height.status, height.height_m) == ("disagreement", None)
    assert "stroke 1.580 m, ranging 1.565 m" in height.reason
    assert "stroke less ranging is +0.015 m from what it was, for " in height.reason
    assert [other.way for other in height.others] == ["stroke", "fixed", "ranging"]
    assert vehicle.drive(30.0).status == "known"


class Along:
    """Poses 1 m apart along a road."""

    def __init__(self, **rules: Any) -> None:
        self.flatness = Flatness(rules=FlatRules(**rules), reach_m=2.0)
        self.now_ns = START_NS

    def flat_after(self, *slopes: float | None) -> bool | None:
        for slope in slopes:
            self.now_ns += STEP_NS
            self.flatness.update(self.now_ns, None if slope is None else Slopes(slope, 0.0), 10.0)
        return self.flatness.flat


def test_flatness_is_unknown_before_the_first_road_and_lasts_over_an_unknown_one() -> None:
    along = Along()
    assert along.flat_after(None, None) is None
    assert along.flat_after(0.0) is True
    assert along.flat_after(*[None] * 50) is True


def test_between_the_two_thresholds_the_last_state_stays() -> None:
    along = Along(dwell_s=0.0)
    assert along.flat_after(*[0.045] * 20) is True
    assert along.flat_after(*[0.055] * 20) is False
    assert along.flat_after(*[0.045] * 20) is False
    assert along.flat_after(*[0.035] * 20) is True


def test_the_state_does_not_change_before_it_has_dwelt() -> None:
    along = Along(dwell_s=2.0)
    along.flat_after(*[0.0] * 30)
    assert along.flat_after(*[0.08] * 1) is False
    assert along.flat_after(*[0.0] * 18) is False
    assert along.flat_after(*[0.0] * 5) is True


def test_a_bend_of_the_road_below_the_beam_is_not_flat() -> None:
    along = Along(dwell_s=0.0)
    assert along.flat_after(*[0.0] * 20) is True
    assert along.flat_after(0.01, 0.02, 0.02) is False
    assert "uneven by 0.040 m" in along.flatness.reason
    assert along.flat_after(*[0.02] * 10) is True
