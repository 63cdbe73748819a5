"""Observations of one epoch as RTCM 3.3 MSM7 messages (1077, 1097, 1117, 1127).

Source: RTCM 10403.3, 3.5.16: header (table 3.5-78), satellite data (3.5-81), signal data (3.5-88), DF393 to DF420.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.broadcast.bit_fields import bit_array, joined, pack_columns
from camber.formats.observations import (
    SPEED_OF_LIGHT_M_S,
    Floats,
    Integers,
    ObservationEpoch,
    satellite_name,
    signal_name,
)
from camber.formats.rtcm.msm_signals import (
    METRES_PER_MS,
    MSM_SIGNALS,
    MSM_SYSTEMS,
    MsmSystem,
)
from camber.geodesy.gps_time import NS_PER_WEEK

MOST_CELLS = 64
ROUGH_PER_MS = 1024.0
"""DF398: 2^-10 ms, about 293 m."""
INVALID_ROUGH_MS = 255
"""DF397"""
PSEUDORANGE_PER_MS, PSEUDORANGE_INVALID = 2.0**29, -(1 << 19)
"""DF405: less than 293 m from the rough range, in steps of 0.6 mm."""
PHASE_PER_MS, PHASE_INVALID = 2.0**31, -(1 << 23)
"""DF406: less than 1171 m from the rough range, in steps of 0.14 mm."""
ROUGH_RATE_INVALID = -(1 << 13)
"""DF399, m/s"""
RATE_PER_M_S, RATE_INVALID = 1e4, -(1 << 14)
"""DF404"""
CN0_PER_DBHZ, MOST_CN0 = 16.0, 1023
"""DF408; 0 is "not known"."""
_NS_PER_MS = 1_000_000
_MOST_LOCK_MS = float(1 << 26)
_CELL_WIDTHS = (20, 24, 10, 1, 10, 15)


def msm7_payloads(epoch: ObservationEpoch, *, station_id: int, more_follow: bool = False) -> list[bytes]:
    """The messages of one epoch, without frames: one a system, more where there are over 64 cells.

    The multiple-message bit is set in all but the last, and in the last too with `more_follow` (another message of the
    same epoch and station comes after these). The phase must be within 1171 m of the rough range, which is that of the
    pseudoranges: a receiver starts its count of cycles so. A break of the phase is told by the lock time alone
    (DF407), hence `loss_of_lock` is not written. Doppler is RINEX's, positive when approaching; a phase range rate is
    positive when receding (DF399). A row without any value stays a cell without values.

    Raises ValueError, naming satellite, signal, field and range, for whatever the message cannot hold.
    """
    if epoch.time_ns % _NS_PER_MS:
        raise ValueError(f"time tag {epoch.time_ns} ns, expected whole milliseconds (DF004)")
    if not 0 <= station_id < 4096:
        raise ValueError(f"station id is {station_id}, expected 0 to 4095 (DF003)")
    if not epoch.satellite.size:
        return []
    cells = _cells(epoch)
    parts = [
        (MSM_SYSTEMS[place], part)
        for place in np.unique(cells.system).tolist()
        for part in _parts(cells, place)
    ]
    last = len(parts) - 1
    return [
        _payload(cells, part, system, epoch.time_ns, station_id, more_follow or place < last)
        for place, (system, part) in enumerate(parts)
    ]


def lock_indicator(lock_time_s: Floats) -> Integers:
    """DF407 (table 3.5-75): the indicator whose minimum lock time is the greatest not above the given, NaN as 0."""
    given_ms = np.where(np.isnan(lock_time_s), 0.0, lock_time_s) * 1e3
    time_ms = np.floor(np.clip(given_ms + 1e-6, 0.0, _MOST_LOCK_MS))
    whole = time_ms.astype(np.int64)
    # 32 steps for each doubling from 64 ms on, of 2, 4, 8, … ms.
    doubling = np.maximum(np.frexp(time_ms)[1].astype(np.int64) - 6, 0)
    return np.where(whole < 64, whole, 32 * (doubling + 1) + (whole - (32 << doubling) >> doubling))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Cells:
    """The whole epoch in integers, sorted by system, satellite and signal id, and one row a satellite beside it."""

    system: Integers
    satellite: Integers
    signal_id: Integers
    of_satellite: Integers
    columns: tuple[Integers, ...]
    first: Integers
    rough_range: Integers
    rough_rate: Integers


def _cells(epoch: ObservationEpoch) -> _Cells:
    place, known = MSM_SIGNALS.places(epoch.satellite, epoch.signal)
    number = epoch.satellite & 255
    rows = _sorted_rows(epoch, place, known, number)
    place, number = place[rows], number[rows]
    system, signal_id = MSM_SIGNALS.system[place], MSM_SIGNALS.ids[place]
    starts = np.empty(rows.size, np.bool_)
    starts[0] = True
    np.not_equal(epoch.satellite[rows[1:]], epoch.satellite[rows[:-1]], out=starts[1:])
    first = np.flatnonzero(starts)
    of_satellite = np.cumsum(starts) - 1

    wavelength_m = SPEED_OF_LIGHT_M_S / MSM_SIGNALS.carriers_hz[place]
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
    rough_ms = (rough / ROUGH_PER_MS)[of_satellite]
    from_rough = (pseudorange_ms - rough_ms) * PSEUDORANGE_PER_MS
    phase_from_rough = (phase_ms - rough_ms) * PHASE_PER_MS
    rate_from_rough = (rate_m_s - rough_rate[of_satellite]) * RATE_PER_M_S
    # What it is, in steps, how large a step is, its unit, the least and the greatest.
    quantities: tuple[_Quantity, ...] = (
        ("range", middle[of_satellite], _M / ROUGH_PER_MS, "m", 0, (INVALID_ROUGH_MS << 10) - 1),
        ("pseudorange from the rough range", from_rough, _M / PSEUDORANGE_PER_MS, "m", -524287, 524287),
        ("phase from the rough range", phase_from_rough, _M / PHASE_PER_MS, "m", -8388607, 8388607),
        ("rough phase range rate", middle_rate[of_satellite], 1.0, "m/s", -8191, 8191),
        ("phase range rate from the rough rate", rate_from_rough, 1e-4, "m/s", -16383, 16383),
        ("C/N0", cn0, 1.0 / CN0_PER_DBHZ, "dB-Hz", 1, MOST_CN0),
        ("lock time", lock_ms, 1e-3, "s", 0, 1_000_000_000_000),
    )
    for quantity in quantities:
        _check_range(epoch, rows, quantity)
    columns = (
        _whole(from_rough, PSEUDORANGE_INVALID),
        _whole(phase_from_rough, PHASE_INVALID),
        lock_indicator(epoch.lock_time_s[rows]),
        epoch.half_cycle[rows].astype(np.int64),
        _whole(cn0, 0),
        _whole(rate_from_rough, RATE_INVALID),
    )
    return _Cells(
        system=system,
        satellite=number,
        signal_id=signal_id,
        of_satellite=of_satellite,
        columns=columns,
        first=first,
        rough_range=_whole(rough, INVALID_ROUGH_MS << 10),
        rough_rate=_whole(rough_rate, ROUGH_RATE_INVALID),
    )


_M = METRES_PER_MS
_Quantity = tuple[str, Floats, float, str, int, int]


def _check_range(epoch: ObservationEpoch, rows: Integers, quantity: _Quantity) -> None:
    name, steps, step, unit, low, high = quantity
    outside = (steps <= low - 0.5) | (steps >= high + 0.5)
    if outside.any():
        place = int(np.flatnonzero(outside)[0])
        raise ValueError(
            f"{_name(epoch, int(rows[place]))}: {name} is {steps[place] * step:.4f} {unit},"
            f" expected {low * step:.4f} to {high * step:.4f} {unit}"
        )


def _sorted_rows(
    epoch: ObservationEpoch, place: Integers, known: NDArray[np.bool_], number: Integers
) -> Integers:
    """The rows by system, satellite and signal; ValueError where one cannot be named, or is there twice."""
    most = _MOST_SATELLITES[MSM_SIGNALS.system[place]]
    wrong = ~known | (number < 1) | (number > most)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        expected = f"satellites 1 to {most[row]}" if known[row] else "a signal of G, E, J or C in RTCM 3.3"
        raise ValueError(f"{_name(epoch, row)} has no number in MSM messages, expected {expected}")
    key = (MSM_SIGNALS.system[place] << 12) + (number << 6) + MSM_SIGNALS.ids[place]
    rows = np.argsort(key, kind="stable")
    key = key[rows]
    double = key[1:] == key[:-1]
    if double.any():
        row = int(rows[np.flatnonzero(double)[0]])
        raise ValueError(f"{_name(epoch, row)}: observed twice in one epoch, expected once")
    return rows


_MOST_SATELLITES = np.array([system.satellites for system in MSM_SYSTEMS])


def _parts(cells: _Cells, system: int) -> list[tuple[slice, slice]]:
    """The (satellites, cells) of each message of a system: whole satellites, at most 64 cells in the mask."""
    begin, end = np.searchsorted(cells.system, (system, system + 1)).tolist()
    sat_begin, sat_end = np.searchsorted(cells.first, (begin, end)).tolist()
    signals = np.count_nonzero(np.bincount(cells.signal_id[begin:end]))
    step = MOST_CELLS // int(signals)
    edges = [*range(sat_begin, sat_end, step), sat_end]
    of_cells = [*cells.first[edges[:-1]].tolist(), end]
    return [
        (slice(edges[i], edges[i + 1]), slice(of_cells[i], of_cells[i + 1])) for i in range(len(edges) - 1)
    ]


def _payload(
    cells: _Cells, part: tuple[slice, slice], system: MsmSystem, time_ns: int, station_id: int, more: bool
) -> bytes:
    of_satellites, of_cells = part
    numbers = cells.satellite[cells.first[of_satellites]]
    ids = cells.signal_id[of_cells]
    used = np.bincount(ids, minlength=33)[1:] > 0
    satellite_mask = np.zeros(64, np.uint8)
    satellite_mask[numbers - 1] = 1
    cell_mask = np.zeros((numbers.size, 32), np.uint8)
    cell_mask[cells.of_satellite[of_cells] - of_satellites.start, ids - 1] = 1

    epoch_ms = (time_ns - system.gps_offset_ns) % NS_PER_WEEK // _NS_PER_MS
    # After the multiple-message bit: issue of data station, reserved, clock steering, external clock, smoothing.
    header = joined(
        ((system.message, 12), (station_id, 12), (epoch_ms, 30), (int(more), 1), (0, 3 + 7 + 2 + 2 + 1 + 3))
    )
    rough = cells.rough_range[of_satellites]
    return pack_columns(
        (bit_array(*header), satellite_mask, used, cell_mask[:, used].reshape(-1)),
        (
            (rough >> 10, 8),
            (np.zeros(numbers.size, np.int64), 4),  # extended satellite information: none
            (rough & 1023, 10),
            (cells.rough_rate[of_satellites], 14),
            *((column[of_cells], width) for column, width in zip(cells.columns, _CELL_WIDTHS, strict=True)),
        ),
    )


def _middle(values: Floats, first: Integers) -> Floats:
    """Half-way between the least and the greatest value of each group of rows, NaN where there is none."""
    middle: Floats = 0.5 * (np.fmin.reduceat(values, first) + np.fmax.reduceat(values, first))
    return middle


def _whole(values: Floats, if_nan: int) -> Integers:
    return np.where(np.isnan(values), if_nan, np.rint(values)).astype(np.int64)


def _name(epoch: ObservationEpoch, row: int) -> str:
    return f"{satellite_name(int(epoch.satellite[row]))} {signal_name(int(epoch.signal[row]))}"
