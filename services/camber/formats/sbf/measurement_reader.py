"""MeasEpoch blocks decoded to observations.

Source: Septentrio mosaic-X5 reference guide, MeasEpoch: a satellite's first signal with full values (sub-blocks of
type 1), its further ones as differences to it (type 2).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import (
    GLONASS_CHANNELS,
    SPEED_OF_LIGHT_M_S,
    Floats,
    Integers,
    ObservationEpoch,
    signal_number,
)
from camber.formats.receiver.loss_of_lock import LossOfLockDetector
from camber.formats.receiver.receiver_epoch import OmittedMeasurements, ReceiverEpoch, first_rows
from camber.formats.sbf.signal_numbers import (
    CARRIER_OF_SIGNAL_HZ,
    CHANNEL_OF_SIGNAL_HZ,
    E6_SIGNAL,
    GPS_P_CODES,
    SATELLITE_OF_SVID,
    SIGNAL_OF_NUMBER,
    SYSTEM_OF_SIGNAL,
)

_HEADER = struct.Struct("<6xBBBBBx")
_FIRST = np.dtype(
    [
        *(("RxChannel", "u1"), ("Type", "u1"), ("SVID", "u1"), ("Misc", "u1"), ("CodeLSB", "<u4")),
        *(("Doppler", "<i4"), ("CarrierLSB", "<u2"), ("CarrierMSB", "i1"), ("CN0", "u1")),
        *(("LockTime", "<u2"), ("ObsInfo", "u1"), ("N2", "u1")),
    ]
)
_FURTHER = np.dtype(
    [
        *(("Type", "u1"), ("LockTime", "u1"), ("CN0", "u1"), ("OffsetsMSB", "u1"), ("CarrierMSB", "i1")),
        *(("ObsInfo", "u1"), ("CodeOffsetLSB", "<u2"), ("CarrierLSB", "<u2"), ("DopplerOffsetLSB", "<u2")),
    ]
)
_E6B_USED = 1 << 6  # `CommonFlags`
_HALF_CYCLE = 1 << 2  # `ObsInfo`
_SIGNAL_IN_INFO = 31  # `Type`: the signal number less 32 is in `ObsInfo`
_CHANNEL_OFFSET = 8  # `ObsInfo`, bits 3 to 7 of a signal of GLONASS: frequency channel plus 8
_LOCK_RESOLUTION_S = 1.0  # mosaic-X5 reference guide, `LockTime`
_CN0_OFFSET_DBHZ = 10.0  # mosaic-X5 reference guide, `CN0`
_CN0_UNKNOWN = 255  # mosaic-X5 reference guide, `CN0`


class _MeasurementColumns(NamedTuple):
    """Rows (n,) of all signals; NaN where the receiver reports no value. `lock_clipped`: locked at least so long."""

    svid: Integers
    kind: Integers
    info: Integers
    code_mm: Floats
    phase_mcycles: Floats
    doppler_hz: Floats
    cn0: Integers
    lock_s: Floats
    lock_clipped: NDArray[np.bool_]


class Measurements(NamedTuple):
    """An epoch of the main antenna, what was left out of it, and the block's count of clock jumps (one byte)."""

    epoch: ReceiverEpoch
    omitted: OmittedMeasurements
    clock_jumps: int


def read_measurements(
    body: bytes, time_ns: int, locks: LossOfLockDetector, clock_jumps: int | None
) -> Measurements:
    """Decode the body of a MeasEpoch of this time; sub-blocks may be longer than known.

    `clock_jumps` is the count of the block before: a change is a reset by whole ms. `half_cycle`: there is a phase, and
    its half cycles are not resolved. `loss_of_lock`: by `LossOfLockDetector`; a phase without lock time has lost it. Of
    repeated signals the first counts. ValueError where the block is inconsistent.
    """
    if len(body) < _HEADER.size:
        raise ValueError(f"{len(body)} bytes, expected at least {_HEADER.size}")
    count, first_size, further_size, flags, jumps = _HEADER.unpack_from(body)
    firsts, further, parent = _sub_blocks(body, (count, first_size, further_size))
    columns = _columns(firsts, further, parent)
    number = _number(columns)
    satellite, carrier_hz = SATELLITE_OF_SVID[columns.svid], _carriers_hz(columns)
    signal = np.where(
        (number == E6_SIGNAL) & bool(flags & _E6B_USED), signal_number("6B"), SIGNAL_OF_NUMBER[number]
    )
    keys = (satellite << 16) + signal
    main = columns.kind >> 5 == 0
    supported = main & (satellite > 0)
    known = supported & (SYSTEM_OF_SIGNAL[number] == satellite >> 8)
    used, repeated = first_rows(known, keys)
    omitted = OmittedMeasurements(
        other_systems=int(np.count_nonzero(main & ~supported)),
        unknown_signals=int(np.count_nonzero(supported & ~known)),
        repeated=repeated,
        other_antennas=int(np.count_nonzero(~main)),
    )
    phase = columns.code_mm / 1000.0 * carrier_hz / SPEED_OF_LIGHT_M_S + columns.phase_mcycles / 1000.0
    columns = _MeasurementColumns._make(column[used] for column in columns)
    has_phase, lock_s = ~np.isnan(phase[used]), np.nan_to_num(columns.lock_s)
    resolution_s = np.where(np.isnan(columns.lock_s), 0.0, _LOCK_RESOLUTION_S)
    cn0 = columns.cn0 * 0.25 + np.where(np.isin(number[used], GPS_P_CODES), 0.0, _CN0_OFFSET_DBHZ)
    epoch = ObservationEpoch(
        time_ns=time_ns,
        satellite=satellite[used],
        signal=signal[used],
        pseudorange_m=columns.code_mm / 1000.0,
        carrier_phase_cycles=phase[used],
        doppler_hz=columns.doppler_hz,
        cn0_dbhz=np.where(columns.cn0 == _CN0_UNKNOWN, np.nan, cn0),
        lock_time_s=columns.lock_s,
        loss_of_lock=locks.detect(
            time_ns,
            keys[used],
            has_phase=has_phase,
            min_lock_s=lock_s,
            max_lock_s=np.where(columns.lock_clipped, np.inf, lock_s + resolution_s),
        ),
        half_cycle=has_phase & (columns.info & _HALF_CYCLE > 0),
    )
    reset = clock_jumps is not None and jumps != clock_jumps
    return Measurements(ReceiverEpoch(epoch, reset), omitted, jumps)


def _sub_blocks(
    body: bytes, sizes: tuple[int, int, int]
) -> tuple[NDArray[np.void], NDArray[np.void], Integers]:
    """Return the sub-blocks of both types, and for each of type 2 the index of the one of type 1 before it."""
    count, first_size, further_size = sizes
    if count and (first_size < _FIRST.itemsize or further_size < _FURTHER.itemsize):
        raise ValueError(f"sub-blocks of {first_size} and {further_size} bytes")
    firsts, further, parent, at = list[int](), list[int](), list[int](), _HEADER.size
    for row in range(count):
        if at + first_size > len(body):
            raise ValueError(f"{len(body)} bytes, expected {count} satellites")
        firsts.append(at)
        count_further = body[at + _FIRST.itemsize - 1]
        at += first_size
        end = at + count_further * further_size
        further += range(at, end, further_size)
        parent += [row] * count_further
        at = end
    if at > len(body):
        raise ValueError(f"{len(body)} bytes, expected {at}")
    return _rows(body, firsts, _FIRST), _rows(body, further, _FURTHER), np.array(parent, np.int64)


def _rows(body: bytes, starts: list[int], layout: np.dtype[np.void]) -> NDArray[np.void]:
    index = np.add.outer(np.array(starts, np.int64), np.arange(layout.itemsize))
    return np.ascontiguousarray(np.frombuffer(body, np.uint8)[index]).view(layout).reshape(-1)


def _columns(firsts: NDArray[np.void], further: NDArray[np.void], parent: Integers) -> _MeasurementColumns:
    """Return all signals, those of a satellite one after another."""
    order = np.argsort(np.concatenate((np.arange(firsts.size), parent)), kind="stable")
    first, second = _first_columns(firsts), _further_columns(further)
    carriers_hz = _carriers_hz(first)[parent], _carriers_hz(second)
    second = second._replace(
        svid=first.svid[parent],
        code_mm=first.code_mm[parent] + second.code_mm,
        doppler_hz=first.doppler_hz[parent] * (carriers_hz[1] / carriers_hz[0]) + second.doppler_hz,
    )
    return _MeasurementColumns._make(np.concatenate(pair)[order] for pair in zip(first, second, strict=True))


def _number(columns: _MeasurementColumns) -> Integers:
    low = columns.kind & 31
    return np.where(low == _SIGNAL_IN_INFO, (columns.info >> 3) + 32, low)


def _carriers_hz(columns: _MeasurementColumns) -> Floats:
    """Return the carriers; of GLONASS' channels NaN where the channel is not known."""
    number, channel = _number(columns), (columns.info >> 3) - _CHANNEL_OFFSET
    carriers_hz = CARRIER_OF_SIGNAL_HZ[number] + channel * CHANNEL_OF_SIGNAL_HZ[number]
    has_channel = CHANNEL_OF_SIGNAL_HZ[number] > 0.0
    return np.where(has_channel & ~np.isin(channel, GLONASS_CHANNELS), np.nan, carriers_hz)


def _first_columns(rows: NDArray[np.void]) -> _MeasurementColumns:
    code_mm = (rows["Misc"].astype(np.int64) & 15) << 32 | rows["CodeLSB"]
    doppler = rows["Doppler"].astype(np.float64) / 1e4
    return _MeasurementColumns(
        svid=rows["SVID"].astype(np.int64),
        kind=rows["Type"].astype(np.int64),
        info=rows["ObsInfo"].astype(np.int64),
        code_mm=np.where(code_mm > 0, code_mm, np.nan),
        phase_mcycles=_split(rows["CarrierMSB"], rows["CarrierLSB"], -128),
        doppler_hz=np.where(rows["Doppler"] == -(2**31), np.nan, doppler),
        cn0=rows["CN0"].astype(np.int64),
        lock_s=np.where(rows["LockTime"] == 65535, np.nan, rows["LockTime"]),
        lock_clipped=rows["LockTime"] == 65534,
    )


def _further_columns(rows: NDArray[np.void]) -> _MeasurementColumns:
    """Return columns whose code and Doppler are differences; the satellite is missing."""
    offsets = rows["OffsetsMSB"].astype(np.int64)
    return _MeasurementColumns(
        svid=np.zeros(rows.size, np.int64),
        kind=rows["Type"].astype(np.int64),
        info=rows["ObsInfo"].astype(np.int64),
        code_mm=_split(((offsets & 7) ^ 4) - 4, rows["CodeOffsetLSB"], -4),
        phase_mcycles=_split(rows["CarrierMSB"], rows["CarrierLSB"], -128),
        doppler_hz=_split((offsets >> 3 ^ 16) - 16, rows["DopplerOffsetLSB"], -16) / 1e4,
        cn0=rows["CN0"].astype(np.int64),
        lock_s=np.where(rows["LockTime"] == 255, np.nan, rows["LockTime"]),
        lock_clipped=rows["LockTime"] == 254,
    )


def _split(high: NDArray[np.generic], low: NDArray[np.generic], missing: int) -> Floats:
    """Return signed high parts × 65536 + low parts; NaN for the lowest possible number, "not available"."""
    wide = high.astype(np.int64)
    value = wide * 65536 + low.astype(np.int64)
    return np.where(value == missing * 65536, np.nan, value)
