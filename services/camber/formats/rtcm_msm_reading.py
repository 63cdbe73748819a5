"""MSM4 to MSM7 messages of RTCM 3.3 as observations.

Source: RTCM 10403.3, 3.5.16, tables 3.5-78 to 3.5-88; DF402 (table 3.5-74), DF407 (table 3.5-75).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.ephemeris_fields import gps_ns_near
from camber.formats.observations import Floats, Integers, ObservationEpoch
from camber.formats.rtcm_msm import (
    CN0_PER_DBHZ,
    INVALID_ROUGH_MS,
    MOST_CELLS,
    ROUGH_PER_MS,
    ROUGH_RATE_INVALID,
)
from camber.formats.rtcm_signals import METRES_PER_MS, MSM_SIGNALS, MSM_SYSTEMS, SPEED_OF_LIGHT_M_S

Bits = NDArray[np.uint8]
FIRST_MSM, LAST_MSM = 1071, 1137
_HEADER_BITS = 73
_MASK_BITS = 64 + 32
_MS_PER_WEEK = 604_800_000
_SYSTEM_OF_TENS = {system.message // 10: place for place, system in enumerate(MSM_SYSTEMS)}


@dataclass(frozen=True, slots=True)
class _Kind:
    """Widths of the fields of a cell and what their steps are, of MSM4 to MSM7."""

    rates: bool
    code_width: int
    phase_width: int
    lock_width: int
    cn0_width: int


_KINDS = {
    4: _Kind(False, 15, 22, 4, 6),
    5: _Kind(True, 15, 22, 4, 6),
    6: _Kind(False, 20, 24, 10, 10),
    7: _Kind(True, 20, 24, 10, 10),
}
_CODE_PER_MS = {15: 2.0**24, 20: 2.0**29}
_PHASE_PER_MS = {22: 2.0**29, 24: 2.0**31}
_CN0_STEP = {6: 1.0, 10: 1.0 / CN0_PER_DBHZ}
_RATE_WIDTH, _RATE_STEP = 15, 1e-4


def minimum_lock_s() -> dict[int, Floats]:
    """Least lock time of each indicator, by the field's width: 4 bits (DF402) and 10 bits (DF407), infinity behind."""
    short = np.array([0.0, *(2.0 ** (i + 4) for i in range(1, 16)), np.inf]) * 1e-3
    steps = [np.arange(64.0)]
    steps += [2.0 ** (k + 5) + 2.0**k * np.arange(32.0) for k in range(1, 21)]
    long = np.concatenate((*steps, [2.0**26], np.full(1025 - 705, np.inf))) * 1e-3
    return {4: short, 10: long}


_MINIMUM_LOCK_S = minimum_lock_s()


@dataclass(frozen=True, slots=True, eq=False)
class MsmMessage:
    """One message: its cells, and the times between which each phase was last broken, before the epoch.

    `most_lock_s` is the least lock time of the next indicator. `unknown_signals` counts cells without a known carrier,
    which are left out.
    """

    station_id: int
    more_follow: bool
    epoch: ObservationEpoch
    most_lock_s: Floats
    unknown_signals: int


def is_msm(number: int) -> bool:
    """Whether a message is an MSM of any system and kind."""
    return FIRST_MSM <= number <= LAST_MSM and 1 <= number % 10 <= 7


def msm_header(bits: Bits) -> tuple[int, bool]:
    """Station id and multiple-message bit, which stand alike in all MSM; ValueError where the message is too short."""
    if bits.size < _HEADER_BITS:
        raise ValueError(f"MSM of {bits.size} bits, expected at least {_HEADER_BITS}")
    return _unsigned(bits, 12, 12), bool(bits[54])


def read_msm(bits: Bits, number: int, near_ns: int) -> MsmMessage | None:
    """The observations, their week being that nearest to `near_ns`; None for systems and kinds that are not read.

    ValueError with one line where the message contradicts itself or is too short.
    """
    place, kind = _SYSTEM_OF_TENS.get(number // 10), _KINDS.get(number % 10)
    if place is None or kind is None:
        return None
    system = MSM_SYSTEMS[place]
    station_id, more = msm_header(bits)
    time_ms = _unsigned(bits, 24, 30)
    if time_ms >= _MS_PER_WEEK:
        raise ValueError(f"epoch time {time_ms} ms, expected less than {_MS_PER_WEEK}")
    numbers = np.flatnonzero(bits[_HEADER_BITS : _HEADER_BITS + 64]) + 1
    ids = np.flatnonzero(bits[_HEADER_BITS + 64 : _HEADER_BITS + _MASK_BITS]) + 1
    mask_size = numbers.size * ids.size
    if mask_size > MOST_CELLS or (numbers.size and int(numbers[-1]) > system.satellites):
        raise ValueError(f"{numbers.size} satellites up to {numbers[-1:]}, {ids.size} signals in one message")
    columns = _Columns(bits, _HEADER_BITS + _MASK_BITS)
    of_satellite, of_signal = np.divmod(np.flatnonzero(columns.take(mask_size, 1)), max(ids.size, 1))
    count = of_satellite.size

    whole_ms = columns.take(numbers.size, 8)
    if kind.rates:
        columns.take(numbers.size, 4)
    rough_ms = whole_ms + columns.take(numbers.size, 10) / ROUGH_PER_MS
    rough_ms[whole_ms == INVALID_ROUGH_MS] = np.nan
    rough_rate = np.full(numbers.size, np.nan)
    if kind.rates:
        rate = columns.signed(numbers.size, 14)
        rough_rate = np.where(rate == ROUGH_RATE_INVALID, np.nan, rate)
    code_ms = rough_ms[of_satellite] + columns.fine(count, kind.code_width) / _CODE_PER_MS[kind.code_width]
    phase_ms = (
        rough_ms[of_satellite] + columns.fine(count, kind.phase_width) / _PHASE_PER_MS[kind.phase_width]
    )
    lock = columns.take(count, kind.lock_width)
    half = columns.take(count, 1).astype(np.bool_)
    cn0 = columns.take(count, kind.cn0_width) * _CN0_STEP[kind.cn0_width]
    cn0[cn0 == 0.0] = np.nan
    rate_m_s = rough_rate[of_satellite]
    if kind.rates:
        rate_m_s = rate_m_s + columns.fine(count, _RATE_WIDTH) * _RATE_STEP

    signal, carrier_hz = _SIGNAL_OF_ID[place, ids[of_signal]], _CARRIER_OF_ID_HZ[place, ids[of_signal]]
    known = signal > 0
    minimum_s = _MINIMUM_LOCK_S[kind.lock_width]
    epoch = ObservationEpoch(
        time_ns=gps_ns_near(system.letter, time_ms * 1_000_000, near_ns),
        satellite=(ord(system.letter) * 256 + numbers[of_satellite])[known],
        signal=signal[known],
        pseudorange_m=(code_ms * METRES_PER_MS)[known],
        carrier_phase_cycles=(phase_ms * METRES_PER_MS / SPEED_OF_LIGHT_M_S * carrier_hz)[known],
        doppler_hz=(-rate_m_s / SPEED_OF_LIGHT_M_S * carrier_hz)[known],
        cn0_dbhz=cn0[known],
        # Beyond indicator 704 the numbers are reserved: such a lock is taken for the longest.
        lock_time_s=np.minimum(minimum_s[lock], minimum_s[np.isfinite(minimum_s)][-1])[known],
        loss_of_lock=np.zeros(int(np.count_nonzero(known)), np.bool_),
        half_cycle=half[known],
    )
    return MsmMessage(station_id, more, epoch, minimum_s[lock + 1][known], count - epoch.satellite.size)


def _unsigned(bits: Bits, first: int, width: int) -> int:
    return int.from_bytes(
        np.packbits(np.concatenate((np.zeros(-width % 8, np.uint8), bits[first : first + width])))
    )


class _Columns:
    """Takes columns of integers one after another."""

    def __init__(self, bits: Bits, place: int) -> None:
        self._bits = bits
        self._place = place

    def take(self, count: int, width: int) -> Integers:
        end = self._place + count * width
        if end > self._bits.size:
            raise ValueError(f"message of {self._bits.size} bits, expected at least {end}")
        rows = self._bits[self._place : end].reshape(count, width)
        self._place = end
        return rows @ _POWERS[width]

    def signed(self, count: int, width: int) -> Integers:
        values = self.take(count, width)
        return np.where(values >> (width - 1), values - (1 << width), values)

    def fine(self, count: int, width: int) -> Floats:
        """Signed, where the lowest value says that there is none: NaN."""
        values = self.signed(count, width)
        return np.where(values == -(1 << (width - 1)), np.nan, values)


_POWERS = {width: 1 << np.arange(width - 1, -1, -1, dtype=np.int64) for width in range(1, 25)}


def _by_id() -> tuple[Integers, Floats]:
    signal, carrier = np.zeros((len(MSM_SYSTEMS), 33), np.int64), np.full((len(MSM_SYSTEMS), 33), np.nan)
    signal[MSM_SIGNALS.system, MSM_SIGNALS.ids] = MSM_SIGNALS.keys & 0xFFFF
    carrier[MSM_SIGNALS.system, MSM_SIGNALS.ids] = MSM_SIGNALS.carriers_hz
    return signal, carrier


_SIGNAL_OF_ID, _CARRIER_OF_ID_HZ = _by_id()
