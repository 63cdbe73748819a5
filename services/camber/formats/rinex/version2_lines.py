"""Lines of RINEX 2 rearranged as RINEX 3 has them, so that one decoder reads the values of both.

Source: W. Gurtner, L. Estey, "RINEX, The Receiver Independent Exchange Format, Version 2.11" (2007), tables A2 to A4.
An observation has the same 16 columns in both; RINEX 2 writes five of them a line, and the satellites of an epoch ahead
of them all, twelve a line. Years have two digits: 80 to 99 are of the 20th century.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

MAX_OBSERVATION_TYPES = 511
"""Chosen, as the longest line of RINEX 3 that is read: more types are read as none."""
_EPOCH = re.compile(
    rb"^ ([ \d]\d)( [ \d]\d [ \d]\d [ \d]\d [ \d]\d[ \d]{2}\d\.\d{7})  ([0-6])([ \d]{2}\d)", re.DOTALL
)
_EVENT_WITHOUT_TIME = re.compile(rb"^ {28}([2-5])([ \d]{2}\d)")
_TYPES = b"# / TYPES OF OBSERV"
_FIRST_YEAR = 80  # RINEX 2.11, 6.5: the years 80 to 99 are 1980 to 1999
_TYPES_A_LINE, _SATELLITES_A_LINE, _OBSERVATION_COLUMNS = 5, 12, 16  # table A2
_SATELLITES_COLUMN, _LINE_COLUMNS, _LABEL_COLUMN = 32, 80, 60  # table A2
_EVENTS = range(2, 6)  # epoch flags followed by header lines
_NAVIGATION_EPOCH = re.compile(
    r"^([ \d]\d) ([ \d]\d)( [ \d]\d [ \d]\d [ \d]\d [ \d]\d)[ \d]([ \d]\d)\.0(.*)$"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedPhases:
    """Phase, Doppler and strength of a band of GPS or GLONASS, whose tracking RINEX 2 does not name.

    They belong to the code of column `preferred` where it was observed, else to that of column `other`, if that was:
    then they stand in columns of their own after all others, as the signal
    of their system. `columns` are theirs, by index.
    """

    preferred: int | None
    other: int
    columns: tuple[int, ...]
    signals: Mapping[str, str]


def shared_phases(types: Sequence[str]) -> list[SharedPhases]:
    """Return them for the types of a file: those of L1 are of C/A or P, those of L2 of P or L2C (GLONASS: C/A)."""
    # As RTKLIB chooses (`rinex.c`): C1 before P1, P2 before C2.
    return [
        SharedPhases(
            preferred=types.index(preferred) if preferred in types else None,
            other=types.index(other),
            columns=tuple(types.index(kind + band) for kind in "LDS" if kind + band in types),
            signals=signals,
        )
        for band, preferred, other, signals in (
            ("1", "C1", "P1", {"G": "1W", "R": "1P"}),
            ("2", "P2", "C2", {"G": "2X", "R": "2C"}),
        )
        if other in types
    ]


def full_year(year: int) -> int:
    """Return the year of two digits."""
    return year + (1900 if year >= _FIRST_YEAR else 2000)


class Rinex2Lines:
    """Rearranges the lines after a header; keeps at most an unfinished epoch.

    `system` is that of satellites without a letter; `types` are the names of the observation types, which an event
    inside the file may change. Comments are left out. A line that fits nowhere is passed on: an error of the decoder.
    """

    def __init__(self, system: str, types: Sequence[str], line_number: int) -> None:
        self._system = system.encode("latin-1")
        self._types = _TypesOfFile(list(types))
        self._next_line = self._first = line_number
        self._numbers: deque[int] = deque()
        self._output = bytearray()
        self._event_lines = 0
        self._epoch: _EpochBlock | None = None

    def rearranged(self, lines: bytes) -> bytes:
        """Return the whole epochs that these whole lines complete."""
        for line in lines.split(b"\n")[:-1]:
            self._line(line.rstrip(b" \r"))
            self._next_line += 1
        return self._take()

    def finish(self) -> bytes:
        """Return the lines of an unfinished epoch at the end."""
        self._end_epoch()
        return self._take()

    def line_number(self, number: int) -> int:
        """Return the file's number of a line that was returned, which are numbered one after another."""
        return self._numbers[number - self._first] if self._numbers else self._next_line

    def forget(self, count: int) -> None:
        """Drop the numbers of the first lines."""
        for _ in range(count):
            self._numbers.popleft()
        self._first += count

    def _take(self) -> bytes:
        output, self._output = bytes(self._output), bytearray()
        return output

    def _emit(self, line: bytes, number: int) -> None:
        self._output += line + b"\n"
        self._numbers.append(number)

    def _line(self, line: bytes) -> None:
        if self._event_lines:
            self._event_lines -= 1
            if line[_LABEL_COLUMN:].rstrip() == _TYPES:
                before = [] if line[:6].strip() else self._types.names
                self._types = _TypesOfFile([*before, *type_names(line[:_LABEL_COLUMN].decode("latin-1"))])
            self._emit(line, self._next_line)
        elif line[_LABEL_COLUMN:].rstrip() != b"COMMENT":
            self._content(line)

    def _content(self, line: bytes) -> None:
        head = _EPOCH.match(line)
        event = None if head else _EVENT_WITHOUT_TIME.match(line)
        if head is not None or event is not None:
            self._end_epoch()
            self._begin(head, event, line)
        elif self._epoch is None or not self._epoch.takes(line):
            self._end_epoch()
            # A line of RINEX 3 must not pass for one.
            self._emit(b" " + line if line.startswith(b">") else line, self._next_line)
        if self._epoch is not None and self._epoch.is_whole:
            self._end_epoch()

    def _begin(self, head: re.Match[bytes] | None, event: re.Match[bytes] | None, line: bytes) -> None:
        if head is not None:
            year, time, flag, count = head.groups()
            text = b"> %04d%b  %b%b" % (full_year(int(year)), time, flag, count)
        else:
            assert event is not None
            flag, count = event.groups()
            text = b">" + b" " * 30 + flag + count
        if int(flag) in _EVENTS:
            self._event_lines = int(count)
            self._emit(text, self._next_line)
            return
        self._epoch = _EpochBlock(text, self._next_line, int(count), types=self._types, system=self._system)
        self._epoch.add_satellites(line)

    def _end_epoch(self) -> None:
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return
        self._emit(epoch.head, epoch.number)
        for k, row in enumerate(epoch.rows()):
            self._emit(row, epoch.number + epoch.head_lines + k * epoch.lines_a_satellite)


def type_names(text: str) -> list[str]:
    """Return the observation types of one header line, six columns each."""
    return [name for k in range(6, _LABEL_COLUMN, 6) if (name := text[k : k + 6].strip())]


class _TypesOfFile:
    """The observation types that hold, none where there are too many."""

    def __init__(self, names: list[str]) -> None:
        self.names = names if len(names) <= MAX_OBSERVATION_TYPES else []
        self.shared = shared_phases(self.names)

    @property
    def columns(self) -> int:
        """Those of a line of RINEX 3."""
        return len(self.names) + sum(len(shared.columns) for shared in self.shared)


class _EpochBlock:
    """The lines of one epoch so far."""

    def __init__(self, head: bytes, number: int, count: int, *, types: _TypesOfFile, system: bytes) -> None:
        self.head, self.number = head, number
        self.lines_a_satellite = -(-len(types.names) // _TYPES_A_LINE)
        self.head_lines = max(-(-count // _SATELLITES_A_LINE), 1)
        self._count, self._types, self._system = count, types, system
        self._satellites: list[bytes] = []
        self._lines: list[bytes] = []

    @property
    def is_whole(self) -> bool:
        return (
            len(self._satellites) == self._count and len(self._lines) == self._count * self.lines_a_satellite
        )

    def add_satellites(self, line: bytes) -> None:
        """Add those of an epoch line, or of the lines that continue it."""
        left = min(self._count - len(self._satellites), _SATELLITES_A_LINE)
        for k in range(left):
            start = _SATELLITES_COLUMN + 3 * k
            name = line[start : start + 3].ljust(3)
            self._satellites.append(self._system + name[1:] if name[:1] == b" " else name)

    def takes(self, line: bytes) -> bool:
        """Add a line; return whether it can be one of this epoch."""
        if len(self._satellites) == self._count:
            # What is beyond the columns stays an error, at one character.
            self._lines.append(line[: _LINE_COLUMNS + 1])
            return True
        if line[:_SATELLITES_COLUMN].strip():
            return False
        self.add_satellites(line)
        return True

    def rows(self) -> list[bytes]:
        """Return the lines of RINEX 3 of those satellites whose lines are whole."""
        size = self.lines_a_satellite
        if not size:
            return list(self._satellites) if self.is_whole else []
        return [
            self._row(self._satellites[k], self._lines[k * size : (k + 1) * size])
            for k in range(len(self._lines) // size)
        ]

    def _row(self, satellite: bytes, lines: list[bytes]) -> bytes:
        row = satellite + b"".join(line[:_LINE_COLUMNS].ljust(_LINE_COLUMNS) for line in lines)
        if satellite[:1] in (b"G", b"R") and self._types.shared:
            row = self._with_shared_phases(row)
        beyond = b"".join(line[_LINE_COLUMNS:] for line in lines)
        if not beyond:
            return row.rstrip()
        return row.ljust(3 + _OBSERVATION_COLUMNS * self._types.columns) + beyond

    def _with_shared_phases(self, row: bytes) -> bytes:
        """Move them to their columns at the end where they belong to the other code."""
        end = 3 + _OBSERVATION_COLUMNS * len(self._types.names)
        if row[end:].strip():
            return row
        cells = [row[k : k + _OBSERVATION_COLUMNS] for k in range(3, end, _OBSERVATION_COLUMNS)]
        blank = b" " * _OBSERVATION_COLUMNS
        for shared in self._types.shared:
            preferred = shared.preferred is not None and _is_observed(cells[shared.preferred])
            moves = not preferred and _is_observed(cells[shared.other])
            cells += [cells[k] if moves else blank for k in shared.columns]
            for k in shared.columns if moves else ():
                cells[k] = blank
        return row[:3] + b"".join(cells)


def _is_observed(cell: bytes) -> bool:
    """Return whether a value is neither blank nor zero."""
    return bool(cell[:14].strip(b" 0.-+"))


def navigation_line(text: str, system: str) -> str:
    """Return a line of a record of one system's navigation file: the satellite's letter, four digits of the year."""
    if not text[:3].strip():
        return f" {text}"
    head = _NAVIGATION_EPOCH.match(text)
    if head is None:
        return f"{system}{text}"
    number, year, time, second, numbers = head.groups()
    return f"{system}{int(number):02d} {full_year(int(year))}{time} {second}{numbers}"
