"""RINEX 2, 3 and 4 observation files, decoded as a stream.

No input raises: content that cannot be read costs its line, or its epoch, and is one `FormatError` among the results.
Refused as a whole: unknown versions and time systems, wavelength factors of half cycles. Times of files of GLONASS are
UTC; an epoch within a leap second is an error.
Ignored: cycle slip records (epoch flag 6), receiver clock offsets.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.observations import ObservationEpoch
from camber.formats.rinex.observation_epochs import (
    EVENT,
    EXPECTED,
    MAXIMUM_LINE_BYTES,
    NEEDS_MORE,
    TRUNCATED,
    ColumnLayout,
    EpochBatch,
    read_epochs,
)
from camber.formats.rinex.observation_header import HeaderParser, ObservationHeader
from camber.formats.rinex.version2_lines import Rinex2Lines

_CHUNK_BYTES = 1 << 18  # chosen: bounds the memory of the compiled loop's tables

ObservationResult = ObservationEpoch | FormatError


class RinexDecoder:
    """Decodes a file in chunks; the results do not depend on the chunks.

    An epoch is returned with its last line. Rows are in the order of the file, without signals of which nothing was
    observed; of a repeated satellite the first line counts. `loss_of_lock` is bit 0 of the indicator and set for all
    rows after a power failure, `half_cycle` bit 1; `lock_time_s` is NaN. Without a signal strength in dB-Hz, C/N0 is
    the middle of the interval of the digit after the phase or pseudorange.

    At most an unfinished epoch is kept: 8 MB.
    """

    def __init__(self, source_name: str) -> None:
        self.header: ObservationHeader | None = None
        """Set once it is complete; events inside the file may change it."""
        self.problems = 0
        """Results that are errors."""
        self.skipped: Counter[str] = Counter()
        """Lines of unsupported satellites, by system letter."""
        self.refused = False
        """Whether the file cannot be read: no more results."""
        self._source_name = source_name
        self._parser = HeaderParser(source_name)
        self._layout: ColumnLayout | None = None
        self._version_2: Rinex2Lines | None = None
        self._pending = bytearray()
        self._missing = 0
        self._partial = bytearray()
        self._line_number = 1
        self._stray_reported = False

    def feed(self, data: bytes) -> list[ObservationResult]:
        """Return the results that the bytes complete, in order."""
        results: list[ObservationResult] = []
        for start in range(0, len(data), _CHUNK_BYTES):
            if not self.refused:
                self._feed(data[start : start + _CHUNK_BYTES], results)
        self.problems += sum(isinstance(r, FormatError) for r in results)
        return results

    def finish(self) -> list[ObservationResult]:
        """Return the remaining results at the end: an incomplete epoch or header is an error."""
        results = self.feed(b"\n") if self._partial else []
        if self._version_2 is not None and not self.refused:
            self._pending += self._version_2.finish()
        if not self.refused and (self.header is None or self._pending):
            field, expected = EXPECTED[TRUNCATED] if self.header else ("header", "END OF HEADER")
            number = self._file_line_number(self._line_number)
            results.append(FormatError(self._source_name, field, expected, line_number=number))
            self.problems += 1
        self._pending, self.refused = bytearray(), True
        return results

    def _feed(self, chunk: bytes, results: list[ObservationResult]) -> None:
        begin = chunk.find(b"\n") + 1
        # Of a line that is too long only enough is kept to recognise it.
        self._partial += (chunk[:begin] if begin else chunk)[: MAXIMUM_LINE_BYTES + 1 - len(self._partial)]
        if not begin:
            return
        end = chunk.rfind(b"\n") + 1
        if self._partial[-1:] != b"\n":
            self._partial += b"\n"
        lines = self._partial + chunk[begin:end]
        self._partial = bytearray(chunk[end:][: MAXIMUM_LINE_BYTES + 1])
        if self._version_2 is not None:
            lines = bytearray(self._version_2.rearranged(bytes(lines)))
        self._pending += lines
        self._missing -= lines.count(b"\n")
        if self._missing > 0 and b">" not in lines:
            return
        lines, self._pending = self._pending, bytearray()
        try:
            rest = bytes(lines) if self._layout else self._read_header(bytes(lines), results)
            if self._layout is not None:
                self._pending += self._read_epochs(rest, self._layout, results)
        except FormatError as error:
            results.append(error)
            self.refused = True

    def _read_header(self, lines: bytes, results: list[ObservationResult]) -> bytes:
        """Parse up to the header's end; return the rest. Raises FormatError where the file cannot be read."""
        start = 0
        while not self._parser.ended and start < len(lines):
            end = lines.index(b"\n", start)
            self._parser.line(self._line_number, lines[start:end])
            self._line_number += 1
            start = end + 1
        rest = lines[start:]
        if self._parser.ended:
            self._update_header(results)
            self._version_2 = self._parser.version_2_lines(self._line_number)
            if self._version_2 is not None:
                rest = self._version_2.rearranged(rest)
        return rest

    def _update_header(self, results: list[ObservationResult]) -> ColumnLayout:
        self.header = self._parser.header()
        self._layout = ColumnLayout.from_header(self.header)
        results += self._parser.problems
        self._parser.problems.clear()
        return self._layout

    def _read_epochs(self, lines: bytes, layout: ColumnLayout, results: list[ObservationResult]) -> bytes:
        """Append whole epochs to the results; return the lines of an unfinished one."""
        while True:
            batch = read_epochs(lines, layout, self._line_number, self._stray_reported)
            self._append_results(batch, lines, layout, results)
            self._line_number += batch.lines
            self._stray_reported = batch.stray_reported
            if batch.stop == EVENT:
                begin, end, count = batch.event
                for k, line in enumerate(lines[begin:end].split(b"\n")[:-1]):
                    self._parser.line(self._file_line_number(self._line_number - count + k), line)
                if count:
                    layout = self._update_header(results)
            if self._version_2 is not None:
                self._version_2.forget(batch.lines)
            lines = lines[batch.consumed :]
            if batch.stop == NEEDS_MORE:
                self._missing = batch.missing
                return lines

    def _append_results(
        self, batch: EpochBatch, lines: bytes, layout: ColumnLayout, results: list[ObservationResult]
    ) -> None:
        assert self.header is not None
        problems = self._errors(batch, lines, layout)
        first_row = first_problem = 0
        for time_ns, end_row, end_problem in batch.epochs.tolist():
            results += problems[first_problem:end_problem]
            gps_time_ns = self.header.gps_time_ns(time_ns)
            results.append(batch.observations(gps_time_ns, slice(first_row, end_row)))
            first_row, first_problem = end_row, end_problem
        results += problems[first_problem:]
        for letter in np.flatnonzero(batch.skipped).tolist():
            self.skipped[chr(letter)] += int(batch.skipped[letter])

    def _errors(self, batch: EpochBatch, lines: bytes, layout: ColumnLayout) -> list[FormatError]:
        errors = []
        for line_number, start, code, column in batch.problems.tolist():
            field, expected = EXPECTED[code]
            if column >= 0:
                field = f"{lines[start : start + 3].decode('latin-1')} {layout.names[column]}"
            text = lines[start : start + 60].split(b"\n")[0]
            errors.append(
                FormatError(
                    self._source_name,
                    field,
                    expected,
                    actual=text,
                    line_number=self._file_line_number(line_number),
                )
            )
        return errors

    def _file_line_number(self, number: int) -> int:
        return number if self._version_2 is None else self._version_2.line_number(number)
