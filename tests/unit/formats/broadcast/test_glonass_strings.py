"""GLONASS' ephemerides from strings, RTCM 1020 and RINEX, against a second implementation, pyrtcm and RTKLIB."""

import math
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyrtcm import RTCMReader

from camber.formats.broadcast.glonass_strings import decode_string
from camber.formats.broadcast.glonass_time import gps_ns_of_day_number, gps_ns_of_week_day
from camber.formats.observations import SPEED_OF_LIGHT_M_S, GlonassEphemeris
from camber.formats.rinex.navigation_reader import NavigationDecoder
from camber.formats.rtcm.reader import RtcmDecoder
from camber.formats.rtcm.writer import rtcm_frame
from camber.formats.ubx.reader import UbxDecoder
from camber.formats.ubx.writer import format_raw_measurements
from camber.geodesy.gps_time import (
    NS_PER_DAY,
    NS_PER_SECOND,
    CalendarTime,
    gps_ns_from_gpst,
    gps_ns_from_utc,
    gpst_from_gps_ns,
)
from support.glonass_messages import (
    glonass_navigation_text,
    glonass_strings,
    message_1020,
    random_glonass_ephemeris,
    string_message,
    string_words,
)
from support.gnss_files import recording
from support.random_msm import any_msm
from support.random_observations import random_epoch

NOW_NS = gps_ns_from_utc(CalendarTime(2026, 5, 2, 9, 0, 0))
SEEDS = st.integers(0, 2**32)
CONVBIN = shutil.which("convbin")
LARGEST_DAY = 1461


def frames_of(e: GlonassEphemeris, day: int | None = None) -> list[bytes]:
    return [string_message(words, e) for words in glonass_strings(e, day)]


@given(SEEDS, st.integers(1, 24))
@settings(derandomize=True, max_examples=100, deadline=None)
def test_strings_and_message_1020_contain_the_ephemeris(seed, number):
    sent = random_glonass_ephemeris(np.random.default_rng(seed), number, NOW_NS)
    assert UbxDecoder("port", NOW_NS).feed(b"".join(frames_of(sent))) == [sent]
    assert UbxDecoder("port", NOW_NS).feed(b"".join(frames_of(sent, day=0)))[0].toe_ns == sent.toe_ns
    assert RtcmDecoder(NOW_NS).feed(message_1020(sent)) == [sent]
    # The number of the day says which of four years, so that the time need not be known well.
    assert RtcmDecoder(NOW_NS + 200 * 86400 * NS_PER_SECOND).feed(message_1020(sent)) == [sent]


@pytest.mark.parametrize("version", [2.11, 3.04, 3.05])
def test_navigation_files_contain_the_ephemerides(version):
    rng = np.random.default_rng(3)
    sent = [random_glonass_ephemeris(rng, number, NOW_NS) for number in range(1, 25)]
    decoder = NavigationDecoder("test.nav")
    results = decoder.feed(glonass_navigation_text(sent, version).encode()) + decoder.finish()
    assert (decoder.problems, len(results)) == (0, 24)
    for e, read in zip(sent, results, strict=True):
        delay_s = e.group_delay_s if version >= 3.05 else math.nan
        np.testing.assert_allclose(read.group_delay_s, delay_s, rtol=1e-12)
        for name in ("position_m", "velocity_m_s", "acceleration_m_s2", "clock"):
            np.testing.assert_allclose(getattr(read, name), getattr(e, name), rtol=1e-11, atol=1e-20)
        for name in ("satellite", "toe_ns", "transmission_ns", "iode", "channel", "health", "toc_ns"):
            assert getattr(read, name) == getattr(e, name)


@given(SEEDS, st.integers(0, 83))
@settings(derandomize=True, max_examples=100, deadline=None)
def test_one_wrong_bit_of_a_string_is_noticed(seed, bit):
    sent = random_glonass_ephemeris(np.random.default_rng(seed), 5, NOW_NS)
    for words in glonass_strings(sent)[:4]:
        string = words[0] << 64 | words[1] << 32 | words[2]
        damaged = string ^ 1 << 95 - bit
        decode_string(words)
        with pytest.raises(ValueError, match="check bits"):
            decode_string((damaged >> 64, damaged >> 32 & 0xFFFFFFFF, damaged & 0xFFFFFFFF, words[3]))


def test_an_ephemeris_needs_four_strings_in_turn_of_one_frame():
    first, second = (random_glonass_ephemeris(np.random.default_rng(seed), 5, NOW_NS) for seed in (1, 2))
    one, two = frames_of(first), frames_of(second)
    for incomplete in (one[1:], [*one[:2], one[3]], [one[0], *two[2:]], [one[0], one[2], one[1], one[3]]):
        assert UbxDecoder("port", NOW_NS).feed(b"".join(incomplete)) == []
    assert UbxDecoder("port", NOW_NS).feed(b"".join([*one[:2], *two])) == [second]
    # A frame lasts 30 s: what was received before an interruption is of another one.
    decoder = UbxDecoder("port", NOW_NS)
    decoder.feed(b"".join(one[:2]))
    decoder.messages.near_ns = NOW_NS + 31 * NS_PER_SECOND
    assert decoder.feed(b"".join(two[2:])) == []


def test_a_string_of_another_satellite_and_damaged_words_are_counted():
    sent = random_glonass_ephemeris(np.random.default_rng(1), 5, NOW_NS)
    decoder = UbxDecoder("port", NOW_NS)
    strings = glonass_strings(sent)
    assert decoder.feed(b"".join(string_message(words, sent, number=6) for words in strings)) == []
    assert decoder.messages.bad_subframes == 1
    assert decoder.feed(string_message(strings[0][:3], sent)) == []
    assert decoder.messages.bad_subframes == 2


@pytest.mark.parametrize(
    "change",
    [
        {"position_m": (1.0e7, 0.0, 0.0)}, {"position_m": (2.0e7, 2.0e7, 2.0e7)}, {"iode": 96}, {"iode": 0},
        {"channel": 14}, {"satellite": ord("R") * 256},
    ],
)  # fmt: skip
def test_what_no_satellite_sends_is_counted_as_malformed(change):
    sent = random_glonass_ephemeris(np.random.default_rng(1), 5, NOW_NS)
    decoder = RtcmDecoder(NOW_NS)
    assert decoder.feed(message_1020(replace(sent, **change))) == []
    assert decoder.malformed == 1


def test_a_truncated_message_1020_is_counted():
    payload = message_1020(random_glonass_ephemeris(np.random.default_rng(1), 5, NOW_NS))[3:-3]
    for size in (2, 10, 30):
        decoder = RtcmDecoder(NOW_NS)
        assert decoder.feed(rtcm_frame(payload[:size])) == []
        assert decoder.malformed == 1


@pytest.mark.parametrize(
    ("line", "column", "text", "says"),
    [
        (2, 23, "x", "tau 'x"),
        (3, 61, " 1.400000000000D+01", None),
        (3, 4, " " * 19, "x_km is blank"),
        (4, 61, " 1.400000000000D+01", "frequency channel 14.0"),
        (4, 61, " 2.490000000000D+02", None),
        (4, 61, " 5.000000000000D-01", "frequency channel 0.5"),
        (3, 61, "-1.000000000000D+00", "health -1.0"),
        (4, 0, "1", "'1   ' at the begin of a line"),
    ],
)
def test_a_damaged_record_is_one_line(line, column, text, says):
    e = random_glonass_ephemeris(np.random.default_rng(1), 5, NOW_NS)
    lines = glonass_navigation_text([e], 3.04).splitlines()
    lines[line] = lines[line][:column] + text + lines[line][column + len(text) :]
    decoder = NavigationDecoder("test.nav")
    results = decoder.feed("\n".join(lines).encode()) + decoder.finish()
    assert len(results) == 1
    if says is None:
        assert isinstance(results[0], GlonassEphemeris)
    else:
        assert str(results[0]).startswith(f"test.nav:3: R05, expected a record that is whole ({says}")


def test_a_record_with_a_line_too_few_is_one_line():
    e = random_glonass_ephemeris(np.random.default_rng(1), 5, NOW_NS)
    text = "\n".join(glonass_navigation_text([e], 3.04).splitlines()[:-1])
    decoder = NavigationDecoder("test.nav")
    (error,) = decoder.feed(text.encode()) + decoder.finish()
    assert str(error) == "test.nav:3: R05, expected a record that is whole (3 lines, not 4)"


def test_recorded_message_1020_has_the_values_of_pyrtcm():
    data = recording("receiver-logs/rtcm-pygpsdata-NTRIP-USCL00CHL0.log")
    compared = 0
    with data.open("rb") as file:
        for raw, message in RTCMReader(file, quitonerror=0):
            if message is None or message.identity != "1020":
                continue
            (read,) = RtcmDecoder(NOW_NS).feed(raw)
            theirs = [getattr(message, f"DF{n}") * 1e3 for n in (112, 115, 118, 111, 114, 117, 113, 116, 119)]
            ours = [*read.position_m, *read.velocity_m_s, *read.acceleration_m_s2]
            np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-15)
            np.testing.assert_allclose(
                read.clock, (-message.DF124 / 2**30, message.DF121 / 2**40), rtol=1e-12
            )
            assert (read.satellite & 255, read.iode) == (message.DF038, message.DF110)
            assert (read.channel, read.health) == (message.DF040 - 7, message.DF108)
            compared += 1
    assert compared == 1


@pytest.mark.skipif(CONVBIN is None, reason="convbin of RTKLIB is not installed")
@pytest.mark.parametrize("protocol", ["ubx", "rtcm3"])
def test_ephemerides_are_those_of_convbin(tmp_path, protocol):
    rng = np.random.default_rng(4)
    sent = [replace(random_glonass_ephemeris(rng, n, NOW_NS), health=0) for n in range(1, 25)]
    sent = [replace(e, toe_ns=NOW_NS - 3 * 900 * NS_PER_SECOND, iode=45) for e in sent]
    sent = [replace(e, transmission_ns=NOW_NS) for e in sent]
    epoch = random_epoch(rng, NOW_NS, carriers={"G": {"1C": 1575.42e6}}, missing=0.0)
    if protocol == "ubx":
        data = format_raw_measurements(epoch) + b"".join(b"".join(frames_of(e)) for e in sent)
        ours = UbxDecoder("port").feed(data)[1:]
    else:
        data = b"".join(map(message_1020, sent))
        ours = RtcmDecoder(NOW_NS).feed(data)
    assert len(ours) == 24
    (tmp_path / "raw").write_bytes(data)
    command = [CONVBIN, "-r", protocol, "-v", "3.04", "-tr", "2026/05/02", "09:00:00", "-n", "raw.nav", "raw"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    decoder = NavigationDecoder("raw.nav")
    results = decoder.feed((tmp_path / "raw.nav").read_bytes()) + decoder.finish()
    theirs = {r.satellite: r for r in results if isinstance(r, GlonassEphemeris)}
    assert len(theirs) == 24
    for e in ours:
        other = theirs[e.satellite]
        assert (e.toe_ns, e.channel, e.health) == (other.toe_ns, other.channel, other.health)
        for name in ("position_m", "velocity_m_s", "acceleration_m_s2", "clock"):
            np.testing.assert_allclose(getattr(e, name), getattr(other, name), rtol=1e-11, atol=1e-20)


@given(st.integers(0, 20_000), st.integers(0, 86_399), st.floats(-0.49, 0.49))
@settings(derandomize=True, max_examples=200, deadline=None)
def test_times_of_glonass_are_utc_and_three_hours(days, second, off):
    first = gps_ns_from_gpst(CalendarTime(1996, 1, 1, 0, 0, 0))
    naive = gpst_from_gps_ns(first + days * NS_PER_DAY + second * NS_PER_SECOND)
    time_ns = gps_ns_from_utc(naive)
    day, of_day_ns = divmod(gps_ns_from_gpst(naive) + 3 * 3600 * NS_PER_SECOND, NS_PER_DAY)
    near_ns = max(time_ns + round(off * 7 * 86_400) * NS_PER_SECOND, 0)
    # GPS time began on a Sunday, on 6 January 1980.
    assert gps_ns_of_week_day(day % 7, of_day_ns, near_ns) == time_ns
    near_ns = max(time_ns + round(off * 86_400) * NS_PER_SECOND, 0)
    assert gps_ns_of_week_day(None, of_day_ns, near_ns) == time_ns
    number = (day - first // NS_PER_DAY) % LARGEST_DAY + 1
    near_ns = time_ns + round(off * 1000 * 86_400) * NS_PER_SECOND
    if near_ns > 0:
        assert gps_ns_of_day_number(number, of_day_ns, near_ns) == time_ns


def test_other_strings_have_no_fields():
    assert decode_string(string_words(5, {80: (77, 11)})) == (5, {})
    assert decode_string(string_words(15, {80: (77, 11)})) == (15, {})


@pytest.mark.parametrize("number", [1084, 1086])
def test_phases_of_msm_without_channels_are_read_once_1020_has_named_them(number):
    rng = np.random.default_rng(7)
    frames = [any_msm(rng, number) for _ in range(60)]
    named = [replace(random_glonass_ephemeris(rng, n, NOW_NS), channel=n % 13 - 6) for n in range(1, 25)]
    before, after = RtcmDecoder(NOW_NS), RtcmDecoder(NOW_NS)
    after.feed(b"".join(map(message_1020, named)))
    compared = 0
    for frame in frames:
        (unknown,), (known,) = (
            [r.epoch for r in decoder.feed(frame) + decoder.finish()] for decoder in (before, after)
        )
        np.testing.assert_array_equal(unknown.pseudorange_m, known.pseudorange_m)
        assert np.isnan(unknown.carrier_phase_cycles).all()
        channel = (known.satellite & 255) % 13 - 6
        carrier_hz = np.where(known.signal >> 8 == ord("1"), 1602e6, 1246e6)
        carrier_hz += channel * np.where(known.signal >> 8 == ord("1"), 562.5e3, 437.5e3)
        metres = known.carrier_phase_cycles * SPEED_OF_LIGHT_M_S / carrier_hz
        near = ~np.isnan(metres) & ~np.isnan(known.pseudorange_m)
        # Code and phase are within a part of a millisecond of the same rough range.
        assert (np.abs(metres - known.pseudorange_m)[near] < 2000.0).all()
        compared += near.sum()
    assert compared > 50
