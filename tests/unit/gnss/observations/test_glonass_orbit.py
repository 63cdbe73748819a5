"""States of GLONASS satellites against another integrator, RTKLIB, and the next sets that the satellites send."""

import re
import subprocess
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from camber.formats.observations import GlonassEphemeris, satellite_number
from camber.geodesy.gps_time import CalendarTime, gps_ns_from_gpst, gps_ns_from_utc
from camber.gnss.observations.ephemeris_store import (
    OLDEST_NS,
    EphemerisStore,
    group_delays_s,
    is_healthy,
    refusal,
)
from camber.gnss.observations.glonass_orbit import integrate_state
from camber.gnss.observations.satellite_states import states_at_transmission
from support.glonass_messages import random_glonass_ephemeris
from support.gnss_files import read_navigation, recording
from support.rtklib_runs import RNX2RTKP

NOW_NS = gps_ns_from_utc(CalendarTime(2026, 5, 2, 9, 0, 0))
OMEGA = np.array([0.0, 0.0, 7.292115e-5])
HALF_HOUR_NS = 1800 * 10**9
_RS = re.compile(
    r"(\d+)/(\d+)/(\d+) (\d+):(\d+):(\d+)\.(\d{6}) sat=(\d+) rs=(.{13}) (.{13}) (.{13}) dts=(.{12})"
)


def ephemeris(seed: int, **changed: object) -> GlonassEphemeris:
    return replace(random_glonass_ephemeris(np.random.default_rng(seed), 5, NOW_NS), health=0, **changed)


def rates(_: float, state: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Gravity as the gradient of its potential, and the forces of a turning frame, as vectors."""
    gravity, radius_m, j2 = 3.986004418e14, 6_378_136.0, 1.08262575e-3
    place, velocity = state[:3], state[3:]
    r = np.linalg.norm(place)
    axis = np.array([0.0, 0.0, 1.0])
    sine = place[2] / r
    # U = μ/r (1 − J₂ (a/r)² (3 sin² φ − 1)/2)
    share = j2 * (radius_m / r) ** 2
    field = (
        -gravity / r**3 * place * (1.0 - 1.5 * share * (5.0 * sine**2 - 1.0))
        - (3.0 * gravity * share * sine / r**2) * axis
    )
    turning = -2.0 * np.cross(OMEGA, velocity) - np.cross(OMEGA, np.cross(OMEGA, place))
    return np.concatenate([velocity, field + turning + acceleration])


@given(st.integers(0, 2**32), st.floats(-1800.0, 1800.0))
@settings(derandomize=True, max_examples=25, deadline=None)
def test_positions_and_velocities_are_those_of_another_integrator(seed, since_s):
    e = ephemeris(seed)
    state = np.array([*e.position_m, *e.velocity_m_s, *e.acceleration_m_s2])
    position, velocity = np.empty(3), np.empty(3)
    integrate_state(state, since_s, position, velocity)
    span, how = (0.0, since_s), {"method": "DOP853", "rtol": 1e-13, "atol": 1e-9}
    other = solve_ivp(rates, span, state[:6], args=(state[6:],), **how).y[:, -1]
    # Any velocity, also such as no orbit has.
    np.testing.assert_allclose(position, other[:3], atol=5e-3, rtol=0)
    np.testing.assert_allclose(velocity, other[3:], atol=1e-5, rtol=0)


def of_recording(name: str) -> list[GlonassEphemeris]:
    everything = read_navigation(recording(name)).ephemerides
    sets = [e for e in everything if isinstance(e, GlonassEphemeris) and is_healthy(e)]
    return sorted(sets, key=lambda e: (e.satellite, e.toe_ns))


def state_of(e: GlonassEphemeris, time_ns: int):
    store = EphemerisStore()
    assert store.add(e) is None
    return states_at_transmission(store.table, np.array([0]), time_ns, np.zeros(1))


@pytest.mark.parametrize("name", ["rooftop-2024-06-24/base.nav", "nagoya-2023-07-11/base.nav"])
def test_sets_half_an_hour_apart_agree_to_metres_in_the_middle(name):
    """As well as the system knows its orbits; without the moon and the sun it would be 3 m more, without J₂ 1 km."""
    apart_m = []
    for one, other in pairwise(of_recording(name)):
        if one.satellite == other.satellite and other.toe_ns - one.toe_ns == HALF_HOUR_NS:
            middle_ns = one.toe_ns + HALF_HOUR_NS // 2
            a, b = state_of(one, middle_ns), state_of(other, middle_ns)
            apart_m.append(np.linalg.norm(a.position_m - b.position_m))
            assert np.linalg.norm(a.velocity_m_s - b.velocity_m_s) < 0.01
    assert len(apart_m) >= 8
    assert np.median(apart_m) < 1.0
    assert max(apart_m) < 4.0


@pytest.mark.skipif(RNX2RTKP is None, reason="rnx2rtkp of RTKLIB is not installed")
def test_positions_and_clocks_are_those_of_rtklib(tmp_path):
    folder = recording("rooftop-2024-06-24")
    options = "pos1-posmode=single\npos1-navsys=4\npos1-elmask=0\npos1-ionoopt=off\npos1-tropopt=off\n"
    (tmp_path / "options.conf").write_text(options)
    command = [RNX2RTKP, "-k", "options.conf", "-x", "4", "-ti", "30", "-o", "out.pos"]
    files = [str(folder / "rover.obs"), str(folder / "base.nav")]
    subprocess.run([*command, *files], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    store = EphemerisStore()
    for e in of_recording("rooftop-2024-06-24/base.nav"):
        store.add(e)
    compared = 0
    for line in _RS.finditer((tmp_path / "out.pos.trace").read_text("latin-1")):
        *date, microsecond, number, x, y, z, clock_ns = line.groups()
        satellite = satellite_number(f"R{int(number) - 32:02d}")
        clock_s = float(clock_ns) * 1e-9
        sent_ns = gps_ns_from_gpst(CalendarTime(*map(int, date), int(microsecond) * 1000))
        row = store.rows_at(sent_ns, np.array([satellite]))
        if row[0] < 0:
            continue
        state = states_at_transmission(store.table, row, sent_ns + round(clock_s * 1e9), np.zeros(1))
        assert state.clock_s[0] == pytest.approx(clock_s, abs=1e-12)
        # The time has microseconds, in which a satellite moves 4 mm.
        assert np.linalg.norm(state.position_m[0] - [float(x), float(y), float(z)]) < 0.01
        compared += 1
    assert compared > 50


def test_a_clock_runs_as_broadcast_and_the_channel_is_that_of_the_set():
    e = ephemeris(3, clock=(1e-4, 1e-11), channel=-5)
    state = state_of(e, e.toe_ns + 600 * 10**9)
    assert state.clock_s[0] == pytest.approx(1e-4 + 600e-11, abs=1e-18)
    assert (state.clock_rate[0], state.channel[0]) == (1e-11, -5.0)


def test_a_set_is_used_for_half_an_hour_and_unhealthy_ones_are_not():
    e = ephemeris(1)
    satellite = np.array([e.satellite])
    store = EphemerisStore()
    store.add(e)
    for off_ns, row in ((OLDEST_NS["R"], 0), (OLDEST_NS["R"] + 1, -1), (-OLDEST_NS["R"] - 1, -1)):
        assert store.rows_at(e.toe_ns + off_ns, satellite).tolist() == [row]
    assert store.add(replace(e, toe_ns=e.toe_ns + HALF_HOUR_NS, health=1)) == "unhealthy"
    assert store.missing(e.toe_ns + HALF_HOUR_NS, satellite) == {"R05": "unhealthy"}


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"position_m": (1e7, 0.0, 0.0)}, "orbit"), ({"velocity_m_s": (7e3, 0.0, 0.0)}, "orbit"),
        ({"acceleration_m_s2": (1.0, 0.0, 0.0)}, "orbit"), ({"position_m": (np.nan, 0.0, 0.0)}, "not_finite"),
        ({"clock": (0.2, 0.0)}, "clock"), ({"channel": 14}, "clock"), ({"satellite": 0x4705}, "system"),
        ({"satellite": ord("R") * 256}, "system"), ({"transmission_ns": 1}, "times"),
    ],
)  # fmt: skip
def test_what_no_satellite_sends_is_refused(changed, reason):
    assert refusal(ephemeris(1)) is None
    assert refusal(replace(ephemeris(1), **changed)) == reason


def test_the_clock_is_that_of_l1():
    assert group_delays_s(ephemeris(1, group_delay_s=3e-9)) == {"1": 0.0, "2": 3e-9}
    assert group_delays_s(ephemeris(1, group_delay_s=float("nan"))) == {"1": 0.0}
