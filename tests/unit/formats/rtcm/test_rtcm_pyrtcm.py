"""RTCM against pyrtcm, to the last bit: recordings, and observations and ephemerides of any content.

pyrtcm scales each field; divided by its step again a value is the integer that was sent.
"""

from __future__ import annotations

import io
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyrtcm import RTCM_DATA_FIELDS, RTCMMessage, RTCMReader, calc_crc24q
from pyrtcm.rtcmtypes_get import RTCM_PAYLOADS_GET

from camber.formats.broadcast.bit_fields import bits_to_bytes, pack_bits
from camber.formats.broadcast.ephemeris_fields import FIELDS, ephemeris_from_integers
from camber.formats.observations import CHANNEL_STEP_HZ, Ephemeris, GlonassEphemeris
from camber.formats.rtcm.ephemeris_messages import EPHEMERIS_MESSAGES
from camber.formats.rtcm.msm_reader import (
    MsmMessage,
    is_msm,
    minimum_lock_s,
    read_msm,
    unknown_channels,
)
from camber.formats.rtcm.msm_signals import MSM_SIGNALS_READ, MSM_SYSTEMS_READ
from camber.formats.rtcm.reader import ReferenceStation, RtcmDecoder
from camber.formats.rtcm.writer import rtcm_frame
from support.gnss_files import recording
from support.random_msm import any_msm
from support.random_observations import LIGHT_M_S, WEEK_NS

DAY_NS = 86_400 * 1_000_000_000
NOW_NS = 2300 * WEEK_NS + 100_000 * 1_000_000_000
LOGS = (
    "rtcm-pygpsdata-NTRIP-1300-1302.log",
    "rtcm-pygpsdata-NTRIP-USCL00CHL0.log",
    "rtcm-pygpsdata-RTCM3.log",
)
TENS = {system.message // 10: place for place, system in enumerate(MSM_SYSTEMS_READ)}
CARRIER_AND_SIGNAL = {
    (system, number): (hz, key & 0xFFFF)
    for system, number, hz, key in zip(
        MSM_SIGNALS_READ.system.tolist(),
        MSM_SIGNALS_READ.ids.tolist(),
        MSM_SIGNALS_READ.carriers_hz.tolist(),
        MSM_SIGNALS_READ.keys.tolist(),
        strict=True,
    )
}
SEEDS = st.integers(0, 2**32)


def log(name: str) -> bytes:
    return recording(f"receiver-logs/{name}").read_bytes()


@cache
def frames_of(data: bytes) -> list[bytes]:
    """The frames of pyrtcm with a correct CRC. (Some messages 1302 it cannot parse.)"""
    reader = RTCMReader(io.BytesIO(data), quitonerror=0, parsed=0)
    return [raw for raw, _ in reader if calc_crc24q(raw) == 0]


def integer(message: RTCMMessage, name: str, index: int | None = None) -> int:
    value = getattr(message, name if index is None else f"{name}_{index:02d}")
    step = RTCM_DATA_FIELDS[name][2]
    whole = round(value / step) if step else value
    assert not step or whole * step == value
    return int(whole)


def cells_by_pyrtcm(frame: bytes) -> tuple[list[list[Any]], int]:
    """A row per cell of a known signal: satellite, signal, half cycle and the scaled values."""
    message = RTCMReader.parse(frame)
    number = int(message.identity)
    system, kind = TENS[number // 10], number % 10
    letter = MSM_SYSTEMS_READ[system].letter
    fine = kind >= 6
    code_name, phase_name, lock_name, cn0_name = (
        ("DF405", "DF406", "DF407", "DF408") if fine else ("DF400", "DF401", "DF402", "DF403")
    )
    code_bits, phase_bits, per_code, per_phase = (20, 24, 29, 31) if fine else (15, 22, 24, 29)
    lock_s = minimum_lock_s()[10 if fine else 4]
    longest_s = lock_s[np.isfinite(lock_s)].max()
    numbers = [k + 1 for k in range(64) if message.DF394 >> (63 - k) & 1]
    ids = [k + 1 for k in range(32) if message.DF395 >> (31 - k) & 1]
    mask = [(n, i) for n in range(len(numbers)) for i in ids]
    chosen = [pair for k, pair in enumerate(mask) if message.DF396 >> (len(mask) - 1 - k) & 1]
    rows, unknown = [], 0
    for cell, (place, signal_id) in enumerate(chosen, start=1):
        if (system, signal_id) not in CARRIER_AND_SIGNAL:
            unknown += 1
            continue
        hz, signal = CARRIER_AND_SIGNAL[system, signal_id]
        if letter == "R":
            # MSM5 and MSM7 name the channel; 14 and 15 are none.
            known = kind in (5, 7) and integer(message, "DF419", place + 1) <= 13
            channel = integer(message, "DF419", place + 1) - 7 if known else math.nan
            hz += channel * CHANNEL_STEP_HZ[chr(signal >> 8)]
        whole_ms = integer(message, "DF397", place + 1)
        rough_ms = math.nan if whole_ms == 255 else whole_ms + integer(message, "DF398", place + 1) / 1024
        code, phase = integer(message, code_name, cell), integer(message, phase_name, cell)
        lock, cn0 = integer(message, lock_name, cell), integer(message, cn0_name, cell)
        doppler_hz = math.nan
        if kind in (5, 7):
            rate, fine_rate = integer(message, "DF399", place + 1), integer(message, "DF404", cell)
            if rate != -8192 and fine_rate != -16384:
                doppler_hz = -(rate + fine_rate * 1e-4) / LIGHT_M_S * hz
        per_ms = LIGHT_M_S * 1e-3
        code_ms = math.nan if code == -(1 << (code_bits - 1)) else rough_ms + code / 2**per_code
        phase_ms = math.nan if phase == -(1 << (phase_bits - 1)) else rough_ms + phase / 2**per_phase
        rows.append(
            [
                ord(letter) * 256 + numbers[place],
                signal,
                integer(message, "DF420", cell),
                code_ms * per_ms,
                phase_ms * per_ms / LIGHT_M_S * hz,
                doppler_hz,
                math.nan if cn0 == 0 else cn0 / (16.0 if fine else 1.0),
                min(lock_s[lock], longest_s),
                lock_s[lock + 1],
            ]
        )
    return rows, unknown


def assert_equal_to_pyrtcm(frame: bytes, decoded: MsmMessage) -> None:
    rows, unknown = cells_by_pyrtcm(frame)
    message = RTCMReader.parse(frame)
    assert decoded.unknown_signals == unknown
    assert (decoded.station_id, decoded.more_follow) == (message.DF003, bool(message.DF393))
    if hasattr(message, "DF034"):
        assert_time_of_glonass(message.DF416, message.DF034, decoded.time_ns)
        time = None
    else:
        time = next(
            getattr(message, name) for name in ("DF004", "DF248", "DF428", "DF427") if hasattr(message, name)
        )
    offset_ns = MSM_SYSTEMS_READ[TENS[int(message.identity) // 10]].gps_offset_ns
    assert time is None or (decoded.time_ns - offset_ns - time * 1_000_000) % WEEK_NS == 0
    theirs = np.array(rows, float).reshape(-1, 9).T
    np.testing.assert_array_equal(decoded.integers, theirs[:3])
    # Equal bits: not a number only where theirs is none.
    np.testing.assert_array_equal(decoded.floats, theirs[3:])


def assert_time_of_glonass(day: int, of_day_ms: int, time_ns: int) -> None:
    """UTC and three hours; 18 leap seconds. Of an unknown day (7) the time of day alone is known."""
    glonass_ns = time_ns + (3 * 3600 - 18) * 1_000_000_000
    period_ns = DAY_NS if day == 7 else WEEK_NS
    assert (glonass_ns - (day % 7) * DAY_NS - of_day_ms * 1_000_000) % period_ns == 0


def assert_ephemeris_equal_to_pyrtcm(frame: bytes, decoded: Ephemeris) -> None:
    message = RTCMReader.parse(frame)
    system, layout, spare = EPHEMERIS_MESSAGES[int(message.identity)]
    names = [name for name in RTCM_PAYLOADS_GET[message.identity] if name != "DF002"]
    assert names[-1].startswith("DF001") == bool(spare)
    integers = {
        field: integer(message, name)
        for field, name in zip(layout, names[:-1] if spare else names, strict=True)
    }
    theirs = ephemeris_from_integers(system, integers, decoded.transmission_ns)
    ours = {name: getattr(decoded, name) for name in Ephemeris.__slots__ if name != "other"}
    assert ours == {name: getattr(theirs, name) for name in ours}
    assert {k: v for k, v in decoded.other.items() if k != "data_sources"} == theirs.other


@pytest.mark.parametrize("name", LOGS)
def test_same_frames_are_valid_as_in_pyrtcm(name: str) -> None:
    data = log(name)
    frames = frames_of(data)
    assert frames
    decoder = RtcmDecoder(NOW_NS)
    decoder.feed(data)
    decoder.finish()
    assert len(data) - decoder.bytes_skipped == sum(map(len, frames))


@pytest.mark.parametrize("name", LOGS)
def test_recorded_messages_equal_those_of_pyrtcm(name: str) -> None:
    decoder, read = RtcmDecoder(NOW_NS), 0
    frames = frames_of(log(name))
    for frame in frames:
        number = frame[3] << 4 | frame[4] >> 4
        if is_msm(number):
            message = read_msm(frame[3:-3], number, NOW_NS, unknown_channels())
            if message is not None:
                assert_equal_to_pyrtcm(frame, message)
                read += 1
            continue
        for result in decoder.feed(frame):
            read += 1
            if isinstance(result, Ephemeris):
                assert_ephemeris_equal_to_pyrtcm(frame, result)
            elif isinstance(result, GlonassEphemeris):
                assert number == 1020
            else:
                assert isinstance(result, ReferenceStation)
                message = RTCMReader.parse(frame)
                position = tuple(integer(message, field) * 1e-4 for field in ("DF025", "DF026", "DF027"))
                height = integer(message, "DF028") * 1e-4 if number == 1006 else None
                assert (result.position_ecef_m, result.antenna_height_m) == (position, height)
                assert result.station_id == message.DF003
    assert decoder.malformed == decoder.bytes_skipped == 0
    numbers = [frame[3] << 4 | frame[4] >> 4 for frame in frames]
    msm = [number for number in numbers if number // 10 in TENS and number % 10 in (4, 5, 6, 7)]
    others = [number for number in numbers if number in (1005, 1006, 1020, *EPHEMERIS_MESSAGES)]
    assert read == len(msm) + len(others)


@given(SEEDS)
@settings(derandomize=True, max_examples=150, deadline=None)
def test_random_observations_equal_those_of_pyrtcm(seed: int) -> None:
    random = np.random.default_rng(seed)
    number = 10 * int(random.choice(list(TENS))) + int(random.integers(4, 8))
    frame = any_msm(random, number)
    decoded = read_msm(frame[3:-3], number, NOW_NS, unknown_channels())
    assert decoded is not None
    assert_equal_to_pyrtcm(frame, decoded)


@given(SEEDS, st.sampled_from(sorted(EPHEMERIS_MESSAGES)))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_random_ephemerides_equal_those_of_pyrtcm(seed: int, number: int) -> None:
    random = np.random.default_rng(seed)
    system, layout, spare = EPHEMERIS_MESSAGES[number]
    values = {name: int(random.integers(0, 1 << FIELDS[system][name].width)) for name in layout}
    values["satellite"] = int(random.integers(1, 11))
    for name in ("toe_s", "toc_s"):
        values[name] = int(random.integers(0, 604_800 // FIELDS[system][name].resolution))
    pairs = [(number, 12), *((values[name], FIELDS[system][name].width) for name in layout), (0, spare)]
    frame = rtcm_frame(bits_to_bytes(*pack_bits(pairs)))
    decoder = RtcmDecoder(NOW_NS)
    (decoded,) = decoder.feed(frame)
    assert isinstance(decoded, Ephemeris)
    assert_ephemeris_equal_to_pyrtcm(frame, decoded)


@given(SEEDS)
@settings(derandomize=True, max_examples=60, deadline=None)
def test_truncated_message_is_refused(seed: int) -> None:
    random = np.random.default_rng(seed)
    number = 10 * int(random.choice(list(TENS))) + int(random.integers(4, 8))
    payload = any_msm(random, number)[3:-3]
    for size in {0, 1, 2, 8, 9, 20, len(payload) // 2, len(payload) - 1} & set(range(len(payload))):
        with pytest.raises(ValueError, match=r"MSM of less|ends before"):
            read_msm(payload[:size], number, NOW_NS, unknown_channels())
