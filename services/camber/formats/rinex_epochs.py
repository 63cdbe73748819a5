"""The epochs of RINEX 3 and 4 observation files: bytes → columns of all epochs at once, compiled.

Source: IGS/RTCM, "RINEX", versions 3.04 (2018) and 4.02 (2024), table A3. The fields are read by their columns and
strictly (`F14.3` has its point in column 11), so that a lost byte shows as damage and not as another value. A value is
the integer of its thousandths divided by 1000: correctly rounded, as reading the decimal text is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import signal_number
from camber.formats.rinex_header import SYSTEMS_SKIPPED, ObservationHeader, ObservationType
from camber.geodesy.compiled import compiled

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

_BLANK_FIELD = -(10**15)
_BAD_FIELD = _BLANK_FIELD - 1
_NOT_IN_HEADER, _LEFT_OUT = -1, -2
_KINDS = {"C": 0, "L": 1, "D": 2, "S": 3}
_NONE = -1
_CR, _NEWLINE, _SPACE, _PLUS, _MINUS, _POINT, _ZERO, _GREATER = 13, 10, 32, 43, 45, 46, 48, 62
_HEAD_BYTES = 35
_PICOSECONDS = 57
_NS_PER_SECOND = 1_000_000_000
_GPS_EPOCH_DAY = 723_125  # 1980-01-06 in days since 0000-03-01

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """A header for the compiled loop: by system letter (256,) where its columns begin and how many there are; the
    columns' kind, place of its signal among the system's, divisor (columns,); the systems' signals (256, most)."""

    first: Integers
    count: Integers
    kind: Integers
    place: Integers
    divisor: Floats
    signals: Integers
    signal_count: Integers
    time_offset_ns: int
    picoseconds: bool
    names: tuple[str, ...]

    @classmethod
    def of(cls, header: ObservationHeader) -> Layout:
        """Of a header."""
        first = np.full(256, _NOT_IN_HEADER, np.int64)
        count = np.zeros(256, np.int64)
        of_system = header.signals
        most = max((len(s) for s in of_system.values()), default=0)
        signals = np.zeros((256, max(most, 1)), np.int64)
        signal_count = np.zeros(256, np.int64)
        for system in SYSTEMS_SKIPPED:
            first[ord(system)] = _LEFT_OUT
        columns: list[tuple[ObservationType, int]] = []
        for system, types in header.types.items():
            k = ord(system)
            first[k] = len(columns) if types else _LEFT_OUT
            count[k] = len(types)
            signal_count[k] = len(of_system[system])
            signals[k, : signal_count[k]] = [signal_number(s) for s in of_system[system]]
            columns += [(t, of_system[system].index(t.signal) if t.kind else 0) for t in types]
        return cls(
            first,
            count,
            np.array([_KINDS.get(t.kind, _NONE) for t, _ in columns], np.int64),
            np.array([place for _, place in columns], np.int64),
            np.array([1000.0 * t.divisor for t, _ in columns]),
            signals,
            signal_count,
            header.time_offset_ns,
            header.version >= 4.0,
            tuple(t.name for t, _ in columns),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
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


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a piece of a file holds.

    `epochs` (n, 3): GPS time [ns], the end of its rows, the number of problems up to its end. `problems` (m, 4): line,
    first byte, one of the codes above, and the column concerned or −1. `skipped` (256,): satellites left out by system
    letter. `used` bytes and `lines` are done with; `event` (3,): where an event's header lines begin and end, and their
    number, if `stop` says so; `missing`: lines without which, or without another epoch line, more cannot be said.
    """

    rows: Rows
    epochs: Integers
    problems: Integers
    skipped: Integers
    used: int
    lines: int
    astray: bool
    stop: int
    event: tuple[int, int, int]
    missing: int


def read_epochs(data: bytes, layout: Layout, line_number: int, astray: bool) -> Found:
    """All whole epochs of bytes that end with a newline, up to the first event that brings header lines.

    `astray`: the lines before could not be read, and that has been said.
    """
    array = np.frombuffer(data, np.uint8)
    most_signals = layout.signals.shape[1]
    # A row has a value of 14 bytes at least, a line no more rows than signals, an epoch a line of 35 bytes.
    capacity = min(array.size // 14, data.count(b"\n") * most_signals) + most_signals
    floats = np.empty((4, capacity))
    integers = np.empty((2, capacity), np.int64)
    flags = np.empty((2, capacity), np.bool_)
    epochs = np.empty((array.size // _HEAD_BYTES + 1, 3), np.int64)
    problems = np.empty((_PROBLEMS, 4), np.int64)
    skipped = np.zeros(256, np.int64)
    n_rows, n_epochs, n_problems, used, lines, is_astray, stop, begin, end, count = _read_epochs(
        array, line_number, astray, layout.first, layout.count, layout.kind, layout.place, layout.divisor,
        layout.signals, layout.signal_count, layout.time_offset_ns, layout.picoseconds,
        floats, integers, flags, epochs, problems, skipped,
    )  # fmt: skip
    # Copies: what is kept of an epoch must not hold on to the room that was left over.
    floats, integers, flags = floats[:, :n_rows].copy(), integers[:, :n_rows].copy(), flags[:, :n_rows].copy()
    rows = Rows(
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
        rows, epochs[:n_epochs], problems[:n_problems], skipped, used, lines, is_astray, stop,
        event=(begin, end, count), missing=count if stop == NEEDS_MORE else 0,
    )  # fmt: skip


@compiled
def _line_end(data: Bytes, start: int) -> int:
    """Where the newline stands; −1 without one."""
    for k in range(start, data.size):
        if data[k] == _NEWLINE:
            return k
    return -1


@compiled
def _text_end(data: Bytes, start: int, end: int) -> int:
    """Without blanks and carriage returns at the end."""
    while end > start and (data[end - 1] == _SPACE or data[end - 1] == _CR):
        end -= 1
    return end


@compiled
def _integer(data: Bytes, start: int, end: int) -> int:
    """Digits, with blanks before them; −1 for anything else."""
    while start < end and data[start] == _SPACE:
        start += 1
    if start == end:
        return -1
    value = 0
    for k in range(start, end):
        digit = int(data[k]) - _ZERO
        if digit < 0 or digit > 9:
            return -1
        value = value * 10 + digit
    return value


@compiled
def _thousandths(data: Bytes, start: int, end: int) -> int:
    """F14.3 at `start` of a line whose text ends at `end`."""
    if end <= start:
        return _BLANK_FIELD
    stop = start + 10
    k = start
    while k < stop and k < end and data[k] == _SPACE:
        k += 1
    if k == end:
        return _BLANK_FIELD
    if end < start + 14:
        return _BAD_FIELD
    if k == stop and data[stop] == _SPACE:
        for j in range(stop, start + 14):
            if data[j] != _SPACE:
                return _BAD_FIELD
        return _BLANK_FIELD
    negative = False
    if k < stop and (data[k] == _MINUS or data[k] == _PLUS):
        negative = data[k] == _MINUS
        k += 1
    if data[stop] != _POINT:
        return _BAD_FIELD
    value = 0
    for j in range(k, stop):
        digit = int(data[j]) - _ZERO
        if digit < 0 or digit > 9:
            return _BAD_FIELD
        value = value * 10 + digit
    for j in range(stop + 1, stop + 4):
        digit = int(data[j]) - _ZERO
        if digit < 0 or digit > 9:
            return _BAD_FIELD
        value = value * 10 + digit
    return -value if negative else value


@compiled
def _indicator(data: Bytes, place: int, end: int) -> int:
    """A digit, 0 for a blank; −1 for anything else."""
    if place >= end or data[place] == _SPACE:
        return 0
    digit = int(data[place]) - _ZERO
    return digit if 0 <= digit <= 9 else -1


@compiled
def _days(year: int, month: int, day: int) -> int:
    """Since 1980-01-06, of the Gregorian calendar; −1 where there is no such day or it is before."""
    lengths = (31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31)
    if year < 1980 or year > 2199 or month < 1 or month > 12 or day < 1:
        return -1
    leap = year % 4 == 0 and (year % 100 != 0 or year % 400 == 0)
    if day > lengths[month - 1] + (1 if leap and month == 2 else 0):
        return -1
    # Years from March to February: the leap day comes last, months have 153 days in five.
    from_march = (month + 9) % 12
    y = year - (1 if month <= 2 else 0)
    whole = 365 * y + y // 4 - y // 100 + y // 400 + (153 * from_march + 2) // 5 + day - 1
    return max(whole - _GPS_EPOCH_DAY, -1)


@compiled
def _epoch_time(data: Bytes, start: int, end: int, picoseconds: bool) -> int:
    """The time of an epoch line, ns since 1980-01-06 in the file's time system; −1 where there is none."""
    year = _integer(data, start + 2, start + 6)
    month = _integer(data, start + 7, start + 9)
    day = _integer(data, start + 10, start + 12)
    hour = _integer(data, start + 13, start + 15)
    minute = _integer(data, start + 16, start + 18)
    second = _integer(data, start + 18, start + 21)
    fraction = _integer(data, start + 22, start + 29)
    days = _days(year, month, day)
    if days < 0 or not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 60 and fraction >= 0):
        return -1
    if data[start + 21] != _POINT or data[start + 22] == _SPACE:
        return -1
    for k in (1, 6, 9, 12, 15, 29, 30):
        if data[start + k] != _SPACE:
            return -1
    time_ns = (((days * 24 + hour) * 60 + minute) * 60 + second) * _NS_PER_SECOND + fraction * 100
    if picoseconds and end > start + _PICOSECONDS:
        more = _integer(data, start + _PICOSECONDS, min(start + _PICOSECONDS + 5, end))
        if end != start + _PICOSECONDS + 5 or more < 0:
            return -1
        time_ns += (more + 500) // 1000
    return time_ns


@compiled
def _satellite(data: Bytes, start: int, end: int) -> int:
    """System letter × 256 + number; −1 where there is none."""
    if end < start + 3:
        return -1
    number = _integer(data, start + 1, start + 3)
    return int(data[start]) * 256 + number if number > 0 else -1


@compiled
def _is_among(value: int, values: Integers, n: int) -> bool:
    found = False
    for k in range(n):
        found |= values[k] == value
    return found


@compiled
def _read_epochs(
    data: Bytes,
    line_number: int,
    astray: bool,
    first: Integers,
    count_of: Integers,
    kind: Integers,
    place: Integers,
    divisor: Floats,
    signals: Integers,
    signal_count: Integers,
    time_offset_ns: int,
    picoseconds: bool,
    floats: Floats,
    integers: Integers,
    flags: Flags,
    epochs: Integers,
    problems: Integers,
    skipped: Integers,
) -> tuple[int, int, int, int, int, bool, int, int, int, int]:
    starts = np.empty(MOST_LINES + 2, np.int64)
    taken = np.empty(MOST_LINES, np.int64)
    strength = np.empty(signals.shape[1], np.int64)
    n_rows = n_epochs = n_problems = position = lines = 0
    while n_problems + MOST_LINES + 2 < _PROBLEMS:
        newline = _line_end(data, position)
        if newline < 0:
            return n_rows, n_epochs, n_problems, position, lines, astray, NEEDS_MORE, 0, 0, 0
        end = _text_end(data, position, newline)
        if data[position] != _GREATER:
            if end > position and not astray:
                n_problems = _problem(problems, n_problems, line_number + lines, position, STRAY, _NONE)
                astray = True
            position, lines = newline + 1, lines + 1
            continue

        flag = count = -1
        time_ns = -1
        if end >= position + _HEAD_BYTES and newline - position <= MAXIMUM_LINE_BYTES:
            flag = int(data[position + 31]) - _ZERO
            count = _integer(data, position + 32, position + 35)
            time_ns = _epoch_time(data, position, end, picoseconds)
            # The time of an event may be blank.
            if time_ns < 0 and not 2 <= flag <= 5:
                flag = -1
        if flag < 0 or flag > 6 or count < 0:
            n_problems = _problem(problems, n_problems, line_number + lines, position, EPOCH_LINE, _NONE)
            astray = True
            position, lines = newline + 1, lines + 1
            continue
        astray = False

        # Where its lines begin; one that begins with '>' is the next epoch already.
        whole = 0
        starts[0] = newline + 1
        while whole < count:
            begin = starts[whole]
            if begin < data.size and data[begin] == _GREATER:
                break
            newline = _line_end(data, begin)
            if newline < 0:
                missing = count - whole
                return n_rows, n_epochs, n_problems, position, lines, astray, NEEDS_MORE, 0, 0, missing
            whole += 1
            starts[whole] = newline + 1
        if whole < count:
            n_problems = _problem(problems, n_problems, line_number + lines, position, CUT_SHORT, _NONE)
            position, lines = starts[whole], lines + 1 + whole
            continue
        if 2 <= flag <= 5:
            return (
                n_rows, n_epochs, n_problems, starts[count], lines + 1 + count, astray, EVENT,
                starts[0], starts[count], count,
            )  # fmt: skip
        if flag == 6:
            position, lines = starts[count], lines + 1 + count
            continue

        rows_before, problems_before, n_taken = n_rows, n_problems, 0
        damaged = twice = False
        for k in range(count):
            begin = starts[k]
            end = _text_end(data, begin, starts[k + 1] - 1)
            line = line_number + lines + 1 + k
            satellite = _satellite(data, begin, end)
            letter = satellite >> 8
            columns = first[letter] if satellite >= 0 else _NOT_IN_HEADER
            fault = -1
            if end - begin > MAXIMUM_LINE_BYTES:
                fault = TOO_LONG
            elif columns == _NOT_IN_HEADER:
                fault = SATELLITE
            if fault < 0 and columns == _LEFT_OUT:
                skipped[letter] += 1
                continue
            if fault < 0 and _is_among(satellite, taken, n_taken):
                twice = True
                n_problems = _problem(problems, n_problems, line, begin, TWICE, _NONE)
                continue
            where = _NONE
            n = 0
            if fault < 0:
                taken[n_taken] = satellite
                n_taken += 1
                n = signal_count[letter]
                for j in range(n):
                    for what in range(4):
                        floats[what, n_rows + j] = np.nan
                    for what in range(2):
                        flags[what, n_rows + j] = what == 0 and flag == 1
                    strength[j] = 0
                if end > begin + 3 + 16 * count_of[letter]:
                    fault = BEYOND
            if fault < 0:
                field = begin + 3
                for j in range(columns, columns + count_of[letter]):
                    if field >= end:
                        break
                    what = kind[j]
                    if what >= 0:
                        value = _thousandths(data, field, end)
                        lock = _indicator(data, field + 14, end)
                        level = _indicator(data, field + 15, end)
                        if value == _BAD_FIELD or lock < 0 or level < 0:
                            fault, where = VALUE if value == _BAD_FIELD else INDICATOR, j
                            break
                        row = n_rows + place[j]
                        # The standard: what is missing is blank or zero.
                        if value != _BLANK_FIELD and value != 0:
                            floats[what, row] = value / divisor[j]
                        if what == 1:
                            flags[0, row] |= lock & 1 != 0
                            flags[1, row] |= lock & 2 != 0
                        # A phase's signal strength before a pseudorange's.
                        if level > 0 and (what == 1 or (what == 0 and strength[place[j]] == 0)):
                            strength[place[j]] = level
                    field += 16
            if fault >= 0:
                damaged = True
                n_problems = _problem(problems, n_problems, line, begin, fault, where)
                continue
            for j in range(n):
                row = n_rows + j
                if np.isnan(floats[3, row]) and strength[j] > 0:
                    floats[3, row] = _middle_of_level_dbhz(strength[j])
                    observed = False
                else:
                    observed = not np.isnan(floats[3, row])
                for what in range(3):
                    observed |= not np.isnan(floats[what, row])
                integers[0, row] = satellite if observed else 0
                integers[1, row] = signals[letter, j]
            kept = n_rows
            for row in range(n_rows, n_rows + n):
                if integers[0, row] > 0:
                    if kept < row:
                        for what in range(4):
                            floats[what, kept] = floats[what, row]
                        for what in range(2):
                            integers[what, kept] = integers[what, row]
                            flags[what, kept] = flags[what, row]
                    kept += 1
            n_rows = kept
        if damaged and twice:
            n_rows, n_problems = rows_before, problems_before
            n_problems = _problem(problems, n_problems, line_number + lines, position, MIXED_UP, _NONE)
        else:
            epochs[n_epochs, 0] = time_ns + time_offset_ns
            epochs[n_epochs, 1] = n_rows
            epochs[n_epochs, 2] = n_problems
            n_epochs += 1
        position, lines = starts[count], lines + 1 + count
    return n_rows, n_epochs, n_problems, position, lines, astray, TABLE_FULL, 0, 0, 0


@compiled
def _middle_of_level_dbhz(level: int) -> float:
    """The middle of the 6 dB-Hz that a signal strength digit stands for (table 5 of the standard)."""
    return 6.0 * level + 3.0


@compiled
def _problem(problems: Integers, n: int, line: int, position: int, code: int, column: int) -> int:
    problems[n, 0] = line
    problems[n, 1] = position
    problems[n, 2] = code
    problems[n, 3] = column
    return n + 1
