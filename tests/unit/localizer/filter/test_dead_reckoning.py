"""Dead reckoning: what the sensors say, what they do not say, and what a standstill teaches."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from camber.localizer.filter.dead_reckoning_time_update import (
    BIAS_A,
    EAST,
    N_MOTION,
    NORTH,
    SCALE,
    SIDE_SLIP,
    TURN_GAIN,
    WHEEL_LAG,
    YAW,
    propagate,
)
from camber.localizer.filter.odometry import MotionModel, WheelOdometry, yaw_rate
from camber.localizer.filter.track import RelativeTrack
from support.pose_inputs import sample

MODEL = MotionModel()
STEP_NS = 200_000_000


class Reckoner:
    """Odometer and propagation with nothing else."""

    def __init__(self, model=MODEL, yaw=0.0):
        self.model, self.odometer, self.track = model, WheelOdometry(model), RelativeTrack()
        self.x = np.zeros(N_MOTION)
        self.x[YAW] = yaw
        self.p = np.diag([1e-4, 1e-4, 1e-6] + [1e-12] * (N_MOTION - 3))

    def feed(self, time_ns, speed, rate=None, steering=None):
        step = self.odometer.advance(sample(time_ns, speed, rate, steering), float(self.x[BIAS_A]))
        if step.outcome in ("repeated", "backwards"):
            return step
        turn = yaw_rate(
            step, self.model.a_rate_sensor, self.model, bias=float(self.x[BIAS_A]), scale=float(self.x[SCALE])
        )
        self.track.append(time_ns, step, step.speed_m_s, turn.rate_rad_s if turn else 0.0)
        propagate(self.x, self.p, step, turn=turn, model=self.model)
        return step

    def sigma(self, index):
        return math.sqrt(self.p[index, index])


def drive(reckoner, seconds, speed, rate=0.0, start_s=0.0, step_s=0.2, **more):
    for k in range(round(seconds / step_s) + 1):
        reckoner.feed(round((start_s + k * step_s) * 1e9), speed, rate, **more)


@pytest.mark.parametrize(
    ("yaw", "seconds", "speed", "rate", "end"),
    [
        (0.0, 40.0, 5.0, math.tau / 40.0, [0.0, 0.0, math.tau]),  # a full circle
        (math.pi / 2, 10.0, 5.0, 0.0, [0.0, 50.0, math.pi / 2]),  # yaw is counter-clockwise from east
        (0.0, 10.0, -1.0, 0.0, [-10.0, 0.0, 0.0]),  # reverse
    ],
)
def test_speed_and_turn_lead_where_geometry_says(yaw, seconds, speed, rate, end):
    reckoner = Reckoner(yaw=yaw)
    drive(reckoner, seconds, speed, rate)
    assert reckoner.x[:3] == pytest.approx(end, abs=1e-6 if rate else 1e-9)


@pytest.mark.parametrize("lag_s", [0.0, 0.08])
def test_the_lag_of_the_wheel_speed_is_compensated(lag_s):
    """Speeding up from 2 to 10 m/s, then on; without their age the way would be 8 m/s times it too short."""
    reckoner = Reckoner()
    reckoner.x[WHEEL_LAG] = lag_s
    for k in range(81):
        t = 0.1 * k
        reckoner.feed(round(t * 1e9), 2.0 + 2.0 * min(max(t - lag_s, 0.0), 4.0), 0.0)
    assert reckoner.x[EAST] == pytest.approx(2.0 * 8.0 + 16.0 + 8.0 * 4.0, abs=0.02)


def test_steering_and_yaw_rate_drive_the_same_circle():
    by_rate, by_steering = Reckoner(), Reckoner(MotionModel(a_rate_sensor="steering"))
    rate = 0.2
    steering = math.atan(rate * MODEL.wheelbase_m / 5.0)
    drive(by_rate, 5.0, 5.0, rate)
    drive(by_steering, 5.0, 5.0, None, steering=steering)
    np.testing.assert_allclose(by_steering.x, by_rate.x, atol=1e-9)


@pytest.mark.parametrize("sensor", ["yaw_rate", "steering"])
def test_propagation_carries_the_covariance_by_its_true_derivatives(sensor):
    model = MotionModel(a_rate_sensor=sensor)
    steering, rate, speed, dt = 0.12, 0.3, 7.0, 0.1

    def run(x):
        x, p, odometer = x.copy(), np.zeros((N_MOTION, N_MOTION)), WheelOdometry(model)
        odometer.advance(sample(0, speed - 0.2, rate, steering), 0.0)
        step = odometer.advance(sample(round(dt * 1e9), speed, rate, steering), 0.0)
        turn = yaw_rate(
            step, sensor, model, bias=float(x[BIAS_A]), scale=float(x[SCALE]), gain=float(x[TURN_GAIN])
        )
        propagate(x, p, step, turn=turn, model=model)
        return x, step, turn

    x0 = np.array([3.0, -2.0, 0.7, 0.01, 0.0, 0.02, 0.004, 0.01, 0.1, 0.3, 0.05])
    f = np.column_stack([(run(x0 + e)[0] - run(x0 - e)[0]) / 2e-6 for e in 1e-6 * np.eye(N_MOTION)])
    root = np.random.default_rng(4).standard_normal((N_MOTION, N_MOTION))
    p0 = root @ root.T
    _, step, turn = run(x0)
    p, q = p0.copy(), np.zeros_like(p0)
    propagate(x0.copy(), p, step, turn=turn, model=model)
    propagate(x0.copy(), q, step, turn=turn, model=model)
    np.testing.assert_allclose(p - q, f @ p0 @ f.T, rtol=1e-6, atol=1e-6)


def test_pose_errors_of_many_drives_have_the_stated_covariance():
    """Monte Carlo over bias, scale, slip and noise on an S-shaped drive of 60 s."""
    seed = 20260702
    print("seed", seed)
    rng, drives = np.random.default_rng(seed), 150
    nees = []
    for _ in range(drives):
        reckoner, truth = Reckoner(), np.zeros(3)
        known = [1e-6] * (N_MOTION - 6)
        sigma = np.array([MODEL.yaw_rate_bias_sigma_rad_s, 1e-6, MODEL.speed_scale_sigma, *known])
        reckoner.p[3:, 3:] = np.diag(sigma**2)
        bias, scale = rng.normal(0, sigma[0]), rng.normal(0, sigma[2])
        for k in range(301):
            rate = 0.15 * math.sin(k / 40.0)
            if k:
                middle = truth[2] + 0.5 * rate * 0.2
                truth += (8.0 * 0.2 * math.cos(middle), 8.0 * 0.2 * math.sin(middle), rate * 0.2)
            reckoner.feed(
                k * STEP_NS,
                8.0 / (1.0 + scale) + rng.normal(0, MODEL.speed_noise_m_s),
                0.15 * math.sin((k + 0.5) / 40.0) + bias + rng.normal(0, MODEL.yaw_rate_noise_rad_s),
            )
        error = reckoner.x[:3] - truth
        nees.append(error @ np.linalg.solve(reckoner.p[:3, :3], error))
    mean = float(np.mean(nees))
    assert mean < stats.chi2.ppf(0.999, 3 * drives) / drives, "overconfident"
    assert mean > 1.0, "sigmas several times too large help nobody"


def test_a_standstill_holds_the_pose_and_its_covariance():
    reckoner = Reckoner()
    drive(reckoner, 10.0, 5.0, 0.01)
    drive(reckoner, 5.0, 0.02, 0.0, start_s=10.2)
    assert reckoner.odometer.standing
    before, x = reckoner.p[:3, :3].copy(), reckoner.x[:3].copy()
    drive(reckoner, 600.0, 0.02, 0.001, start_s=15.4)
    np.testing.assert_array_equal(reckoner.p[:3, :3], before)
    np.testing.assert_array_equal(reckoner.x[:3], x)


def test_wheels_in_their_dead_zone_hide_a_little_distance_at_both_ends_of_a_stop():
    reckoner = Reckoner()
    drive(reckoner, 10.0, 5.0)
    drive(reckoner, 2.0, 0.0, start_s=10.2)
    stopped, sigma = float(reckoner.x[EAST]), reckoner.sigma(EAST)
    drive(reckoner, 30.0, 0.0, start_s=12.4)
    assert reckoner.x[EAST] == stopped
    assert sigma < reckoner.sigma(EAST) < sigma + 0.1
    for k in range(3):
        reckoner.feed(round((42.6 + 0.2 * k) * 1e9), 1.0, 0.0)
    assert reckoner.x[EAST] - stopped == pytest.approx(0.5 + MODEL.creep_m, abs=0.01)
    assert reckoner.sigma(EAST) > math.hypot(sigma, MODEL.creep_sigma_m)


def test_turning_on_the_spot_is_no_standstill():
    reckoner = Reckoner()
    drive(reckoner, 10.0, 0.0, 0.3)
    assert not reckoner.odometer.standing
    assert reckoner.x[YAW] == pytest.approx(3.0)


def test_repeated_and_backward_samples_change_nothing():
    reckoner = Reckoner()
    drive(reckoner, 2.0, 5.0, 0.1)
    x, p = reckoner.x.copy(), reckoner.p.copy()
    assert reckoner.feed(2_000_000_000, 9.0, 1.0).outcome == "repeated"
    assert reckoner.feed(1_000_000_000, 9.0, 1.0).outcome == "backwards"
    np.testing.assert_array_equal(reckoner.x, x)
    np.testing.assert_array_equal(reckoner.p, p)


@pytest.mark.parametrize(
    ("seconds", "speed", "rate", "hidden", "least"),
    [
        (2.0, 8.0, None, YAW, 0.3 * 2.0),  # the turn that the missing yaw rate could hide
        (4.0, None, 0.0, EAST, 0.25 * 2.0 * 4.0**2),  # half of the way to braking to nothing
    ],
)
def test_a_missing_reading_is_covered_by_what_it_could_hide(seconds, speed, rate, hidden, least):
    reckoner = Reckoner()
    drive(reckoner, 2.0, 8.0, 0.0)
    drive(reckoner, seconds, speed, rate, start_s=2.2)
    assert reckoner.x[EAST] == pytest.approx(8.0 * (2.2 + seconds), abs=0.1)
    assert reckoner.sigma(hidden) > least


def test_a_gap_in_time_is_bridged_and_covered():
    reckoner = Reckoner()
    drive(reckoner, 2.0, 8.0, 0.0)
    step = reckoner.feed(6_000_000_000, 8.0, 0.0)
    assert step.outcome == "gap"
    assert reckoner.x[EAST] == pytest.approx(48.0)
    assert reckoner.sigma(EAST) > 3.0
    assert reckoner.sigma(NORTH) > 3.0


def test_the_same_noise_read_more_often_does_not_average_out():
    slow, fast = Reckoner(), Reckoner()
    drive(slow, 20.0, 8.0, 0.0, step_s=0.2)
    drive(fast, 20.0, 8.0, 0.0, step_s=0.01)
    for index in (EAST, NORTH, YAW):
        assert fast.sigma(index) == pytest.approx(slow.sigma(index), rel=0.1)


MAYBE = st.one_of(st.none(), st.floats(-40.0, 40.0))


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(-300, 3000), MAYBE, MAYBE), max_size=60), st.booleans())
def test_any_sequence_of_samples_leaves_a_covariance(samples, by_steering):
    reckoner = Reckoner(MotionModel(a_rate_sensor="steering" if by_steering else "yaw_rate"))
    now_ms = 0
    for dt_ms, speed, rate in samples:
        now_ms += dt_ms
        reckoner.feed(now_ms * 1_000_000, speed, None if by_steering else rate, rate if by_steering else None)
    assert np.isfinite(reckoner.x).all()
    scale = np.sqrt(np.diag(reckoner.p))
    correlation = reckoner.p / np.outer(scale, scale)
    assert np.linalg.eigvalsh(correlation)[0] > -1e-9
    np.testing.assert_allclose(correlation, correlation.T, rtol=0.0, atol=1e-12)


@settings(deadline=None)
@given(st.floats(0.0, 15.0), st.floats(-0.5, 0.5), st.floats(1.0, 5.0))
def test_noisier_sensors_never_give_a_smaller_covariance(speed, rate, factor):
    noisier = MotionModel(
        speed_noise_m_s=MODEL.speed_noise_m_s * factor,
        yaw_rate_noise_rad_s=MODEL.yaw_rate_noise_rad_s * factor,
    )
    less, more = Reckoner(), Reckoner(noisier)
    for reckoner in (less, more):
        drive(reckoner, 4.0, speed, rate)
    assert np.linalg.eigvalsh(more.p - less.p)[0] > -1e-9


def test_the_track_interpolates_and_reaches_a_little_ahead():
    reckoner = Reckoner()
    drive(reckoner, 2.0, 5.0)
    assert reckoner.track.at(1_100_000_000).east_m == pytest.approx(5.5)
    assert reckoner.track.at(2_200_000_000).east_m == pytest.approx(11.0)
    assert reckoner.track.at(3_000_000_000) is None
    assert reckoner.track.at(-1) is None


def test_side_slip_pushes_outwards_in_a_curve():
    straight, slipping = Reckoner(), Reckoner()
    slipping.x[SIDE_SLIP] = 0.005
    for reckoner in (straight, slipping):
        drive(reckoner, 2.0, 10.0, 0.2)
    assert slipping.x[NORTH] < straight.x[NORTH]
