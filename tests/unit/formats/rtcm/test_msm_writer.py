"""MSM7: pyrtcm decodes every message within the resolution of each field."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyrtcm import RTCMReader
from pyrtcm.rtcmtables import BEIDOU_SIG_MAP, GALILEO_SIG_MAP, GPS_SIG_MAP, QZSS_SIG_MAP

from camber.formats.observations import (
    ObservationEpoch,
    carrier_hz,
    satellite_number,
    signal_name,
    signal_number,
)
from camber.formats.receiver.phase_alignment import PhaseAlignment
from camber.formats.rtcm.msm_reader import minimum_lock_s
from camber.formats.rtcm.msm_signals import MSM_SIGNALS
from camber.formats.rtcm.msm_writer import lock_indicator
from camber.formats.rtcm.writer import format_observations
from support.random_observations import COMMON, LIGHT_M_S, MAX_NUMBER, SECOND_NS, WEEK_NS, random_epoch

LETTERS = {"1077": "G", "1097": "E", "1117": "J", "1127": "C"}
TIMES = st.one_of(
    st.integers(1500, 3900).map(lambda week: week * WEEK_NS),
    st.integers(1500, 3900).map(lambda week: week * WEEK_NS - 1_000_000),
    # Around the beginning of BeiDou's week, and the end of a day.
    st.integers(1500, 3900).map(lambda week: week * WEEK_NS + 14 * SECOND_NS),
    st.integers(1500, 3900).map(lambda week: week * WEEK_NS + 14 * SECOND_NS - 1_000_000),
    st.integers(1, 6).map(lambda day: 2300 * WEEK_NS + day * 86_400 * SECOND_NS - 1_000_000),
    st.integers(1000 * 604_800_000, 4000 * 604_800_000).map(lambda ms: ms * 1_000_000),
)


# Table 3.5-75: of each 32 indicators from 64 on, 2^n · i − this.
SUBTRACTED = (
    *(64, 256, 768, 2048, 5120, 12288, 28672, 65536, 147456, 327680, 720896, 1572864, 3407872, 7340032),
    *(15728640, 33554432, 71303168, 150994944, 318767104, 671088640),
)


def minimum_lock_ms(indicator: int) -> int:
    if indicator < 64:
        return indicator
    if indicator == 704:
        return 67_108_864
    row = (indicator - 64) // 32
    return 2 ** (row + 1) * indicator - SUBTRACTED[row]


@given(st.floats(0.0, 90_000.0))
@settings(derandomize=True, max_examples=300)
def test_lock_indicator_is_the_greatest_with_minimum_below_the_lock_time(lock_s):
    indicator = int(lock_indicator(np.array([lock_s]))[0])
    assert minimum_lock_ms(indicator) <= lock_s * 1e3 + 1e-5
    assert indicator == 704 or minimum_lock_ms(indicator + 1) > lock_s * 1e3


def test_minimum_lock_times_of_reader_and_writer_are_those_of_the_standard():
    minimum = np.array([minimum_lock_ms(i) for i in range(705)])
    assert lock_indicator(minimum * 1e-3).tolist() == list(range(705))
    np.testing.assert_allclose(minimum_lock_s()[10][:705], minimum * 1e-3, rtol=1e-15)
    assert lock_indicator(minimum_lock_s()[10][:705]).tolist() == list(range(705))


@given(st.integers(0, 2**32), TIMES, st.integers(0, 4095), st.sampled_from([12, 63]), st.booleans())
@settings(derandomize=True, max_examples=60, deadline=None)
def test_messages_have_64_cells_at_most_and_one_header(seed, time_ns, station_id, satellites, more_follow):
    """Their cells are compared in `test_rtcm_reader`, with a reader that equals pyrtcm bit by bit."""
    epoch = random_epoch(np.random.default_rng(seed), time_ns, satellites=satellites)
    frames = format_observations(epoch, station_id=station_id, more_follow=more_follow)
    messages = [RTCMReader.parse(frame) for frame in frames]
    letters = [LETTERS[message.identity] for message in messages]
    assert letters == sorted(letters, key="GEJC".index)
    for letter in set(letters):
        selected = epoch.satellite >> 8 == ord(letter)
        numbers, signals = (np.unique(of[selected]).size for of in (epoch.satellite, epoch.signal))
        assert letters.count(letter) == math.ceil(numbers / (64 // signals))
    for place, (letter, message) in enumerate(zip(letters, messages, strict=True)):
        time_ms = next(
            getattr(message, n) for n in ("DF004", "DF248", "DF428", "DF427") if hasattr(message, n)
        )
        offset_ns = 14 * SECOND_NS if letter == "C" else 0
        assert time_ms == (time_ns - offset_ns) % WEEK_NS // 1_000_000
        assert station_id == message.DF003
        assert (more_follow or place < len(messages) - 1) == message.DF393
        assert message.NSat * message.NSig <= 64


def test_empty_epoch_has_no_message():
    nothing = random_epoch(np.random.default_rng(0), 0, satellites=0)
    assert format_observations(nothing, station_id=0) == []


def test_signal_ids_and_carriers_equal_those_of_pyrtcm():
    """Compared with the tables of pyrtcm and with the RINEX carriers."""
    tables = zip("GEJC", (GPS_SIG_MAP, GALILEO_SIG_MAP, QZSS_SIG_MAP, BEIDOU_SIG_MAP), strict=True)
    theirs = {(letter, name): number for letter, table in tables for number, (_, name) in table.items()}
    ours = {
        (chr(key >> 16), signal_name(key & 0xFFFF)): number
        for key, number in zip(MSM_SIGNALS.keys.tolist(), MSM_SIGNALS.ids.tolist(), strict=True)
    }
    assert ours == theirs
    for letter, carriers in COMMON.items():
        for name, carrier in carriers.items():
            assert carrier_hz(letter, name) == carrier


def one(**changes) -> ObservationEpoch:
    values = {
        "time_ns": 2300 * WEEK_NS,
        "satellite": np.array([satellite_number("G05")] * 2),
        "signal": np.array([signal_number("1C"), signal_number("2L")]),
        "pseudorange_m": np.array([2.2e7, 2.2e7]),
        "carrier_phase_cycles": np.array([2.2e7 * 1575.42e6 / LIGHT_M_S, 2.2e7 * 1227.6e6 / LIGHT_M_S]),
        "doppler_hz": np.array([1000.0, 1000.0 * 1227.6 / 1575.42]),
        "cn0_dbhz": np.array([45.0, 40.0]),
        "lock_time_s": np.array([3.0, 3.0]),
        "loss_of_lock": np.zeros(2, np.bool_),
        "half_cycle": np.zeros(2, np.bool_),
    }
    return ObservationEpoch(**(values | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"pseudorange_m": np.array([8e7, 8e7])},
            r"G05 1C: range is 80000000.0000 m, expected 0.0000 to 7644",
        ),
        ({"pseudorange_m": np.array([-1e3, -1e3])}, r"G05 1C: range is -1000.0000 m, expected 0"),
        ({"pseudorange_m": np.array([2.2e7, 2.2e7 + 800.0])}, r"pseudorange from the rough range is -\d+"),
        ({"pseudorange_m": np.array([np.inf, 2.2e7])}, "pseudorange is infinite"),
        ({"carrier_phase_cycles": np.array([1e8, np.nan])}, r"G05 1C: phase from the rough range is -"),
        (
            {"doppler_hz": np.array([5e4, 4e4])},
            r"rough phase range rate is -9\d\d\d\.\d+ m/s, expected -8191",
        ),
        ({"doppler_hz": np.array([1000.0, 1000.0])}, "phase range rate from the rough rate"),
        ({"cn0_dbhz": np.array([64.0, 40.0])}, r"C/N0 is 64.0000 dB-Hz, expected 0.0625 to 63.9375"),
        ({"cn0_dbhz": np.array([0.0, 40.0])}, r"C/N0 is 0.0000"),
        ({"lock_time_s": np.array([-1.0, 0.0])}, r"lock time is -1.0000 s"),
        ({"time_ns": 2300 * WEEK_NS + 1}, "expected whole milliseconds"),
        ({"satellite": np.array([satellite_number("R05")] * 2)}, "R05 1C has no number in MSM messages"),
        ({"satellite": np.array([satellite_number("G64")] * 2)}, "G64 1C .* expected satellites 1 to 63"),
        ({"satellite": np.array([satellite_number("J00")] * 2)}, "J00 1C .* expected satellites 1 to 10"),
        ({"signal": np.array([signal_number("1C"), signal_number("2I")])}, "G05 2I has no number"),
        ({"signal": np.array([signal_number("1C")] * 2)}, "G05 1C: observed twice"),
    ],
)
def test_values_out_of_range_are_refused_with_field_and_range(changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        format_observations(one(**changes), station_id=1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("station_id", [-1, 4096])
def test_station_id_beyond_12_bits_is_refused(station_id):
    with pytest.raises(ValueError, match="station id"):
        format_observations(one(), station_id=station_id)


@pytest.mark.parametrize(("letter", "number"), MAX_NUMBER.items())
def test_last_satellite_of_each_system_is_encoded(letter, number):
    signal = next(iter(COMMON[letter]))
    epoch = one(
        satellite=np.array([satellite_number(f"{letter}{number}")] * 2),
        signal=np.array([signal_number(signal), signal_number("5P" if letter == "C" else "5Q")]),
        doppler_hz=np.zeros(2),
        carrier_phase_cycles=np.full(2, np.nan),
    )
    (message,) = (RTCMReader.parse(frame) for frame in format_observations(epoch, station_id=0))
    assert (message.NSat, int(message.PRN_01) - (192 if letter == "J" else 0)) == (1, number)


def test_removed_cycles_are_constant_until_loss_of_lock():
    rng = np.random.default_rng(4)
    counts = PhaseAlignment()
    wavelength = np.array([LIGHT_M_S / 1575.42e6, LIGHT_M_S / 1227.6e6])
    ambiguity = np.array([400_000.0, -333_333.5])
    reported = []
    for k in range(40):
        if k == 20:
            ambiguity = ambiguity + np.array([0.0, 77_777.0])
        lock_s = np.array([5.0 + k, 5.0 + k if k < 20 else k - 20.0])
        pseudorange = 2.2e7 + 700.0 * k + rng.normal(size=2)
        if k in (7, 20):
            pseudorange[0] = np.nan
        phase = (2.2e7 + 700.0 * k) / wavelength + ambiguity
        epoch = one(
            time_ns=2300 * WEEK_NS + k * SECOND_NS,
            pseudorange_m=pseudorange,
            carrier_phase_cycles=phase,
            lock_time_s=lock_s,
        )
        aligned = counts.align_to_pseudorange(epoch)
        format_observations(aligned, station_id=1)
        reported.append(phase - aligned.carrier_phase_cycles)
    off = np.array(reported)
    assert np.all(off == np.rint(off))
    assert np.unique(off[:, 0]).size == 1
    assert np.unique(off[:20, 1]).size == np.unique(off[20:, 1]).size == 1
    assert abs(off[20, 1] - off[19, 1] - 77_777.0) < 40


def test_drifting_phase_is_realigned_with_loss_of_lock():
    counts = PhaseAlignment()
    started = None
    for k in range(300):
        epoch = one(
            time_ns=2300 * WEEK_NS + k * SECOND_NS,
            carrier_phase_cycles=one().carrier_phase_cycles + 50.0 * k,
            lock_time_s=np.full(2, 100.0 + k),
        )
        aligned = counts.align_to_pseudorange(epoch)
        format_observations(aligned, station_id=1)
        if started is None and aligned.loss_of_lock[0]:
            started = k
            assert k * 50.0 * LIGHT_M_S / 1575.42e6 > 700.0
        if started is not None and not aligned.loss_of_lock[0]:
            assert aligned.lock_time_s[0] < 100.0
    assert started is not None


def test_phase_without_pseudorange_is_omitted_until_there_is_one():
    counts = PhaseAlignment()
    without = one(pseudorange_m=np.array([np.nan, 2.2e7]))
    assert np.isnan(counts.align_to_pseudorange(without).carrier_phase_cycles).tolist() == [True, False]
    later = one(time_ns=one().time_ns + SECOND_NS)
    assert not np.isnan(counts.align_to_pseudorange(later).carrier_phase_cycles).any()
