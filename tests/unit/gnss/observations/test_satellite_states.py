"""States of satellites against the simulator's own orbits and against their differences."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.observations import SPEED_OF_LIGHT_M_S
from camber.geodesy.ellipsoid import ecef_from_geodetic_scalar, geodetic_from_ecef_scalar
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst
from camber.geodesy.local_frame import LocalFrame
from camber.gnss.observations.satellite_states import (
    EARTH_ROTATION_RAD_S,
    SatelliteStates,
    enu_from_ecef_rotation,
    geodetic,
    ranges,
    states_at_transmission,
)
from camber.simulator.satellites.constellation import true_ephemerides
from camber.simulator.satellites.orbits import OrbitTable, newest_in_use, satellite_states
from support.engine_drives import store_of

BEGIN_NS = gps_ns_from_gpst(CalendarTime(2026, 5, 2, 23, 30, 0))  # half an hour before a new week
HOUR_NS = 3600 * 10**9
TRUE = true_ephemerides(BEGIN_NS, BEGIN_NS + 2 * HOUR_NS, 7)
SATELLITES = np.array(sorted({e.satellite for e in TRUE}))
STORE = store_of(TRUE)
RECEIVER = np.array(ecef_from_geodetic_scalar(math.radians(35.17), math.radians(136.9), 50.0))


def states_at(time_ns: int, pseudorange_m: np.ndarray) -> SatelliteStates:
    rows = STORE.rows_at(time_ns, SATELLITES)
    assert (rows >= 0).all()
    return states_at_transmission(STORE.table, rows, time_ns, pseudorange_m)


@pytest.mark.parametrize("after_s", [0.123456789, 1799.9, 1800.0, 1801.0, 5000.0, 7199.0])
def test_states_are_those_of_the_simulator_at_the_time_of_transmission(after_s):
    time_ns = BEGIN_NS + round(after_s * 1e9)
    pseudorange = np.random.default_rng(3).uniform(1.9e7, 4.2e7, SATELLITES.size)
    states = states_at(time_ns, pseudorange)
    table = OrbitTable.of(newest_in_use(TRUE, time_ns))
    assert table.satellite.tolist() == SATELLITES.tolist()
    sent_s = -pseudorange / SPEED_OF_LIGHT_M_S
    for _ in range(4):
        expected = satellite_states(table, np.array([time_ns]), sent_s[None])
        sent_s = -pseudorange / SPEED_OF_LIGHT_M_S - expected.clock_s[0]
    np.testing.assert_allclose(states.position_m, expected.position_m[0], atol=1e-6, rtol=0)
    np.testing.assert_allclose(states.velocity_m_s, expected.velocity_m_s[0], atol=1e-9, rtol=0)
    np.testing.assert_allclose(states.clock_s, expected.clock_s[0], atol=1e-16, rtol=0)
    np.testing.assert_allclose(states.clock_rate, expected.clock_rate[0], atol=1e-22, rtol=0)


def test_velocities_and_clock_rates_are_the_differences_of_positions_and_clocks():
    pseudorange = np.full(SATELLITES.size, 2.5e7)
    middle_ns, step_ns = BEGIN_NS + HOUR_NS // 3, 10**8
    before, at, after = (states_at(middle_ns + d, pseudorange) for d in (-step_ns, 0, step_ns))
    # Times of transmission are 1 − clock rate as far apart as those of reception.
    step_s = 2e-9 * step_ns * (1.0 - at.clock_rate)
    velocity = (after.position_m - before.position_m) / step_s[:, None]
    np.testing.assert_allclose(at.velocity_m_s, velocity, atol=1e-6, rtol=0)
    np.testing.assert_allclose(at.clock_rate, (after.clock_s - before.clock_s) / step_s, atol=1e-15, rtol=0)


@pytest.mark.parametrize("wrong_m", [np.nan, np.inf, -np.inf, 1e12])
def test_without_a_row_or_a_pseudorange_a_state_is_nan_and_the_others_stand(wrong_m):
    rows = STORE.rows_at(BEGIN_NS, SATELLITES[:6]).copy()
    rows[1], rows[2], rows[3] = -1, 10**9, -(2**62)
    pseudorange = np.full(6, 2.3e7)
    pseudorange[4] = wrong_m
    states = states_at_transmission(STORE.table, rows, BEGIN_NS, pseudorange)
    for column in states:
        assert np.isnan(column[1:5]).all()
        assert np.isfinite(column[[0, 5]]).all()


def test_no_satellite_at_all_gives_empty_columns():
    none = np.zeros(0, np.int64)
    states = states_at_transmission(STORE.table, none, BEGIN_NS, np.zeros(0))
    assert [c.shape for c in states] == [(0, 3), (0, 3), (0,), (0,), (0,)]
    assert [c.shape for c in ranges(states.position_m, RECEIVER)] == [(0,), (0, 3)]
    empty = store_of([])
    rows, codes = empty.rows_at(BEGIN_NS, SATELLITES), np.full(SATELLITES.size, 2e7)
    assert np.isnan(states_at_transmission(empty.table, rows, BEGIN_NS, codes).position_m).all()


def test_a_range_closes_the_light_time_in_an_inertial_frame():
    states = states_at(BEGIN_NS, np.full(SATELLITES.size, 2.3e7))
    distance, direction = ranges(states.position_m, RECEIVER)
    for k in range(SATELLITES.size):
        travel_s = 0.0
        for _ in range(10):
            a = EARTH_ROTATION_RAD_S * travel_s
            turn = np.array([[math.cos(a), math.sin(a), 0], [-math.sin(a), math.cos(a), 0], [0, 0, 1]])
            line = turn @ states.position_m[k] - RECEIVER
            travel_s = float(np.linalg.norm(line)) / SPEED_OF_LIGHT_M_S
        assert distance[k] == pytest.approx(travel_s * SPEED_OF_LIGHT_M_S, abs=1e-6)
        np.testing.assert_allclose(direction[k], line / np.linalg.norm(line), atol=1e-13)


@settings(derandomize=True, max_examples=200)
@given(st.floats(-math.pi / 2, math.pi / 2), st.floats(-math.pi, math.pi), st.floats(-1e4, 3e7))
def test_the_compiled_place_is_that_of_the_geodesy(latitude, longitude, height):
    ecef = ecef_from_geodetic_scalar(latitude, longitude, height)
    expected = geodetic_from_ecef_scalar(*ecef)
    antenna = geodetic(np.array(ecef))
    assert antenna[0] == pytest.approx(expected[0], abs=1e-15)
    assert math.cos(antenna[1] - expected[1]) == pytest.approx(1.0, abs=1e-15)
    assert antenna[2] == pytest.approx(expected[2], abs=1e-8)
    rotation = LocalFrame(antenna[0], antenna[1], 0.0).enu_from_ecef_rotation()
    np.testing.assert_allclose(enu_from_ecef_rotation(antenna[0], antenna[1]), rotation, atol=1e-15)


@pytest.mark.parametrize(
    "place", [(0.0, 0.0, 0.0), (math.nan, 0.0, 6.4e6), (math.inf, 0.0, 0.0), (1e6, 1e6, 1e6)]
)
def test_no_receiver_is_at_the_centre_of_the_earth_or_nowhere(place):
    assert all(map(math.isnan, geodetic(np.array(place))))
