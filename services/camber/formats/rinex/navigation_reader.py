"""RINEX 2, 3 and 4 navigation files: ephemerides of GPS, QZSS, Galileo, BeiDou and GLONASS, and the ionosphere.

Source: IGS/RTCM, "RINEX", version 3.04 (2018), table A5, and version 4.02 (2024), types of navigation records; version
2.11 (2007), tables A3 and A4 (GPS alone), A10 and A11 (GLONASS alone).
Supported are GPS and QZSS LNAV, Galileo I/NAV and F/NAV, BeiDou D1 and D2, GLONASS FDMA; other messages are counted.
"""

from __future__ import annotations

from collections import Counter

from camber.formats.broadcast.klobuchar_coefficients import Four, IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.line_buffer import MAXIMUM_LINE_BYTES, LineBuffer
from camber.formats.observations import BroadcastEphemeris
from camber.formats.rinex.navigation_records import (
    NavigationRecord,
    parse_ephemeris,
    parse_glonass_ephemeris,
    parse_ionosphere,
)
from camber.formats.rinex.observation_header import (
    MAX_HEADER_LINES,
    decimal_number,
    leap_seconds_from_text,
    rinex_version,
)
from camber.formats.rinex.version2_lines import navigation_line

_MAX_RECORD_LINES = 12  # chosen: more than any supported record has (8), so that longer ones are an error
_FIRST_OF_ALL_SYSTEMS = 3.0  # before, the records are of one system and without its letter
_TYPES_OF_VERSION_2 = {
    "N": "G",
    "G": "R",
}  # RINEX 2.11, tables A3 and A10: navigation data of GPS, of GLONASS
_IONOSPHERE_OF_VERSION_2 = {"ION ALPHA": "A", "ION BETA": "B"}
_MESSAGES = {"G": ("LNAV",), "J": ("LNAV",), "E": ("INAV", "FNAV"), "C": ("D1", "D2"), "R": ("FDMA",)}
_IONOSPHERE_MESSAGES = {"G": "LNAV", "J": "LNAV", "C": "D1D2"}
_IONOSPHERE_SYSTEMS = {"GPS": "G", "BDS": "C", "QZS": "J"}

NavigationResult = BroadcastEphemeris | IonosphereCoefficients | FormatError


class NavigationDecoder:
    """Decodes a file in chunks; the results do not depend on the chunks, and nothing is raised."""

    def __init__(self, source_name: str) -> None:
        self.version: float | None = None
        self.klobuchar: dict[str, IonosphereCoefficients] = {}
        """The last coefficients, by system letter."""
        self.leap_seconds: int | None = None
        self.problems = 0
        self.skipped: Counter[str] = Counter()
        """Unsupported records, by system letter and, in RINEX 4, message: `S`, `G CNAV`."""
        self.refused = False
        """Whether the file cannot be read: no more results."""
        self._source_name = source_name
        self._lines = LineBuffer()
        self._line_number = 0
        self._system_of_version_2 = "G"
        self._halves: dict[tuple[str, str], dict[str, Four]] = {}
        self._in_header = True
        self._record: NavigationRecord | None = None
        self._stray_reported = False
        self._results: list[NavigationResult] = []

    def feed(self, data: bytes) -> list[NavigationResult]:
        """Return the results that the bytes complete, in order."""
        for line_number, line in self._lines.feed(data):
            self._line_number = line_number
            if self.refused:
                break
            self._line(line)
        return self._take_results()

    def finish(self) -> list[NavigationResult]:
        """Return the remaining results at the end: the last record."""
        rest, self._line_number = self._lines.take_rest(), self._lines.line_number
        if rest and not self.refused:
            self._line(rest)
        if not self.refused and self._in_header:
            self._problem(self._error("header", "END OF HEADER"))
        elif not self.refused:
            self._end_record()
        self.refused = True
        return self._take_results()

    def _take_results(self) -> list[NavigationResult]:
        results, self._results = self._results, []
        return results

    def _error(
        self, field: str, expected: str, actual: str | None = None, *, line_number: int | None = None
    ) -> FormatError:
        line_number = self._line_number if line_number is None else line_number
        return FormatError(self._source_name, field, expected, actual=actual, line_number=line_number)

    def _problem(self, error: FormatError) -> None:
        self.problems += 1
        self._results.append(error)

    def _line(self, line: bytes | None) -> None:
        if line is None:
            self._problem(self._error("line", f"at most {MAXIMUM_LINE_BYTES} bytes"))
            self._record, self._stray_reported = None, True
            self.refused = self.version is None
            return
        text = line.decode("latin-1").rstrip()
        if not self._in_header:
            assert self.version is not None
            version_2 = self.version < _FIRST_OF_ALL_SYSTEMS
            self._body_line(navigation_line(text, self._system_of_version_2) if version_2 else text)
            return
        try:
            self._header_line(text)
        except FormatError as error:
            self._problem(error)
            # Without a version nothing can be read; another malformed header line costs only itself.
            self.refused = self.version is None or self._line_number > MAX_HEADER_LINES

    def _header_line(self, text: str) -> None:
        label = text[60:].strip()
        if self.version is None:
            self._first_line(text)
        elif self._line_number > MAX_HEADER_LINES:
            raise self._error("header", f"END OF HEADER within {MAX_HEADER_LINES} lines")
        elif label in _IONOSPHERE_OF_VERSION_2 and self.version < _FIRST_OF_ALL_SYSTEMS:
            numbers = [text[k : k + 12] for k in range(2, 50, 12)]
            self._ionosphere_half(label, ("G", ""), _IONOSPHERE_OF_VERSION_2[label], numbers)
        elif label == "IONOSPHERIC CORR":
            self._header_ionosphere(text)
        elif label == "LEAP SECONDS":
            self.leap_seconds = leap_seconds_from_text(text)
            if self.leap_seconds is None:
                raise self._error("LEAP SECONDS", "a number", text[:6])
        elif label == "END OF HEADER":
            self._in_header = False

    def _first_line(self, text: str) -> None:
        version = decimal_number(text[:9])
        file_type = text[20:21]
        if version is not None and version < _FIRST_OF_ALL_SYSTEMS and file_type in _TYPES_OF_VERSION_2:
            self._system_of_version_2 = _TYPES_OF_VERSION_2[file_type]
            self.version = rinex_version(text, f"navigation data ({file_type})", self._error)
        else:
            self.version = rinex_version(text, "navigation data (N)", self._error)

    def _header_ionosphere(self, text: str) -> None:
        """Add the coefficients with the line of their second half."""
        system = _IONOSPHERE_SYSTEMS.get(text[:3])
        if system is None or text[3:4] not in ("A", "B"):
            return
        # BeiDou may have several lines: the halves of a pair have the same time and satellite after the numbers.
        numbers = [text[k : k + 12] for k in range(5, 53, 12)]
        self._ionosphere_half(text[:4], (system, text[53:60]), text[3], numbers)

    def _ionosphere_half(self, field: str, key: tuple[str, str], half: str, numbers: list[str]) -> None:
        a, b, c, d = map(decimal_number, numbers)
        if a is None or b is None or c is None or d is None:
            raise self._error(field, "four numbers of 12 columns", "".join(numbers))
        system = key[0]
        halves = self._halves.setdefault(key, {})
        halves[half] = (a, b, c, d)
        if len(halves) == 2:
            coefficients = IonosphereCoefficients(system=system, alpha=halves["A"], beta=halves["B"])
            self.klobuchar[system] = coefficients
            del self._halves[key]
            self._results.append(coefficients)

    def _body_line(self, text: str) -> None:
        """A line that begins with a satellite or `>` begins a record, blanks continue it."""
        announces = text.startswith(">")
        if announces or (text[:1].isalpha() and not self._is_announced()):
            self._end_record()
            self._stray_reported = False
            kind, satellite, message = "EPH", text[:3], ""
            if announces:
                kind, satellite, message = [*text[1:].split(), "", "", ""][:3]
            self._record = NavigationRecord(
                first_line=self._line_number, kind=kind, satellite=satellite, message=message
            )
        if self._record is None:
            if text and not self._stray_reported:
                self._stray_reported = True
                self._problem(self._error("line", "a satellite or '>' at the begin of a record", text))
        elif not announces and len(self._record.lines) < _MAX_RECORD_LINES:
            self._record.lines.append(text)

    def _is_announced(self) -> bool:
        """Whether the next line with a satellite belongs to the `>` line before it."""
        return self._record is not None and self._record.message != "" and not self._record.lines

    def _end_record(self) -> None:
        record, self._record = self._record, None
        if record is None:
            return
        try:
            result = self._parse(record)
        except FormatError as error:
            self._problem(error)
        except ValueError as error:
            expected = f"a record that is whole ({error})"
            self._problem(self._error(record.satellite or "record", expected, line_number=record.first_line))
        else:
            if result is not None:
                self._results.append(result)

    def _parse(self, record: NavigationRecord) -> BroadcastEphemeris | IonosphereCoefficients | None:
        """Parse a record. Raises FormatError or ValueError where it is malformed."""
        assert self.version is not None
        system = record.satellite[:1]
        messages = _MESSAGES.get(system)
        if record.kind == "EPH" and messages and record.message in ("", *messages):
            if self.version >= 4.0 and not record.message:
                expected = "a line '> EPH …' before it"
                raise self._error("record", expected, record.satellite, line_number=record.first_line)
            return parse_glonass_ephemeris(record) if system == "R" else parse_ephemeris(record)
        if record.kind == "ION" and record.message == _IONOSPHERE_MESSAGES.get(system):
            self.klobuchar[system] = parse_ionosphere(record)
            return self.klobuchar[system]
        if record.kind not in ("EPH", "ION", "STO", "EOP") or system not in "GREJCSI":
            actual = f"{record.kind} {record.satellite}"
            raise self._error("record", "a known record", actual, line_number=record.first_line)
        if record.kind == "EPH":
            self.skipped[f"{system} {record.message}".strip()] += 1
        return None
