"""Errors of the sensors stay within what is physically possible: positions that are led away do not calibrate them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.contradictions.sensor_bounds import SensorBounds
from camber.localizer.filter.dead_reckoning_time_update import BIAS_A, SCALE, TURN_GAIN
from camber.localizer.filter.filter_state import FilterState
from camber.localizer.filter.odometry import MotionModel
from camber.localizer.filter.pose_filter import PoseFilter
from camber.localizer.filter.pose_model import PoseModel
from support.pose_inputs import sample, start_pose
from support.pose_vehicle import RIGHT, PoseVehicle

MOTION = MotionModel()
SPEED_M_S = 10.0


def anchored(seed, seconds=60.0):
    vehicle = PoseVehicle(seed)
    vehicle.drive(10.0, 0.0, anchors=RIGHT)
    vehicle.drive(seconds, SPEED_M_S, anchors=RIGHT)
    return vehicle


def led_away(vehicle, along_m_s, seconds):
    """Anchors five a second that depart from the truth along the way; yield the time since they began to."""
    for k in range(1, round(seconds / 0.1) + 1):
        vehicle.step(SPEED_M_S)
        if k % 2 == 0:
            vehicle.anchor((along_m_s * 0.1 * k, 0.0))
            yield 0.1 * k


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("along_m_s", [0.3, -0.3])
def test_anchors_led_away_along_are_a_fault_and_no_calibration(seed, along_m_s):
    """3 % of the speed: no tyre changes so much. The covariance then covers where odometry would be."""
    vehicle = anchored(seed)
    detected_s = None
    for now_s in led_away(vehicle, along_m_s, 60.0):
        assert abs(vehicle.filter.state.x[SCALE]) <= MOTION.speed_scale_bound
        if vehicle.filter.sensor_fault is not None and detected_s is None:
            detected_s = now_s
    fault, e = vehicle.filter.sensor_fault, vehicle.filter.estimate()
    assert detected_s is not None
    assert detected_s <= 30.0
    assert fault.error == "wheel_scale"
    assert e.conflict == "odometry"
    assert e.mode == "dead_reckoning"
    assert vehicle.distance() < 3.0 * e.horizontal_sigma_m


@pytest.mark.parametrize("seed", [1, 2])
def test_a_tyre_within_the_bounds_is_learnt_without_a_fault(seed):
    vehicle = PoseVehicle(seed)
    vehicle.scale = 0.015
    vehicle.drive(10.0, 0.0, anchors=RIGHT)
    for _ in range(30):
        vehicle.drive(10.0, SPEED_M_S, anchors=RIGHT)
        assert vehicle.filter.sensor_fault is None
        assert vehicle.filter.estimate().conflict is None
    assert vehicle.filter.state.x[SCALE] == pytest.approx(0.015, abs=0.002)


def test_a_fault_ends_when_the_anchors_agree_with_odometry_again():
    vehicle = anchored(4)
    for _ in led_away(vehicle, 0.3, 40.0):
        pass
    assert vehicle.filter.sensor_fault is not None
    for _ in range(3600):  # until the longest window has no anchor of before
        vehicle.step(SPEED_M_S)
        vehicle.anchor((12.0, 0.0))
    assert vehicle.filter.sensor_fault is None
    assert vehicle.filter.estimate().conflict is None


def test_errors_that_nothing_observes_do_not_walk_away():
    """A day of driving: σ is that of the beginning, where a random walk would have reached four times as much."""
    model = PoseModel(lost_sigma_m=1e9, max_yaw_sigma_rad=1e9)
    pose_filter = PoseFilter(model)
    pose_filter.predict(sample(0, 20.0, 0.0))
    pose_filter.start(start_pose(0, (0.0, 0.0, 0.0)))
    for k in range(1, 4000):
        pose_filter.predict(sample(k * 20_000_000_000, 20.0, 0.0))
    sigma = np.sqrt(np.diag(pose_filter.state.p))
    assert sigma[SCALE] == pytest.approx(MOTION.speed_scale_sigma, rel=1e-6)
    assert sigma[BIAS_A] == pytest.approx(MOTION.yaw_rate_bias_sigma_rad_s, rel=1e-6)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-0.1, 0.1), st.floats(-0.2, 0.2))
def test_the_projection_leaves_a_covariance_and_moves_the_pose_as_the_correlation_says(seed, scale, gain):
    state = FilterState(PoseModel())
    root = np.random.default_rng(seed).standard_normal((len(state.x), len(state.x)))
    state.p = root @ root.T * 1e-4
    state.x[SCALE], state.x[TURN_GAIN] = scale, gain
    within = abs(scale) <= MOTION.speed_scale_bound, abs(gain) <= MOTION.yaw_rate_scale_bound
    east, slope = float(state.x[0]), float(state.p[0, SCALE] / state.p[SCALE, SCALE])
    bounds = SensorBounds(state, MOTION)
    bounds.enforce(1)
    assert abs(state.x[SCALE]) <= MOTION.speed_scale_bound
    assert abs(state.x[TURN_GAIN]) <= MOTION.yaw_rate_scale_bound
    assert np.linalg.eigvalsh(state.p)[0] > -1e-12
    assert (bounds.fault(1) is None) == all(within)
    if all(within):
        assert state.x[0] == east
    elif within[1] and bounds.fault(1).error == "wheel_scale":
        assert state.x[0] - east == pytest.approx(slope * (state.x[SCALE] - scale))
