"""Velocities from Doppler against the truth of simulated drives, against differences of ranges, and on a rooftop."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.observations import SPEED_OF_LIGHT_M_S, ObservationEpoch, satellite_name
from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.observations.satellite_states import ranges, states_at_transmission
from camber.gnss.position.single_point import single_point
from camber.gnss.velocity.doppler_velocity import DopplerVelocity, doppler_velocity, range_rate_m_s
from camber.simulator.satellites.parameters import ROVER
from camber.simulator.satellites.track import AntennaTrack
from support.canyon_statistics import FIRST_NS, FRAME
from support.engine_drives import of_systems, received, some_rows, store_of, wavelengths_m
from support.gnss_files import read_navigation, read_observations, recording


@functools.cache
def circle(
    seed: int, noise_factor: float = 1.0
) -> tuple[tuple[ObservationEpoch, ...], np.ndarray, EphemerisStore]:
    """A car on a circle of 40 m at 12 m/s for a minute: epochs, true velocities (n, 3), ephemerides."""
    time_ns = FIRST_NS + seed * 7321 * NS_PER_SECOND + np.arange(300) * (NS_PER_SECOND // 5)
    turn = 0.3 * np.arange(300) / 5
    place = np.column_stack((40.0 * np.cos(turn), 40.0 * np.sin(turn), np.full(300, 50.0)))
    velocity = np.column_stack((-12.0 * np.sin(turn), 12.0 * np.cos(turn), np.zeros(300)))
    track = AntennaTrack(time_ns=time_ns, antenna_m=place, antenna_velocity_m_s=velocity)
    epochs, store = received(track, seed, replace(ROVER, noise_factor=noise_factor))
    return epochs, velocity, store


def velocity_of(epoch: ObservationEpoch, store: EphemerisStore) -> DopplerVelocity:
    return doppler_velocity(epoch, single_point(epoch, store))


def satellites(epoch: ObservationEpoch, store: EphemerisStore, rows: np.ndarray) -> list[int]:
    return sorted(single_point(epoch, store).satellite[rows].tolist())


def test_of_a_moving_car_velocities_are_centimetres_a_second_off_and_their_covariances_say_so():
    nees, errors, chi_squared, degrees = [], [], 0.0, 0
    for seed in range(1, 4):
        epochs, truth, store = circle(seed)
        for epoch, true in zip(epochs, truth, strict=True):
            velocity_ = velocity_of(epoch, store)
            assert velocity_.status == "ok"
            error = velocity_.velocity_enu_m_s - true
            errors.append(math.hypot(error[0], error[1]))
            nees.append(error @ np.linalg.solve(velocity_.covariance_enu_m2_s2, error))
            chi_squared += velocity_.chi_squared
            degrees += velocity_.degrees
    assert np.quantile(errors, 0.95) < 0.05
    assert 1.5 < np.mean(nees) < 4.5
    assert 0.5 < chi_squared / degrees < 1.5


def test_without_noise_errors_are_below_a_millimetre_a_second():
    epochs, truth, store = circle(1, 1e-6)
    off = [velocity_of(e, store).velocity_enu_m_s - v for e, v in zip(epochs, truth, strict=True)]
    # The atmosphere's own rates and those of the errors of broadcast orbits.
    assert np.abs(np.mean(off, axis=0)).max() < 2e-3
    assert np.quantile(np.abs(off), 0.95) < 3e-3


def test_a_range_rate_is_the_difference_of_ranges():
    _, _, store = circle(1)
    middle_ns = FIRST_NS + 8000 * NS_PER_SECOND
    satellites = np.unique(store.table.satellite)
    rows = store.rows_at(middle_ns, satellites)
    satellites, rows = satellites[rows >= 0], rows[rows >= 0]
    place = np.array(ecef_from_geodetic_scalar(FRAME.latitude_rad, FRAME.longitude_rad, 50.0))
    velocity = np.array([-3.0, 14.0, 9.0])

    def ranges_at(offset_ns: int) -> np.ndarray:
        """At a true time of reception, by iteration of the travel time."""
        receiver = place + velocity * offset_ns * 1e-9
        pseudorange = np.full(satellites.size, 2.3e7)
        for _ in range(6):
            states = states_at_transmission(store.table, rows, middle_ns + offset_ns, pseudorange)
            distance, _ = ranges(states.position_m, receiver)
            pseudorange = distance - SPEED_OF_LIGHT_M_S * states.clock_s
        return distance

    step_ns = 10**8
    expected = (ranges_at(step_ns) - ranges_at(-step_ns)) / (2e-9 * step_ns)
    pseudorange = ranges_at(0)
    states = states_at_transmission(store.table, rows, middle_ns, pseudorange)
    for _ in range(3):
        code_m = pseudorange - SPEED_OF_LIGHT_M_S * states.clock_s
        states = states_at_transmission(store.table, rows, middle_ns, code_m)
    for k in range(satellites.size):
        direction = np.empty(3)
        standing, slope = range_rate_m_s(states.position_m[k], states.velocity_m_s[k], place, direction)
        velocity_ = standing - direction @ velocity / slope
        assert velocity_ == pytest.approx(expected[k], abs=1e-5), satellite_name(satellites[k])


def test_the_drift_of_the_receivers_clock_is_separated():
    epochs, _, store = circle(2)
    straight = velocity_of(epochs[0], store)
    # A receiver's clock that gains makes all pseudoranges grow: Doppler goes down.
    fast = replace(epochs[0], doppler_hz=epochs[0].doppler_hz - 25.0 / wavelengths_m(epochs[0]))
    velocity_ = velocity_of(fast, store)
    np.testing.assert_allclose(velocity_.velocity_enu_m_s, straight.velocity_enu_m_s, atol=1e-6)
    assert velocity_.clock_drift_m_s - straight.clock_drift_m_s == pytest.approx(25.0, abs=1e-6)


def test_the_rate_of_a_satellites_clock_is_taken_off():
    epochs, _, store = circle(2)
    single = single_point(epochs[0], store)
    straight = doppler_velocity(epochs[0], single)
    chosen = int(np.flatnonzero(straight.used)[3])
    rate = single.states.clock_rate.copy()
    rate[chosen] += 1e-9
    carrier_hz = SPEED_OF_LIGHT_M_S / wavelengths_m(epochs[0])
    of_satellite = carrier_hz * 1e-9 * (epochs[0].satellite == single.satellite[chosen])
    velocity_ = doppler_velocity(
        replace(epochs[0], doppler_hz=epochs[0].doppler_hz + of_satellite),
        replace(single, states=single.states._replace(clock_rate=rate)),
    )
    np.testing.assert_allclose(velocity_.velocity_enu_m_s, straight.velocity_enu_m_s, atol=1e-9)


def test_of_two_codes_of_a_band_the_one_with_the_better_carrier_to_noise_counts():
    epochs, _, store = circle(3)
    rows = np.arange(epochs[4].satellite.size)
    straight = velocity_of(epochs[4], store)
    twice = some_rows(epochs[4], np.concatenate((rows, rows)))
    worse = np.arange(twice.satellite.size) >= rows.size
    for off_hz in (0.0, 300.0):
        levels, doppler = twice.cn0_dbhz - 10.0 * worse, twice.doppler_hz + off_hz * worse
        velocity_ = velocity_of(replace(twice, doppler_hz=doppler, cn0_dbhz=levels), store)
        np.testing.assert_allclose(velocity_.velocity_enu_m_s, straight.velocity_enu_m_s, atol=1e-12)
        np.testing.assert_allclose(velocity_.covariance_enu_m2_s2, straight.covariance_enu_m2_s2, rtol=1e-9)


@settings(derandomize=True, max_examples=20, deadline=None)
@given(st.permutations(range(9)))
def test_the_order_of_rows_does_not_matter(order):
    epochs, _, store = circle(3)
    rows = np.arange(epochs[4].satellite.size)
    straight = velocity_of(epochs[4], store)
    velocity_ = velocity_of(some_rows(epochs[4], np.concatenate([rows[k::9] for k in order])), store)
    np.testing.assert_allclose(velocity_.velocity_enu_m_s, straight.velocity_enu_m_s, atol=1e-9)


@pytest.mark.parametrize("error_m_s", [0.5, -3.0, 400.0])
def test_a_wrong_satellite_is_left_out_and_named(error_m_s):
    for seed in range(1, 4):
        epochs, truth, store = circle(seed)
        straight = velocity_of(epochs[9], store)
        for satellite in satellites(epochs[9], store, straight.used)[::5]:
            late = np.where(epochs[9].satellite == satellite, error_m_s / 0.19, 0.0)
            velocity_ = velocity_of(replace(epochs[9], doppler_hz=epochs[9].doppler_hz + late), store)
            assert satellites(epochs[9], store, velocity_.excluded) == [satellite]
            assert np.abs(velocity_.velocity_enu_m_s - truth[9]).max() < 0.2


def test_two_wrong_satellites_are_left_out_and_named():
    epochs, _, store = circle(2)
    straight = velocity_of(epochs[9], store)
    two = satellites(epochs[9], store, straight.used)[2:-2:15]
    late = np.where(np.isin(epochs[9].satellite, two), 10.0, 0.0)
    velocity_ = velocity_of(replace(epochs[9], doppler_hz=epochs[9].doppler_hz + late), store)
    assert satellites(epochs[9], store, velocity_.excluded) == two


def test_without_doppler_without_satellites_or_without_a_position_there_is_no_velocity():
    epochs, _, store = circle(1)
    epoch = epochs[0]
    blind = velocity_of(replace(epoch, doppler_hz=np.full(epoch.doppler_hz.size, np.nan)), store)
    assert blind.status == "too_few"
    assert velocity_of(some_rows(epoch, np.zeros(0, np.int64)), store).status == "no_position"
    assert velocity_of(epoch, EphemerisStore()).status == "no_position"
    some = np.isin(epoch.satellite, single_point(epoch, store).satellite[:3])
    three = velocity_of(replace(epoch, doppler_hz=np.where(some, epoch.doppler_hz, np.nan)), store)
    assert three.status == "too_few"
    for velocity_ in (blind, three):
        assert np.isnan(velocity_.velocity_enu_m_s).all()
        assert np.isnan(velocity_.hdop)
        assert not velocity_.used.any()


@settings(derandomize=True, max_examples=60, deadline=None)
@given(st.randoms(use_true_random=False), st.integers(0, 80))
def test_whatever_an_epoch_holds_nothing_is_raised(random, count):
    epochs, _, store = circle(1)
    rng = np.random.default_rng(random.randrange(2**32))
    epoch = some_rows(epochs[0], rng.integers(0, epochs[0].satellite.size, count))
    wild = np.array([np.nan, np.inf, -np.inf, 0.0, 1e30, -9e4, 5e3])
    doppler = np.where(rng.random(count) < rng.random(), rng.choice(wild, count), epoch.doppler_hz)
    level = np.where(rng.random(count) < 0.2, rng.choice([np.nan, np.inf, -1e9, 0.0], count), epoch.cn0_dbhz)
    velocity_ = velocity_of(replace(epoch, doppler_hz=doppler, cn0_dbhz=level), store)
    if velocity_.status == "ok":
        assert np.isfinite(velocity_.velocity_enu_m_s).all()
        assert np.isfinite(velocity_.covariance_enu_m2_s2).all()
        assert math.isfinite(velocity_.clock_drift_m_s)
    else:
        assert np.isnan(velocity_.velocity_enu_m_s).all()


@pytest.mark.parametrize("systems", ["GJEC", "GJ"])
def test_on_a_rooftop_95_of_100_velocities_are_within_5_cm_a_second_of_zero(systems):
    folder = recording("rooftop-2024-06-24")
    store = store_of(read_navigation(folder / "base.nav").ephemerides)
    epochs = read_observations(folder / "rover.obs").epochs
    velocity_ = [velocity_of(of_systems(e, systems), store) for e in epochs]
    assert len(velocity_) == 301
    assert all(f.status == "ok" and not f.excluded.any() for f in velocity_)
    speeds = [np.linalg.norm(f.velocity_enu_m_s) for f in velocity_]
    assert np.quantile(speeds, 0.95) < 0.05
