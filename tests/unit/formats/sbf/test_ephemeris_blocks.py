"""Ephemerides of SBF are, bit for bit, those that the same transmitted integers give by any other message."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.broadcast.ephemeris_fields import ephemeris_from_integers, integers_from_ephemeris
from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris
from camber.formats.sbf.reader import SbfDecoder
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from support.glonass_messages import random_glonass_ephemeris
from support.random_observations import random_ephemeris, random_toe_ns
from support.sbf_blocks import GPS_ION, GPS_NAV, NO_FLOAT, ephemeris_block, glonass_block, sbf_block, svid_of
from support.sbf_oracle import parsed

NAMES = ("G05", "G32", "J02", "E11", "E36", "C03", "C19", "C45")
WEEK = 2367
# pysbf2's names of what is the same in all blocks: our attribute, and whether it is an angle in semicircles.
COMMON = {
    "SQRT_A": ("sqrt_a", False), "e": ("eccentricity", False), "C_rs": ("crs_m", False), "C_rc": ("crc_m", False),
    "C_uc": ("cuc", False), "C_us": ("cus", False), "C_ic": ("cic", False), "C_is": ("cis", False),
    "M_0": ("mean_anomaly_rad", True), "OMEGA_0": ("ascending_node_rad", True), "omega": ("perigee_rad", True),
    "i_0": ("inclination_rad", True), "OMEGADOT": ("ascending_node_rate_rad_s", True),
    "IDOT": ("inclination_rate_rad_s", True), "DEL_N": ("mean_motion_difference_rad_s", True),
}  # fmt: skip


def decoded(data: bytes) -> tuple[list, SbfDecoder]:
    decoder = SbfDecoder("test")
    return decoder.feed(data) + decoder.finish(), decoder


def random_case(seed: int, name: str) -> tuple[Ephemeris, int]:
    rng = np.random.default_rng(seed)
    toe_ns = random_toe_ns(rng, name, WEEK)
    ephemeris = random_ephemeris(rng, name, toe_ns)
    if name[0] in "GJ":
        iodc = float(int(ephemeris.other["iodc"]) & 0x300 | ephemeris.iode)
        ephemeris = replace(ephemeris, other={**ephemeris.other, "iodc": iodc})
    return ephemeris, toe_ns + int(rng.integers(-7200, 7200)) * NS_PER_SECOND


@given(st.integers(0, 2**32), st.integers(1, 30))
@settings(derandomize=True, max_examples=60, deadline=None)
def test_an_ephemeris_of_glonass_is_that_of_the_satellite(seed: int, number: int) -> None:
    time_ns = WEEK * NS_PER_WEEK + 200_000 * NS_PER_SECOND
    sent = random_glonass_ephemeris(np.random.default_rng(seed), number, time_ns)
    frame = glonass_block(sent, time_ns)
    (read,), _ = decoded(frame)
    assert replace(read, transmission_ns=sent.transmission_ns) == sent
    message = parsed(frame)
    theirs = [message.X, message.Y, message.Z, message.Dx, message.Dy, message.Dz]
    np.testing.assert_allclose([*read.position_m, *read.velocity_m_s], theirs, rtol=1e-12)
    np.testing.assert_allclose([message.tau, message.gamma], [-read.clock[0], read.clock[1]], rtol=1e-12)
    assert (message.t_oe, message.FreqNr) == (read.toe_ns % NS_PER_WEEK // NS_PER_SECOND, read.channel + 8)


@pytest.mark.parametrize(
    "changes", [{"SVID": 5}, {"SVID": 62}, {"FreqNr": 0}, {"FreqNr": 22}, {"t_oe": 604_800}]
)
def test_an_ephemeris_of_glonass_that_no_satellite_sends_is_malformed(changes: dict[str, int]) -> None:
    time_ns = WEEK * NS_PER_WEEK + 200_000 * NS_PER_SECOND
    sent = random_glonass_ephemeris(np.random.default_rng(1), 5, time_ns)
    results, decoder = decoded(glonass_block(sent, time_ns, **changes))
    assert (results, decoder.messages.malformed) == ([], 1)


@given(st.integers(0, 2**32), st.sampled_from(NAMES))
@settings(derandomize=True, max_examples=200, deadline=None)
def test_ephemeris_is_that_of_the_transmitted_integers(seed: int, name: str) -> None:
    ephemeris, time_ns = random_case(seed, name)
    expected = ephemeris_from_integers(name[0], integers_from_ephemeris(ephemeris), time_ns)
    if name[0] == "E":
        expected = replace(expected, other={**expected.other, "data_sources": 517.0})
    frame = ephemeris_block(ephemeris, time_ns)
    results, _ = decoded(frame)
    # NaN of an accuracy that is not predicted equals itself.
    assert repr(results) == repr([expected])
    message = parsed(frame)
    assert (message.t_oe, message.t_oc) == tuple(
        (t - (14 * NS_PER_SECOND if name[0] == "C" else 0)) % NS_PER_WEEK // NS_PER_SECOND
        for t in (results[0].toe_ns, results[0].toc_ns)
    )
    for block_name, (attribute, is_angle) in COMMON.items():
        value = getattr(message, block_name) * (np.pi if is_angle else 1.0)
        assert getattr(results[0], attribute) == pytest.approx(value, rel=1e-15)
    assert results[0].clock == pytest.approx((message.a_f0, message.a_f1, message.a_f2), rel=1e-15)


def test_sources_of_galileo_have_their_clock_accuracy_and_group_delays() -> None:
    ephemeris, time_ns = random_case(1, "E11")
    inav, fnav = (decoded(ephemeris_block(ephemeris, time_ns, source=source))[0][0] for source in (2, 16))
    assert (inav.other["data_sources"], fnav.other["data_sources"]) == (517.0, 258.0)
    integers = integers_from_ephemeris(ephemeris)
    assert inav.other["bgd_e5b_s"] == integers["bgd_e5b_s"] * 2.0**-32


def test_group_delay_that_is_not_available_is_absent() -> None:
    ephemeris, time_ns = random_case(1, "E11")
    results, _ = decoded(ephemeris_block(ephemeris, time_ns, BGD_L1E5b=NO_FLOAT))
    assert "bgd_e5a_s" in results[0].other
    assert "bgd_e5b_s" not in results[0].other


def test_ionosphere_is_that_of_pysbf2() -> None:
    alpha = {
        f"alpha_{k}": float(v)
        for k, v in enumerate(np.array([14, 3, -1, -2]) * 2.0 ** np.array([-30, -27, -24, -24]))
    }
    beta = {
        f"beta_{k}": float(v)
        for k, v in enumerate(np.array([51, 8, -1, -7]) * 2.0 ** np.array([11, 14, 16, 16]))
    }
    frame = sbf_block(GPS_ION, WEEK * NS_PER_WEEK, PRN=9, **alpha, **beta)
    (result,), _ = decoded(frame)
    assert isinstance(result, IonosphereCoefficients)
    message = parsed(frame)
    assert result.system == "G"
    assert result.alpha == tuple(getattr(message, name) for name in alpha)
    assert result.beta == tuple(getattr(message, name) for name in beta)


@pytest.mark.parametrize(
    "change",
    [
        {"IODE3": 7}, {"SQRT_A": 0.0}, {"t_oe": 604_800}, {"t_oe": 0xFFFFFFFF}, {"M_0": float("nan")}, {"M_0": 1.5},
        {"PRN": 71}, {"PRN": 0}, {"a_f0": NO_FLOAT},
    ],
)  # fmt: skip
def test_impossible_ephemeris_is_malformed(change: dict[str, float]) -> None:
    good = {"PRN": 5, "SQRT_A": 5153.6, "t_oe": 7200, "t_oc": 7200, "IODC": 3, "IODE2": 3, "IODE3": 3}
    results, _ = decoded(sbf_block(GPS_NAV, WEEK * NS_PER_WEEK, **good))
    assert len(results) == 1
    results, decoder = decoded(sbf_block(GPS_NAV, WEEK * NS_PER_WEEK, **good | change))
    assert not results
    assert decoder.messages.malformed == 1


def test_numbers_of_satellites_have_an_inverse() -> None:
    assert [svid_of(ord(name[0]) * 256 + int(name[1:])) for name in NAMES] == [
        5,
        32,
        182,
        81,
        106,
        143,
        159,
        227,
    ]
