"""RINEX 3 and 4 observation files, as a stream and whole.

Whatever the bytes are, nothing is raised by the decoder: what cannot be read costs its line, or its epoch, and is one
`FormatError` among the results. Refused as a whole: RINEX 2, unknown versions, times in UTC, files of GLONASS alone.
Not read: cycle slips that the file says are repaired (epoch flag 6), receiver clock offsets.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.observations import ObservationEpoch
from camber.formats.rinex.compressed_files import rinex_chunks
from camber.formats.rinex.observation_epochs import (
    CUT_SHORT,
    EVENT,
    EXPECTED,
    MAXIMUM_LINE_BYTES,
    NEEDS_MORE,
    ColumnLayout,
    Found,
    read_epochs,
)
from camber.formats.rinex.observation_header import HeaderReader, ObservationHeader

_PIECE_BYTES = 1 << 18
_MOST_PROBLEMS_KEPT = 1000

ObservationResult = ObservationEpoch | FormatError


class RinexDecoder:
    """Reads a file piece by piece; the results do not depend on how it is cut.

    An epoch is given out with its last line. Rows are in the order of the file, without signals of which nothing was
    observed; of a satellite given twice the first line counts. `loss_of_lock` is bit 0 of the indicator and set for all
    rows after a power failure, `half_cycle` bit 1; `lock_time_s` is NaN. Without a signal strength in dB-Hz, C/N0 is
    the middle of what the digit beside the phase or pseudorange stands for.

    At most an unfinished epoch is kept: 8 MB.
    """

    def __init__(self, source_name: str) -> None:
        self.header: ObservationHeader | None = None
        """Once it is complete; events inside the file may change it."""
        self.problems = 0
        """Results that were errors."""
        self.skipped: Counter[str] = Counter()
        """Lines of satellites that are not read, by system letter."""
        self.refused = False
        """The file cannot be read: nothing more will come."""
        self._source_name = source_name
        self._reader = HeaderReader(source_name)
        self._layout: ColumnLayout | None = None
        self._pending = bytearray()
        self._missing = 0
        self._partial = bytearray()
        self._line_number = 1
        self._astray = False

    def feed(self, data: bytes) -> list[ObservationResult]:
        """What the bytes complete, in order."""
        results: list[ObservationResult] = []
        for start in range(0, len(data), _PIECE_BYTES):
            if not self.refused:
                self._feed(data[start : start + _PIECE_BYTES], results)
        self.problems += sum(isinstance(r, FormatError) for r in results)
        return results

    def finish(self) -> list[ObservationResult]:
        """Call at the end: an epoch or a header that is not whole is an error."""
        results = self.feed(b"\n") if self._partial else []
        if not self.refused and (self.header is None or self._pending):
            what, expected = EXPECTED[CUT_SHORT] if self.header else ("header", "END OF HEADER")
            results.append(FormatError(self._source_name, what, expected, line_number=self._line_number))
            self.problems += 1
        self._pending, self.refused = bytearray(), True
        return results

    def _feed(self, piece: bytes, results: list[ObservationResult]) -> None:
        begin = piece.find(b"\n") + 1
        # Of a line that is too long no more is kept than shows that it is.
        self._partial += (piece[:begin] if begin else piece)[: MAXIMUM_LINE_BYTES + 1 - len(self._partial)]
        if not begin:
            return
        end = piece.rfind(b"\n") + 1
        if self._partial[-1:] != b"\n":
            self._partial += b"\n"
        lines = self._partial + piece[begin:end]
        self._partial = bytearray(piece[end:][: MAXIMUM_LINE_BYTES + 1])
        self._pending += lines
        self._missing -= lines.count(b"\n")
        if self._missing > 0 and b">" not in lines:
            return
        lines, self._pending = self._pending, bytearray()
        try:
            rest = self._header(bytes(lines), results) if self._layout is None else bytes(lines)
            if self._layout is not None:
                self._pending += self._epochs(rest, self._layout, results)
        except FormatError as error:
            results.append(error)
            self.refused = True

    def _header(self, lines: bytes, results: list[ObservationResult]) -> bytes:
        """Reads up to the header's end; returns what follows. Raises FormatError where the file cannot be read."""
        start = 0
        while not self._reader.ended and start < len(lines):
            end = lines.index(b"\n", start)
            self._reader.line(self._line_number, lines[start:end])
            self._line_number += 1
            start = end + 1
        if self._reader.ended:
            self._new_header(results)
        return lines[start:]

    def _new_header(self, results: list[ObservationResult]) -> None:
        self.header = self._reader.header()
        self._layout = ColumnLayout.of(self.header)
        results += self._reader.problems
        self._reader.problems.clear()

    def _epochs(self, lines: bytes, layout: ColumnLayout, results: list[ObservationResult]) -> bytes:
        """Gives out whole epochs; returns the lines of an unfinished one."""
        while True:
            found = read_epochs(lines, layout, self._line_number, self._astray)
            self._give_out(found, lines, layout, results)
            self._line_number += found.lines
            self._astray = found.astray
            if found.stop == EVENT:
                begin, end, count = found.event
                for k, line in enumerate(lines[begin:end].split(b"\n")[:-1]):
                    self._reader.line(self._line_number - count + k, line)
                if count:
                    self._new_header(results)
                    assert self._layout is not None
                    layout = self._layout
            lines = lines[found.used :]
            if found.stop == NEEDS_MORE:
                self._missing = found.missing
                return lines

    def _give_out(
        self, found: Found, lines: bytes, layout: ColumnLayout, results: list[ObservationResult]
    ) -> None:
        problems = self._errors(found, lines, layout)
        rows, begin, said = found.rows, 0, 0
        for time_ns, end, before in found.epochs.tolist():
            part = slice(begin, end)
            results += problems[said:before]
            results.append(
                ObservationEpoch(
                    time_ns=time_ns,
                    satellite=rows.satellite[part],
                    signal=rows.signal[part],
                    pseudorange_m=rows.pseudorange_m[part],
                    carrier_phase_cycles=rows.carrier_phase_cycles[part],
                    doppler_hz=rows.doppler_hz[part],
                    cn0_dbhz=rows.cn0_dbhz[part],
                    lock_time_s=rows.lock_time_s[part],
                    loss_of_lock=rows.loss_of_lock[part],
                    half_cycle=rows.half_cycle[part],
                )
            )
            begin, said = end, before
        results += problems[said:]
        for letter in np.flatnonzero(found.skipped).tolist():
            self.skipped[chr(letter)] += int(found.skipped[letter])

    def _errors(self, found: Found, lines: bytes, layout: ColumnLayout) -> list[FormatError]:
        errors = []
        for line_number, place, code, column in found.problems.tolist():
            what, expected = EXPECTED[code]
            if column >= 0:
                what = f"{lines[place : place + 3].decode('latin-1')} {layout.names[column]}"
            text = lines[place : place + 60].split(b"\n")[0]
            errors.append(
                FormatError(self._source_name, what, expected, actual=text, line_number=line_number)
            )
        return errors


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RinexObservations:
    """A whole file. `problems` are the first thousand of `problem_count`; `skipped` satellites by system letter."""

    header: ObservationHeader
    epochs: list[ObservationEpoch]
    problems: list[FormatError]
    problem_count: int
    skipped: Mapping[str, int]


def read_observations(path: Path) -> RinexObservations:
    """A file, plain or compressed: see `rinex_files`.

    Raises FormatError where it is no RINEX observation file that can be read, OSError where it cannot be opened.
    """
    decoder = RinexDecoder(path.name)
    epochs: list[ObservationEpoch] = []
    problems: list[FormatError] = []
    count = 0

    def take(results: list[ObservationResult]) -> None:
        nonlocal count
        for result in results:
            if isinstance(result, FormatError):
                count += 1
                if len(problems) < _MOST_PROBLEMS_KEPT:
                    problems.append(result)
            else:
                epochs.append(result)

    try:
        for piece in rinex_chunks(path):
            take(decoder.feed(piece))
    except FormatError as damage:
        if decoder.header is None:
            raise
        take([damage])
    take(decoder.finish())
    if decoder.header is None:
        raise problems[0]
    return RinexObservations(
        header=decoder.header, epochs=epochs, problems=problems, problem_count=count, skipped=decoder.skipped
    )
