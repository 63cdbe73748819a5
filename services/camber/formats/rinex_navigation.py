"""RINEX 3 and 4 navigation files: the Keplerian ephemerides of GPS, QZSS, Galileo and BeiDou, and what is broadcast of
the ionosphere.

Source: IGS/RTCM, "RINEX", version 3.04 (2018), tables A5, A6, A8, A12, A14; version 4.02 (2024), tables A9, A10 (record
types), A33 (Klobuchar). Read are GPS and QZSS LNAV, Galileo I/NAV and F/NAV, BeiDou D1 and D2; other messages are
counted. A number must fill its 19 columns: one that is cut short is not a smaller one.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from camber.formats.errors import FormatError
from camber.formats.line_buffer import MAXIMUM_LINE_BYTES, LineBuffer
from camber.formats.observations import Ephemeris
from camber.formats.rinex_files import rinex_pieces
from camber.formats.rinex_header import leap_seconds_from_text
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK, CalendarTime, gps_ns_from_gpst

_WIDTH = 19
_MOST_HEADER_LINES = 20_000
_MOST_RECORD_LINES = 12
_MOST_PROBLEMS_KEPT = 1000
_BDT_BEHIND_GPS_NS = 14 * NS_PER_SECOND
_BDT_FIRST_GPS_WEEK = 1356
_UNKNOWN_TIME_S = 0.9999e9
_ORBIT_ROWS = (
    ("iode", "crs_m", "mean_motion_difference_rad_s", "mean_anomaly_rad"),
    ("cuc", "eccentricity", "cus", "sqrt_a"),
    ("toe_s", "cic", "ascending_node_rad", "cis"),
    ("inclination_rad", "crc_m", "perigee_rad", "ascending_node_rate_rad_s"),
)
_RATE = "inclination_rate_rad_s"
_GPS_ROWS = (
    *_ORBIT_ROWS,
    (_RATE, "codes_on_l2", "week", "l2_p_data"),
    ("accuracy_m", "health", "tgd_s", "iodc"),
    ("sent_s", "fit"),
)
_ROWS: dict[str, tuple[tuple[str, ...], ...]] = {
    "G": _GPS_ROWS,
    "J": _GPS_ROWS,
    "E": (
        *_ORBIT_ROWS,
        (_RATE, "data_sources", "week"),
        ("accuracy_m", "health", "bgd_e5a_s", "bgd_e5b_s"),
        ("sent_s",),
    ),
    "C": (
        *_ORBIT_ROWS,
        (_RATE, "", "week"),
        ("accuracy_m", "health", "tgd1_s", "tgd2_s"),
        ("sent_s", "aodc"),
    ),
}
_OTHER = ("tgd_s", "iodc", "bgd_e5a_s", "bgd_e5b_s", "data_sources", "tgd1_s", "tgd2_s", "aodc")
_MAY_BE_BLANK = {*_OTHER, "accuracy_m", "sent_s", "fit", "codes_on_l2", "l2_p_data"}
_ORBIT = [n for row in (*_ORBIT_ROWS, (_RATE,)) for n in row if n not in ("iode", "toe_s")]
_MESSAGES = {"G": ("LNAV",), "J": ("LNAV",), "E": ("INAV", "FNAV"), "C": ("D1", "D2")}
_IONOSPHERE_MESSAGES = {"G": "LNAV", "J": "LNAV", "C": "D1D2"}
_IONOSPHERE_SYSTEMS = {"GPS": "G", "BDS": "C", "QZS": "J"}

Four = tuple[float, float, float, float]
NavigationResult = Ephemeris | FormatError


@dataclass(slots=True)
class Klobuchar:
    """A system's coefficients of the broadcast ionosphere: alpha in s, s/sc, …, beta likewise; None: not given."""

    alpha: Four | None = None
    beta: Four | None = None


@dataclass(frozen=True, slots=True)
class _Record:
    """Lines of one record, and what a RINEX 4 line `> EPH G01 LNAV` said before it."""

    first_line: int
    kind: str
    satellite: str
    message: str
    lines: list[str] = field(default_factory=list)


class NavigationDecoder:
    """Reads a file piece by piece; the results do not depend on how it is cut, and nothing is raised."""

    def __init__(self, source_name: str) -> None:
        self.version: float | None = None
        self.klobuchar: dict[str, Klobuchar] = {}
        """The last that was read, by system letter."""
        self.leap_seconds: int | None = None
        self.problems = 0
        self.skipped: Counter[str] = Counter()
        """Records that are not read, by system letter and, of RINEX 4, message: `R`, `G CNAV`."""
        self.refused = False
        """The file cannot be read: nothing more will come."""
        self._source_name = source_name
        self._lines = LineBuffer()
        self._in_header = True
        self._record: _Record | None = None
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
        return FormatError(self._source_name, what, expected, found=found, line_number=line_number)

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
            self._header(line_number, text)
        except FormatError as error:
            self._problem(error, results)
            # Without a version nothing can be read; a header line that is damaged costs itself.
            self.refused = self.version is None or line_number > _MOST_HEADER_LINES

    def _header(self, line_number: int, text: str) -> None:
        label = text[60:].strip()
        if self.version is None:
            self._first(line_number, text, label)
        elif line_number > _MOST_HEADER_LINES:
            raise self._error("header", f"END OF HEADER within {_MOST_HEADER_LINES} lines", line_number)
        elif label == "IONOSPHERIC CORR":
            self._header_ionosphere(line_number, text)
        elif label == "LEAP SECONDS":
            self.leap_seconds = leap_seconds_from_text(text)
            if self.leap_seconds is None:
                raise self._error("LEAP SECONDS", "a number", line_number, text[:6])
        elif label == "END OF HEADER":
            self._in_header = False

    def _first(self, line_number: int, text: str, label: str) -> None:
        if label != "RINEX VERSION / TYPE":
            raise self._error("first line", "'RINEX VERSION / TYPE' in columns 61 to 80", line_number, text)
        version = _number(text[:9])
        if version is None or not 3.0 <= version < 5.0:
            raise self._error("RINEX version", "3 or 4", line_number, text[:9].strip())
        if text[20:21] != "N":
            raise self._error("file type", "navigation data (N)", line_number, text[20:40].strip())
        self.version = version

    def _header_ionosphere(self, line_number: int, text: str) -> None:
        system = _IONOSPHERE_SYSTEMS.get(text[:3])
        if system is None or text[3:4] not in ("A", "B"):
            return
        values = [_number(text[k : k + 12]) for k in range(5, 53, 12)]
        a, b, c, d = values
        if a is None or b is None or c is None or d is None:
            raise self._error(text[:4], "four numbers of 12 columns", line_number, text[5:53])
        klobuchar = self.klobuchar.setdefault(system, Klobuchar())
        if text[3] == "A":
            klobuchar.alpha = (a, b, c, d)
        else:
            klobuchar.beta = (a, b, c, d)

    def _body(self, line_number: int, text: str, results: list[NavigationResult]) -> None:
        """A line that begins with a satellite or `>` begins a record, blanks go on with it."""
        announced = text.startswith(">")
        begins = announced or (text[:1].isalpha() and not self._is_announced())
        if begins:
            self._close(results)
            self._astray = False
            words = text[1:].split() if announced else []
            kind, satellite, message = ([*words, "", "", ""])[:3] if announced else ("EPH", text[:3], "")
            self._record = _Record(line_number, kind, satellite, message)
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

    def _read(self, record: _Record) -> Ephemeris | None:
        """Raises FormatError or ValueError where a record is damaged."""
        system = record.satellite[:1]
        if record.kind == "EPH" and record.message in ("", *_MESSAGES.get(system, ())) and system in _ROWS:
            if self._version() >= 4.0 and not record.message:
                raise self._error("record", "a line '> EPH …' before it", record.first_line, record.satellite)
            return _ephemeris(record)
        if record.kind == "ION" and record.message == _IONOSPHERE_MESSAGES.get(system):
            self.klobuchar[system] = _ionosphere(record)
            return None
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


def _ephemeris(record: _Record) -> Ephemeris:
    system = record.satellite[0]
    rows = _ROWS[system]
    if len(record.lines) != 1 + len(rows):
        raise ValueError(f"{len(record.lines)} lines, not {1 + len(rows)}")
    head = record.lines[0]
    if head[:3] != record.satellite:
        raise ValueError(f"satellite {head[:3]!r} in its first line")
    clock_s = tuple(_required(head, 23 + _WIDTH * k, name) for k, name in enumerate(("af0", "af1", "af2")))
    values: dict[str, float] = {}
    for names, line in zip(rows, record.lines[1:], strict=True):
        if line[:4].strip():
            raise ValueError(f"{line[:4]!r} at the begin of a line")
        for k, name in enumerate(names):
            if name in _MAY_BE_BLANK:
                if (value := _at(line, 4 + _WIDTH * k, name)) is not None:
                    values[name] = value
            elif name:
                values[name] = _required(line, 4 + _WIDTH * k, name)
    shift_ns = _BDT_BEHIND_GPS_NS if system == "C" else 0
    toc_ns = gps_ns_from_gpst(_calendar(head)) + shift_ns
    toe_ns = _toe_ns(system, values["toe_s"], toc_ns - shift_ns, values["week"]) + shift_ns
    _check(values)
    number = _digits(record.satellite[1:3], "satellite")
    if number == 0:
        raise ValueError("satellite 0")
    other = {name: values[name] for name in _OTHER if name in values}
    if system in "GJ":
        other["fit_interval_h"] = _fit_interval_h(system, values.get("fit", 0.0))
    accuracy_m = values.get("accuracy_m", math.nan)
    return Ephemeris(
        satellite=ord(system) * 256 + number,
        toe_ns=toe_ns,
        toc_ns=toc_ns,
        transmission_ns=_transmission_ns(values.get("sent_s", _UNKNOWN_TIME_S), toe_ns, shift_ns),
        iode=int(values["iode"]),
        clock=(clock_s[0], clock_s[1], clock_s[2]),
        # Galileo says −1 where there is no prediction.
        accuracy_m=accuracy_m if accuracy_m >= 0.0 else math.nan,
        health=int(values["health"]),
        other=other,
        **{name: values[name] for name in _ORBIT},
    )


def _calendar(head: str) -> CalendarTime:
    places = ((4, 8), (9, 11), (12, 14), (15, 17), (18, 20), (21, 23))
    year, month, day, hour, minute, second = (_digits(head[a:b], "time") for a, b in places)
    return CalendarTime(year, month, day, hour, minute, second)


def _toe_ns(system: str, toe_s: float, toc_ns: int, week: float) -> int:
    """In the system's own time since 1980: that nearest to the clock's reference time, which has a date.

    The week, with which writers differ (full or modulo 1024, of toe or of transmission, BeiDou's or GPS's), must not
    contradict it.
    """
    if not 0.0 <= toe_s <= NS_PER_WEEK / NS_PER_SECOND:
        raise ValueError(f"toe {toe_s} s of the week")
    toe_ns = _nearest(round(toe_s * NS_PER_SECOND), toc_ns)
    found = toe_ns // NS_PER_WEEK
    expected = (found, found - _BDT_FIRST_GPS_WEEK) if system == "C" else (found,)
    if not any(abs((week - w + 512.0) % 1024.0 - 512.0) <= 1.0 for w in expected):
        raise ValueError(f"week {week:.0f} with a date in week {found}")
    return toe_ns


def _nearest(of_week_ns: int, near_ns: int) -> int:
    return near_ns + (of_week_ns - near_ns + NS_PER_WEEK // 2) % NS_PER_WEEK - NS_PER_WEEK // 2


def _transmission_ns(sent_s: float, toe_ns: int, shift_ns: int) -> int:
    """Nearest to toe: not all writers count it from the week of toe. Unknown: toe, before which it was sent."""
    if not abs(sent_s) < 2 * NS_PER_WEEK / NS_PER_SECOND:
        return toe_ns
    return _nearest(round(sent_s * NS_PER_SECOND), toe_ns - shift_ns) + shift_ns


def _fit_interval_h(system: str, said: float) -> float:
    """Hours; QZSS's, and some writers' of GPS, is the broadcast flag for more than the nominal two or four hours."""
    nominal = 2.0 if system == "J" else 4.0
    return {0.0: nominal, 1.0: 1.5 * nominal}.get(said, said)


def _check(values: Mapping[str, float]) -> None:
    for name in ("iode", "health"):
        if not (0.0 <= values[name] < 2.0**16 and values[name].is_integer()):
            raise ValueError(f"{name} {values[name]}")
    if not (0.0 <= values["eccentricity"] < 1.0 and values["sqrt_a"] > 0.0):
        raise ValueError(f"eccentricity {values['eccentricity']}, square root of a {values['sqrt_a']} √m")


def _ionosphere(record: _Record) -> Klobuchar:
    """RINEX 4: three numbers beside the time, four, one and the region."""
    if len(record.lines) < 3:
        raise ValueError(f"{len(record.lines)} lines, not 3")
    first = [_required(record.lines[0], 23 + _WIDTH * k, "alpha") for k in range(3)]
    second = [_required(record.lines[1], 4 + _WIDTH * k, "alpha, beta") for k in range(4)]
    last = _required(record.lines[2], 4, "beta")
    return Klobuchar((first[0], first[1], first[2], second[0]), (second[1], second[2], second[3], last))


def _required(line: str, start: int, name: str) -> float:
    value = _at(line, start, name)
    if value is None:
        raise ValueError(f"{name} is blank")
    return value


def _at(line: str, start: int, name: str) -> float | None:
    """The number in 19 columns; None for blanks."""
    text = line[start : start + _WIDTH]
    if not text.strip():
        return None
    value = _number(text) if len(text) == _WIDTH else None
    if value is None:
        raise ValueError(f"{name} {text.strip()!r}")
    return value


def _number(text: str) -> float | None:
    """A finite decimal number, with E or D before its exponent."""
    if "_" in text or not text.isascii():
        return None
    try:
        value = float(text.upper().replace("D", "E"))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _digits(text: str, name: str) -> int:
    stripped = text.strip()
    if not (stripped.isascii() and stripped.isdigit()):
        raise ValueError(f"{name} {text!r}")
    return int(stripped)


@dataclass(frozen=True, slots=True, eq=False)
class RinexNavigation:
    """A whole file. `problems` are the first thousand of `problem_count`; `skipped` records as the decoder has them."""

    version: float
    ephemerides: list[Ephemeris]
    klobuchar: Mapping[str, Klobuchar]
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
        for piece in rinex_pieces(path):
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
        decoder.version,
        [r for r in results if isinstance(r, Ephemeris)],
        decoder.klobuchar,
        decoder.leap_seconds,
        problems[:_MOST_PROBLEMS_KEPT],
        len(problems),
        decoder.skipped,
    )
