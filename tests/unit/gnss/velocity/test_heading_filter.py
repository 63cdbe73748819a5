"""Headings of simulated turns, and what the gates, gaps and clocks do."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.geodesy.angles import angle_difference, heading_from_yaw
from camber.gnss.velocity.doppler_velocity import DopplerVelocity
from camber.gnss.velocity.heading_filter import (
    DRIFT_RAD_PER_ROOT_S,
    YAW_ACCELERATION_RAD_S2,
    YAW_RATE_SIGMA_RAD_S,
    HeadingEstimate,
    HeadingFilter,
)

BEGIN_NS = 1_460_000_000 * 10**9
SIGMA_M_S = 0.05
COVARIANCE = (SIGMA_M_S**2, 0.0, SIGMA_M_S**2)
ANY = st.floats(allow_nan=True, allow_infinity=True)


def doppler(
    time_ns: int, east_m_s: float, north_m_s: float, covariance_m2_s2=COVARIANCE, hdop: float = 1.0
) -> DopplerVelocity:
    ee, en, nn = covariance_m2_s2
    return DopplerVelocity(
        time_ns=time_ns,
        status="ok",
        velocity_enu_m_s=np.array([east_m_s, north_m_s, 0.0]),
        covariance_enu_m2_s2=np.array([[ee, en, 0.0], [en, nn, 0.0], [0.0, 0.0, 1.0]]),
        clock_drift_m_s=0.0,
        hdop=hdop,
        chi_squared=0.0,
        degrees=0,
        used=np.zeros(0, np.bool_),
        excluded=np.zeros(0, np.bool_),
    )


def velocity(
    filter_: HeadingFilter, at_s: float, heading_rad: float, speed_m_s: float, **changed: float
) -> str:
    """A velocity without noise; the vehicle moves along its heading, backwards with a negative speed."""
    east_m_s, north_m_s = speed_m_s * math.sin(heading_rad), speed_m_s * math.cos(heading_rad)
    seen = doppler(BEGIN_NS + round(at_s * 1e9), east_m_s, north_m_s, hdop=changed.get("hdop", 1.0))
    return filter_.add_velocity(seen, changed.get("wheel_speed_m_s", speed_m_s))


def started(*, heading_rad: float = 1.0, speed_m_s: float = 10.0) -> HeadingFilter:
    """After one velocity."""
    filter_ = HeadingFilter()
    velocity(filter_, 0.0, heading_rad, speed_m_s)
    return filter_


def turning(filter_: HeadingFilter, yaw_rate_rad_s: float, count: int = 50, period_s: float = 0.02) -> None:
    """Yaw rates since the beginning."""
    for k in range(1, count + 1):
        filter_.add_yaw_rate(BEGIN_NS + round(k * period_s * 1e9), yaw_rate_rad_s)


def at(filter_: HeadingFilter, at_s: float) -> HeadingEstimate | None:
    return filter_.at(BEGIN_NS + round(at_s * 1e9))


def known(filter_: HeadingFilter, at_s: float) -> HeadingEstimate:
    heading = at(filter_, at_s)
    assert heading is not None
    return heading


def drive(seed: int, duration_s: float, speed_m_s: float) -> tuple[list[float], list[float]]:
    """Errors and normalised errors of a car that turns this way and that: yaw rate at 50 Hz, velocity at 10 Hz."""
    rng = np.random.default_rng(seed)
    filter_ = HeadingFilter()
    yaw, errors, normalised = float(rng.uniform(-math.pi, math.pi)), [], []
    for k in range(round(duration_s * 50)):
        t = k / 50
        yaw_rate = 0.4 * math.sin(0.3 * t + seed)
        filter_.add_yaw_rate(BEGIN_NS + k * 20_000_000, yaw_rate + YAW_RATE_SIGMA_RAD_S * rng.normal())
        if k % 5 == 0:
            noise = SIGMA_M_S * rng.normal(size=2)
            east, north = speed_m_s * math.cos(yaw) + noise[0], speed_m_s * math.sin(yaw) + noise[1]
            filter_.add_velocity(doppler(BEGIN_NS + k * 20_000_000, east, north), speed_m_s)
        if t > 2.0:
            estimate = known(filter_, t)
            errors.append(angle_difference(estimate.heading_rad, heading_from_yaw(yaw)))
            normalised.append(errors[-1] / estimate.heading_sigma_rad)
        yaw += yaw_rate / 50
    return errors, normalised


def test_in_turns_the_heading_is_as_good_as_it_says_and_better_than_one_velocity():
    for speed in (2.0, 10.0):
        errors, normalised = zip(*(drive(seed, 30.0, speed) for seed in range(6)), strict=True)
        rms = np.sqrt(np.mean(np.square(np.concatenate(errors))))
        assert rms < 0.7 * SIGMA_M_S / speed
        assert 0.2 < np.mean(np.square(np.concatenate(normalised))) < 1.5


def test_the_slower_the_less_a_velocity_counts():
    for speed in (1.0, 4.0, 16.0):
        sigma = known(started(speed_m_s=speed), 0.0).heading_sigma_rad
        assert sigma == pytest.approx(SIGMA_M_S / speed)


def test_only_the_error_across_the_travel_turns_the_heading():
    filter_ = HeadingFilter()
    filter_.add_velocity(doppler(BEGIN_NS, 0.0, 10.0, (0.01, 0.0, 4.0)), 10.0)
    assert known(filter_, 0.0).heading_sigma_rad == pytest.approx(0.01)
    filter_ = HeadingFilter()
    # An ellipse turned by 45°, long along the travel to the north-east.
    filter_.add_velocity(doppler(BEGIN_NS, 7.0, 7.0, (2.005, 1.995, 2.005)), 9.9)
    assert known(filter_, 0.0).heading_sigma_rad == pytest.approx(0.1 / math.hypot(7.0, 7.0))


def test_a_yaw_rate_to_the_left_turns_the_heading_anticlockwise():
    filter_ = started(heading_rad=math.radians(90.0))
    turning(filter_, 0.5)
    assert known(filter_, 1.0).heading_rad == pytest.approx(math.radians(90.0) - 0.5, abs=0.02)
    assert known(filter_, 1.5).heading_rad == pytest.approx(math.radians(90.0) - 0.75, abs=0.025)


def test_velocities_alone_determine_the_rate():
    filter_ = HeadingFilter()
    for k in range(60):
        velocity(filter_, k / 10, 0.3 * k / 10, 10.0)
    assert known(filter_, 5.9).heading_rad == pytest.approx(0.3 * 5.9, abs=0.005)
    assert known(filter_, 6.4).heading_rad == pytest.approx(0.3 * 6.4, abs=0.01)


def test_by_yaw_rates_a_heading_is_kept_as_well_as_they_drift():
    filter_ = started()
    turning(filter_, 0.0)
    # Between two rates, 20 ms apart, the yaw acceleration turns the car by what neither shows: q Δt³ / 12.
    between = 50 * YAW_ACCELERATION_RAD_S2**2 * 0.02**3 / 12.0
    expected = math.sqrt((SIGMA_M_S / 10.0) ** 2 + DRIFT_RAD_PER_ROOT_S**2 + between)
    assert known(filter_, 1.0).heading_sigma_rad == pytest.approx(expected, rel=0.01)


def test_backwards_the_vehicle_points_against_its_velocity():
    filter_ = HeadingFilter()
    assert velocity(filter_, 0.0, math.radians(30.0), -3.0) == "accepted"
    assert known(filter_, 0.0).heading_rad == pytest.approx(math.radians(30.0))
    # Out of the parking place and on: no half turn.
    assert velocity(filter_, 0.1, math.radians(30.0), 3.0) == "accepted"
    assert known(filter_, 0.1).heading_rad == pytest.approx(math.radians(30.0))


@pytest.mark.parametrize("north_deg", [-0.5, 0.0, 0.5])
def test_headings_cross_north_over_the_smaller_angle(north_deg):
    filter_ = HeadingFilter()
    for k in range(40):
        heading_rad = math.radians(north_deg + (1.0 if k % 2 else -1.0))
        assert velocity(filter_, 0.1 * k, heading_rad, 10.0) == "accepted"
    estimate = known(filter_, 3.9)
    assert 0.0 <= estimate.heading_rad < 2.0 * math.pi
    assert abs(angle_difference(estimate.heading_rad, math.radians(north_deg))) < math.radians(1.0)


@pytest.mark.parametrize(
    ("speed", "changed", "gate"),
    [
        (0.4, {}, "wheel_speed"),
        (0.5, {}, "wheel_speed"),
        (5.0, {"wheel_speed_m_s": 3.4}, "speeds_differ"),
        (5.0, {"wheel_speed_m_s": 6.6}, "speeds_differ"),
        (5.0, {"hdop": 2.5}, "hdop"),
        (5.0, {"hdop": math.nan}, "not_finite"),
        (0.05, {"wheel_speed_m_s": 1.0}, "imprecise"),
        (1e-200, {"wheel_speed_m_s": 1.0}, "imprecise"),
    ],
)
def test_the_gates_hold_a_velocity_back(speed, changed, gate):
    filter_ = HeadingFilter()
    assert velocity(filter_, 0.0, 1.0, speed, **changed) == gate
    assert at(filter_, 0.0) is None
    velocity(filter_, 0.1, 1.0, 10.0)
    before = known(filter_, 0.2)
    assert velocity(filter_, 0.2, 2.0, speed, **changed) == gate
    assert known(filter_, 0.2) == before


def test_without_velocities_the_heading_is_unknown_after_a_while_however_well_the_yaw_rate_is_known():
    filter_ = started()
    for k in range(1, 1200):
        filter_.add_yaw_rate(BEGIN_NS + k * 10_000_000, 0.0)
        assert (at(filter_, k / 100) is not None) == (k <= 1000)
    assert velocity(filter_, 12.0, 2.0, 10.0) == "accepted"
    assert known(filter_, 12.0).heading_rad == pytest.approx(2.0)


def test_after_a_gap_of_everything_the_heading_is_unknown():
    filter_ = started()
    assert at(filter_, 1.0) is not None
    assert at(filter_, 1.001) is None
    filter_.add_yaw_rate(BEGIN_NS + 1_001_000_000, 0.0)
    assert at(filter_, 1.001) is None, "what comes then does not bring it back"


def test_uncertainty_grows_until_the_next_velocity():
    filter_ = started()
    sigmas = []
    for k in range(1, 300):
        filter_.add_yaw_rate(BEGIN_NS + k * 20_000_000, 0.0)
        sigmas.append(known(filter_, k / 50).heading_sigma_rad)
    assert all(b > a for a, b in itertools.pairwise(sigmas[5:]))
    velocity(filter_, 6.0, 1.0, 10.0)
    assert known(filter_, 6.0).heading_sigma_rad < sigmas[-1]


def test_one_velocity_that_contradicts_is_an_outlier_many_are_the_truth():
    filter_ = HeadingFilter()
    for k in range(20):
        filter_.add_yaw_rate(BEGIN_NS + k * 100_000_000, 0.0)
        velocity(filter_, k / 10, 1.0, 10.0)
    gates = []
    for k in range(20, 25):
        filter_.add_yaw_rate(BEGIN_NS + k * 100_000_000, 0.0)
        gates.append(velocity(filter_, k / 10, 2.5, 10.0))
    assert gates == ["outlier"] * 4 + ["accepted"]
    assert known(filter_, 2.4).heading_rad == pytest.approx(2.5)


def test_what_is_older_changes_nothing_and_a_clock_that_jumps_back_starts_anew():
    filter_ = HeadingFilter()
    velocity(filter_, 100.0, 1.0, 10.0)
    before = known(filter_, 100.0)
    assert velocity(filter_, 99.9, 2.0, 10.0) == "too_old"
    assert not filter_.add_yaw_rate(BEGIN_NS + 99_900_000_000, 1.0)
    assert known(filter_, 100.0) == before
    assert at(filter_, 99.9) is None
    assert filter_.add_yaw_rate(BEGIN_NS, 0.0)
    assert at(filter_, 0.0) is None
    assert velocity(filter_, 0.1, 2.0, 10.0) == "accepted"
    assert known(filter_, 0.1).heading_rad == pytest.approx(2.0)


def test_a_speed_that_no_receiver_states_is_an_outlier():
    filter_ = HeadingFilter()
    absurd = doppler(BEGIN_NS, 1.34e154, 0.0, (0.0, 0.0, 0.0))
    assert filter_.add_velocity(absurd, 1.34e154) == "outlier"
    assert filter_.at(BEGIN_NS) is None


@settings(derandomize=True, max_examples=200)
@given(
    st.lists(
        st.tuples(
            st.integers(-(2**62), 2**62) | st.integers(0, 10**11), st.booleans(), ANY, ANY, ANY, ANY, ANY
        ),
        max_size=15,
    )
)
def test_whatever_comes_a_known_heading_is_a_number_with_a_sigma(steps):
    filter_ = HeadingFilter()
    last_ns = 0
    for time_ns, is_rate, a, b, c, d, e in steps:
        last_ns = max(last_ns, time_ns)
        if is_rate:
            filter_.add_yaw_rate(time_ns, a)
        else:
            filter_.add_velocity(doppler(time_ns, a, b, (c, d, c), d), e)
        for when_ns in (time_ns, last_ns):
            estimate = filter_.at(when_ns)
            if estimate is not None:
                assert 0.0 <= estimate.heading_rad < 2.0 * math.pi
                assert 0.0 < estimate.heading_sigma_rad < math.inf
