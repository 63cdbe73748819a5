"""The epochs of RINEX 3 and 4 observation files: bytes → columns of all epochs at once, compiled.

Source: IGS/RTCM, "RINEX", versions 3.04 (2018) and 4.02 (2024), table A3. The fields are read by their columns and
strictly (`F14.3` has its point in column 11), so that a lost byte shows as damage and not as another value. A value is
the integer of its thousandths divided by 1000: correctly rounded, as reading the decimal text is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import signal_number
from camber.formats.rinex.observation_fields import (
    BAD,
    BLANK,
    GREATER,
    HEAD_BYTES,
    ZERO,
    Bytes,
    epoch_time,
    indicator,
    integer,
    line_end,
    satellite_at,
    text_end,
    thousandths,
)
from camber.formats.rinex.observation_header import SYSTEMS_SKIPPED, ObservationHeader, ObservationType

MAXIMUM_LINE_BYTES = 8192
"""A line of 511 observation types."""
MOST_LINES = 999
"""Of an epoch: its number has three digits."""
_PROBLEMS = 2 * (MOST_LINES + 1)

# Why the compiled loop came back.
NEEDS_MORE, EVENT, TABLE_FULL = 0, 1, 2
# What is wrong with a line or an epoch.
STRAY, EPOCH_LINE, CUT_SHORT, SATELLITE, VALUE, INDICATOR, BEYOND, TWICE, MIXED_UP, TOO_LONG = range(10)
EXPECTED: dict[int, tuple[str, str]] = {
    STRAY: ("line", "an epoch line, which begins with '>'"),
    EPOCH_LINE: ("epoch", "'> yyyy mm dd hh mm ss.sssssss', a flag from 0 to 6, the number of lines"),
    CUT_SHORT: ("epoch", "as many lines as it announces"),
    SATELLITE: ("satellite", "a system of the header and a number"),
    VALUE: ("value", "14 columns with three decimals, or blanks"),
    INDICATOR: ("indicators", "digits or blanks"),
    BEYOND: ("line", "nothing beyond the header's observation types"),
    TWICE: ("satellite", "each once an epoch"),
    MIXED_UP: ("epoch", "no damaged line beside a satellite given twice: bytes are missing"),
    TOO_LONG: ("line", f"at most {MAXIMUM_LINE_BYTES} bytes"),
}

# Of a system letter without columns: damage, or not read.
_NOT_IN_HEADER, _LEFT_OUT = -1, -2
_SKIPPED = 1000
_CODE, _PHASE, _DOPPLER, _STRENGTH = range(4)
_KINDS = {"C": _CODE, "L": _PHASE, "D": _DOPPLER, "S": _STRENGTH}
_NONE = -1

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


class HeaderTables(NamedTuple):
    """A header for the compiled loop.

    By system letter (256,): `first` column of its lines or one of the codes above, `column_count`, `signals`
    (256, most) and `signal_count`. By column: `kind`, `place` of its signal among the system's, `divisor`.
    """

    first: Integers
    column_count: Integers
    signals: Integers
    signal_count: Integers
    kind: Integers
    place: Integers
    divisor: Floats
    time_offset_ns: int
    picoseconds: bool


@dataclass(frozen=True, slots=True, eq=False)
class ColumnLayout:
    """The columns of a file, and their names."""

    columns: HeaderTables
    names: tuple[str, ...]

    @classmethod
    def of(cls, header: ObservationHeader) -> ColumnLayout:
        """Of a header."""
        first = np.full(256, _NOT_IN_HEADER, np.int64)
        count = np.zeros(256, np.int64)
        signal_count = np.zeros(256, np.int64)
        of_system = header.signals
        most = max((len(s) for s in of_system.values()), default=0)
        signals = np.zeros((256, max(most, 1)), np.int64)
        for system in SYSTEMS_SKIPPED:
            first[ord(system)] = _LEFT_OUT
        types: list[tuple[ObservationType, int]] = []
        for system, of_file in header.types.items():
            k = ord(system)
            first[k] = len(types) if of_file else _LEFT_OUT
            count[k] = len(of_file)
            signal_count[k] = len(of_system[system])
            signals[k, : signal_count[k]] = [signal_number(s) for s in of_system[system]]
            types += [(t, of_system[system].index(t.signal) if t.kind else 0) for t in of_file]
        columns = HeaderTables(
            first,
            count,
            signals,
            signal_count,
            kind=np.array([_KINDS.get(t.kind, _NONE) for t, _ in types], np.int64),
            place=np.array([place for _, place in types], np.int64),
            divisor=np.array([1000.0 * t.divisor for t, _ in types]),
            time_offset_ns=header.time_offset_ns,
            picoseconds=header.version >= 4.0,
        )
        return cls(columns, tuple(t.name for t, _ in types))


class _Tables(NamedTuple):
    """The output: floats (4, room), integers (2, room), flags (2, room) are the columns of `ObservationColumns`."""

    floats: Floats
    integers: Integers
    flags: Flags
    epochs: Integers
    problems: Integers
    skipped: Integers


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ObservationColumns:
    """Columns (rows,) of all epochs, as `ObservationEpoch` has them."""

    satellite: Integers
    signal: Integers
    pseudorange_m: Floats
    carrier_phase_cycles: Floats
    doppler_hz: Floats
    cn0_dbhz: Floats
    loss_of_lock: Flags
    half_cycle: Flags
    lock_time_s: Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Found:
    """What a piece of a file holds.

    `epochs` (n, 3): GPS time [ns], the end of its rows, the number of problems up to its end. `problems` (m, 4): line,
    first byte, one of the codes above, and the column concerned or −1. `skipped` (256,): satellites left out by system
    letter. `used` bytes and `lines` are done with; `event` (3,): where an event's header lines begin and end, and their
    number, if `stop` says so; `missing`: lines without which, or without another epoch line, more cannot be said.
    """

    rows: ObservationColumns
    epochs: Integers
    problems: Integers
    skipped: Integers
    used: int
    lines: int
    astray: bool
    stop: int
    event: tuple[int, int, int]
    missing: int


def read_epochs(data: bytes, layout: ColumnLayout, line_number: int, astray: bool) -> Found:
    """All whole epochs of bytes that end with a newline, up to the first event that brings header lines.

    `astray`: the lines before could not be read, and that has been said.
    """
    array = np.frombuffer(data, np.uint8)
    most_signals = layout.columns.signals.shape[1]
    # A row has a value of 14 bytes at least, a line no more rows than signals, an epoch a line of 35 bytes.
    room = min(array.size // 14, data.count(b"\n") * most_signals) + most_signals
    tables = _Tables(
        np.empty((4, room)),
        np.empty((2, room), np.int64),
        np.empty((2, room), np.bool_),
        np.empty((array.size // HEAD_BYTES + 1, 3), np.int64),
        np.empty((_PROBLEMS, 4), np.int64),
        np.zeros(256, np.int64),
    )
    n_rows, n_epochs, n_problems, used, lines, is_astray, stop, begin, end, count = _read_epochs(
        array, line_number, astray, layout.columns, tables
    )
    # Copies: what is kept of an epoch must not hold on to the room that was left over.
    floats, integers, flags = (t[:, :n_rows].copy() for t in (tables.floats, tables.integers, tables.flags))
    rows = ObservationColumns(
        satellite=integers[0],
        signal=integers[1],
        pseudorange_m=floats[0],
        carrier_phase_cycles=floats[1],
        doppler_hz=floats[2],
        cn0_dbhz=floats[3],
        loss_of_lock=flags[0],
        half_cycle=flags[1],
        lock_time_s=np.full(n_rows, np.nan),
    )
    return Found(
        rows=rows,
        epochs=tables.epochs[:n_epochs],
        problems=tables.problems[:n_problems],
        skipped=tables.skipped,
        used=used,
        lines=lines,
        astray=is_astray,
        stop=stop,
        event=(begin, end, count),
        missing=count if stop == NEEDS_MORE else 0,
    )


@compiled
def _read_epochs(
    data: Bytes, line_number: int, astray: bool, columns: HeaderTables, tables: _Tables
) -> tuple[int, int, int, int, int, bool, int, int, int, int]:
    """Numbers of rows, epochs, problems; bytes and lines used; astray; why it stops; what belongs to that."""
    starts = np.empty(MOST_LINES + 2, np.int64)
    taken = np.empty(MOST_LINES, np.int64)
    strength = np.empty(columns.signals.shape[1], np.int64)
    n_rows = n_epochs = n_problems = position = lines = 0
    while n_problems + MOST_LINES + 2 < _PROBLEMS:
        newline = line_end(data, position)
        if newline < 0:
            return n_rows, n_epochs, n_problems, position, lines, astray, NEEDS_MORE, 0, 0, 0
        # Of a line that is too long the reader may hold its beginning only: nothing rests on where its text ends.
        too_long = newline - position > MAXIMUM_LINE_BYTES
        end = text_end(data, position, newline)
        number = line_number + lines
        flag = count = -1
        time_ns = -1
        if data[position] == GREATER and not too_long:
            flag, count, time_ns = _epoch_line(data, position, end, columns.picoseconds)
        if flag < 0:
            fault = EPOCH_LINE if data[position] == GREATER else STRAY
            # Of lines that belong to no epoch the first is an error.
            if fault == EPOCH_LINE or ((end > position or too_long) and not astray):
                n_problems = _problem(tables, n_problems, number, position, fault, _NONE)
                astray = True
            position, lines = newline + 1, lines + 1
            continue
        astray = False

        starts[0] = newline + 1
        whole, ended = _find_lines(data, starts, count)
        if not ended:
            missing = count - whole
            return n_rows, n_epochs, n_problems, position, lines, astray, NEEDS_MORE, 0, 0, missing
        if whole < count:
            n_problems = _problem(tables, n_problems, number, position, CUT_SHORT, _NONE)
        elif 2 <= flag <= 5:
            begin, end, lines = starts[0], starts[count], lines + 1 + count
            return n_rows, n_epochs, n_problems, end, lines, astray, EVENT, begin, end, count
        elif flag < 2:
            rows_before, problems_before, n_taken = n_rows, n_problems, 0
            damaged = twice = False
            for k in range(count):
                begin, line = starts[k], number + 1 + k
                end = text_end(data, begin, starts[k + 1] - 1)
                satellite, fault = _satellite_or_fault(data, begin, end, columns, taken, n_taken)
                if starts[k + 1] - 1 - begin > MAXIMUM_LINE_BYTES:
                    fault = TOO_LONG
                where = _NONE
                if fault == _SKIPPED:
                    tables.skipped[satellite >> 8] += 1
                    continue
                if fault < 0:
                    taken[n_taken] = satellite
                    n_taken += 1
                    _clear_rows(tables, n_rows, columns.signal_count[satellite >> 8], strength, flag == 1)
                    fault, where = _read_values(
                        data, begin, end, satellite, columns, tables, n_rows, strength
                    )
                if fault >= 0:
                    damaged |= fault != TWICE
                    twice |= fault == TWICE
                    n_problems = _problem(tables, n_problems, line, begin, fault, where)
                else:
                    n_rows = _keep_observed(satellite, columns, tables, n_rows, strength)
            if damaged and twice:
                n_rows = rows_before
                n_problems = _problem(tables, problems_before, number, position, MIXED_UP, _NONE)
            else:
                tables.epochs[n_epochs, 0] = time_ns + columns.time_offset_ns
                tables.epochs[n_epochs, 1] = n_rows
                tables.epochs[n_epochs, 2] = n_problems
                n_epochs += 1
        position, lines = starts[whole], lines + 1 + whole
    return n_rows, n_epochs, n_problems, position, lines, astray, TABLE_FULL, 0, 0, 0


@compiled
def _epoch_line(data: Bytes, position: int, end: int, picoseconds: bool) -> tuple[int, int, int]:
    """Flag, number of lines, time in the file's system; the flag is −1 where the line is damaged."""
    if end - position < HEAD_BYTES:
        return -1, -1, -1
    flag = int(data[position + 31]) - ZERO
    count = integer(data, position + 32, position + 35)
    time_ns = epoch_time(data, position, end, picoseconds)
    # The time of an event may be blank.
    if not 0 <= flag <= 6 or count < 0 or (time_ns < 0 and not 2 <= flag <= 5):
        return -1, -1, -1
    return flag, count, time_ns


@compiled
def _find_lines(data: Bytes, starts: Integers, count: int) -> tuple[int, bool]:
    """Where the lines of an epoch begin, from `starts[0]` on: how many there are, and whether that is all.

    One that begins with '>' is the next epoch already.
    """
    for whole in range(count):
        begin = starts[whole]
        if begin < data.size and data[begin] == GREATER:
            return whole, True
        newline = line_end(data, begin)
        if newline < 0:
            return whole, False
        starts[whole + 1] = newline + 1
    return count, True


@compiled
def _satellite_or_fault(
    data: Bytes, begin: int, end: int, columns: HeaderTables, taken: Integers, n_taken: int
) -> tuple[int, int]:
    """The satellite of a line, and what is wrong with it, −1: nothing."""
    satellite = satellite_at(data, begin, end)
    first = columns.first[satellite >> 8] if satellite >= 0 else _NOT_IN_HEADER
    if first == _NOT_IN_HEADER:
        return satellite, SATELLITE
    if first == _LEFT_OUT:
        return satellite, _SKIPPED
    for k in range(n_taken):
        if taken[k] == satellite:
            return satellite, TWICE
    return satellite, -1


@compiled
def _clear_rows(tables: _Tables, begin: int, n: int, strength: Integers, power_failed: bool) -> None:
    for row in range(begin, begin + n):
        for what in range(4):
            tables.floats[what, row] = np.nan
        tables.flags[0, row] = power_failed
        tables.flags[1, row] = False
        strength[row - begin] = 0


@compiled
def _read_values(
    data: Bytes,
    begin: int,
    end: int,
    satellite: int,
    columns: HeaderTables,
    tables: _Tables,
    n_rows: int,
    strength: Integers,
) -> tuple[int, int]:
    """Fills the rows of a satellite's signals. What is wrong, −1: nothing, and in which column."""
    field = begin + 3
    first, count = columns.first[satellite >> 8], columns.column_count[satellite >> 8]
    if end > field + 16 * count:
        return BEYOND, _NONE
    for j in range(first, first + count):
        if field >= end:
            break
        what = columns.kind[j]
        if what >= 0:
            value = thousandths(data, field, end)
            lock = indicator(data, field + 14, end)
            level = indicator(data, field + 15, end)
            if value == BAD:
                return VALUE, j
            if lock < 0 or level < 0:
                return INDICATOR, j
            place = columns.place[j]
            # The standard: what is missing is blank or zero.
            if value != BLANK and value != 0:
                tables.floats[what, n_rows + place] = value / columns.divisor[j]
            if what == _PHASE:
                tables.flags[0, n_rows + place] |= lock & 1 != 0
                tables.flags[1, n_rows + place] |= lock & 2 != 0
            # A phase's signal strength before a pseudorange's.
            if level > 0 and (what == _PHASE or (what == _CODE and strength[place] == 0)):
                strength[place] = level
        field += 16
    return -1, _NONE


@compiled
def _keep_observed(
    satellite: int, columns: HeaderTables, tables: _Tables, n_rows: int, strength: Integers
) -> int:
    """Moves the rows of which something was observed together; returns the number of rows then.

    A signal strength digit is no observation; it stands for 6 dB-Hz, of which the middle is taken.
    """
    kept = n_rows
    for j in range(columns.signal_count[satellite >> 8]):
        row = n_rows + j
        observed = False
        for what in range(4):
            observed |= not np.isnan(tables.floats[what, row])
        if not observed:
            continue
        if np.isnan(tables.floats[_STRENGTH, row]) and strength[j] > 0:
            tables.floats[_STRENGTH, row] = 6.0 * strength[j] + 3.0
        for what in range(4):
            tables.floats[what, kept] = tables.floats[what, row]
        for what in range(2):
            tables.flags[what, kept] = tables.flags[what, row]
        tables.integers[0, kept] = satellite
        tables.integers[1, kept] = columns.signals[satellite >> 8, j]
        kept += 1
    return kept


@compiled
def _problem(tables: _Tables, n: int, line: int, position: int, code: int, column: int) -> int:
    problems = tables.problems
    problems[n, 0] = line
    problems[n, 1] = position
    problems[n, 2] = code
    problems[n, 3] = column
    return n + 1
