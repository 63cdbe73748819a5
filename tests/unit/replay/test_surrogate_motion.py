"""Motion made from a truth: what it says without errors, and that its errors are as large as stated."""

import math

import numpy as np
import numpy.typing as npt
import pytest

from camber.formats.drive.truth_csv import TruthTable
from camber.geodesy.local_frame import LocalFrame
from camber.replay.surrogates import correlated_noise, make_initial_pose, make_motion, true_motion
from camber.replay.truth_interpolation import interpolate_truth
from camber.schemas.drive import Surrogates
from camber.simulator.random_streams import stream

START_NS = 1_400_000_000 * 10**9
ALL = ("wheel_speed", "yaw_rate", "steering")


def circle(n: int = 400, speed_m_s: float = 6.0, radius_m: float = 30.0) -> TruthTable:
    """A drive round a circle to the left at 5 Hz; a negative speed reverses."""
    time_s = 0.2 * np.arange(n)
    yaw = speed_m_s / radius_m * time_s
    plane = radius_m * np.column_stack((np.sin(yaw), 1.0 - np.cos(yaw)))
    frame = LocalFrame(math.radians(35.0), math.radians(137.0), 0.0)
    latitude, longitude, height = frame.geodetic_from_east_north_array(plane, np.full(n, 40.0))
    velocity = speed_m_s * np.column_stack((np.cos(yaw), np.sin(yaw), np.zeros(n)))
    zero = np.zeros(n)
    time_ns = START_NS + np.arange(n) * 200_000_000
    return TruthTable(
        time_ns=time_ns,
        latitude_rad=latitude,
        longitude_rad=longitude,
        height_m=height,
        roll_rad=zero,
        pitch_rad=zero,
        yaw_rad=(yaw + np.pi) % (2 * np.pi) - np.pi,
        velocity_enu_m_s=velocity,
    )


def column(samples: list[object], name: str) -> npt.NDArray[np.float64]:
    return np.array([getattr(sample, name) for sample in samples], dtype=np.float64)


@pytest.mark.parametrize("speed_m_s", [6.0, -2.0])
def test_without_errors_motion_is_that_of_the_circle(speed_m_s: float) -> None:
    motion = true_motion(circle(speed_m_s=speed_m_s), 2.7)
    np.testing.assert_allclose(motion.wheel_speed_m_s, speed_m_s, atol=1e-9)
    np.testing.assert_allclose(motion.yaw_rate_rad_s, speed_m_s / 30.0, atol=1e-9)
    np.testing.assert_allclose(motion.steering_angle_rad, math.atan(2.7 / 30.0), atol=1e-9)


def test_standing_still_gives_no_steering_and_no_rotation() -> None:
    motion = true_motion(circle(speed_m_s=0.0), 2.7)
    assert np.isnan(motion.steering_angle_rad).all()
    assert (motion.yaw_rate_rad_s == 0.0).all()


def test_motion_is_made_at_the_epochs_of_the_truth_and_only_what_is_asked_for() -> None:
    truth = circle()
    samples = make_motion(truth, Surrogates(inputs=("yaw_rate",)))
    assert [sample.time_ns for sample in samples] == truth.time_ns.tolist()
    assert all(s.wheel_speed_m_s is None and s.steering_angle_rad is None for s in samples)
    assert all(s.yaw_rate_rad_s is not None for s in samples)


def test_errors_over_many_seeds_are_as_large_as_stated() -> None:
    truth = circle()
    real = true_motion(truth, 2.7)
    wheel, rate, steering = [], [], []
    for seed in range(200):
        samples: list[object] = list(make_motion(truth, Surrogates(inputs=ALL, seed=seed)))
        wheel.append(column(samples, "wheel_speed_m_s") - real.wheel_speed_m_s)
        rate.append(column(samples, "yaw_rate_rad_s") - real.yaw_rate_rad_s)
        steering.append(column(samples, "steering_angle_rad") - real.steering_angle_rad)
    e = Surrogates()
    stated = (
        (np.array(wheel), 6.0 * e.wheel_scale_sigma, e.wheel_noise_m_s),
        (np.array(rate), e.yaw_rate_bias_sigma_rad_s, e.yaw_rate_noise_rad_s),
        (np.array(steering), e.steering_bias_sigma_rad, e.steering_noise_rad),
    )
    for errors, once, white in stated:
        # The mean over a drive still has white / √400 of noise in it; 200 seeds show a sigma to 5 %.
        expected = math.hypot(once, white / 20.0)
        assert np.std(errors.mean(axis=1)) == pytest.approx(expected, rel=0.2)
        assert np.std(errors - errors.mean(axis=1, keepdims=True)) == pytest.approx(white, rel=0.02)


def test_changing_one_error_leaves_the_others_as_they_were() -> None:
    truth = circle()
    before: list[object] = list(make_motion(truth, Surrogates(inputs=ALL)))
    after: list[object] = list(make_motion(truth, Surrogates(inputs=ALL, wheel_noise_m_s=0.5)))
    assert (column(before, "yaw_rate_rad_s") == column(after, "yaw_rate_rad_s")).all()
    assert (column(before, "steering_angle_rad") == column(after, "steering_angle_rad")).all()
    assert (column(before, "wheel_speed_m_s") != column(after, "wheel_speed_m_s")).all()


def test_streams_of_a_seed_are_different_and_repeatable() -> None:
    assert stream(1, "a").random() == stream(1, "a").random()
    assert len({stream(seed, name).random() for seed in (1, 2) for name in ("a", "b")}) == 4


@pytest.mark.parametrize("spacing_m", [0.7, 2.0, 9.0])
def test_correlated_noise_has_its_sigma_and_correlation_whatever_the_spacing(spacing_m: float) -> None:
    at_m = spacing_m * np.arange(60)
    z = np.array([correlated_noise(at_m, 0.05, 20.0, stream(seed, "noise")) for seed in range(1500)])
    assert np.std(z[:, 0]) == pytest.approx(0.05, rel=0.08)
    assert np.std(z) == pytest.approx(0.05, rel=0.06)
    for lag in (1, 5, 20):
        measured = np.mean(z[:, :-lag] * z[:, lag:]) / np.mean(z**2)
        assert measured == pytest.approx(math.exp(-lag * spacing_m / 20.0), abs=0.05)


def test_a_given_pose_is_off_by_what_it_says() -> None:
    truth = circle(n=2)
    poses = [make_initial_pose(truth, Surrogates(seed=seed)) for seed in range(400)]
    north = np.deg2rad([p.latitude_deg for p in poses]) - truth.latitude_rad[0]
    assert np.std(north * 6.36e6) == pytest.approx(poses[0].horizontal_sigma_m, rel=0.12)
    assert np.std([p.yaw_deg for p in poses]) == pytest.approx(poses[0].yaw_sigma_deg, rel=0.12)


def test_truth_between_epochs_is_interpolated_and_unknown_in_gaps_and_outside() -> None:
    truth = circle(n=50)
    gappy = truth.rows(np.r_[0:20, 30:50])
    asked = START_NS + np.array(
        [-1, 0, 100_000_000, 3_900_000_000, 5_000_000_000, 6_000_000_000, 9_900_000_000]
    )
    table, known = interpolate_truth(gappy, asked)
    assert known.tolist() == [False, True, True, False, False, True, False]
    assert table.time_ns.tolist() == asked[known].tolist()
    assert table.latitude_rad[0] == truth.latitude_rad[0]
    assert table.yaw_rad[1] == pytest.approx(6.0 / 30.0 * 0.1)


def test_truth_turns_through_the_smaller_angle_between_epochs() -> None:
    truth = circle(n=100)
    halves, _ = interpolate_truth(truth, truth.time_ns[:-1] + 100_000_000)
    expected = 6.0 / 30.0 * (0.2 * np.arange(99) + 0.1)
    np.testing.assert_allclose(np.cos(halves.yaw_rad - expected), 1.0, atol=1e-9)
