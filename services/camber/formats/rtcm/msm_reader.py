"""MSM4 to MSM7 messages of RTCM 3.3 decoded to columns of observations.

Source: RTCM 10403.3, 3.5.16, tables 3.5-78 to 3.5-88; DF402 (table 3.5-74), DF407 (table 3.5-75), DF416, DF034 (epoch
time of GLONASS), DF419 (its frequency channels).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.broadcast.ephemeris_fields import gps_ns_near
from camber.formats.broadcast.glonass_time import gps_ns_of_week_day
from camber.formats.observations import CHANNEL_STEP_HZ, SPEED_OF_LIGHT_M_S, Floats, Integers, signal_name
from camber.formats.rtcm.msm_signals import GLONASS_MSM, METRES_PER_MS, MSM_SIGNALS_READ, MSM_SYSTEMS_READ
from camber.formats.rtcm.msm_writer import (
    CN0_PER_DBHZ,
    MAX_CELLS,
    NS_PER_MS,
    PHASE_PER_MS,
    PSEUDORANGE_PER_MS,
    RANGE_MS_INVALID,
    ROUGH_PER_MS,
    ROUGH_RATE_INVALID,
)

Bytes = NDArray[np.uint8]
# RTCM 10403.3: message numbers (table 3.5-76), header and masks (3.5-78), range of the epoch time (DF004).
_FIRST_MSM, _LAST_MSM = 1071, 1137
_FIRST_KIND, _LAST_KIND = 4, 7
_HEADER_BITS, _MASK_BITS = 73, 64 + 32
_MS_PER_WEEK = 604_800_000  # DF004
_TIME_OF_DAY_BITS = 27  # DF034, after the three bits of DF416
_MS_PER_DAY = 86_401_000  # DF034: with a leap second
_UNKNOWN_DAY = 7  # DF416
_CHANNEL_OFFSET, _HIGHEST_CHANNEL = 7, 13  # DF419: channels −7 to 6; 14 and 15 are no channel
_SYSTEM_OF_TENS = {system.message // 10: k for k, system in enumerate(MSM_SYSTEMS_READ)}

_COMPLETE, _TOO_SHORT, _WRONG_TIME, _WRONG_MASK, _TRUNCATED = range(5)
_PROBLEMS = {
    _TOO_SHORT: f"MSM of less than {_HEADER_BITS} bits",
    _WRONG_TIME: "epoch time after the end of the week or day",
    _WRONG_MASK: f"satellites that the system has not got, or more than {MAX_CELLS} cells",
    _TRUNCATED: "message ends before its last cell",
}


def minimum_lock_s() -> dict[int, Floats]:
    """Return the minimum lock time of each indicator by the field's width, 4 bits (DF402) or 10 (DF407), then ∞."""
    short = np.array([0.0, *(2.0 ** (i + 4) for i in range(1, 16)), np.inf]) * 1e-3
    steps = [np.arange(64.0)]
    steps += [2.0 ** (k + 5) + 2.0**k * np.arange(32.0) for k in range(1, 21)]
    long = np.concatenate((*steps, [2.0**26], np.full(1025 - 705, np.inf))) * 1e-3
    return {4: short, 10: long}


_SHORT_LOCK_S, _LONG_LOCK_S = minimum_lock_s().values()


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MsmMessage:
    """One message; columns with one row per cell of a known signal, `unknown_signals` being the number of the others.

    `integers` (3, n): satellite, signal, half-cycle ambiguity. `floats` (6, n): pseudorange [m], phase [cycles],
    Doppler [Hz], C/N0 [dB-Hz], lock time [s] and the next indicator's. The last loss of lock was between these two
    times before the epoch.
    """

    station_id: int
    more_follow: bool
    time_ns: int
    integers: Integers
    floats: Floats
    unknown_signals: int


def is_msm(number: int) -> bool:
    """Whether a message number is that of an MSM of any system and kind."""
    return _FIRST_MSM <= number <= _LAST_MSM and 1 <= number % 10 <= 7


def msm_header(payload: bytes) -> tuple[int, bool]:
    """Return station id and multiple-message bit of any MSM; ValueError where the message is too short."""
    if 8 * len(payload) < _HEADER_BITS:
        raise ValueError(_PROBLEMS[_TOO_SHORT])
    return (payload[1] & 15) << 8 | payload[2], bool(payload[6] & 2)


def unknown_channels() -> Floats:
    """Return the frequency channels (65,) of GLONASS' satellites by number, for `read_msm`: NaN, not known."""
    return np.full(65, np.nan)


def read_msm(payload: bytes, number: int, near_ns: int, channels: Floats) -> MsmMessage | None:
    """Decode an MSM in the week nearest to `near_ns`; None for systems and kinds that are not supported.

    `channels` (65,) are those of GLONASS: MSM5 and MSM7 write them, and phase and Doppler are NaN without. Raises
    ValueError where the message is inconsistent or truncated.
    """
    system, kind = _SYSTEM_OF_TENS.get(number // 10), number % 10
    if system is None or not _FIRST_KIND <= kind <= _LAST_KIND:
        return None
    station_id, more_follow = msm_header(payload)
    letter, is_glonass = MSM_SYSTEMS_READ[system].letter, MSM_SYSTEMS_READ[system] is GLONASS_MSM
    integers, floats = np.empty((3, MAX_CELLS), np.int64), np.empty((6, MAX_CELLS))
    status, epoch_time, count, unknown = _read_cells(
        payload=np.frombuffer(payload, np.uint8),
        kind=kind,
        first_satellite=ord(letter) << 8,
        max_satellite=MSM_SYSTEMS_READ[system].satellites,
        signal_of_id=_SIGNAL_OF_ID[system],
        carrier_of_id_hz=_CARRIER_OF_ID_HZ[system],
        step_of_id_hz=_STEP_OF_ID_HZ[system],
        channels=channels if is_glonass else _NO_CHANNELS,
        minimum_lock_s=_SHORT_LOCK_S if kind < 6 else _LONG_LOCK_S,
        integers=integers,
        floats=floats,
    )
    if status != _COMPLETE:
        raise ValueError(_PROBLEMS[status])
    return MsmMessage(
        station_id=station_id,
        more_follow=more_follow,
        time_ns=_glonass_time_ns(epoch_time, near_ns)
        if is_glonass
        else _time_ns(letter, epoch_time, near_ns),
        integers=integers[:, :count],
        floats=floats[:, :count],
        unknown_signals=unknown,
    )


def _time_ns(system: str, epoch_time: int, near_ns: int) -> int:
    if epoch_time >= _MS_PER_WEEK:
        raise ValueError(_PROBLEMS[_WRONG_TIME])
    return gps_ns_near(system, epoch_time * NS_PER_MS, near_ns)


def _glonass_time_ns(epoch_time: int, near_ns: int) -> int:
    day, of_day_ms = epoch_time >> _TIME_OF_DAY_BITS, epoch_time & (1 << _TIME_OF_DAY_BITS) - 1
    if of_day_ms >= _MS_PER_DAY:
        raise ValueError(_PROBLEMS[_WRONG_TIME])
    return gps_ns_of_week_day(None if day == _UNKNOWN_DAY else day, of_day_ms * NS_PER_MS, near_ns)


@compiled
def _read_cells(
    payload: Bytes,
    kind: int,
    first_satellite: int,
    max_satellite: int,
    signal_of_id: Integers,
    carrier_of_id_hz: Floats,
    step_of_id_hz: Floats,
    channels: Floats,
    minimum_lock_s: Floats,
    integers: Integers,
    floats: Floats,
) -> tuple[int, int, int, int]:
    """Fill the columns; return status, epoch time (30 bits), number of rows, cells of unknown signals.

    A message is a sequence of columns, first of the satellites, then of the cells (tables 3.5-80 to 3.5-88).
    """
    rates = kind == 5 or kind == 7
    fine = kind >= 6
    code_width, phase_width, lock_width, cn0_width = (20, 24, 10, 10) if fine else (15, 22, 4, 6)
    code_per_ms = PSEUDORANGE_PER_MS if fine else 2.0**24
    phase_per_ms = PHASE_PER_MS if fine else 2.0**29
    cn0_step = 1.0 / CN0_PER_DBHZ if fine else 1.0
    size = 8 * payload.size
    if size < _HEADER_BITS + _MASK_BITS:
        return _TOO_SHORT, 0, 0, 0
    epoch_time = _unsigned(payload, 24, 30)
    numbers, satellites = np.empty(64, np.int64), 0
    for k in range(64):
        if _unsigned(payload, _HEADER_BITS + k, 1):
            numbers[satellites] = k + 1
            satellites += 1
    ids, signals = np.empty(32, np.int64), 0
    for k in range(32):
        if _unsigned(payload, _HEADER_BITS + 64 + k, 1):
            ids[signals] = k + 1
            signals += 1
    if satellites * signals > MAX_CELLS or (satellites and numbers[satellites - 1] > max_satellite):
        return _WRONG_MASK, 0, 0, 0
    mask = _HEADER_BITS + _MASK_BITS
    whole_ranges = mask + satellites * signals
    if whole_ranges > size:
        return _TRUNCATED, 0, 0, 0
    cells = 0
    for k in range(satellites * signals):
        cells += _unsigned(payload, mask + k, 1)

    rough_ranges = whole_ranges + satellites * (12 if rates else 8)
    rough_rates = rough_ranges + satellites * 10
    codes = rough_rates + satellites * (14 if rates else 0)
    phases = codes + cells * code_width
    locks = phases + cells * phase_width
    half_cycles = locks + cells * lock_width
    cn0s = half_cycles + cells
    fine_rates = cn0s + cells * cn0_width
    if fine_rates + cells * (15 if rates else 0) > size:
        return _TRUNCATED, 0, 0, 0

    # Indicators above 704 are reserved: such a lock is taken as the longest.
    is_fdma = step_of_id_hz.any()
    longest_s = 0.0
    for least_s in minimum_lock_s:
        if np.isfinite(least_s):
            longest_s = max(longest_s, least_s)
    cell, row = -1, 0
    for satellite in range(satellites):
        whole_ms = _unsigned(payload, whole_ranges + 8 * satellite, 8)
        rough_ms = whole_ms + _unsigned(payload, rough_ranges + 10 * satellite, 10) / ROUGH_PER_MS
        if whole_ms == RANGE_MS_INVALID:
            rough_ms = np.nan
        channel = channels[numbers[satellite]]
        rough_rate = np.nan
        if rates:
            information = _unsigned(payload, whole_ranges + 8 * satellites + 4 * satellite, 4)
            if is_fdma and information <= _HIGHEST_CHANNEL:
                channel = channels[numbers[satellite]] = information - _CHANNEL_OFFSET
            rough_rate = float(_signed(payload, rough_rates + 14 * satellite, 14))
            if rough_rate == ROUGH_RATE_INVALID:
                rough_rate = np.nan
        for signal in range(signals):
            if not _unsigned(payload, mask + satellite * signals + signal, 1):
                continue
            cell += 1
            if np.isnan(carrier_of_id_hz[ids[signal]]):
                continue
            carrier_hz = carrier_of_id_hz[ids[signal]] + channel * step_of_id_hz[ids[signal]]
            code_ms = rough_ms + _signed_or_nan(payload, codes + cell * code_width, code_width) / code_per_ms
            phase_ms = (
                rough_ms + _signed_or_nan(payload, phases + cell * phase_width, phase_width) / phase_per_ms
            )
            rate_m_s = rough_rate
            if rates:
                rate_m_s += _signed_or_nan(payload, fine_rates + cell * 15, 15) * 1e-4
            lock = _unsigned(payload, locks + cell * lock_width, lock_width)
            cn0 = _unsigned(payload, cn0s + cell * cn0_width, cn0_width)
            integers[0, row] = first_satellite + numbers[satellite]
            integers[1, row] = signal_of_id[ids[signal]]
            integers[2, row] = _unsigned(payload, half_cycles + cell, 1)
            floats[0, row] = code_ms * METRES_PER_MS
            floats[1, row] = phase_ms * METRES_PER_MS / SPEED_OF_LIGHT_M_S * carrier_hz
            floats[2, row] = -rate_m_s / SPEED_OF_LIGHT_M_S * carrier_hz
            floats[3, row] = cn0 * cn0_step if cn0 else np.nan
            floats[4, row] = min(minimum_lock_s[lock], longest_s)
            floats[5, row] = minimum_lock_s[lock + 1]
            row += 1
    return _COMPLETE, epoch_time, row, cells - row


@compiled
def _unsigned(payload: Bytes, first: int, width: int) -> int:
    """Return the integer of `width` bits, at most 32, at bit `first`; the caller has checked the bounds."""
    value = 0
    for k in range(first >> 3, (first + width + 7) >> 3):
        value = value << 8 | payload[k]
    return value >> (-(first + width) & 7) & (1 << width) - 1


@compiled
def _signed(payload: Bytes, first: int, width: int) -> int:
    value = _unsigned(payload, first, width)
    return value - (1 << width) if value >> (width - 1) else value


@compiled
def _signed_or_nan(payload: Bytes, first: int, width: int) -> float:
    """Return the signed integer; NaN for the lowest value, which means "invalid"."""
    value = _signed(payload, first, width)
    return np.nan if value == -(1 << (width - 1)) else float(value)


def _tables_by_id() -> tuple[Integers, Floats, Floats]:
    shape, table = (len(MSM_SYSTEMS_READ), 33), MSM_SIGNALS_READ
    signal, carrier, step = np.zeros(shape, np.int64), np.full(shape, np.nan), np.zeros(shape)
    signal[table.system, table.ids] = table.keys & 0xFFFF
    carrier[table.system, table.ids] = table.carriers_hz
    fdma = table.keys >> 16 == ord(GLONASS_MSM.letter)
    bands = [signal_name(key & 0xFFFF)[0] for key in table.keys[fdma].tolist()]
    step[table.system[fdma], table.ids[fdma]] = [CHANNEL_STEP_HZ[band] for band in bands]
    return signal, carrier, step


_SIGNAL_OF_ID, _CARRIER_OF_ID_HZ, _STEP_OF_ID_HZ = _tables_by_id()
_NO_CHANNELS = np.zeros(65)
