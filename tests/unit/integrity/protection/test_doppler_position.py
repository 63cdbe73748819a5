"""Position by satellite velocities: how far it has come and how sure that is, and what ends it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.protection.doppler_position import DopplerPosition, DopplerRules
from camber.schemas.gnss import SatelliteVelocity
from support.judging import START_NS

exactly = settings(derandomize=True, deadline=None)
STEP_NS = 100_000_000
PLAIN = DopplerRules(sigma_scale=1.0, sigma_floor_m_s=0.0)


def at(k: float) -> int:
    return START_NS + round(k * STEP_NS)


def velocity(k, east=10.0, north=0.0, up=0.0, sigma=0.05, **changes):
    v = sigma * sigma
    fields = {
        "time_ns": at(k),
        "velocity_enu_m_s": (east, north, up),
        "covariance_enu_m2_s2": (v, 0.0, 0.0, v, 0.0, v),
        "hdop": 1.0,
        "satellites": 8,
        "heading_rad": math.pi / 2.0,
    }
    return SatelliteVelocity(**(fields | changes))


def driven(rules=PLAIN, steps=50, wheels=10.0, make=velocity, begin=0):
    """Velocities of epochs 0 to `steps`; a position is confirmed at `begin`."""
    position = DopplerPosition(rules)
    for k in range(steps + 1):
        if wheels is not None:
            position.add_wheel_speed(at(k), wheels)
        position.add_velocity(make(k))
        if k == begin:
            position.begin(at(begin))
    return position


def test_it_has_come_as_far_as_the_velocities_say():
    result = driven(wheels=9.5, make=lambda k: velocity(k, east=9.0 + 0.02 * k, north=1.0, up=0.1)).at(at(50))
    assert result.metres == pytest.approx([5.0 * 9.5, 5.0, 0.5])
    assert result.since_ns == at(0)
    assert result.yaw_rad == pytest.approx(0.0)
    assert result.checked


def test_its_covariance_is_that_of_draws_of_errors_that_are_alike_for_a_while():
    rng, n, steps, sigma = np.random.default_rng(4), 20_000, 60, 0.05
    rho = math.exp(-0.1 / PLAIN.correlation_s)
    error = rng.normal(0.0, sigma, n)
    metres = np.zeros(n)
    for _ in range(steps):
        later = rho * error + math.sqrt(1.0 - rho**2) * rng.normal(0.0, sigma, n)
        metres += 0.05 * (error + later)
        error = later
    result = driven(steps=steps).at(at(steps))
    assert result.covariance_m2 == pytest.approx(metres.var() * np.eye(3), rel=0.04, abs=1e-12)


@pytest.mark.parametrize("correlation_s", [0.3, 1.0, 5.0])
def test_one_step_is_as_unsure_as_the_mean_velocity_and_the_errors_it_keeps(correlation_s):
    rules = DopplerRules(sigma_scale=1.0, sigma_floor_m_s=0.0, correlation_s=correlation_s)
    result = driven(rules, 1).at(at(1)).covariance_m2
    rho = math.exp(-0.1 / correlation_s)
    assert result == pytest.approx(0.5 * 0.1**2 * (1.0 + rho) * 0.05**2 * np.eye(3))


@pytest.mark.parametrize("correlation_s", [0.3, 5.0])
def test_long_after_it_grows_as_twice_the_variance_times_correlation_and_time(correlation_s):
    rules = DopplerRules(sigma_scale=1.0, sigma_floor_m_s=0.0, correlation_s=correlation_s, longest_s=1000.0)
    early, late = (driven(rules, k).at(at(k)).covariance_m2[0, 0] for k in (400, 500))
    assert late - early == pytest.approx(2.0 * 0.05**2 * correlation_s * 10.0, rel=0.02)


def test_where_velocities_become_worse_so_do_the_errors_they_share():
    """The same as if they had been so bad from the beginning, but for what has been summed up already."""
    worse = driven(steps=2, make=lambda k: velocity(k, sigma=0.2 if k == 2 else 0.05)).at(at(2)).covariance_m2
    rho, v, w = math.exp(-0.1), 0.05**2, 0.2**2
    shared = 4.0 * 0.05 * (rho * v + v)  # after the first step, four times worse
    expected = 0.005 * (1.0 + rho) * v + 0.1 * (1.0 + rho) * shared + 0.005 * (1.0 + rho) * 0.5 * (v + w)
    assert worse[0, 0] == pytest.approx(expected)


@pytest.mark.slow
@exactly
@given(st.integers(1, 200), st.floats(0.01, 0.5))
def test_it_grows_faster_than_of_white_errors_and_no_faster_than_of_a_constant_one(steps, sigma):
    def variance(k):
        rules = DopplerRules(sigma_scale=1.0, sigma_floor_m_s=0.0, longest_s=100.0)
        return driven(rules, k, make=lambda i: velocity(i, sigma=sigma)).at(at(k)).covariance_m2[0, 0]

    once, twice = variance(steps), variance(2 * steps)
    assert 2.0 * once * (1.0 - 1e-9) <= twice <= 4.0 * once * (1.0 + 1e-9)
    assert once <= (sigma * 0.1 * steps) ** 2 * (1.0 + 1e-9)


@exactly
@given(st.floats(0.01, 0.5), st.floats(1.0, 5.0), st.integers(1, 40), st.integers(0, 39))
def test_a_worse_velocity_never_shrinks_it(sigma, factor, steps, which):
    def variance(f):
        return (
            driven(steps=steps, make=lambda k: velocity(k, sigma=sigma * (f if k == which else 1.0)))
            .at(at(steps))
            .covariance_m2[2, 2]
        )

    assert variance(factor) >= variance(1.0) * (1.0 - 1e-9)


def test_the_claimed_covariance_is_scaled_and_has_a_floor():
    rules = DopplerRules(sigma_scale=2.0, sigma_floor_m_s=0.1)
    sigma = math.hypot(2.0 * 0.05, 0.1)
    same = driven(steps=10, make=lambda k: velocity(k, sigma=sigma)).at(at(10))
    assert driven(rules, 10).at(at(10)).covariance_m2 == pytest.approx(same.covariance_m2)


def test_between_velocities_it_is_moved_on_and_less_sure():
    position = driven(steps=10)
    result = position.at(at(12))
    assert result.metres == pytest.approx([12.0, 0.0, 0.0])
    assert result.covariance_m2[0, 0] > position.at(at(10)).covariance_m2[0, 0]
    assert position.at(at(9)).metres == pytest.approx([9.0, 0.0, 0.0])


@pytest.mark.parametrize("ahead_s", [0.2, -0.05])
@pytest.mark.parametrize("steps", [0, 1])
def test_between_velocities_it_is_as_unsure_as_the_last_one_and_what_a_vehicle_may_turn_meanwhile(
    steps, ahead_s
):
    """P + |t| (X + Xᵀ) + t² V, and half of a t² with a = 3 m/s²."""
    result = driven(steps=steps).at(at(steps + ahead_s / 0.1))
    if steps == 0 and ahead_s < 0.0:
        assert result is None
        return
    rho, v = math.exp(-0.1), 0.05**2
    p, x = (0.0, 0.0) if steps == 0 else (0.005 * (1.0 + rho) * v, 0.05 * (rho * v + v))
    expected = p + 2.0 * abs(ahead_s) * x + ahead_s**2 * v + (0.5 * 3.0 * ahead_s**2) ** 2
    assert result.covariance_m2 == pytest.approx(expected * np.eye(3))


def test_what_ends_among_the_velocities_that_are_here_already_ends_it():
    position = driven(begin=None, make=lambda k: velocity(k, east=13.0 if k == 40 else 10.0))
    position.begin(at(30))
    assert position.at(at(50)) is None


def test_a_wheel_speed_that_comes_late_is_of_no_use():
    position = DopplerPosition(PLAIN)
    position.add_velocity(velocity(0))
    for k, wheels in ((0, 10.0), (2, 10.0), (1, 100.0)):
        position.add_wheel_speed(at(k), wheels)
    position.begin(at(0))
    position.add_velocity(velocity(1))
    assert position.at(at(1)) is not None


def test_a_velocity_that_claims_to_be_exact_is_as_good_as_the_floor():
    exact = {"covariance_enu_m2_s2": (0.0,) * 6}
    result = driven(DopplerRules(), 1, make=lambda k: velocity(k, **exact)).at(at(1))
    floor = DopplerRules(sigma_scale=1.0, sigma_floor_m_s=0.0)
    same = driven(floor, 1, make=lambda k: velocity(k, sigma=DopplerRules().sigma_floor_m_s)).at(at(1))
    assert result.covariance_m2 == pytest.approx(same.covariance_m2)


def test_one_with_fully_correlated_errors_is_used_too():
    one = 0.05**2 * np.ones(6)
    result = driven(steps=1, make=lambda k: velocity(k, covariance_enu_m2_s2=tuple(one.tolist())))
    assert result.at(at(1)) is not None


def test_wheels_may_be_off_by_a_share_of_the_path():
    """2 %, with no other allowance."""
    rules = DopplerRules(sigma_scale=1.0, sigma_floor_m_s=0.0, path_gate_m=0.0, sigmas=0.0)
    assert driven(rules, wheels=9.85).at(at(50)) is not None
    assert driven(rules, wheels=9.75).at(at(50)) is None


def test_a_verdict_that_comes_late_finds_the_velocities_since():
    position = driven(begin=None)
    position.begin(at(30))
    assert position.at(at(50)).metres == pytest.approx([20.0, 0.0, 0.0])
    position.begin(at(29.5))
    assert position.at(at(50)).metres == pytest.approx([20.5, 0.0, 0.0])
    assert position.at(at(29)) is None


def test_the_first_velocity_may_come_just_after_the_position():
    position = DopplerPosition(PLAIN)
    position.add_velocity(velocity(2))
    position.begin(at(0))
    assert position.at(at(2)).metres == pytest.approx([2.0, 0.0, 0.0])


def test_without_a_velocity_near_the_position_there_is_nothing():
    position = DopplerPosition(PLAIN)
    assert position.at(at(0)) is None
    position.begin(at(0))
    assert position.at(at(0)) is None
    position.add_velocity(velocity(20))
    position.begin(at(0))
    assert position.at(at(20)) is None
    position = driven(begin=None)
    position.begin(at(30))
    assert position.at(at(51)) is not None
    position.add_velocity(velocity(58))
    position.begin(at(30))
    assert position.at(at(58)) is None


def test_it_ends_when_it_is_too_old_or_velocities_pause():
    rules = DopplerRules(longest_s=2.0)
    position = driven(rules, 20)
    assert position.at(at(20)) is not None
    assert position.at(at(21)) is None
    assert driven().at(at(53)) is not None
    assert driven().at(at(53.1)) is None
    paused = driven()
    paused.add_velocity(velocity(53.1))
    assert paused.at(at(53.1)) is None


def test_it_ends_on_demand_and_begins_anew_with_the_next_position():
    position = driven()
    position.end()
    assert position.at(at(50)) is None
    position.add_velocity(velocity(51))
    assert position.at(at(51)) is None
    position.begin(at(51))
    assert position.at(at(51)).metres == pytest.approx([0.0, 0.0, 0.0])


def test_speeds_that_contradict_the_wheels_end_it():
    assert driven(wheels=10.7).at(at(50)) is None
    assert driven(wheels=-10.0).at(at(50)) is not None
    spoofed = driven(make=lambda k: velocity(k, east=10.0 if k < 40 else 13.0))
    assert spoofed.at(at(50)) is None


def test_a_velocity_that_the_wheels_contradict_begins_none():
    wrong = driven(steps=0, make=lambda k: velocity(k, east=7.0))
    assert wrong.at(at(0)) is None
    right_again = driven(steps=3, make=lambda k: velocity(k, east=7.0 if k < 2 else 10.0), begin=2)
    assert right_again.at(at(3)).metres == pytest.approx([1.0, 0.0, 0.0])


@pytest.mark.parametrize(("up", "goes_on"), [(-8.0, False), (-3.0, True), (3.0, True), (8.0, False)])
def test_what_climbs_as_no_road_does_ends_it_and_begins_none(up, goes_on):
    """At 10 m/s a road of 30 % rises by 3 m/s; the gate and 5 σ of 5 cm/s come on top."""
    later = driven(steps=5, make=lambda k: velocity(k, up=up if k == 5 else 0.0))
    assert (later.at(at(5)) is not None) is goes_on
    assert (driven(steps=0, make=lambda k: velocity(k, up=up)).at(at(0)) is not None) is goes_on


def test_what_is_not_known_well_upwards_may_climb_so_much_more():
    def unsure(k):
        return velocity(k, up=-8.0, covariance_enu_m2_s2=(0.0025, 0.0, 0.0, 0.0025, 0.0, 1.0))

    assert driven(steps=2, make=unsure).at(at(2)) is not None


def test_what_began_without_wheels_is_not_checked():
    position = DopplerPosition(PLAIN)
    position.add_velocity(velocity(0))
    position.begin(at(0))
    assert not position.at(at(0)).checked


@pytest.mark.parametrize("axis", [0, 1])
def test_a_larger_sigma_along_an_axis_allows_a_larger_difference(axis):
    variances = [0.0025, 0.0025]
    variances[axis] = 1.0
    covariance = (variances[0], 0.0, 0.0, variances[1], 0.0, 0.0025)
    unsure = driven(steps=2, wheels=8.0, make=lambda k: velocity(k, covariance_enu_m2_s2=covariance))
    assert unsure.at(at(2)) is not None


def test_what_it_rises_by_is_not_driven():
    assert driven(make=lambda k: velocity(k, east=6.0, north=8.0, up=2.0)).at(at(50)) is not None
    assert driven(make=lambda k: velocity(k, east=10.0, north=5.0)).at(at(50)) is None


def test_slips_of_opposite_sign_cancel():
    """Half a metre and 2 % of the way, and 5 σ: for ten seconds 0.3 m/s too fast, then as long too slow."""
    for first in (0.3, -0.3):
        position = driven(steps=0)
        for k in range(1, 201):
            position.add_wheel_speed(at(k), 10.0 + (first if k <= 20 else -first if k <= 40 else 0.0))
            position.add_velocity(velocity(k))
        assert position.at(at(200)) is not None


def test_the_path_goes_on_where_the_wheels_were_silent_for_a_while():
    position = driven(wheels=9.6, steps=20)
    for k in range(21, 200):
        if k > 30:
            position.add_wheel_speed(at(k), 9.6)
        position.add_velocity(velocity(k))
        result = position.at(at(k))
        if result is None:
            break
        assert result.checked is (k <= 23)
    assert position.at(at(199)) is None


def test_a_slow_drag_ends_it_by_the_path():
    assert driven(wheels=9.6, steps=10).at(at(10)) is not None
    assert driven(wheels=9.6, steps=200).at(at(200)) is None


@pytest.mark.parametrize("wheels", [None, 10.0])
def test_without_wheels_all_the_time_it_is_not_checked(wheels):
    position = driven(wheels=wheels)
    for k in range(51, 56):
        position.add_velocity(velocity(k))
    assert not position.at(at(55)).checked


def test_what_is_older_than_the_last_is_of_no_use():
    position = driven()
    position.add_velocity(velocity(49, east=100.0))
    position.add_velocity(velocity(50, east=100.0))
    position.add_wheel_speed(at(49), 100.0)
    position.add_velocity(velocity(51))
    assert position.at(at(51)).metres == pytest.approx([51.0, 0.0, 0.0])


def test_a_velocity_with_an_invalid_covariance_is_ignored():
    position = driven()
    position.add_velocity(velocity(51, east=12.0, covariance_enu_m2_s2=(1.0, 2.0, 0.0, 1.0, 0.0, 1.0)))
    assert position.at(at(51)).metres == pytest.approx([51.0, 0.0, 0.0])


def test_the_yaw_is_that_of_the_heading_or_not_known():
    assert driven(make=lambda k: velocity(k, heading_rad=0.0)).at(at(50)).yaw_rad == pytest.approx(
        math.pi / 2.0
    )
    assert driven(make=lambda k: velocity(k, heading_rad=None)).at(at(50)).yaw_rad is None


def test_what_is_dated_ahead_is_forgotten():
    position = driven()
    position.forget_future(at(60))
    assert position.at(at(50)) is not None
    position.forget_future(at(40))
    assert position.at(at(40)) is None
    position.add_wheel_speed(at(41), 10.0)
    position.add_velocity(velocity(41))
    position.begin(at(41))
    assert position.at(at(41)) is not None


def test_what_is_dated_as_late_as_may_be_is_kept():
    position = driven()
    position.forget_future(at(50))
    assert position.at(at(50)) is not None
    position.add_velocity(velocity(50, east=100.0))
    position.add_wheel_speed(at(50), 100.0)
    position.begin(at(50))
    assert position.at(at(50)).checked


def test_a_wheel_speed_dated_ahead_does_not_keep_out_those_of_now():
    position = driven()
    position.add_wheel_speed(at(70), 10.0)
    position.forget_future(at(50))
    for k in range(51, 60):
        position.add_wheel_speed(at(k), 10.0)
        position.add_velocity(velocity(k))
    assert position.at(at(59)).checked


def test_what_is_kept_is_what_a_late_verdict_needs_and_no_more():
    position = driven(steps=1000, begin=None)
    position.begin(at(980))
    assert position.at(at(1000)).metres == pytest.approx([20.0, 0.0, 0.0])
    position.begin(at(950))
    assert position.at(at(1000)) is None
    assert len(position._velocities) == len(position._speeds) == 32
