"""Orbits and ranges against other ways to compute them."""

import numpy as np
import pytest

from camber.formats.observations import Ephemeris, satellite_name, satellite_number
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK, CalendarTime, gps_ns_from_gpst
from camber.geodesy.local_frame import LocalFrame
from camber.simulator.satellites.constellation import broadcast_ephemerides, true_ephemerides
from camber.simulator.satellites.orbits import (
    EARTH_ROTATION_RAD_S,
    SPEED_OF_LIGHT_M_S,
    OrbitTable,
    newest_in_use,
    satellite_states,
)
from camber.simulator.satellites.ranges import ranges
from camber.simulator.satellites.track import geodetic_track

BEGIN_NS = gps_ns_from_gpst(CalendarTime(2026, 5, 2, 23, 30, 0))  # half an hour before a new week
HOUR_NS = 3600 * NS_PER_SECOND
FRAME = LocalFrame(np.deg2rad(35.17), np.deg2rad(136.9), 0.0)
TRUE = true_ephemerides(BEGIN_NS, BEGIN_NS + 2 * HOUR_NS, 7)


def by_satellite() -> dict[int, list[Ephemeris]]:
    sets: dict[int, list[Ephemeris]] = {}
    for e in TRUE:
        sets.setdefault(e.satellite, []).append(e)
    return sets


def one_position(e: Ephemeris, time_ns: int) -> np.ndarray:
    """Table 20-IV once more, one satellite, with rotation matrices and a bisection for Kepler's equation."""
    system = chr(e.satellite >> 8)
    mu = 3.9860050e14 if system in "GJ" else 3.986004418e14
    omega = 7.292115e-5 if system == "C" else 7.2921151467e-5
    tk = (time_ns - e.toe_ns) * 1e-9
    mean = e.mean_anomaly_rad + (np.sqrt(mu) / e.sqrt_a**3 + e.mean_motion_difference_rad_s) * tk
    low, high = mean - 0.2, mean + 0.2
    for _ in range(80):
        middle = 0.5 * (low + high)
        if middle - e.eccentricity * np.sin(middle) < mean:
            low = middle
        else:
            high = middle
    half = np.sqrt((1 + e.eccentricity) / (1 - e.eccentricity)) * np.tan(0.5 * middle)
    phi = 2.0 * np.arctan(half) + e.perigee_rad
    u = phi + e.cus * np.sin(2 * phi) + e.cuc * np.cos(2 * phi)
    r = e.sqrt_a**2 * (1 - e.eccentricity * np.cos(middle))
    r += e.crs_m * np.sin(2 * phi) + e.crc_m * np.cos(2 * phi)
    i = e.inclination_rad + e.inclination_rate_rad_s * tk + e.cis * np.sin(2 * phi) + e.cic * np.cos(2 * phi)
    toe_of_week = ((e.toe_ns - (14 * NS_PER_SECOND if system == "C" else 0)) % NS_PER_WEEK) * 1e-9
    node = e.ascending_node_rad + e.ascending_node_rate_rad_s * tk - omega * toe_of_week

    def about_z(a: float) -> np.ndarray:
        return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])

    def about_x(a: float) -> np.ndarray:
        return np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])

    inertial = about_z(node) @ about_x(i) @ about_z(u) @ np.array([r, 0.0, 0.0])
    number = e.satellite & 255
    if system == "C" and (number <= 5 or number >= 59):
        inertial = about_x(np.deg2rad(5.0)) @ inertial
    return about_z(-omega * tk) @ inertial


def test_positions_agree_with_the_table_worked_out_one_satellite_at_a_time():
    times = BEGIN_NS + np.array([0, 1800, 5000], np.int64) * NS_PER_SECOND
    states = satellite_states(OrbitTable.of(TRUE), times, np.zeros((3, len(TRUE))))
    for k, e in enumerate(TRUE):
        for j, time_ns in enumerate(times.tolist()):
            expected = one_position(e, time_ns)
            assert states.position_m[j, k] == pytest.approx(expected, abs=2e-3), satellite_name(e.satellite)


def test_velocities_and_clock_rates_are_the_derivatives_of_positions_and_clocks():
    table = OrbitTable.of(TRUE)
    times = np.array([BEGIN_NS], np.int64)
    at, before, after = (satellite_states(table, times, np.full((1, len(TRUE)), s)) for s in (0.0, -1.0, 1.0))
    assert np.max(np.abs((after.position_m - before.position_m) / 2.0 - at.velocity_m_s)) < 1e-4
    assert np.max(np.abs((after.clock_s - before.clock_s) / 2.0 - at.clock_rate)) < 1e-16 / 2 + 1e-15


def test_all_sets_of_a_satellite_describe_one_orbit_and_one_clock_across_the_end_of_the_week():
    times = BEGIN_NS + np.arange(0, 7200, 900, dtype=np.int64) * NS_PER_SECOND
    for sets in by_satellite().values():
        states = satellite_states(OrbitTable.of(sets), times, np.zeros((len(times), len(sets))))
        assert np.max(np.abs(states.position_m - states.position_m[:, :1])) < 1e-5
        assert np.max(np.abs(states.clock_s - states.clock_s[:, :1])) < 1e-15


def test_the_constellations_have_their_sizes_and_orbits():
    numbers = [satellite_name(s)[0] for s in by_satellite()]
    assert {s: numbers.count(s) for s in "GJEC"} == {"G": 31, "J": 4, "E": 26, "C": 39}
    table = OrbitTable.of(newest_in_use(TRUE, BEGIN_NS))
    state = satellite_states(table, np.array([BEGIN_NS]), np.zeros((1, len(table.satellite))))
    radius = np.linalg.norm(state.position_m[0], axis=1)
    for k, s in enumerate(table.satellite.tolist()):
        system, number = chr(s >> 8), s & 255
        if system == "G":
            assert radius[k] == pytest.approx(26560e3, rel=0.02)
        if system == "C" and number <= 5:
            longitude = np.rad2deg(np.arctan2(state.position_m[0, k, 1], state.position_m[0, k, 0]))
            nominal = {1: 140.0, 2: 80.0, 3: 110.5, 4: 160.0, 5: 58.75}
            assert longitude == pytest.approx(nominal[number], abs=0.5)
            assert np.linalg.norm(state.velocity_m_s[0, k]) < 10.0


def test_a_receiver_finds_a_set_of_the_age_it_accepts_at_any_time_of_the_drive():
    oldest = {"G": 2, "J": 2, "E": 4, "C": 6}
    for time_ns in range(BEGIN_NS, BEGIN_NS + 2 * HOUR_NS, HOUR_NS // 4):
        for s, sets in by_satellite().items():
            system = chr(s >> 8)
            ages = [time_ns - e.toe_ns for e in sets]
            usable = [a for a in ages if abs(a) <= oldest[system] * HOUR_NS and (system != "E" or a > 0)]
            assert usable, satellite_name(s)


def test_broadcast_sets_are_metres_off_the_true_ones():
    broadcast = broadcast_ephemerides(TRUE, 7)
    times, zero = np.array([BEGIN_NS]), np.zeros((1, len(TRUE)))
    off = satellite_states(OrbitTable.of(broadcast), times, zero).position_m
    off = off - satellite_states(OrbitTable.of(TRUE), times, zero).position_m
    rms = float(np.sqrt(np.mean(np.sum(off**2, axis=-1))))
    assert 0.5 < rms < 2.0


def test_ranges_solve_the_light_time_equation_and_rates_are_their_derivatives():
    sets = newest_in_use(TRUE, BEGIN_NS)
    table = OrbitTable.of(sets)
    velocity = np.array([[15.0, -7.0, 1.0]])
    place = np.array([[120.0, -340.0, 55.0]])

    def at(seconds: float):
        track = geodetic_track(FRAME, place + seconds * velocity, velocity)
        return ranges(table, (np.array([BEGIN_NS]), np.array([-seconds])), track, FRAME), track

    now, track = at(0.0)
    for k in range(0, len(sets), 9):
        travel = 0.07
        for _ in range(20):
            state = satellite_states(table, np.array([BEGIN_NS]), np.full((1, len(sets)), -travel))
            a = EARTH_ROTATION_RAD_S * travel
            x, y, z = state.position_m[0, k]
            seen = np.array([np.cos(a) * x + np.sin(a) * y, np.cos(a) * y - np.sin(a) * x, z])
            travel = float(np.linalg.norm(seen - track.ecef_m[0])) / SPEED_OF_LIGHT_M_S
        assert now.range_m[0, k] == pytest.approx(travel * SPEED_OF_LIGHT_M_S, abs=1e-4)
    slope = (at(0.5)[0].range_m - at(-0.5)[0].range_m)[0]
    assert np.max(np.abs(slope - now.rate_m_s[0])) < 2e-4


def test_another_seed_moves_the_satellites_a_little():
    other = newest_in_use(true_ephemerides(BEGIN_NS, BEGIN_NS, 8), BEGIN_NS)
    same = newest_in_use(true_ephemerides(BEGIN_NS, BEGIN_NS, 7), BEGIN_NS)
    assert [e.satellite for e in other] == [e.satellite for e in same]
    assert all(
        a.mean_anomaly_rad != b.mean_anomaly_rad
        for a, b in zip(other, same, strict=True)
        if a.satellite != satellite_number("C01")
    )
