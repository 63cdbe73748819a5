from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.simulator.scene import Path, Trajectory
from camber.simulator.vehicle.attitude_sensor import AttitudeSensor
from camber.simulator.vehicle.body import CAR, ROBOT
from camber.simulator.vehicle.motion import drive
from camber.simulator.vehicle.rate_sensor import AUTOMOTIVE_YAW_RATE, RateSensor, additional_errors
from camber.simulator.vehicle.sensor_clock import DriftingClock
from camber.simulator.vehicle.sensors import (
    BiasedSensor,
    RangingSensor,
    SensorSet,
    WheelSensor,
    distance_to_road_m,
    edge_times,
    motion_messages,
    ranging_messages,
    read_sensors,
    speed_of_edges,
    suspension_messages,
)
from support.simulated_paths import flat, hilly, path_over, sloping, winding

START_NS = 1_400_000_000 * 1_000_000_000
EXACT = BiasedSensor(bias_sigma=0.0, noise=0.0, step=0.0)
PERFECT = SensorSet(
    wheel=WheelSensor(scale_sigma=0.0, edge_sigma=0.0, step_m_s=0.0),
    yaw_rate=RateSensor(
        bias_sigma_rad_s=0.0, walk_rad_s_sqrt_s=0.0, noise_rad_s=0.0, scale_sigma=0.0, step_rad_s=0.0
    ),
    steering=EXACT,
    attitude=AttitudeSensor(
        bias_sigma_rad=0.0, wander_sigma_rad=0.0, noise_rad=0.0, leaking_share=0.0, step_rad=0.0
    ),
    stroke=EXACT,
    ranging=RangingSensor(bias_sigma_m=0.0, noise_m=0.0, step_m=0.0, angle_sigma_rad=0.0, lost_share=0.0),
    clock_offset_sigma_s=0.0,
    clock_drift_sigma=0.0,
)
NORMAL = SensorSet()


@pytest.fixture(scope="module")
def path() -> Path:
    return path_over(hilly, winding(800), stops={300: 4.0})


@pytest.fixture(scope="module")
def trajectory(path: Path) -> Trajectory:
    return drive(path, CAR, start_ns=START_NS)


def true(trajectory: Trajectory, name: str, time_ns: np.ndarray) -> np.ndarray:
    passed = (time_ns - START_NS) / 1e9
    return np.interp(passed, (trajectory.time_ns - START_NS) / 1e9, getattr(trajectory, name))


def test_without_errors_the_sensors_give_the_truth(path: Path, trajectory: Trajectory) -> None:
    readings = read_sensors(trajectory, CAR, path.surface_m, PERFECT, 1)
    for column in ("steering", "stroke", "pitch", "roll"):
        one, name = getattr(readings, column), column + ("_m" if column == "stroke" else "_rad")
        np.testing.assert_array_equal(one.time_ns, one.true_time_ns)
        np.testing.assert_allclose(one.value, true(trajectory, name, one.time_ns), atol=1e-12)
    wheel = readings.wheel_speed
    middle = wheel.true_time_ns - 10_000_000  # of the window
    off = wheel.value - true(trajectory, "wheel_speed_m_s", middle)
    assert np.abs(off[wheel.value > 1.0]).max() < 0.05
    assert np.abs(off[wheel.value > 1.0].mean()) < 0.01


def test_the_rate_sensor_turns_with_the_body(path: Path, trajectory: Trajectory) -> None:
    readings = read_sensors(trajectory, CAR, path.surface_m, PERFECT, 1).yaw_rate
    # Another derivation: the skew part of Rᵀ dR/dt, by differences of rotations.
    angles = [true(trajectory, name, trajectory.time_ns) for name in ("roll_rad", "pitch_rad", "yaw_rad")]
    at = np.array([rotation_from_roll_pitch_yaw(*a) for a in np.column_stack(angles)])
    turned = np.einsum("nki,nkj->nij", at[:-2], at[2:])[:, 1, 0] / 0.02
    expected = np.interp(readings.true_time_ns[1:-1] - START_NS, trajectory.time_ns[1:-1] - START_NS, turned)
    np.testing.assert_allclose(readings.value[1:-1], expected, atol=1e-4)
    plain = true(trajectory, "yaw_rate_rad_s", readings.true_time_ns)
    assert np.abs(readings.value - plain).max() > 5e-4  # the hills show


def test_the_wheel_sensor_gives_zero_below_its_least_speed(path: Path, trajectory: Trajectory) -> None:
    readings = read_sensors(trajectory, CAR, path.surface_m, NORMAL, 3).wheel_speed
    moving = readings.value > 0.0
    assert readings.value[moving].min() >= 0.35 - 1e-9
    speed = true(trajectory, "wheel_speed_m_s", readings.true_time_ns)
    assert (readings.value[speed == 0.0] == 0.0).mean() > 0.98  # but for the last edge before a stop
    assert (readings.value[speed > 0.5] > 0.0).all()
    np.testing.assert_allclose(readings.value / 0.01, np.round(readings.value / 0.01), atol=1e-6)
    # The distance it counts is the true one but for its scale and the lowest speeds.
    counted = readings.value.sum() / 50.0
    driven = trajectory.wheel_speed_m_s.sum() / 100.0
    assert counted == pytest.approx(driven, rel=0.02)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.floats(0.4, 30.0), st.floats(0.005, 0.2), st.floats(0.005, 0.1))
def test_edges_at_an_even_speed_give_that_speed(speed: float, pitch: float, window: float) -> None:
    time_s = np.linspace(0.0, 10.0, 1001)
    edges = edge_times(time_s, np.full(1001, speed), pitch * (np.arange(70_000) + 0.3))
    np.testing.assert_allclose(np.diff(edges), pitch / speed, rtol=1e-6)
    assert len(edges) == math.floor(10.0 * speed / pitch - 0.3 + 1e-9) + 1
    late = np.linspace(6.0, edges[-1], 50)
    np.testing.assert_allclose(speed_of_edges(edges, late, window, pitch), speed, rtol=1e-6)
    # When no more edges come, the speed runs out like pitch over waiting time.
    waited = edges[-1] + np.array([1.0, 2.0])
    assert (speed_of_edges(edges, waited, window, pitch) <= pitch / np.array([1.0, 2.0]) + 1e-9).all()


def test_an_edge_never_falls_into_a_standstill() -> None:
    time_s = np.arange(0.0, 30.0, 0.01)
    speed = np.where((time_s > 10.0) & (time_s < 20.0), 0.0, 2.0)
    edges = edge_times(time_s, speed, 0.0173 * np.arange(5_000))
    assert len(edges) > 2_000
    assert not ((edges > 10.01) & (edges < 19.99)).any()


def test_the_beam_meets_a_plane_road_as_in_closed_form() -> None:
    slopes = (0.09, -0.04)
    path = path_over(sloping(*slopes), winding(400))
    t = drive(path, CAR, start_ns=START_NS)
    distance = distance_to_road_m(t, CAR, path.surface_m, t.time_ns, angle_rad=CAR.ranging_angle_rad)
    normal = np.array([-slopes[0], -slopes[1], 1.0])
    for k in range(0, len(t.time_ns), 97):
        turn = rotation_from_roll_pitch_yaw(t.roll_rad[k], t.pitch_rad[k], t.yaw_rad[k])
        origin = t.antenna_m[k] + turn @ (np.array(CAR.ranging) - np.array(CAR.antenna))
        angle = CAR.ranging_angle_rad
        beam = turn @ np.array([-math.cos(angle), 0.0, -math.sin(angle)])
        expected = (np.array([0.0, 0.0, 40.0]) - origin) @ normal / (beam @ normal)
        assert distance[k] == pytest.approx(expected, abs=1e-7)


def test_where_no_road_is_known_the_ranging_sensor_gives_nothing() -> None:
    path = path_over(flat, np.zeros(100), surface=False)
    t = drive(path, CAR, start_ns=START_NS)
    readings = read_sensors(t, CAR, path.surface_m, NORMAL, 1)
    assert np.isnan(readings.ranging.value).all()
    assert ranging_messages(readings, NORMAL, CAR) == []


def test_errors_are_as_large_as_set() -> None:
    path = path_over(flat, np.zeros(200))
    t = drive(path, CAR, start_ns=START_NS, duration_s=120.0)
    sensors, last = NORMAL, []
    for seed in range(40):
        readings = read_sensors(t, CAR, path.surface_m, sensors, seed)
        assert readings.stroke is not None
        last.append([x.value[-2000:].mean() for x in (readings.yaw_rate, readings.steering)])
        if seed == 0:
            spread = [x.value[-2000:].std() for x in (readings.yaw_rate, readings.steering, readings.stroke)]
            noise = (sensors.yaw_rate.noise_rad_s, sensors.steering.noise, sensors.stroke.noise)
            np.testing.assert_allclose(spread, noise, rtol=0.1)
            distance = readings.ranging.value[-400:]
            assert 0.0 < np.isnan(distance).mean() < 0.05
            assert np.nanstd(distance) == pytest.approx(sensors.ranging.noise_m, rel=0.25)
    # Within what 40 draws of a normal distribution allow (χ², 99.9 %).
    bias = np.std(last, axis=0) / (sensors.yaw_rate.bias_sigma_rad_s, sensors.steering.bias_sigma)
    assert ((bias > 0.65) & (bias < 1.4)).all()


def test_attitude_is_off_by_a_bias_that_wanders_and_by_noise() -> None:
    path = path_over(flat, np.zeros(200))
    t = drive(path, CAR, start_ns=START_NS, duration_s=200.0)
    sensor = NORMAL.attitude
    means, steps = [], []
    for seed in range(60):
        readings = read_sensors(t, CAR, path.surface_m, NORMAL, seed)
        at_rest = np.stack((readings.pitch.value, readings.roll.value))[:, -5000:]  # flat: the truth is zero
        means.append(at_rest.mean(axis=1))
        steps.append(at_rest[:, 1:] - at_rest[:, :-1])
        assert np.corrcoef(at_rest)[0, 1] < 0.95
    # The mean of a wander of 0.1°, 20 s over 100 s keeps 2 τ / T (1 − τ / T) of its variance: 0.32.
    expected = math.hypot(sensor.bias_sigma_rad, math.sqrt(0.32) * sensor.wander_sigma_rad)
    assert np.std(means) == pytest.approx(expected, rel=0.2)  # 120 draws
    assert np.std(steps) == pytest.approx(math.sqrt(2.0) * sensor.noise_rad, rel=0.05)


def test_attitude_takes_some_of_the_acceleration_for_gravity() -> None:
    # A quarter turn to the left and a stop, on flat road, with nothing else in the angles.
    curvature = np.concatenate((np.zeros(400), np.full(628, 0.01), np.zeros(100)))
    path = path_over(flat, curvature, speed_m_s=12.0)
    t = drive(path, ROBOT, start_ns=START_NS)
    leaky = dataclasses.replace(PERFECT.attitude, leaking_share=0.03, leaking_s=2.0)
    readings = read_sensors(t, ROBOT, path.surface_m, dataclasses.replace(PERFECT, attitude=leaky), 1)
    assert readings.stroke is None  # a robot has no springs
    time_s = (readings.roll.true_time_ns - START_NS) / 1e9
    in_curve = np.flatnonzero(np.interp(time_s, (t.time_ns - START_NS) / 1e9, t.yaw_rate_rad_s) > 0.1)
    # Long after its beginning: the whole share of v² κ / g, the left side up.
    late = in_curve[3 * len(in_curve) // 4]
    assert readings.roll.value[late] == pytest.approx(0.03 * 12.0**2 * 0.01 / 9.80665, rel=0.03)
    assert readings.roll.value[in_curve[0]] < 0.3 * readings.roll.value[late]
    # Speeding up: the nose seems up, which is negative; braking: down.
    assert readings.pitch.value[time_s < 5.0].min() < -0.002
    assert readings.pitch.value[time_s > time_s[-1] - 5.0].max() > 0.002
    assert np.abs(readings.pitch.value[late]) < 1e-4


def test_each_sensor_has_another_clock(path: Path, trajectory: Trajectory) -> None:
    readings = read_sensors(trajectory, CAR, path.surface_m, NORMAL, 5)
    assert readings.stroke is not None
    sensors = (readings.wheel_speed, readings.yaw_rate, readings.steering, readings.stroke)
    off = [r.time_ns - r.true_time_ns for r in sensors]
    assert len({int(o[0]) for o in off}) == 4
    assert all(abs(int(o[0])) < 15_000_000 for o in off)
    assert all(int(np.ptp(o)) > 1_000 for o in off)  # and drifts
    # Even by its stamps.
    assert all(np.ptp(np.diff(r.time_ns)) <= 2 for r in (readings.wheel_speed, readings.yaw_rate))


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.integers(-(10**8), 10**8), st.floats(-1e-3, 1e-3), st.floats(1.0, 200.0))
def test_a_clock_samples_at_even_times_of_its_stamps(offset: int, drift: float, rate: float) -> None:
    true_ns, stamps = DriftingClock(offset, drift).sampling(START_NS, START_NS + 20_000_000_000, rate)
    assert true_ns[0] == START_NS
    assert true_ns[-1] <= START_NS + 20_000_000_000
    assert stamps[0] - START_NS == offset
    np.testing.assert_allclose(np.diff(stamps), 1e9 / rate, atol=3.0)
    assert len(true_ns) == pytest.approx(20.0 * rate * (1.0 + drift) + 1, abs=1.0)


def test_messages_hold_the_newest_readings(path: Path, trajectory: Trajectory) -> None:
    readings = read_sensors(trajectory, CAR, path.surface_m, NORMAL, 6)
    messages = motion_messages(readings)
    assert [m.time_ns for m in messages] == readings.yaw_rate.time_ns.tolist()
    for m in messages[5::200]:
        held = np.flatnonzero(readings.wheel_speed.time_ns <= m.time_ns)[-1]
        assert m.wheel_speed_m_s == readings.wheel_speed.value[held]
        assert m.steering_angle_rad is not None
        held = np.flatnonzero(readings.pitch.time_ns <= m.time_ns)[-1]
        assert (m.pitch_rad, m.roll_rad) == (readings.pitch.value[held], readings.roll.value[held])
    # A unit that has fallen silent is not known, not repeated.
    wheel = readings.wheel_speed
    stopped = dataclasses.replace(wheel, time_ns=wheel.time_ns[:100], value=wheel.value[:100])
    silent = dataclasses.replace(readings, wheel_speed=stopped)
    assert motion_messages(silent)[-1].wheel_speed_m_s is None
    assert len(suspension_messages(readings, NORMAL)) == len(readings.stroke.time_ns)  # type: ignore[union-attr]
    assert len(ranging_messages(readings, NORMAL, CAR)) == int(np.isfinite(readings.ranging.value).sum())


def test_to_change_one_error_leaves_the_others(path: Path, trajectory: Trajectory) -> None:
    changed = dataclasses.replace(NORMAL, yaw_rate=RateSensor(noise_rad_s=0.1))
    a, b = (read_sensors(trajectory, CAR, path.surface_m, s, 1) for s in (NORMAL, changed))
    assert a.wheel_speed.value.tobytes() == b.wheel_speed.value.tobytes()
    assert a.steering.value.tobytes() == b.steering.value.tobytes()
    assert a.yaw_rate.value.tobytes() != b.yaw_rate.value.tobytes()


def test_an_automotive_yaw_rate_sensor_has_the_errors_of_its_sizes(trajectory):
    """Over seeds: σ of instability and, at the end, of warming; a tilted axis reads a share of roll and pitch rate."""
    asked_s = np.arange(0.0, 60.0, 0.1)
    sizes = AUTOMOTIVE_YAW_RATE
    only = dataclasses.replace(sizes, warming_sigma_rad_s=0.0, misalignment_sigma_rad=0.0)
    spread = [additional_errors(trajectory, only, asked_s, seed)[::300] for seed in range(300)]
    assert np.std(spread) == pytest.approx(sizes.instability_rad_s, rel=0.15)
    only = dataclasses.replace(sizes, instability_rad_s=0.0, misalignment_sigma_rad=0.0)
    ends = [additional_errors(trajectory, only, np.array([0.0, 6000.0]), seed) for seed in range(300)]
    np.testing.assert_array_equal(np.array(ends)[:, 0], 0.0)
    assert np.std(np.array(ends)[:, 1]) == pytest.approx(sizes.warming_sigma_rad_s, rel=0.15)
    assert additional_errors(trajectory, RateSensor(), asked_s, 1) is None


def test_the_sensor_of_before_reads_the_same_beside_the_automotive_one(path, trajectory):
    """The new errors have streams of their own: all other sensors' readings stay as they are."""
    changed = dataclasses.replace(NORMAL, yaw_rate=AUTOMOTIVE_YAW_RATE)
    a, b = (read_sensors(trajectory, CAR, path.surface_m, s, 1) for s in (NORMAL, changed))
    np.testing.assert_array_equal(a.wheel_speed.value, b.wheel_speed.value)
    np.testing.assert_array_equal(a.steering.value, b.steering.value)
    assert not np.array_equal(a.yaw_rate.value, b.yaw_rate.value)
    assert np.abs(a.yaw_rate.value - b.yaw_rate.value).max() < math.radians(3.0)
