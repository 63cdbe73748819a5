"""Observations of one epoch as RTCM 3.3 MSM7 messages (1077, 1097, 1117, 1127).

Source: RTCM 10403.3, 3.5.16: header (table 3.5-78), satellite data (3.5-81), signal data (3.5-88), DF393 to DF420.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.broadcast.bit_fields import bits_to_bytes, pack_bits, pack_columns
from camber.formats.observations import (
    SPEED_OF_LIGHT_M_S,
    Floats,
    Integers,
    ObservationEpoch,
    satellite_name,
    signal_name,
)
from camber.formats.rtcm.msm_signals import METRES_PER_MS, MSM_SIGNALS, MSM_SYSTEMS
from camber.geodesy.gps_time import NS_PER_WEEK

MAX_CELLS = 64
"""DF396"""
ROUGH_PER_MS = 1024.0
"""DF398: 2^-10 ms, about 293 m."""
RANGE_MS_INVALID = 255
"""DF397"""
PSEUDORANGE_PER_MS, PSEUDORANGE_INVALID = 2.0**29, -(1 << 19)
"""DF405: less than 293 m from the rough range, in steps of 0.6 mm."""
PHASE_PER_MS, PHASE_INVALID = 2.0**31, -(1 << 23)
"""DF406: less than 1171 m from the rough range, in steps of 0.14 mm."""
ROUGH_RATE_INVALID = -(1 << 13)
"""DF399, m/s"""
RATE_PER_M_S, RATE_INVALID = 1e4, -(1 << 14)
"""DF404"""
CN0_PER_DBHZ, MAX_CN0 = 16.0, 1023
"""DF408; 0 is "unknown"."""
NS_PER_MS = 1_000_000  # unit
_MAX_LOCK_MS = float(1 << 26)  # DF407, indicator 704
_CELL_WIDTHS = (20, 24, 10, 1, 10, 15)
_MAX_SATELLITES = np.array([system.satellites for system in MSM_SYSTEMS])


def msm7_payloads(epoch: ObservationEpoch, *, station_id: int, more_follow: bool = False) -> list[bytes]:
    """Return the messages of one epoch, without frames: one per system, several where there are more than 64 cells.

    The multiple-message bit is set in all but the last, with `more_follow` also there (another message of the same
    epoch and station follows). The phase must be within 1171 m of the rough range, which is that of the pseudoranges:
    receivers initialise their cycle count accordingly. Loss of lock is expressed by the lock time alone (DF407), hence
    `loss_of_lock` is not encoded. Doppler is RINEX's, positive when approaching; a phase range rate is positive when
    receding (DF399). A row without any value stays a cell without values.

    Raises ValueError with satellite, signal, field and range for values that the message cannot represent.
    """
    if epoch.time_ns % NS_PER_MS:
        raise ValueError(f"time tag {epoch.time_ns} ns, expected whole milliseconds (DF004)")
    if not 0 <= station_id < 4096:
        raise ValueError(f"station id is {station_id}, expected 0 to 4095 (DF003)")
    if not epoch.satellite.size:
        return []
    cells = _cells(epoch)
    parts = [
        (MSM_SYSTEMS[system], part)
        for system in np.unique(cells.system).tolist()
        for part in _message_parts(cells, system)
    ]
    payloads = []
    for k, (system, part) in enumerate(parts):
        epoch_ms = (epoch.time_ns - system.gps_offset_ns) % NS_PER_WEEK // NS_PER_MS
        more = more_follow or k < len(parts) - 1
        # After the multiple-message bit: issue of data station, reserved, clock steering, external clock, smoothing.
        header = [(system.message, 12), (station_id, 12), (epoch_ms, 30), (int(more), 1), (0, 18)]
        payloads.append(_payload(header, cells, part))
    return payloads


def lock_indicator(lock_time_s: Floats) -> Integers:
    """Return the greatest DF407 (table 3.5-75) whose minimum lock time is not above the given one; 0 for NaN."""
    given_ms = np.where(np.isnan(lock_time_s), 0.0, lock_time_s) * 1e3
    time_ms = np.floor(np.clip(given_ms + 1e-6, 0.0, _MAX_LOCK_MS))
    whole = time_ms.astype(np.int64)
    # 32 steps for each doubling from 64 ms on, of 2, 4, 8, … ms.
    doubling = np.maximum(np.frexp(time_ms)[1].astype(np.int64) - 6, 0)
    return np.where(whole < 64, whole, 32 * (doubling + 1) + (whole - (32 << doubling) >> doubling))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Cells:
    """The epoch in integers: a row per cell, sorted by system, satellite and signal id, and a row per satellite.

    `satellite_row` is the satellite's row of each cell, `first` the first cell of each satellite.
    """

    system: Integers
    satellite: Integers
    signal_id: Integers
    satellite_row: Integers
    columns: tuple[Integers, ...]
    first: Integers
    rough_range: Integers
    rough_rate: Integers


_Quantity = tuple[str, Floats, float, str, int, int]
"""Name, values in steps, step, unit, lowest and highest value that the message can represent."""


def _cells(epoch: ObservationEpoch) -> _Cells:
    table_row, known = MSM_SIGNALS.rows(epoch.satellite, epoch.signal)
    number = epoch.satellite & 255
    rows = _sorted_rows(epoch, table_row, known, number)
    table_row, number = table_row[rows], number[rows]
    starts = np.empty(rows.size, np.bool_)
    starts[0] = True
    np.not_equal(epoch.satellite[rows[1:]], epoch.satellite[rows[:-1]], out=starts[1:])
    first = np.flatnonzero(starts)
    satellite_row = np.cumsum(starts) - 1

    wavelength_m = SPEED_OF_LIGHT_M_S / MSM_SIGNALS.carriers_hz[table_row]
    pseudorange_ms = epoch.pseudorange_m[rows] / METRES_PER_MS
    phase_ms = epoch.carrier_phase_cycles[rows] * wavelength_m / METRES_PER_MS
    rate_m_s = -epoch.doppler_hz[rows] * wavelength_m
    cn0, lock_ms = epoch.cn0_dbhz[rows] * CN0_PER_DBHZ, epoch.lock_time_s[rows] * 1e3
    for name, values in (("pseudorange", pseudorange_ms), ("phase", phase_ms), ("Doppler", rate_m_s)):
        if np.isinf(values).any():
            row = int(rows[np.flatnonzero(np.isinf(values))[0]])
            raise ValueError(f"{_name(epoch, row)}: {name} is infinite, expected a number")

    middle_ms = _middle(pseudorange_ms, first)
    middle = np.where(np.isnan(middle_ms), _middle(phase_ms, first), middle_ms) * ROUGH_PER_MS
    middle_rate = _middle(rate_m_s, first)
    rough, rough_rate = np.rint(middle), np.rint(middle_rate)
    rough_ms = (rough / ROUGH_PER_MS)[satellite_row]
    fine_range = (pseudorange_ms - rough_ms) * PSEUDORANGE_PER_MS
    fine_phase = (phase_ms - rough_ms) * PHASE_PER_MS
    fine_rate = (rate_m_s - rough_rate[satellite_row]) * RATE_PER_M_S
    m = METRES_PER_MS
    quantities: tuple[_Quantity, ...] = (
        ("range", middle[satellite_row], m / ROUGH_PER_MS, "m", 0, (RANGE_MS_INVALID << 10) - 1),
        ("pseudorange from the rough range", fine_range, m / PSEUDORANGE_PER_MS, "m", -524287, 524287),
        ("phase from the rough range", fine_phase, m / PHASE_PER_MS, "m", -8388607, 8388607),
        ("rough phase range rate", middle_rate[satellite_row], 1.0, "m/s", -8191, 8191),
        ("phase range rate from the rough rate", fine_rate, 1e-4, "m/s", -16383, 16383),
        ("C/N0", cn0, 1.0 / CN0_PER_DBHZ, "dB-Hz", 1, MAX_CN0),
        ("lock time", lock_ms, 1e-3, "s", 0, 1_000_000_000_000),
    )
    for quantity in quantities:
        _check_range(epoch, rows, quantity)
    columns = (
        _rounded(fine_range, PSEUDORANGE_INVALID),
        _rounded(fine_phase, PHASE_INVALID),
        lock_indicator(epoch.lock_time_s[rows]),
        epoch.half_cycle[rows].astype(np.int64),
        _rounded(cn0, 0),
        _rounded(fine_rate, RATE_INVALID),
    )
    return _Cells(
        system=MSM_SIGNALS.system[table_row],
        satellite=number,
        signal_id=MSM_SIGNALS.ids[table_row],
        satellite_row=satellite_row,
        columns=columns,
        first=first,
        rough_range=_rounded(rough, RANGE_MS_INVALID << 10),
        rough_rate=_rounded(rough_rate, ROUGH_RATE_INVALID),
    )


def _check_range(epoch: ObservationEpoch, rows: Integers, quantity: _Quantity) -> None:
    name, values, step, unit, low, high = quantity
    outside = np.flatnonzero((values <= low - 0.5) | (values >= high + 0.5))
    if outside.size:
        k = int(outside[0])
        raise ValueError(
            f"{_name(epoch, int(rows[k]))}: {name} is {values[k] * step:.4f} {unit},"
            f" expected {low * step:.4f} to {high * step:.4f} {unit}"
        )


def _sorted_rows(
    epoch: ObservationEpoch, table_row: Integers, known: NDArray[np.bool_], number: Integers
) -> Integers:
    """Return the rows by system, satellite and signal; ValueError for one without a number or a repeated one."""
    max_number = _MAX_SATELLITES[MSM_SIGNALS.system[table_row]]
    wrong = np.flatnonzero(~known | (number < 1) | (number > max_number))
    if wrong.size:
        row = int(wrong[0])
        expected = (
            f"satellites 1 to {max_number[row]}" if known[row] else "a signal of G, E, J or C in RTCM 3.3"
        )
        raise ValueError(f"{_name(epoch, row)} has no number in MSM messages, expected {expected}")
    key = (MSM_SIGNALS.system[table_row] << 12) + (number << 6) + MSM_SIGNALS.ids[table_row]
    rows = np.argsort(key, kind="stable")
    repeated = np.flatnonzero(np.diff(key[rows]) == 0)
    if repeated.size:
        raise ValueError(
            f"{_name(epoch, int(rows[repeated[0]]))}: observed twice in one epoch, expected once"
        )
    return rows


def _message_parts(cells: _Cells, system: int) -> list[tuple[slice, slice]]:
    """Return the (satellites, cells) of each message of a system: whole satellites, at most 64 cells in the mask."""
    begin, end = np.searchsorted(cells.system, (system, system + 1)).tolist()
    sat_begin, sat_end = np.searchsorted(cells.first, (begin, end)).tolist()
    signals = np.count_nonzero(np.bincount(cells.signal_id[begin:end]))
    step = MAX_CELLS // int(signals)
    edges = [*range(sat_begin, sat_end, step), sat_end]
    cell_edges = [*cells.first[edges[:-1]].tolist(), end]
    return [
        (slice(edges[i], edges[i + 1]), slice(cell_edges[i], cell_edges[i + 1]))
        for i in range(len(edges) - 1)
    ]


def _payload(header: list[tuple[int, int]], cells: _Cells, part: tuple[slice, slice]) -> bytes:
    satellites, rows = part
    numbers = cells.satellite[cells.first[satellites]]
    ids = cells.signal_id[rows]
    signal_mask = np.bincount(ids, minlength=33)[1:] > 0
    satellite_mask = np.zeros(64, np.uint8)
    satellite_mask[numbers - 1] = 1
    cell_mask = np.zeros((numbers.size, 32), np.uint8)
    cell_mask[cells.satellite_row[rows] - satellites.start, ids - 1] = 1
    bits, width = pack_bits(header)
    header_bits = np.unpackbits(np.frombuffer(bits_to_bytes(bits, width), np.uint8), count=width)
    rough = cells.rough_range[satellites]
    return pack_columns(
        (header_bits, satellite_mask, signal_mask, cell_mask[:, signal_mask].reshape(-1)),
        (
            (rough >> 10, 8),
            (np.zeros(numbers.size, np.int64), 4),  # extended satellite information: none
            (rough & 1023, 10),
            (cells.rough_rate[satellites], 14),
            *((column[rows], width) for column, width in zip(cells.columns, _CELL_WIDTHS, strict=True)),
        ),
    )


def _middle(values: Floats, first: Integers) -> Floats:
    """Return the mean of the least and the greatest value of each group of rows, NaN where there is none."""
    middle: Floats = 0.5 * (np.fmin.reduceat(values, first) + np.fmax.reduceat(values, first))
    return middle


def _rounded(values: Floats, if_nan: int) -> Integers:
    return np.where(np.isnan(values), if_nan, np.rint(values)).astype(np.int64)


def _name(epoch: ObservationEpoch, row: int) -> str:
    return f"{satellite_name(int(epoch.satellite[row]))} {signal_name(int(epoch.signal[row]))}"
