"""RINEX 3 and 4 navigation files: the Keplerian ephemerides of GPS, QZSS, Galileo and BeiDou, and what is broadcast of
the ionosphere.

Source: IGS/RTCM, "RINEX", version 3.04 (2018), table A5, and version 4.02 (2024), types of navigation records. Read are
GPS and QZSS LNAV, Galileo I/NAV and F/NAV, BeiDou D1 and D2; other messages are counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from camber.formats.broadcast.klobuchar_coefficients import Four, IonosphereCoefficients
from camber.formats.errors import FormatError
from camber.formats.line_buffer import MAXIMUM_LINE_BYTES, LineBuffer
from camber.formats.observations import Ephemeris
from camber.formats.rinex.compressed_files import rinex_chunks
from camber.formats.rinex.navigation_records import NavigationRecord, parse_ephemeris, parse_ionosphere
from camber.formats.rinex.observation_header import decimal_number, leap_seconds_from_text

_MOST_HEADER_LINES = 20_000
_MOST_RECORD_LINES = 12
_MOST_PROBLEMS_KEPT = 1000
_MESSAGES = {"G": ("LNAV",), "J": ("LNAV",), "E": ("INAV", "FNAV"), "C": ("D1", "D2")}
_IONOSPHERE_MESSAGES = {"G": "LNAV", "J": "LNAV", "C": "D1D2"}
_IONOSPHERE_SYSTEMS = {"GPS": "G", "BDS": "C", "QZS": "J"}

NavigationResult = Ephemeris | IonosphereCoefficients | FormatError


class NavigationDecoder:
    """Reads a file piece by piece; the results do not depend on how it is cut, and nothing is raised."""

    def __init__(self, source_name: str) -> None:
        self.version: float | None = None
        self.klobuchar: dict[str, IonosphereCoefficients] = {}
        """The last that was read, by system letter."""
        self.leap_seconds: int | None = None
        self.problems = 0
        self.skipped: Counter[str] = Counter()
        """Records that are not read, by system letter and, of RINEX 4, message: `R`, `G CNAV`."""
        self.refused = False
        """The file cannot be read: nothing more will come."""
        self._source_name = source_name
        self._lines = LineBuffer()
        self._halves: dict[tuple[str, str], dict[str, Four]] = {}
        self._in_header = True
        self._record: NavigationRecord | None = None
        self._astray = False

    def feed(self, data: bytes) -> list[NavigationResult]:
        """What the bytes complete, in order."""
        results: list[NavigationResult] = []
        for line_number, line in self._lines.feed(data):
            if self.refused:
                break
            self._guarded(line_number, line, results)
        return results

    def finish(self) -> list[NavigationResult]:
        """Call at the end: gives out the last record."""
        results: list[NavigationResult] = []
        rest, line_number = self._lines.take_rest(), self._lines.line_number
        if rest and not self.refused:
            self._guarded(line_number, rest, results)
        if not self.refused and self._in_header:
            self._problem(self._error("header", "END OF HEADER", line_number), results)
        elif not self.refused:
            self._close(results)
        self.refused = True
        return results

    def _error(self, what: str, expected: str, line_number: int, found: str | None = None) -> FormatError:
        return FormatError(self._source_name, what, expected, actual=found, line_number=line_number)

    def _problem(self, error: FormatError, results: list[NavigationResult]) -> None:
        self.problems += 1
        results.append(error)

    def _guarded(self, line_number: int, line: bytes | None, results: list[NavigationResult]) -> None:
        if line is None:
            expected = f"at most {MAXIMUM_LINE_BYTES} bytes"
            self._problem(self._error("line", expected, line_number), results)
            self._record, self._astray = None, True
            self.refused = self.version is None
            return
        text = line.decode("latin-1").rstrip()
        if not self._in_header:
            self._body(line_number, text, results)
            return
        try:
            self._header(line_number, text, results)
        except FormatError as error:
            self._problem(error, results)
            # Without a version nothing can be read; a header line that is damaged costs itself.
            self.refused = self.version is None or line_number > _MOST_HEADER_LINES

    def _header(self, line_number: int, text: str, results: list[NavigationResult]) -> None:
        label = text[60:].strip()
        if self.version is None:
            self._first(line_number, text, label)
        elif line_number > _MOST_HEADER_LINES:
            raise self._error("header", f"END OF HEADER within {_MOST_HEADER_LINES} lines", line_number)
        elif label == "IONOSPHERIC CORR":
            results += self._header_ionosphere(line_number, text)
        elif label == "LEAP SECONDS":
            self.leap_seconds = leap_seconds_from_text(text)
            if self.leap_seconds is None:
                raise self._error("LEAP SECONDS", "a number", line_number, text[:6])
        elif label == "END OF HEADER":
            self._in_header = False

    def _first(self, line_number: int, text: str, label: str) -> None:
        if label != "RINEX VERSION / TYPE":
            raise self._error("first line", "'RINEX VERSION / TYPE' in columns 61 to 80", line_number, text)
        version = decimal_number(text[:9])
        if version is None or not 3.0 <= version < 5.0:
            raise self._error("RINEX version", "3 or 4", line_number, text[:9].strip())
        if text[20:21] != "N":
            raise self._error("file type", "navigation data (N)", line_number, text[20:40].strip())
        self.version = version

    def _header_ionosphere(self, line_number: int, text: str) -> list[IonosphereCoefficients]:
        """The coefficients whose second half the line says."""
        system = _IONOSPHERE_SYSTEMS.get(text[:3])
        if system is None or text[3:4] not in ("A", "B"):
            return []
        values = [decimal_number(text[k : k + 12]) for k in range(5, 53, 12)]
        a, b, c, d = values
        if a is None or b is None or c is None or d is None:
            raise self._error(text[:4], "four numbers of 12 columns", line_number, text[5:53])
        # BeiDou's lines may be several: of one time and satellite, which stand behind them, are those of a pair.
        halves = self._halves.setdefault((system, text[53:60]), {})
        halves[text[3]] = (a, b, c, d)
        if len(halves) < 2:
            return []
        self.klobuchar[system] = IonosphereCoefficients(system=system, alpha=halves["A"], beta=halves["B"])
        del self._halves[system, text[53:60]]
        return [self.klobuchar[system]]

    def _body(self, line_number: int, text: str, results: list[NavigationResult]) -> None:
        """A line that begins with a satellite or `>` begins a record, blanks go on with it."""
        announced = text.startswith(">")
        begins = announced or (text[:1].isalpha() and not self._is_announced())
        if begins:
            self._close(results)
            self._astray = False
            words = text[1:].split() if announced else []
            kind, satellite, message = ([*words, "", "", ""])[:3] if announced else ("EPH", text[:3], "")
            self._record = NavigationRecord(
                first_line=line_number, kind=kind, satellite=satellite, message=message
            )
        if self._record is None:
            if text and not self._astray:
                self._astray = True
                self._problem(
                    self._error("line", "a satellite or '>' at the begin of a record", line_number, text),
                    results,
                )
            return
        if not announced and len(self._record.lines) < _MOST_RECORD_LINES:
            self._record.lines.append(text)

    def _is_announced(self) -> bool:
        """The next line with a satellite belongs to a `>` line before it."""
        return self._record is not None and self._record.message != "" and not self._record.lines

    def _close(self, results: list[NavigationResult]) -> None:
        record, self._record = self._record, None
        if record is None:
            return
        try:
            result = self._read(record)
        except FormatError as error:
            self._problem(error, results)
        except ValueError as error:
            what = record.satellite or "record"
            self._problem(self._error(what, f"a record that is whole ({error})", record.first_line), results)
        else:
            if result is not None:
                results.append(result)

    def _read(self, record: NavigationRecord) -> Ephemeris | IonosphereCoefficients | None:
        """Raises FormatError or ValueError where a record is damaged."""
        system = record.satellite[:1]
        messages = _MESSAGES.get(system)
        if record.kind == "EPH" and messages and record.message in ("", *messages):
            if self._version() >= 4.0 and not record.message:
                raise self._error("record", "a line '> EPH …' before it", record.first_line, record.satellite)
            return parse_ephemeris(record)
        if record.kind == "ION" and record.message == _IONOSPHERE_MESSAGES.get(system):
            self.klobuchar[system] = parse_ionosphere(record)
            return self.klobuchar[system]
        if record.kind not in ("EPH", "ION", "STO", "EOP") or system not in "GREJCSI":
            raise self._error(
                "record", "a known record", record.first_line, f"{record.kind} {record.satellite}"
            )
        if record.kind == "EPH":
            self.skipped[f"{system} {record.message}".strip()] += 1
        return None

    def _version(self) -> float:
        assert self.version is not None
        return self.version


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RinexNavigation:
    """A whole file. `problems` are the first thousand of `problem_count`; `skipped` records as the decoder has them."""

    version: float
    ephemerides: list[Ephemeris]
    klobuchar: Mapping[str, IonosphereCoefficients]
    leap_seconds: int | None
    problems: list[FormatError]
    problem_count: int
    skipped: Mapping[str, int]


def read_navigation(path: Path) -> RinexNavigation:
    """A file, plain or compressed: see `rinex_files`.

    Raises FormatError where it is no RINEX navigation file that can be read, OSError where it cannot be opened.
    """
    decoder = NavigationDecoder(path.name)
    results: list[NavigationResult] = []
    try:
        for piece in rinex_chunks(path):
            results += decoder.feed(piece)
    except FormatError as damage:
        if decoder.version is None:
            raise
        results.append(damage)
    results += decoder.finish()
    problems = [r for r in results if isinstance(r, FormatError)]
    if decoder.version is None:
        raise problems[0]
    return RinexNavigation(
        version=decoder.version,
        ephemerides=[r for r in results if isinstance(r, Ephemeris)],
        klobuchar=decoder.klobuchar,
        leap_seconds=decoder.leap_seconds,
        problems=problems[:_MOST_PROBLEMS_KEPT],
        problem_count=len(problems),
        skipped=decoder.skipped,
    )
