"""RXM-SFRBX: ephemerides decoded from encoded subframes, and from those recorded from a receiver."""

from __future__ import annotations

import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyubx2 import UBXReader

from camber.formats.broadcast.beidou_d1_d2 import FIELDS_AND_IONOSPHERE, decode_d1_subframe, decode_d2_page
from camber.formats.broadcast.bit_fields import combine_parts
from camber.formats.broadcast.ephemeris_fields import FIELDS, integers_from_ephemeris
from camber.formats.broadcast.galileo_inav import decode_inav_page
from camber.formats.broadcast.gps_lnav import add_parity, decode_lnav_subframe
from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import Ephemeris, satellite_name, satellite_number
from camber.formats.ubx.reader import UbxDecoder
from camber.formats.ubx.subframe_schedule import Subframe, subframes_between
from camber.formats.ubx.writer import format_subframe, ubx_frame
from support.random_observations import SECOND_NS, WEEK_NS, random_ephemeris

NAMES = ("G01", "G32", "J03", "E07", "E36", "C06", "C30", "C46", "C01", "C05", "C59", "C63")
GEOSTATIONARY = ("01", "05", "59", "63")
SEEDS, WEEKS = st.integers(0, 2**32), st.integers(1400, 3900)
# Sent by a ZED-X20P: examples in the tests of libgnss++, from rtklibexplorer/GNSS_IMU, drive_0708 (BSD).
RECEIVED = {
    "G10": "B56202133000000A00000A3C02001846C122D849CC131A006414409BA58E90EE2D28B2A6992E71C1D69A30F1CE90FDE93F00F49E6"
    "8B05A35",
    "E04": "B562021328000204010008590200C8CF0501760ED2136F2F260000C004AA88D3D9B02A61F7434154AAAA00C04AFD7808",
    "C27": "B56202133000031B04000A2C0200BE139038B510A0187E75F407265FBD31C0FF1E1529CF033E257F313F0A2000001C40E7328361B2"
    "028CEB",
}
# GPS L5 CNAV, Galileo E5a F/NAV, BeiDou B1C B-CNAV1 of the same receiver.
OTHER_MESSAGES = (
    "B56202133000001206000A010200F2E4498B76ED72F9A144635501303A8082FE0FEEE07FFCCFFEFF030AF9FF0931E2070046A1B4C86801A4",
    "B5620213280002130300081D0200FC5C3005C82A4180FD500C00A00319AD8AF381394AC6768C43AAAAAA00000C4054F6",
    "B56202132C0003310600094D0200BCCA1E09A563FE380067F1FF7859FA9ABC1E7802A02F0A000000007052AC00001728A9696602",
)


def consistent_ephemeris(rng: np.random.Generator, name: str, toe_ns: int) -> Ephemeris:
    """An ephemeris with consistent issues of data."""
    ephemeris = random_ephemeris(rng, name, toe_ns)
    if "iodc" in ephemeris.other:
        iodc = float(int(rng.integers(0, 4)) << 8 | ephemeris.iode)
        return replace(ephemeris, other={**ephemeris.other, "iodc": iodc})
    return ephemeris


def toe_near(name: str, time_ns: int) -> int:
    offset_ns = 14 * SECOND_NS if name[0] == "C" else 0
    return time_ns - time_ns % (7200 * SECOND_NS) + offset_ns


def frames(ephemeris: Ephemeris, from_ns: int, seconds: int = 30) -> list[bytes]:
    return [format_subframe(s) for s in subframes_between(ephemeris, from_ns, from_ns + seconds * SECOND_NS)]


def words_of(frame: bytes) -> tuple[int, ...]:
    return struct.unpack(f"<{frame[10]}I", frame[14:-2])


def assert_same(decoded: Ephemeris, sent: Ephemeris) -> None:
    """The same integers are broadcast: equal within the resolution of each field."""
    assert (decoded.satellite, decoded.toe_ns, decoded.toc_ns) == (sent.satellite, sent.toe_ns, sent.toc_ns)
    integers, expected = integers_from_ephemeris(decoded), integers_from_ephemeris(sent)
    if chr(sent.satellite >> 8) == "E":
        # I/NAV does not say anything of E5a.
        for name in ("e5a_invalid", "e5a_health"):
            del integers[name], expected[name]
        assert decoded.other["data_sources"] == 517.0
    assert integers == expected


@given(SEEDS, st.sampled_from(NAMES), WEEKS, st.integers(0, 604_799))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_ephemeris_is_decoded_once_per_frame(seed, name, week, second):
    rng = np.random.default_rng(seed)
    begin_ns = week * WEEK_NS + second * SECOND_NS
    sent = consistent_ephemeris(rng, name, toe_near(name, begin_ns))
    near_ns = begin_ns + int(rng.integers(-3, 4)) * 86_400 * SECOND_NS // 2
    decoder = UbxDecoder("port", near_ns)
    # BeiDou's parts have to be of one period: two of them hold a whole one.
    decoded = [decoder.feed(frame) for frame in frames(sent, begin_ns, 60)]
    ephemerides = [result for results in decoded for result in results]
    whole = {1, 2} if name[0] == "C" else {2}
    assert len(ephemerides) in whole
    for ephemeris in ephemerides:
        assert_same(ephemeris, sent)
        assert ephemeris.transmission_ns == near_ns
    assert (decoder.messages.bad_subframes, decoder.messages.not_read) == (0, 0)


@given(SEEDS)
@settings(derandomize=True, max_examples=20, deadline=None)
def test_satellites_are_separate_and_lost_subframes_are_awaited(seed):
    rng = np.random.default_rng(seed)
    begin_ns = 2300 * WEEK_NS + 302_400 * SECOND_NS + 14 * SECOND_NS
    sent = {name: consistent_ephemeris(rng, name, toe_near(name, begin_ns)) for name in NAMES}
    subframes = sorted(
        (s for e in sent.values() for s in subframes_between(e, begin_ns, begin_ns + 120 * SECOND_NS)),
        key=lambda subframe: subframe.end_ns,
    )
    kept = [s for s in subframes if rng.random() < 0.97]
    decoder = UbxDecoder("port", begin_ns)
    for subframe in kept:
        for result in decoder.feed(format_subframe(subframe)):
            assert_same(result, sent[satellite_name(result.satellite)])
    assert decoder.messages.bad_subframes == 0


@pytest.mark.parametrize("name", ["G07", "J02", "E11"])
def test_parts_of_two_issues_are_not_combined(name):
    rng = np.random.default_rng(5)
    begin_ns = 2300 * WEEK_NS + 302_400 * SECOND_NS
    old = replace(random_ephemeris(rng, name, begin_ns), iode=10)
    new = replace(random_ephemeris(rng, name, begin_ns), iode=11)
    if name[0] != "E":
        old = replace(old, other={**old.other, "iodc": 10.0})
        new = replace(new, other={**new.other, "iodc": 11.0})
    first, then = frames(old, begin_ns), frames(new, begin_ns + 30 * SECOND_NS)
    half = len(first) // 2 + (name[0] != "E")
    decoder = UbxDecoder("port", begin_ns)
    # All parts are there, and they are of two issues.
    assert [r for frame in (*first[:half], *then[half:]) for r in decoder.feed(frame)] == []
    decoded = [r for frame in frames(new, begin_ns + 60 * SECOND_NS)[:half] for r in decoder.feed(frame)]
    assert [result.iode for result in decoded] == [11]
    assert_same(decoded[0], new)


@pytest.mark.parametrize("name", ["C20", "C03"])
def test_beidou_parts_of_two_periods_are_not_combined(name):
    begin_ns = 2300 * WEEK_NS + (302_400 + 14) * SECOND_NS
    old, new = (
        random_ephemeris(np.random.default_rng(seed), name, toe_near(name, begin_ns)) for seed in (1, 2)
    )
    first, then = frames(old, begin_ns), frames(new, begin_ns + 30 * SECOND_NS)
    decoder = UbxDecoder("port", begin_ns)
    assert [r for frame in first[:-1] for r in decoder.feed(frame)] == []
    assert [r for frame in then[-1:] for r in decoder.feed(frame)] == []
    decoded = [r for frame in frames(new, begin_ns + 60 * SECOND_NS) for r in decoder.feed(frame)]
    assert len(decoded) == 1
    assert_same(decoded[0], new)


@pytest.mark.parametrize("name", NAMES)
def test_repeated_subframes_are_harmless(name):
    begin_ns = 2300 * WEEK_NS + 302_400 * SECOND_NS + 14 * SECOND_NS
    sent = consistent_ephemeris(np.random.default_rng(6), name, toe_near(name, begin_ns))
    sent_frames = frames(sent, begin_ns, 60)
    decoder = UbxDecoder("port", begin_ns)
    decoded = [e for frame in sent_frames for e in decoder.feed(frame + frame)]
    decoded += [e for frame in sent_frames + sent_frames for e in decoder.feed(frame)]
    assert len(decoded) >= 3
    for ephemeris in decoded:
        assert_same(ephemeris, sent)
    assert decoder.messages.bad_subframes == 0


@given(SEEDS, st.sampled_from(NAMES))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_word_with_a_wrong_bit_is_never_used(seed, name):
    rng = np.random.default_rng(seed)
    begin_ns = 2300 * WEEK_NS + 302_400 * SECOND_NS
    sent = consistent_ephemeris(rng, name, toe_near(name, begin_ns))
    subframe = subframes_between(sent, begin_ns, begin_ns + 30 * SECOND_NS)[0]
    place, bit = int(rng.integers(0, len(subframe.words))), int(rng.integers(0, 30))
    words = list(subframe.words)
    words[place] ^= 1 << bit
    decoder = UbxDecoder("port", begin_ns)
    decoder.feed(format_subframe(replace(subframe, words=tuple(words))))
    read = {"E": decode_inav_page, "C": decode_d2_page if name[1:] in GEOSTATIONARY else decode_d1_subframe}
    if decoder.messages.bad_subframes == 0:
        # Tail, fill and reserved bits have no check, and nothing stands in them.
        assert name[0] in "EC"
        assert read[name[0]](words) == read[name[0]](subframe.words)


def test_recorded_words_equal_those_of_pyubx2():
    for name, text in RECEIVED.items():
        frame = bytes.fromhex(text)
        message = UBXReader.parse(frame)
        words = tuple(getattr(message, f"dwrd_{k:02d}") for k in range(1, message.numWords + 1))
        assert words == words_of(frame)
        # July 2025: week 2374, reference times of whole hours, clocks within a millisecond.
        if name[0] == "G":
            number, fields = decode_lnav_subframe(words)
            integers = combine_parts([fields], FIELDS["G"])
            assert (number, integers["toc_s"] * 16 % 7200, integers["week"]) == (1, 0, 2374 % 1024)
            assert abs(integers["af0_s"] * 2.0**-31) < 1e-3
        elif name[0] == "E":
            number, fields = decode_inav_page(words)
            integers = combine_parts([fields], FIELDS["E"])
            assert (number, integers["sqrt_a"] * 2.0**-19) == (1, pytest.approx(5440.6, abs=0.1))
            assert integers["eccentricity"] * 2.0**-33 < 0.001
        else:
            part = decode_d1_subframe(words)
            integers = combine_parts([part.fields], FIELDS_AND_IONOSPHERE)
            assert (part.number, part.second % 30, integers["week"]) == (1, 0, 2374 - 1356)
            assert (integers["toc_s"] * 8 % 3600, abs(integers["af0_s"] * 2.0**-33) < 1e-3) == (0, True)


def test_other_navigation_messages_are_counted():
    decoder = UbxDecoder("port", 2300 * WEEK_NS)
    for text in OTHER_MESSAGES:
        assert decoder.feed(bytes.fromhex(text)) == []
    assert (decoder.messages.not_read, decoder.messages.bad_subframes) == (3, 0)
    navic = ubx_frame(0x02, 0x13, bytes([7, 3, 0, 8, 4, 0, 2, 0]) + bytes(16))
    assert decoder.feed(navic) == []
    assert decoder.messages.not_read == 4


ALPHA, BETA = (9, -3, -1, 2), (44, -2, -3, 1)


def ionosphere_page(name: str, sv_id: int = 56) -> bytes:
    coefficients = [value & 255 for value in (*ALPHA, *BETA)]
    bits = (0b01 << 6 | sv_id) << 64 | int.from_bytes(bytes(coefficients), "big")
    body = bits << 192 - 72
    data = [0x8B << 16, 100 << 7 | 4 << 2, *((body >> 192 - 24 * k) & 0xFFFFFF for k in range(1, 9))]
    words = tuple(add_parity(data))
    return format_subframe(Subframe(end_ns=0, satellite=satellite_number(name), signal_id=0, words=words))


def test_ionosphere_is_decoded_from_page_18_of_subframe_4():
    decoder = UbxDecoder("port", 2300 * WEEK_NS)
    steps = (2.0**-30, 2.0**-27, 2.0**-24, 2.0**-24, 2.0**11, 2.0**14, 2.0**16, 2.0**16)
    values = [value * step for value, step in zip((*ALPHA, *BETA), steps, strict=True)]
    assert decoder.feed(ionosphere_page("G05")) == [
        IonosphereCoefficients(system="G", alpha=tuple(values[:4]), beta=tuple(values[4:]))
    ]
    # Of QZSS it is for Japan, of another page something else.
    assert decoder.feed(ionosphere_page("J02") + ionosphere_page("G05", 25)) == []
    assert decoder.messages.bad_subframes == 0


def test_beidou_ionosphere_is_decoded_from_subframe_1():
    decoder = UbxDecoder("port", 2374 * WEEK_NS)
    (decoded,) = decoder.feed(bytes.fromhex(RECEIVED["C27"]))
    assert isinstance(decoded, IonosphereCoefficients)
    # Amplitudes of some tens of ns, periods of about a day, as the model's document expects them.
    assert decoded.system == "C"
    assert 1e-9 < decoded.alpha[0] < 1e-7
    assert 72_000 < decoded.beta[0] < 172_800


def test_subframes_without_time_are_counted():
    sent = consistent_ephemeris(np.random.default_rng(1), "G05", 2300 * WEEK_NS)
    decoder = UbxDecoder("port")
    for frame in frames(sent, 2300 * WEEK_NS):
        assert decoder.feed(frame) == []
    assert decoder.messages.without_time == 3


@given(SEEDS, st.integers(0, 16), st.sampled_from([0, 2, 3, 5]), st.integers(0, 12))
@settings(derandomize=True, max_examples=300, deadline=None)
def test_random_words_yield_no_ephemeris(seed, count, gnss_id, signal_id):
    rng = np.random.default_rng(seed)
    payload = bytes([gnss_id, int(rng.integers(0, 256)), signal_id, 0, count, 0, 2, 0]) + rng.bytes(4 * count)
    decoder = UbxDecoder("port", 2300 * WEEK_NS)
    assert decoder.feed(ubx_frame(0x02, 0x13, payload)) == []
    assert decoder.messages.bad_subframes + decoder.messages.not_read == 1
    assert decoder.feed(ubx_frame(0x02, 0x13, payload[:-1])) == []
    assert decoder.messages.malformed == 1


def test_orbit_of_zeros_is_refused():
    begin_ns = 2300 * WEEK_NS
    sent = replace(consistent_ephemeris(np.random.default_rng(1), "E05", begin_ns), sqrt_a=0.0)
    decoder = UbxDecoder("port", begin_ns)
    assert [r for frame in frames(sent, begin_ns) for r in decoder.feed(frame)] == []
    assert decoder.messages.bad_subframes == 1


def test_accuracy_without_prediction_is_nan():
    sent = replace(consistent_ephemeris(np.random.default_rng(1), "G05", 2300 * WEEK_NS), accuracy_m=math.nan)
    decoder = UbxDecoder("port", 2300 * WEEK_NS)
    (decoded,) = [r for frame in frames(sent, 2300 * WEEK_NS) for r in decoder.feed(frame)]
    assert math.isnan(decoded.accuracy_m)
