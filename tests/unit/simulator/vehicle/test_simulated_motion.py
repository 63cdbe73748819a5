from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from camber.geodesy.gravity import STANDARD_GRAVITY_M_S2
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.simulator.injected_faults import ChangedLoad, ChangedTyre, WheelSlip
from camber.simulator.scene import Floats, Path, Trajectory
from camber.simulator.vehicle.body import CAR, ROBOT, VehicleBody
from camber.simulator.vehicle.motion import drive
from camber.simulator.vehicle.speed_profile import DRIVER
from support.simulated_paths import flat, hilly, path_over, sloping, winding

START_NS = 1_400_000_000 * 1_000_000_000
BODIES = pytest.mark.parametrize("body", [CAR, ROBOT], ids=lambda body: body.name)


def over_hills(**more: object) -> Path:
    return path_over(hilly, winding(), stops={500: 3.0, 501: 3.0, 1200: 1.5}, **more)  # type: ignore[arg-type]


def integral(rate: Floats, step_s: float = 0.01) -> Floats:
    """By the trapezium rule."""
    return np.vstack((np.zeros(3), np.cumsum(0.5 * (rate[1:] + rate[:-1]), axis=0))) * step_s


def stroke_height(body: VehicleBody, trajectory: Trajectory) -> Floats:
    assert body.suspension_to_antenna_m is not None
    return body.suspension_to_antenna_m + trajectory.stroke_m + body.tyre_radius_m


@BODIES
def test_integrating_true_speeds_gives_true_positions(body: VehicleBody) -> None:
    t = drive(over_hills(), body, start_ns=START_NS)
    assert np.abs(t.origin_m[0] + integral(t.velocity_m_s) - t.origin_m).max() < 1e-4
    assert np.abs(t.antenna_m[0] + integral(t.antenna_velocity_m_s) - t.antenna_m).max() < 2e-4
    turned = np.append(0.0, np.cumsum(0.5 * (t.yaw_rate_rad_s[1:] + t.yaw_rate_rad_s[:-1]))) * 0.01
    assert np.abs(t.yaw_rad[0] + turned - t.yaw_rad).max() < 1e-4
    np.testing.assert_allclose(np.linalg.norm(t.velocity_m_s, axis=1), t.speed_m_s, atol=1e-9)


@BODIES
def test_the_antenna_is_the_road_under_it_and_its_height(body: VehicleBody) -> None:
    t = drive(over_hills(), body, start_ns=START_NS)
    road = hilly(t.antenna_m[:, 0], t.antenna_m[:, 1])
    np.testing.assert_allclose(t.road_height_m, road, atol=1e-9)
    assert np.abs(t.road_height_m + t.antenna_height_m - t.antenna_m[:, 2]).max() < 1e-3
    assert np.ptp(t.antenna_height_m) > 1e-4  # it is not a constant


def test_where_no_surface_is_known_the_path_s_plane_is_the_road() -> None:
    # On a plane the two are the same, and both wheels and antenna stand on it.
    known, unknown = (
        drive(path_over(sloping(0.06, -0.03), winding(800), surface=s), CAR, start_ns=START_NS)
        for s in (True, False)
    )
    for name in ("antenna_m", "road_height_m", "pitch_rad", "roll_rad"):
        np.testing.assert_allclose(getattr(known, name), getattr(unknown, name), atol=1e-6)


@BODIES
def test_the_rear_axle_follows_the_path_and_never_slips_sideways(body: VehicleBody) -> None:
    path = over_hills()
    t = drive(path, body, start_ns=START_NS)
    assert np.abs(t.origin_m[:, 2] - hilly(t.origin_m[:, 0], t.origin_m[:, 1])).max() < 1e-4
    assert np.hypot(t.origin_m[-1, 0] - path.east_m[-1], t.origin_m[-1, 1] - path.north_m[-1]) < 1e-6
    for k in (0, 300, 700, 1599):  # it comes by every sample
        away = np.hypot(t.origin_m[:, 0] - path.east_m[k], t.origin_m[:, 1] - path.north_m[k])
        near = int(away.argmin())
        assert away[near] <= 0.5 * t.speed_m_s[near] * 0.01 + 1e-4
        assert abs(t.yaw_rad[near] - path.yaw_rad[k]) < 0.01
    side = -np.sin(t.yaw_rad) * t.velocity_m_s[:, 0] + np.cos(t.yaw_rad) * t.velocity_m_s[:, 1]
    assert np.abs(side).max() < 1e-9


def test_a_circle_is_steered_by_the_bicycle_model() -> None:
    radius_m = 15.0
    t = drive(path_over(flat, np.full(400, 1.0 / radius_m)), CAR, start_ns=START_NS)
    np.testing.assert_allclose(t.steering_rad, np.arctan(CAR.wheelbase_m / radius_m), rtol=3e-4)
    np.testing.assert_allclose(t.yaw_rate_rad_s, t.speed_m_s / radius_m, rtol=3e-4)


@BODIES
def test_the_driver_s_bounds_hold(body: VehicleBody) -> None:
    driver = DRIVER
    t = drive(over_hills(), body, start_ns=START_NS)
    acceleration = np.diff(t.speed_m_s) / 0.01
    assert acceleration.max() < driver.acceleration_m_s2 + 1e-3
    assert acceleration.min() > -driver.deceleration_m_s2 - 1e-3
    assert np.abs(np.diff(acceleration)).max() / 0.01 < driver.jerk_m_s3 * 1.01
    assert np.abs(t.speed_m_s * t.yaw_rate_rad_s).max() < driver.lateral_acceleration_m_s2 * 1.0001
    assert np.abs(t.speed_m_s * t.yaw_rate_rad_s).max() > 0.9 * driver.lateral_acceleration_m_s2
    assert t.speed_m_s.max() < 10.0


def test_the_vehicle_stands_where_and_as_long_as_the_path_asks_for() -> None:
    path = over_hills()
    t = drive(path, CAR, start_ns=START_NS)
    for k, seconds in ((500, 3.0), (1200, 1.5)):
        away = np.hypot(t.origin_m[:, 0] - path.east_m[k], t.origin_m[:, 1] - path.north_m[k])
        standing = (t.speed_m_s == 0.0) & (away < 1e-6)
        assert standing.sum() * 0.01 == pytest.approx(seconds, abs=0.025)
    assert (t.speed_m_s == 0.0).sum() * 0.01 == pytest.approx(3.0 + 1.5 + 2 * 1.0, abs=0.07)


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.1, 0.0), (0.0, 0.04), (-0.08, 0.05)])
@BODIES
def test_at_rest_the_body_is_posed_as_in_closed_form(body: VehicleBody, slopes: tuple[float, float]) -> None:
    # The path leads east, so the slopes are grade and crossfall.
    t = drive(path_over(sloping(*slopes), np.zeros(400)), body, start_ns=START_NS)
    normal = np.array([-slopes[0], -slopes[1], 1.0]) / np.hypot(1.0, np.hypot(*slopes))
    ahead = np.array([1.0, 0.0, slopes[0]]) / np.hypot(1.0, slopes[0])
    on_road = np.column_stack((ahead, np.cross(normal, ahead), normal))
    pitch, roll = -np.arctan(slopes[0]), np.arcsin(on_road[2, 1] / np.cos(np.arctan(slopes[0])))
    if body.suspension is not None:
        leaning = body.suspension.lean_rad_s2_m * STANDARD_GRAVITY_M_S2 * np.sin(roll)
        pitch, roll = (
            pitch + body.suspension.dive_rad_s2_m * STANDARD_GRAVITY_M_S2 * np.sin(pitch),
            roll + leaning,
        )
    assert t.pitch_rad[0] == pytest.approx(pitch, abs=1e-9)
    assert t.roll_rad[0] == pytest.approx(roll, abs=1e-9)
    centre = np.array([0.5 * body.wheelbase_m, 0.0, body.tyre_radius_m])
    leaned = rotation_from_roll_pitch_yaw(roll, pitch, 0.0) @ (np.array(body.antenna) - centre)
    np.testing.assert_allclose(t.antenna_m[0] - t.origin_m[0], on_road @ centre + leaned, atol=1e-9)


def test_on_flat_road_at_rest_the_stroke_gives_the_antenna_s_height() -> None:
    t = drive(path_over(flat, np.zeros(400)), CAR, start_ns=START_NS)
    assert abs(stroke_height(CAR, t)[0] - t.antenna_height_m[0]) < 1e-9
    assert t.antenna_height_m[0] == pytest.approx(CAR.antenna[2], abs=1e-9)
    # and 10 s after braking it has come to rest again
    later = drive(path_over(flat, np.zeros(400)), CAR, start_ns=START_NS, duration_s=60.0)
    assert abs(stroke_height(CAR, later)[-1] - later.antenna_height_m[-1]) < 1e-6


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.1, 0.02), (-0.05, 0.06)])
def test_driving_on_a_plane_the_stroke_s_height_is_off_as_documented_at_most(
    slopes: tuple[float, float],
) -> None:
    path = path_over(sloping(*slopes), winding(), stops={700: 2.0})
    t = drive(path, CAR, start_ns=START_NS)
    road = drive(path, dataclasses.replace(CAR, suspension=None), start_ns=START_NS)
    pitch, roll = np.abs(t.pitch_rad - road.pitch_rad), np.abs(t.roll_rad - road.roll_rad)
    x, y = CAR.stroke_point
    slope = np.arctan(np.hypot(*slopes))
    lever = np.linalg.norm(np.array(CAR.antenna) - (0.5 * CAR.wheelbase_m, 0.0, CAR.tyre_radius_m))
    both = pitch + roll
    bound = pitch * abs(CAR.antenna[0] - x) + roll * abs(CAR.antenna[1] - y)
    bound += (CAR.antenna[2] + lever) * (1.0 / np.cos(slope) - 1.0 + both**2 + np.sin(slope) * both)
    error = np.abs(stroke_height(CAR, t) - t.antenna_height_m)
    assert (error <= bound + 1e-6).all()
    assert error.max() > 1e-3  # the driving shows


def test_braking_dives_and_a_curve_to_the_left_lifts_the_left_side() -> None:
    curvature = np.where(np.arange(800) < 500, 0.0, 1.0 / 20.0)
    t = drive(path_over(flat, curvature, speed_m_s=9.0), CAR, start_ns=START_NS)
    acceleration = np.gradient(t.speed_m_s, 0.01)
    assert t.pitch_rad[acceleration < -1.5].mean() > 0.002
    assert t.pitch_rad[acceleration > 1.2].mean() < -0.002
    steady = (t.speed_m_s * t.yaw_rate_rad_s > 1.5) & (np.abs(acceleration) < 0.01)
    assert steady.any()
    expected = CAR.suspension.lean_rad_s2_m * (t.speed_m_s * t.yaw_rate_rad_s)[steady][-50:]  # type: ignore[union-attr]
    np.testing.assert_allclose(t.roll_rad[steady][-50:], expected, rtol=0.05)


def test_the_wheels_turn_slower_on_greater_tyres_and_faster_when_they_slip() -> None:
    path = path_over(flat, np.zeros(1200))
    plain = drive(path, CAR, start_ns=START_NS)
    np.testing.assert_allclose(plain.wheel_speed_m_s, plain.speed_m_s, rtol=1e-12)
    faults = [
        ChangedTyre(kind="changed_tyre", radius_change_m=0.02, onset_s=10.0, end_s=15.0),
        WheelSlip(kind="wheel_slip", factor=1.3, onset_s=20.0, end_s=22.0),
        ChangedLoad(kind="changed_load", load_kg=300.0, onset_s=24.0),
    ]
    t = drive(path, CAR, start_ns=START_NS, faults=faults)
    moving = t.speed_m_s > 1.0
    ratio = t.wheel_speed_m_s[moving] / t.speed_m_s[moving]
    time_s = np.flatnonzero(moving) * 0.01
    nominal = CAR.tyre_radius_m
    np.testing.assert_allclose(ratio[(time_s > 10.6) & (time_s < 14.4)], nominal / (nominal + 0.02))
    np.testing.assert_allclose(ratio[(time_s > 20.6) & (time_s < 21.4)], 1.3)
    np.testing.assert_allclose(ratio[(time_s > 16.0) & (time_s < 20.0)], 1.0)
    # The stored tyre radius is wrong by what has changed: JP7707657B2 eq. (1) misses it.
    missed = t.antenna_height_m - stroke_height(CAR, t)
    assert missed[1440] == pytest.approx(missed[900] + 0.02, abs=2e-3)
    # A load lowers the antenna, and the stroke shows it.
    sunk = t.antenna_height_m[-1] - plain.antenna_height_m[-1]
    seen = t.stroke_m[-1] - plain.stroke_m[-1]
    assert sunk < -0.01
    assert seen == pytest.approx(sunk, abs=0.01)
    # With everything over, the integral of the velocity is still the position.
    assert np.abs(t.antenna_m[0] + integral(t.antenna_velocity_m_s) - t.antenna_m).max() < 2e-4


def test_what_cannot_be_driven_is_refused() -> None:
    path = path_over(flat, np.zeros(50))
    with pytest.raises(ValueError, match="no speed"):
        drive(dataclasses.replace(path, speed_limit_m_s=np.zeros(50)), CAR, start_ns=START_NS)
    with pytest.raises(ValueError, match="four points"):
        drive(path_over(flat, np.zeros(3)), CAR, start_ns=START_NS)
    short = ChangedLoad(kind="changed_load", load_kg=10.0, onset_s=5.0, end_s=5.5)
    with pytest.raises(ValueError, match="end_s"):
        drive(path, CAR, start_ns=START_NS, faults=[short])
