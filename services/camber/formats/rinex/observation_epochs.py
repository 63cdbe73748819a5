"""The epochs of RINEX observation files in the lines of versions 3 and 4: bytes decoded to columns at once, compiled.

Source: IGS/RTCM, "RINEX", versions 3.04 (2018) and 4.02 (2024), table A3. The fields are read strictly by their columns
(`F14.3` has its point in column 11), so that a lost byte is an error and not another value. A value is the integer of
its thousandths divided by 1000: correctly rounded, like the decimal text.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers, ObservationEpoch, signal_number
from camber.formats.rinex.observation_fields import (
    BAD,
    BLANK,
    EPOCH_LINE_BYTES,
    GREATER,
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
"""Derived: a line of 511 observation types."""
_MAX_LINES = 999  # of an epoch: its number has three digits (table A3)
_MAX_PROBLEMS = 2 * (_MAX_LINES + 1)

# Why the compiled loop returns.
NEEDS_MORE, EVENT, TABLE_FULL = 0, 1, 2
# Problems of a line or an epoch.
_STRAY, _EPOCH_LINE, TRUNCATED, _SATELLITE, _VALUE, _INDICATOR, _BEYOND, _REPEATED, _MIXED, _TOO_LONG = range(
    10
)
EXPECTED: dict[int, tuple[str, str]] = {
    _STRAY: ("line", "an epoch line, which begins with '>'"),
    _EPOCH_LINE: ("epoch", "'> yyyy mm dd hh mm ss.sssssss', a flag from 0 to 6, the number of lines"),
    TRUNCATED: ("epoch", "as many lines as it announces"),
    _SATELLITE: ("satellite", "a system of the header and a number"),
    _VALUE: ("value", "14 columns with three decimals, or blanks"),
    _INDICATOR: ("indicators", "digits or blanks"),
    _BEYOND: ("line", "nothing beyond the header's observation types"),
    _REPEATED: ("satellite", "each once an epoch"),
    _MIXED: ("epoch", "no damaged line beside a satellite given twice: bytes are missing"),
    _TOO_LONG: ("line", f"at most {MAXIMUM_LINE_BYTES} bytes"),
}
_NO_PROBLEM = -1  # outside the codes above
# In place of the first column of a system letter: malformed, or skipped.
_NOT_IN_HEADER, _SKIPPED_SYSTEM = -1, -2
_SKIPPED_SATELLITE = 1000  # outside the codes above
_CODE, _PHASE, _DOPPLER, _STRENGTH = range(4)
_KINDS = {"C": _CODE, "L": _PHASE, "D": _DOPPLER, "S": _STRENGTH}
_NO_COLUMN = -1  # no index

Flags = NDArray[np.bool_]


class HeaderTables(NamedTuple):
    """A header for the compiled loop.

    By system letter (256,): `first` column of its lines or one of the codes above, `column_count`, `signals`
    (256, most) and `signal_count`. By column: `kind`, index of its `signal` among the system's, `divisor`.
    """

    first: Integers
    column_count: Integers
    signals: Integers
    signal_count: Integers
    kind: Integers
    signal: Integers
    divisor: Floats
    picoseconds: bool


@dataclass(frozen=True, slots=True, eq=False)
class ColumnLayout:
    """The columns of a file, and their names."""

    tables: HeaderTables
    names: tuple[str, ...]

    @classmethod
    def from_header(cls, header: ObservationHeader) -> ColumnLayout:
        """Return the columns of a header."""
        first = np.full(256, _NOT_IN_HEADER, np.int64)
        column_count = np.zeros(256, np.int64)
        signal_count = np.zeros(256, np.int64)
        system_signals = header.signals
        most = max((len(s) for s in system_signals.values()), default=0)
        signals = np.zeros((256, max(most, 1)), np.int64)
        for system in SYSTEMS_SKIPPED:
            first[ord(system)] = _SKIPPED_SYSTEM
        columns: list[tuple[ObservationType, int]] = []
        for system, types in header.types.items():
            k, names = ord(system), system_signals[system]
            first[k] = len(columns) if types else _SKIPPED_SYSTEM
            column_count[k] = len(types)
            signal_count[k] = len(names)
            signals[k, : len(names)] = [signal_number(s) for s in names]
            columns += [(t, names.index(t.signal) if t.kind else 0) for t in types]
        tables = HeaderTables(
            first=first,
            column_count=column_count,
            signals=signals,
            signal_count=signal_count,
            kind=np.array([_KINDS.get(t.kind, _NO_COLUMN) for t, _ in columns], np.int64),
            signal=np.array([signal for _, signal in columns], np.int64),
            divisor=np.array([1000.0 * t.divisor for t, _ in columns]),
            picoseconds=header.version >= 4.0,
        )
        return cls(tables, tuple(t.name for t, _ in columns))


class _Output(NamedTuple):
    """Arrays filled by the loop: floats (4, room), integers (2, room), flags (2, room) are columns of observations."""

    floats: Floats
    integers: Integers
    flags: Flags
    epochs: Integers
    problems: Integers
    skipped: Integers


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EpochBatch:
    """The content of a chunk of a file.

    `columns` (rows,) of all epochs, in the order of `ObservationEpoch`; RINEX has no lock time. `epochs` (n, 3):
    time [ns] in the file's system, end of its rows, number of problems up to its end. `problems` (m, 4): line, first
    byte, one of the codes above, and the column or −1. `skipped` (256,): satellites skipped by system letter.
    `consumed` bytes and `lines` are finished; `event` (3,): begin and end of an event's header lines, and their number,
    if `stop` is EVENT; `missing`: lines needed, or another epoch line, before the next epoch can be decoded.
    `stray_reported`: the last lines could not be read, and that has been reported.
    """

    columns: tuple[Integers, Integers, Floats, Floats, Floats, Floats, Floats, Flags, Flags]
    epochs: Integers
    problems: Integers
    skipped: Integers
    consumed: int
    lines: int
    stray_reported: bool
    stop: int
    event: tuple[int, int, int]
    missing: int

    def observations(self, time_ns: int, rows: slice) -> ObservationEpoch:
        """Return the observations of one epoch."""
        satellite, signal, pseudorange, phase, doppler, cn0, lock_time, loss_of_lock, half_cycle = (
            self.columns
        )
        return ObservationEpoch(
            time_ns=time_ns,
            satellite=satellite[rows],
            signal=signal[rows],
            pseudorange_m=pseudorange[rows],
            carrier_phase_cycles=phase[rows],
            doppler_hz=doppler[rows],
            cn0_dbhz=cn0[rows],
            lock_time_s=lock_time[rows],
            loss_of_lock=loss_of_lock[rows],
            half_cycle=half_cycle[rows],
        )


def read_epochs(data: bytes, layout: ColumnLayout, line_number: int, stray_reported: bool) -> EpochBatch:
    """Decode all whole epochs of bytes that end with a newline, up to the first event with header lines."""
    array = np.frombuffer(data, np.uint8)
    max_signals = layout.tables.signals.shape[1]
    # A row has a value of 14 bytes at least, a line no more rows than signals, an epoch a line of 35 bytes.
    room = min(array.size // 14, data.count(b"\n") * max_signals) + max_signals
    output = _Output(
        floats=np.empty((4, room)),
        integers=np.empty((2, room), np.int64),
        flags=np.empty((2, room), np.bool_),
        epochs=np.empty((array.size // EPOCH_LINE_BYTES + 1, 3), np.int64),
        problems=np.empty((_MAX_PROBLEMS, 4), np.int64),
        skipped=np.zeros(256, np.int64),
    )
    n_rows, n_epochs, n_problems, consumed, lines, stray_reported, stop, event, missing = _read_epochs(
        array, (line_number, stray_reported), layout.tables, output
    )
    # Copies: what is kept of an epoch must not keep the unused room alive.
    integers, floats = output.integers[:, :n_rows].copy(), output.floats[:, :n_rows].copy()
    flags, lock_time_s = output.flags[:, :n_rows].copy(), np.full(n_rows, np.nan)
    return EpochBatch(
        columns=(*integers, *floats, lock_time_s, *flags),
        epochs=output.epochs[:n_epochs],
        problems=output.problems[:n_problems],
        skipped=output.skipped,
        consumed=consumed,
        lines=lines,
        stray_reported=stray_reported,
        stop=stop,
        event=event,
        missing=missing,
    )


@compiled
def _read_epochs(
    data: Bytes, state: tuple[int, bool], columns: HeaderTables, output: _Output
) -> tuple[int, int, int, int, int, bool, int, tuple[int, int, int], int]:
    """Return numbers of rows, epochs, problems; bytes and lines consumed; stray reported; stop; event; missing."""
    line_number, stray_reported = state
    starts = np.empty(_MAX_LINES + 2, np.int64)
    no_event = (0, 0, 0)
    n_rows = n_epochs = n_problems = position = lines = 0
    while n_problems + _MAX_LINES + 2 < _MAX_PROBLEMS:
        newline = line_end(data, position)
        if newline < 0:
            return n_rows, n_epochs, n_problems, position, lines, stray_reported, NEEDS_MORE, no_event, 0
        # Of a line that is too long the caller may keep only the beginning: its end must not matter.
        too_long = newline - position > MAXIMUM_LINE_BYTES
        end = text_end(data, position, newline)
        number = line_number + lines
        flag = count = -1
        time_ns = -1
        if data[position] == GREATER and not too_long:
            flag, count, time_ns = _epoch_line(data, position, end, columns.picoseconds)
        if flag < 0:
            problem = _EPOCH_LINE if data[position] == GREATER else _STRAY
            # Of lines that belong to no epoch the first is an error.
            if problem == _EPOCH_LINE or ((end > position or too_long) and not stray_reported):
                n_problems = _add_problem(output, n_problems, (number, position, problem, _NO_COLUMN))
                stray_reported = True
            position, lines = newline + 1, lines + 1
            continue
        stray_reported = False

        starts[0] = newline + 1
        whole, ended = _find_lines(data, starts, count)
        if not ended:
            stop, missing = NEEDS_MORE, count - whole
            return n_rows, n_epochs, n_problems, position, lines, stray_reported, stop, no_event, missing
        if whole < count:
            n_problems = _add_problem(output, n_problems, (number, position, TRUNCATED, _NO_COLUMN))
        elif 2 <= flag <= 5:
            event = (starts[0], starts[count], count)
            lines += 1 + count
            return n_rows, n_epochs, n_problems, starts[count], lines, stray_reported, EVENT, event, 0
        elif flag < 2:
            new_rows, new_problems, mixed = _read_satellites(
                data,
                starts[: count + 1],
                columns,
                output,
                first_line=number + 1,
                n_rows=n_rows,
                n_problems=n_problems,
                power_failed=flag == 1,
            )
            if mixed:
                n_problems = _add_problem(output, n_problems, (number, position, _MIXED, _NO_COLUMN))
            else:
                n_rows, n_problems = new_rows, new_problems
                output.epochs[n_epochs, 0] = time_ns
                output.epochs[n_epochs, 1] = n_rows
                output.epochs[n_epochs, 2] = n_problems
                n_epochs += 1
        position, lines = starts[whole], lines + 1 + whole
    return n_rows, n_epochs, n_problems, position, lines, stray_reported, TABLE_FULL, no_event, 0


@compiled
def _read_satellites(
    data: Bytes,
    starts: Integers,
    columns: HeaderTables,
    output: _Output,
    first_line: int,
    n_rows: int,
    n_problems: int,
    power_failed: bool,
) -> tuple[int, int, bool]:
    """Decode the lines of an epoch; return numbers of rows and problems, and whether two epochs are mixed."""
    taken, n_taken = np.empty(starts.size, np.int64), 0
    strength = np.empty(columns.signals.shape[1], np.int64)
    damaged = repeated = False
    for k in range(starts.size - 1):
        begin, newline = starts[k], starts[k + 1] - 1
        end = text_end(data, begin, newline)
        satellite, problem = _satellite_or_problem(data, (begin, end), columns, taken[:n_taken])
        if newline - begin > MAXIMUM_LINE_BYTES:
            problem = _TOO_LONG
        column = _NO_COLUMN
        if problem == _SKIPPED_SATELLITE:
            output.skipped[satellite >> 8] += 1
            continue
        if problem == _NO_PROBLEM:
            taken[n_taken] = satellite
            n_taken += 1
            _clear_rows(output, (n_rows, columns.signal_count[satellite >> 8]), strength, power_failed)
            problem, column = _read_values(
                data, (begin, end), columns, output, satellite=satellite, n_rows=n_rows, strength=strength
            )
        if problem == _NO_PROBLEM:
            n_rows = _keep_observed(columns, output, satellite=satellite, n_rows=n_rows, strength=strength)
        else:
            damaged |= problem != _REPEATED
            repeated |= problem == _REPEATED
            n_problems = _add_problem(output, n_problems, (first_line + k, begin, problem, column))
    return n_rows, n_problems, damaged and repeated


@compiled
def _epoch_line(data: Bytes, position: int, end: int, picoseconds: bool) -> tuple[int, int, int]:
    """Return flag, number of lines, time in the file's system; the flag is −1 where the line is malformed."""
    if end - position < EPOCH_LINE_BYTES:
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
    """Set the starts of an epoch's lines, from `starts[0]` on; return their number, and whether it is final.

    A line that begins with '>' is the next epoch already.
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
def _satellite_or_problem(
    data: Bytes, span: tuple[int, int], columns: HeaderTables, taken: Integers
) -> tuple[int, int]:
    """Return the satellite of a line, and the problem with it."""
    satellite = satellite_at(data, span[0], span[1])
    first = columns.first[satellite >> 8] if satellite >= 0 else _NOT_IN_HEADER
    if first == _NOT_IN_HEADER:
        return satellite, _SATELLITE
    if first == _SKIPPED_SYSTEM:
        return satellite, _SKIPPED_SATELLITE
    for other in taken:
        if other == satellite:
            return satellite, _REPEATED
    return satellite, _NO_PROBLEM


@compiled
def _clear_rows(output: _Output, rows: tuple[int, int], strength: Integers, power_failed: bool) -> None:
    begin, n = rows
    for row in range(begin, begin + n):
        for kind in range(4):
            output.floats[kind, row] = np.nan
        output.flags[0, row] = power_failed
        output.flags[1, row] = False
        strength[row - begin] = 0


@compiled
def _read_values(
    data: Bytes,
    span: tuple[int, int],
    columns: HeaderTables,
    output: _Output,
    satellite: int,
    n_rows: int,
    strength: Integers,
) -> tuple[int, int]:
    """Fill the rows of a satellite's signals; return the problem and its column."""
    field, end = span[0] + 3, span[1]
    first, count = columns.first[satellite >> 8], columns.column_count[satellite >> 8]
    if end > field + 16 * count:
        return _BEYOND, _NO_COLUMN
    for j in range(first, first + count):
        if field >= end:
            break
        kind = columns.kind[j]
        if kind >= 0:
            value = thousandths(data, field, end)
            lli = indicator(data, field + 14, end)
            ssi = indicator(data, field + 15, end)
            if value == BAD:
                return _VALUE, j
            if lli < 0 or ssi < 0:
                return _INDICATOR, j
            signal = columns.signal[j]
            # Table A3: missing observations are blank or zero.
            if value != BLANK and value != 0:
                output.floats[kind, n_rows + signal] = value / columns.divisor[j]
            if kind == _PHASE:
                output.flags[0, n_rows + signal] |= lli & 1 != 0
                output.flags[1, n_rows + signal] |= lli & 2 != 0
            # The signal strength of the phase has priority over that of the pseudorange.
            if ssi > 0 and (kind == _PHASE or (kind == _CODE and strength[signal] == 0)):
                strength[signal] = ssi
        field += 16
    return _NO_PROBLEM, _NO_COLUMN


@compiled
def _keep_observed(
    columns: HeaderTables, output: _Output, satellite: int, n_rows: int, strength: Integers
) -> int:
    """Compact the rows with an observation; return the number of rows.

    A signal strength digit alone is no observation; it is 6 dB-Hz wide, of which the middle is taken.
    """
    kept = n_rows
    for j in range(columns.signal_count[satellite >> 8]):
        row = n_rows + j
        observed = False
        for kind in range(4):
            observed |= not np.isnan(output.floats[kind, row])
        if not observed:
            continue
        if np.isnan(output.floats[_STRENGTH, row]) and strength[j] > 0:
            output.floats[_STRENGTH, row] = 6.0 * strength[j] + 3.0
        for kind in range(4):
            output.floats[kind, kept] = output.floats[kind, row]
        for flag in range(2):
            output.flags[flag, kept] = output.flags[flag, row]
        output.integers[0, kept] = satellite
        output.integers[1, kept] = columns.signals[satellite >> 8, j]
        kept += 1
    return kept


@compiled
def _add_problem(output: _Output, n: int, problem: tuple[int, int, int, int]) -> int:
    for k in range(4):
        output.problems[n, k] = problem[k]
    return n + 1
