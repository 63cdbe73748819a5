"""Positions against the path by odometry: χ² without a drift, a drift named as soon as its derivation says."""

import math

import numpy as np
import pytest
from scipy import stats

from camber.localizer.contradictions.path_comparison import (
    THRESHOLD,
    PathWindow,
    PlacedPosition,
    SegmentOdometry,
    rotation,
)
from camber.localizer.filter.dead_reckoning_time_update import BIAS_A, N_MOTION, WHEEL_LAG, propagate
from camber.localizer.filter.odometry import WheelOdometry, yaw_rate
from camber.localizer.filter.pose_filter import PoseFilter
from support import odometry_detectability as detectability
from support.pose_inputs import sample
from support.pose_vehicle import RIGHT, PoseVehicle

SPEED_M_S = 10.0
NOISE = np.eye(2) * 0.06**2


def test_the_threshold_has_the_false_alarm_rate_stated():
    assert stats.chi2.sf(THRESHOLD, 3) == pytest.approx(1e-6, rel=1e-3)


def test_segments_compose_to_the_displacement_and_covariance_of_one_propagation():
    """A bend of 40 s, in segments of 5 s, against the state of dead reckoning carried through."""
    state = detectability.sensors_known()
    motion = detectability.MotionModel()
    odometer, segments, segment = WheelOdometry(motion), [], SegmentOdometry(motion, state)
    x, p = np.zeros(N_MOTION), np.zeros((N_MOTION, N_MOTION))
    sensors = slice(BIAS_A, WHEEL_LAG + 1)
    p[sensors, sensors], x[sensors] = state.p[sensors, sensors], state.x[sensors]
    middle = None
    for k in range(401):
        step = odometer.advance(sample(k * 10**8, 8.0 + 0.01 * k, 0.03), 0.0)
        if not k:
            continue
        turn = yaw_rate(step, "yaw_rate", motion, bias=float(x[BIAS_A]), scale=0.0, gain=0.0)
        propagate(x, p, step, turn=turn, model=motion)
        segment.advance(step)
        if k % 50 == 0:
            segments.append(segment.close())
            segment = SegmentOdometry(motion, state)
        if k == 200:
            middle = x[:2].copy()
    placed = PlacedPosition(np.zeros(2), NOISE)
    window = PathWindow((segments[:4], segments[4:]), (placed, placed, placed), p[sensors, sensors] * 0.0)
    path, by_sensors, noise = window.displacements(np.zeros(6))
    np.testing.assert_allclose(np.concatenate((middle, x[:2] - middle)), path, atol=0.01)
    to_end = np.hstack((np.eye(2), np.eye(2)))
    covariance = by_sensors @ state.p[sensors, sensors] @ by_sensors.T + noise
    np.testing.assert_allclose(to_end @ covariance @ to_end.T, p[:2, :2], rtol=0.02, atol=0.05)


@pytest.mark.parametrize("second_s", [10.0, 30.0])
def test_without_a_drift_the_statistic_is_chi_squared_or_smaller(second_s):
    seed, drives = 20261120, 120
    print("seed", seed)
    rng = np.random.default_rng(seed)
    quiet = np.array(
        [detectability.simulated(rng, SPEED_M_S, second_s, (0.0, 0.0), None).statistic for _ in range(drives)]
    )
    assert quiet.mean() < stats.chi2.ppf(0.999, 3 * drives) / drives
    assert quiet.mean() > 1.5, "σ much too large would hide drifts"


def test_half_of_the_drifts_of_the_rate_computed_are_detected():
    seed, drives = 20261121, 100
    print("seed", seed)
    rng = np.random.default_rng(seed)
    for axis, rate in enumerate(detectability.rates(SPEED_M_S, 10.0, scale=None, power=0.5)):
        drift = (rate, 0.0) if axis == 0 else (0.0, rate)
        tests = [detectability.simulated(rng, SPEED_M_S, 10.0, drift, None) for _ in range(drives)]
        detected = sum(test.contradicts for test in tests)
        assert stats.binom.ppf(1e-4, drives, 0.4) <= detected <= stats.binom.ppf(1.0 - 1e-4, drives, 0.7)
        named = np.mean([(test.along_m_s, test.across_m_s) for test in tests], axis=0)
        np.testing.assert_allclose(named, drift, atol=0.3 * rate)


def test_a_path_that_a_bias_has_bent_by_ten_degrees_is_no_drift():
    """Without iteration over the sensors' errors its chord seemed 5 m too short, and each second drive led away."""
    state = detectability.sensors_known(bias_rad_s=None)
    bias, steps = math.radians(0.1), 1300
    readings = [(SPEED_M_S, bias)] * (steps + 1)
    positions = [np.array((SPEED_M_S * t, 0.0)) for t in (0.0, 30.0, 130.0)]
    test = detectability.driven_window(state, readings, 30.0, positions).compare()
    assert test.statistic < 3.0 + 4.0  # twice σ of the bias, and nothing else


def driven(seed, *, calibrated=False):
    """A vehicle, and where `calibrated` a filter without anchors that has learnt the bias at the standstill."""
    vehicle = PoseVehicle(seed, at=(0.0, 0.0, 0.3))
    if calibrated:
        alone, predict = PoseFilter(vehicle.model), vehicle.filter.predict
        alone.predict(sample(vehicle.time_ns, 0.0, vehicle.bias))
        alone.start(vehicle.given())
        vehicle.filter.predict = lambda motion: (alone.predict(motion), predict(motion))[1]
        vehicle.filter.use_sensors_of(alone)
    vehicle.drive(15.0, 0.0, anchors=RIGHT)
    vehicle.drive(60.0, SPEED_M_S, anchors=RIGHT)
    return vehicle


def named_after_s(vehicle, drift_m_s, seconds):
    for k in range(1, round(seconds / vehicle.step_s) + 1):
        vehicle.step(SPEED_M_S)
        if k % 2 == 0:
            off = np.array(drift_m_s) * vehicle.step_s * k
            vehicle.anchor((float(off[0]), float(off[1])))
        if vehicle.filter.path_fault is not None:
            return k * vehicle.step_s
    return math.inf


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("drift_m_s", [(0.3, 0.0), (-0.2, 0.0)])
def test_anchors_led_away_along_are_named_within_twenty_seconds(seed, drift_m_s):
    vehicle = driven(seed)
    assert named_after_s(vehicle, drift_m_s, 20.0) <= 20.0
    fault, e = vehicle.filter.path_fault, vehicle.filter.estimate()
    assert fault.along_m_s * drift_m_s[0] > 0.0
    assert e.conflict == "odometry"
    assert vehicle.distance() < 4.0 * e.horizontal_sigma_m


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_anchors_led_away_across_are_named_where_the_bias_is_known(seed):
    """0.5 m/s is a bend of 2.9°; by the curve 0.2 m/s is half detected."""
    assert named_after_s(driven(seed, calibrated=True), (0.0, 0.5), 30.0) <= 30.0


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_right_anchors_in_bends_and_stops_contradict_nothing(seed):
    vehicle = driven(seed)
    for _ in range(6):
        for seconds, speed, rate in (
            (30.0, 12.0, 0.0),
            (8.0, 8.0, 0.2),
            (15.0, 0.0, 0.0),
            (25.0, 9.0, -0.06),
        ):
            vehicle.drive(seconds, speed, rate, anchors=RIGHT)
            assert vehicle.filter.path_fault is None
            assert vehicle.filter.sensor_fault is None


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_one_wrong_anchor_is_not_taken_for_a_drift(seed):
    vehicle = driven(seed)
    for k in range(600):
        vehicle.step(SPEED_M_S)
        if k % 10 == 0:
            off = rotation(0.3 * seed) @ (1.5, 0.0) if k == 200 else (0.0, 0.0)
            vehicle.anchor((float(off[0]), float(off[1])))
        assert vehicle.filter.path_fault is None
