"""A perfect unit leads back to where the vehicle was; a real one has errors of the sizes of its data sheet."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest

from camber.geodesy.ellipsoid import ecef_from_geodetic
from camber.geodesy.gravity import normal_gravity_m_s2
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.schemas.motion import MountedImu
from camber.simulator.scene import Floats, Integers, Trajectory
from camber.simulator.vehicle.attitude import rotations
from camber.simulator.vehicle.body import CAR, ROBOT
from camber.simulator.vehicle.imu import (
    UNITS,
    ImuReadings,
    InertialErrors,
    InertialUnit,
    imu_messages,
    read_imu,
    vibration,
    with_errors,
)
from camber.simulator.vehicle.inertial_motion import inertial_motion
from camber.simulator.vehicle.motion import drive
from camber.simulator.vehicle.pose_track import PoseTrack
from support.simulated_paths import flat, hilly, path_over, winding
from support.strapdown import EARTH_RATE_RAD_S, integrate

START_NS = 1_400_000_000 * 1_000_000_000
FRAME = LocalFrame(math.radians(35.17), math.radians(136.88), 0.0)
MOUNTED = MountedImu(
    **{
        "class": "mems",
        "x_m": 2.0,
        "y_m": 0.6,
        "z_m": 0.8,
        "roll_deg": 10.0,
        "pitch_deg": -5.0,
        "yaw_deg": 30.0,
    }
)
LEVEL = MountedImu(**{"class": "mems", "x_m": 0.2, "z_m": 0.4})
PERFECT = InertialUnit(
    gyro=InertialErrors(),
    accelerometer=InertialErrors(),
    bracket_sigma_rad=0.0,
    clock_offset_sigma_s=0.0,
    clock_drift_sigma=0.0,
    vibration_share=0.0,
)


def winding_drive(body=CAR) -> Trajectory:
    """Sixty seconds over hills, round narrow curves, with a stop."""
    return drive(path_over(hilly, winding(), stops={300: 4.0}), body, start_ns=START_NS, duration_s=61.0)


def standing_drive(duration_s: float = 30.0) -> Trajectory:
    """Half a minute of which the end is at rest on level ground."""
    return drive(path_over(flat, np.zeros(40)), CAR, start_ns=START_NS, duration_s=duration_s)


def read(trajectory: Trajectory, mounted: MountedImu, unit: InertialUnit, *, body=CAR, seed=1) -> ImuReadings:
    return read_imu(trajectory, body, FRAME, mounted, unit=unit, rate_hz=200.0, seed=seed)


def earth_fixed(track: PoseTrack, time_ns: Integers) -> tuple[Floats, Floats]:
    """Places (n, 3) and rotations (n, 3, 3) to the earth-fixed frame."""
    position, rotation = track.at(time_ns)
    latitude, longitude, height = FRAME.geodetic_from_east_north_array(position[:, :2], position[:, 2])
    local = LocalFrame(float(latitude[0]), float(longitude[0]), 0.0).enu_from_ecef_rotation()
    return ecef_from_geodetic(latitude, longitude, height), local.T @ rotation


@pytest.mark.parametrize("body", [CAR, ROBOT], ids=["car", "robot"])
def test_integrated_in_the_earth_fixed_frame_a_perfect_unit_follows_the_vehicle(body) -> None:
    trajectory = winding_drive(body)
    readings = read(trajectory, MOUNTED, PERFECT, body=body)
    track = PoseTrack.of(trajectory, body, (MOUNTED.x_m, MOUNTED.y_m, MOUNTED.z_m))
    expected, rotation = earth_fixed(track, readings.true_time_ns)
    assert np.linalg.norm(np.ptp(expected, axis=0)) > 100.0
    turn = rotation_from_roll_pitch_yaw(*np.radians((10.0, -5.0, 30.0)).tolist())
    places = integrate(
        (readings.true_time_ns - START_NS) / 1e9,
        readings.angular_rate_rad_s,
        readings.specific_force_m_s2,
        place_m=expected[0],
        earth_from_unit=rotation[0] @ turn,
    )
    off_m = np.linalg.norm(places - expected, axis=1)
    assert len(off_m) > 12_000
    assert off_m.max() < 0.01


def test_at_rest_it_measures_gravity_and_the_rotation_of_the_earth() -> None:
    trajectory = standing_drive()
    readings = read(trajectory, MOUNTED, PERFECT)
    force, rate = readings.specific_force_m_s2[-1000:], readings.angular_rate_rad_s[-1000:]
    gravity = normal_gravity_m_s2(FRAME.latitude_rad, 40.0)
    assert np.linalg.norm(force, axis=1) == pytest.approx(gravity, abs=1e-4)
    assert np.linalg.norm(rate, axis=1) == pytest.approx(EARTH_RATE_RAD_S[2], rel=1e-4)
    turn = rotation_from_roll_pitch_yaw(*np.radians((10.0, -5.0, 30.0)).tolist())
    assert turn @ force[0] == pytest.approx([0.0, 0.0, gravity], abs=1e-3)
    # Up, and north, as much as the latitude says.
    assert (turn @ rate[0])[2] == pytest.approx(EARTH_RATE_RAD_S[2] * math.sin(FRAME.latitude_rad), rel=1e-3)


def test_apart_from_the_middle_of_a_curve_it_feels_the_lever_arm() -> None:
    """On a flat circle: ω² r inwards of its own radius, and on the body's tilt the weight."""
    radius_m, speed_m_s = 40.0, 8.0
    path = path_over(flat, np.full(1200, 1.0 / radius_m), speed_m_s=speed_m_s)
    trajectory = drive(path, ROBOT, start_ns=START_NS)
    middle = trajectory.time_ns[len(trajectory.time_ns) // 2 :][:1]
    for x_m, y_m in ((0.0, 0.0), (0.0, 2.0), (0.0, -2.0), (3.0, 0.0)):
        track = PoseTrack.of(trajectory, ROBOT, (x_m, y_m, 0.4))
        force = inertial_motion(track, FRAME, np.eye(3), middle).specific_force_m_s2[0]
        turn_rate = speed_m_s / radius_m
        expected = turn_rate**2 * np.array([-x_m, radius_m - y_m])
        # Coriolis by the earth: 2 ω v < 0.0012 m/s².
        assert force[:2] == pytest.approx(expected, abs=2e-3)


def test_it_samples_at_its_rate_by_its_clock_and_messages_hold_the_samples() -> None:
    trajectory = standing_drive()
    readings = read(trajectory, LEVEL, UNITS["mems"], seed=3)
    assert len(readings.time_ns) == pytest.approx(30 * 200 + 1, abs=2)
    off_ns = readings.time_ns - readings.true_time_ns
    assert 0 < abs(int(off_ns[0])) < 20_000_000
    assert int(np.ptp(off_ns)) > 1_000
    messages = imu_messages(readings)
    assert [m.time_ns for m in messages] == readings.time_ns.tolist()
    assert messages[7].angular_rate_rad_s == tuple(readings.angular_rate_rad_s[7].tolist())
    assert messages[7].specific_force_m_s2 == tuple(readings.specific_force_m_s2[7].tolist())
    assert messages[7].temperature_c is None


def allan_deviation(value: Floats, rate_hz: float, tau_s: float) -> float:
    """Of three axes (n, 3), by means of neighbouring clusters (IEEE Std 952, annex C)."""
    size = round(tau_s * rate_hz)
    count = len(value) // size
    means = value[: count * size].reshape(count, size, 3).mean(axis=1)
    return float(np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2)))


@pytest.mark.parametrize("tau_s", [0.1, 1.0, 10.0])
def test_noise_is_the_random_walk_of_the_data_sheet(tau_s: float) -> None:
    """IEEE Std 952: the Allan deviation of white noise of the rate is N / √τ."""
    errors = InertialErrors(noise_density=2e-3)
    value = with_errors(np.zeros((200 * 2000, 3)), errors, 200.0, name="gyro", seed=1)
    assert allan_deviation(value, 200.0, tau_s) == pytest.approx(2e-3 / math.sqrt(tau_s), rel=0.08)


def test_instability_is_the_level_of_the_allan_deviation_and_then_it_rises() -> None:
    errors = InertialErrors(instability=5e-5)
    value = with_errors(np.zeros((60_000, 3)), errors, 1.0, name="gyro", seed=2)
    level = allan_deviation(value, 1.0, 189.0) / errors.instability
    # The Gauss–Markov process at its peak, and of the walk √(189 / 1000).
    assert level == pytest.approx(math.hypot(1.0, math.sqrt(0.189)), rel=0.12)
    walk = InertialErrors(instability=5e-5).walk_density
    assert walk * math.sqrt(1000.0 / 3.0) == pytest.approx(errors.instability)


def test_constant_errors_have_their_sizes_over_seeds() -> None:
    true = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    errors = InertialErrors(bias_sigma=0.01, scale_sigma=0.02, misalignment_sigma_rad=0.03)
    of_seeds = np.array([with_errors(true, errors, 200.0, name="gyro", seed=seed) for seed in range(400)])
    np.testing.assert_allclose(of_seeds[:, 0].std(axis=0), 0.01, rtol=0.12)
    grown = of_seeds[:, 1] - of_seeds[:, 0] - [1.0, 0.0, 0.0]
    np.testing.assert_allclose(grown.std(axis=0), [0.02, 0.03, 0.03], rtol=0.12)


def test_values_are_steps_within_the_range() -> None:
    true = np.linspace(-3.0, 3.0, 3000).reshape(1000, 3)
    value = with_errors(true, InertialErrors(step=0.25, limit=2.0), 200.0, name="gyro", seed=1)
    assert set(np.unique(value).tolist()) == {k * 0.25 for k in range(-8, 9)}


def test_without_errors_it_gives_the_truth() -> None:
    true = np.linspace(-3.0, 3.0, 30).reshape(10, 3)
    np.testing.assert_array_equal(with_errors(true, InertialErrors(), 200.0, name="gyro", seed=1), true)


@pytest.mark.parametrize("name", [f.name for f in fields(InertialErrors) if f.name not in ("step", "limit")])
def test_to_change_one_error_leaves_the_others(name: str) -> None:
    """What the changed error adds does not depend on the sizes of the others."""
    true = np.tile([0.1, -0.2, 0.3], (50, 1))
    sizes = {f.name: 1e-3 for f in fields(InertialErrors) if f.name not in ("step", "limit")}
    all_errors = InertialErrors(**sizes)
    without, alone = replace(all_errors, **{name: 0.0}), InertialErrors(**{name: 1e-3})
    values = [with_errors(true, e, 200.0, name="gyro", seed=4) for e in (all_errors, without, alone)]
    np.testing.assert_allclose(values[0] - values[1], values[2] - true, atol=1e-12)
    assert np.abs(values[2] - true).max() > 0.0


def test_vibration_grows_with_the_speed_and_leads_nowhere() -> None:
    rate_hz = 200.0
    sizes = []
    for speed in (0.0, 5.0, 14.0):
        shaken = vibration(np.full(60 * 200, speed), rate_hz, 1)
        sizes.append((shaken.specific_force_m_s2.std(axis=0), shaken.angular_rate_rad_s.std(axis=0)))
        velocity = np.cumsum(shaken.specific_force_m_s2, axis=0) / rate_hz
        assert np.abs(velocity).max() < 0.1
        assert np.abs(np.cumsum(shaken.angular_rate_rad_s, axis=0) / rate_hz).max() < math.radians(0.1)
    for one, other in pairwise(sizes):
        assert (other[0] > one[0]).all()
        assert (other[1] > one[1]).all()
    # At 50 km/h a car's floor has some tenths of a m/s².
    assert 0.3 < sizes[-1][0][2] < 0.6


@pytest.mark.parametrize("rate_hz", [50.0, 400.0])
def test_vibration_is_where_the_unit_can_measure_it(rate_hz: float) -> None:
    shaken = vibration(np.full(round(60 * rate_hz), 14.0), rate_hz, 1).specific_force_m_s2[:, 2]
    power = np.abs(np.fft.rfft(shaken)) ** 2
    at_hz = np.fft.rfftfreq(len(shaken), 1.0 / rate_hz)
    assert power[at_hz > 0.41 * rate_hz].sum() < 1e-3 * power.sum()
    assert power[at_hz < 4.0].sum() < 1e-3 * power.sum()


@pytest.mark.parametrize("imu_class", sorted(UNITS))
def test_units_of_all_classes_measure_within_their_range(imu_class) -> None:
    unit = UNITS[imu_class]
    readings = read(winding_drive(), MOUNTED, unit, seed=5)
    for value, errors in (
        (readings.angular_rate_rad_s, unit.gyro),
        (readings.specific_force_m_s2, unit.accelerometer),
    ):
        assert np.abs(value).max() < errors.limit
        np.testing.assert_allclose(value / errors.step, np.round(value / errors.step), atol=1e-3)


def test_classes_are_in_the_order_of_their_accuracy() -> None:
    classes = [UNITS[name] for name in ("phone", "mems", "tactical")]
    for worse, better in pairwise(classes):
        assert better.gyro.instability < worse.gyro.instability
        assert better.gyro.bias_sigma < worse.gyro.bias_sigma
        assert better.gyro.scale_sigma < worse.gyro.scale_sigma
    bias = [unit.accelerometer.bias_sigma for unit in classes]
    assert bias == sorted(bias, reverse=True)


def test_the_bracket_turns_the_unit_by_its_size_over_seeds() -> None:
    trajectory = standing_drive(15.0)
    unit = replace(PERFECT, bracket_sigma_rad=0.01)
    tilts = []
    for seed in range(120):
        force = read(trajectory, LEVEL, unit, seed=seed).specific_force_m_s2[-1]
        tilts.append(force[:2] / force[2])
    assert np.std(tilts) == pytest.approx(0.01, rel=0.15)


def test_world_from_sensor_is_that_of_the_body_and_the_mounting() -> None:
    """A unit on its side feels gravity along its y."""
    side = LEVEL.model_copy(update={"roll_deg": 90.0})
    force = read(standing_drive(15.0), side, PERFECT).specific_force_m_s2[-1]
    turn = rotations(np.array([math.pi / 2.0]), np.zeros(1), np.zeros(1))[0]
    assert turn @ force == pytest.approx([0.0, 0.0, normal_gravity_m_s2(FRAME.latitude_rad, 40.0)], abs=1e-3)
    assert force[1] == pytest.approx(9.8, abs=0.02)
