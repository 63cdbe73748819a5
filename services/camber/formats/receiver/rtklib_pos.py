"""RTKLIB solution files (`.pos`): position with ellipsoidal height per epoch, read as a stream and written.

Source: RTKLIB 2.4.2 manual, appendix B.1 "Positioning Solution File", and `outpos`, `decode_solllh` in its
`solution.c`. Accepted: columns named by the header in any order, times as calendar or GPS week and seconds, GPST or
UTC, blanks, tabs or commas between columns, with or without velocity.

Refused, with a reason: heights that are not declared ellipsoidal (`WGS84/geodetic` are heights above a geoid that the
file does not name), other datums, degrees-minutes-seconds, ECEF and baselines, JST, and week and seconds under a UTC
header (RTKLIB writes them in UTC and reads them as GPST, so they may be wrong by 18 s).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from camber.formats.errors import FormatError
from camber.formats.line_buffer import MAXIMUM_LINE_BYTES, LineBuffer
from camber.formats.receiver.printed_covariance import covariance_from_printed, signed_root
from camber.formats.receiver.solution import ReceiverSolution, SolutionQuality
from camber.geodesy.covariance import EnuCovariance
from camber.geodesy.gps_time import (
    calendar_from_text,
    gps_ns_from_gpst,
    gps_ns_from_utc,
    gps_ns_from_week_tow,
    gpst_from_gps_ns,
    nanoseconds_from_decimal,
    text_from_calendar,
)
from camber.schemas.base import LATEST_NS

_REQUIRED = ("latitude(deg)", "longitude(deg)", "height(m)", "Q", "ns")
_DEVIATIONS = ("sdn(m)", "sde(m)", "sdu(m)", "sdne(m)", "sdeu(m)", "sdun(m)")
_VELOCITIES = ("vn(m/s)", "ve(m/s)", "vu(m/s)")
_VELOCITY_DEVIATIONS = ("sdvn", "sdve", "sdvu", "sdvne", "sdveu", "sdvun")
_GROUPS = (_REQUIRED, _DEVIATIONS, _VELOCITIES, _VELOCITY_DEVIATIONS)

# Half a unit of the last digit RTKLIB prints: four decimals for positions, five for velocities.
_POSITION_ROUNDING_M = 0.5e-4
_VELOCITY_ROUNDING_M_S = 0.5e-5
# Chosen, but for degrees: far beyond anything on Earth, so that only damaged numbers exceed them.
_BOUNDS = {
    "latitude(deg)": (-90.0, 90.0),
    "longitude(deg)": (-180.0, 180.0),
    "height(m)": (-1.0e5, 1.0e5),
    "age(s)": (-1.0e6, 1.0e6),
    "ratio": (0.0, math.inf),
    **dict.fromkeys(_VELOCITIES, (-1.0e4, 1.0e4)),
    **dict.fromkeys((*_DEVIATIONS[:3], *_VELOCITY_DEVIATIONS[:3]), (0.0, 1.0e6)),
    **dict.fromkeys((*_DEVIATIONS[3:], *_VELOCITY_DEVIATIONS[3:]), (-1.0e6, 1.0e6)),
}

_DATUM = re.compile(r"lat/lon/height=([^/,\s]*)/([^,\s)]*)")
_OTHER_POSITION = re.compile(r"x/y/z-ecef|e/n/u-baseline|x-ecef\(|e-baseline\(")


@dataclass(frozen=True, slots=True, kw_only=True)
class _PosColumns:
    """A column header: the time system, and the index of each column after the two of the time."""

    utc: bool
    indices: dict[str, int]
    field_count: int


class PosDecoder:
    """Decodes the bytes of a `.pos` file, in chunks of any size, to solutions and errors."""

    def __init__(self, source_name: str) -> None:
        self.source_name = source_name
        self.rows_refused = 0
        """Rows skipped because their header is missing or refused, which is reported once, not by row."""
        self._lines = LineBuffer()
        self._datum: Literal["unknown", "good", "refused"] = "unknown"
        self._columns: _PosColumns | None = None
        self._reported = False
        self._line_number = 0

    def feed(self, data: bytes) -> list[ReceiverSolution | FormatError]:
        """Return the results of the lines that `data` completes. Never raises; keeps at most one partial line."""
        results: list[ReceiverSolution | FormatError] = []
        for line_number, line in self._lines.feed(data):
            self._line_number = line_number
            try:
                if line is None:
                    raise self._error("line", f"at most {MAXIMUM_LINE_BYTES} bytes before the next newline")
                solution = self._line(line)
            except FormatError as error:
                results.append(error)
            else:
                if solution is not None:
                    results.append(solution)
        return results

    def finish(self) -> list[ReceiverSolution | FormatError]:
        """Return the remaining results at the end: a last line without newline may be truncated and is an error."""
        rest = self._lines.take_rest()
        self._line_number = self._lines.line_number
        return [self._error("last line", "a newline at its end", rest)] if rest.strip() else []

    def _error(self, field: str, expected: str, actual: str | bytes | None = None) -> FormatError:
        return FormatError(self.source_name, field, expected, actual=actual, line_number=self._line_number)

    def _line(self, line: bytes) -> ReceiverSolution | None:
        if line.startswith(b"%"):
            self._header(line.decode("latin-1"))
            return None
        fields = line.replace(b",", b" ").split()
        columns = self._columns_for_row() if fields else None
        if columns is None:
            return None
        row = _Row(
            source_name=self.source_name, line_number=self._line_number, columns=columns, fields=fields
        )
        return row.solution()

    def _header(self, text: str) -> None:
        datum = _DATUM.search(text)
        names = text[1:].replace(",", " ").split()
        if datum is not None:
            self._reported, self._datum = True, "refused"
            self._check_datum(datum[1], datum[2])
            self._reported, self._datum = False, "good"
        elif _OTHER_POSITION.search(text):
            already_reported = self._reported and self._datum == "refused"
            self._reported, self._columns, self._datum = True, None, "refused"
            if already_reported:
                return
            expected = "latitude(deg) longitude(deg) height(m); ECEF and baselines are not read"
            raise self._error("columns", expected, text.strip("% "))
        elif any(name.startswith("latitude(") for name in names):
            self._reported, self._columns = True, None
            self._columns = self._read_columns(names)
            self._reported = self._datum == "refused"

    def _check_datum(self, datum: str, height: str) -> None:
        if datum != "WGS84":
            raise self._error("datum", "WGS84", datum)
        if height != "ellipsoidal":
            expected = "ellipsoidal: orthometric height without a named geoid model"
            raise self._error("height(m)", expected, height)

    def _read_columns(self, names: list[str]) -> _PosColumns:
        time_system, *columns = names
        if time_system not in ("GPST", "UTC"):
            raise self._error("time system", "GPST or UTC", time_system)
        if len(set(columns)) != len(columns):
            raise self._error("columns", "each name once")
        for group in _GROUPS:
            missing = [name for name in group if name not in columns]
            if missing and (group is _REQUIRED or len(missing) < len(group)):
                raise self._error("columns", f"a column {missing[0]}", " ".join(columns))
        # The time takes two fields: date and time of day, or week and seconds.
        indices = {name: 2 + i for i, name in enumerate(columns)}
        return _PosColumns(utc=time_system == "UTC", indices=indices, field_count=2 + len(columns))

    def _columns_for_row(self) -> _PosColumns | None:
        """Return the columns of rows, or None if they cannot be read and that has been reported already."""
        if self._columns is not None and self._datum == "good":
            return self._columns
        self.rows_refused += 1
        if self._reported:
            return None
        self._reported = True
        if self._columns is None:
            raise self._error("columns", "a header line naming them before the first solution")
        expected = "a header line (lat/lon/height=WGS84/ellipsoidal,…) before the first solution"
        raise self._error("height(m)", expected)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Row:
    source_name: str
    line_number: int
    columns: _PosColumns
    fields: Sequence[bytes]

    def solution(self) -> ReceiverSolution:
        if len(self.fields) != self.columns.field_count:
            expected = f"{self.columns.field_count} fields, as the header names"
            raise self.error("columns", expected, f"{len(self.fields)} fields")
        quality = SolutionQuality(self.integer("Q", min(SolutionQuality), max(SolutionQuality)))
        has_velocity = _VELOCITIES[0] in self.columns.indices
        return ReceiverSolution(
            time_ns=self.time_ns(),
            latitude_rad=math.radians(self.number("latitude(deg)")),
            longitude_rad=math.radians(self.number("longitude(deg)")),
            height_m=self.number("height(m)"),
            quality=quality,
            satellites=self.integer("ns", 0, 255),
            covariance_enu_m2=self.covariance(_DEVIATIONS, _POSITION_ROUNDING_M),
            age_s=self.age_s(quality),
            ratio=self.ratio(),
            velocity_enu_m_s=self.velocity_enu_m_s() if has_velocity else None,
            velocity_covariance_enu_m2_s2=(
                self.covariance(_VELOCITY_DEVIATIONS, _VELOCITY_ROUNDING_M_S) if has_velocity else None
            ),
        )

    def error(self, field: str, expected: str, actual: str | bytes) -> FormatError:
        return FormatError(self.source_name, field, expected, actual=actual, line_number=self.line_number)

    def time_ns(self) -> int:
        first, second = (field.decode("latin-1") for field in self.fields[:2])
        try:
            if "/" in first:
                calendar = calendar_from_text(f"{first} {second}")
                time_ns = gps_ns_from_utc(calendar) if self.columns.utc else gps_ns_from_gpst(calendar)
            elif first.isascii() and first.isdigit() and len(first) <= 4:
                time_ns = gps_ns_from_week_tow(int(first), nanoseconds_from_decimal(second))
            else:
                raise ValueError(first)
            if time_ns > LATEST_NS:
                raise ValueError(time_ns)
        except ValueError:
            expected = "yyyy/mm/dd hh:mm:ss.sss or GPS week and seconds of week, from 1980 to 2079"
            raise self.error("time", expected, f"{first} {second}") from None
        if self.columns.utc and "/" not in first:
            raise self.error("time", "a date and time of day where the header says UTC", f"{first} {second}")
        return time_ns

    def number(self, name: str) -> float:
        lowest, highest = _BOUNDS[name]
        text = self.fields[self.columns.indices[name]]
        try:
            value = float(text) if b"_" not in text else math.nan
        except ValueError:
            value = math.nan
        if not lowest <= value <= highest:
            raise self.error(name, f"a number from {lowest:g} to {highest:g}", text)
        return value

    def integer(self, name: str, lowest: int, highest: int) -> int:
        text = self.fields[self.columns.indices[name]]
        if not (text.isdigit() and len(text) <= 9 and lowest <= int(text) <= highest):
            raise self.error(name, f"a whole number from {lowest} to {highest}", text)
        return int(text)

    def ratio(self) -> float | None:
        """Return the ratio; RTKLIB prints zero without ambiguity search, a computed one is 1 or more."""
        if "ratio" not in self.columns.indices:
            return None
        ratio = self.number("ratio")
        if math.isinf(ratio):
            raise self.error("ratio", "a finite number", "inf")
        return ratio if ratio > 0.0 else None

    def age_s(self, quality: SolutionQuality) -> float | None:
        """Return the age; zero is real (a base epoch of the same second) unless no corrections were used at all."""
        if "age(s)" not in self.columns.indices:
            return None
        age_s = self.number("age(s)")
        return None if quality is SolutionQuality.SINGLE and age_s == 0.0 else age_s

    def velocity_enu_m_s(self) -> tuple[float, float, float]:
        north, east, up = map(self.number, _VELOCITIES)
        return east, north, up

    def covariance(self, names: tuple[str, ...], rounding: float) -> EnuCovariance | None:
        if names[0] not in self.columns.indices:
            return None
        n, e, u, ne, eu, un = map(self.number, names)
        try:
            return covariance_from_printed((e, n, u), (ne, eu, un), rounding)
        except ValueError:
            actual = b" ".join(self.fields[self.columns.indices[name]] for name in names)
            expected = "standard deviations and cross terms of a positive semidefinite covariance"
            raise self.error(f"{names[0]} to {names[-1]}", expected, actual) from None


def format_pos_header(*, velocity: bool = False, ambiguities: bool = True) -> bytes:
    """Return the header lines for `format_pos_line`: GPST, decimal degrees, ellipsoidal heights."""
    columns = (
        f"%  {'GPST':<20} {'latitude(deg)':>14} {'longitude(deg)':>14} {'height(m)':>10} {'Q':>3} {'ns':>3} "
        + " ".join(f"{name:>8}" for name in _DEVIATIONS)
        + (f" {'age(s)':>6} {'ratio':>6}" if ambiguities else "")
    )
    if velocity:
        columns += " " + " ".join(f"{name:>10}" for name in _VELOCITIES)
        columns += " " + " ".join(f"{name:>8}" for name in _VELOCITY_DEVIATIONS)
    legend = "Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites"
    return f"% (lat/lon/height=WGS84/ellipsoidal,{legend})\n{columns}\n".encode("ascii")


def format_pos_line(solution: ReceiverSolution, *, velocity: bool = False, ambiguities: bool = True) -> bytes:
    """Return one line as RTKLIB prints it, with more decimals of the time where they are needed.

    The format has no "unknown": an unknown covariance, ratio, age or number of satellites is zero, as RTKLIB prints it
    (an unknown age is then read as zero unless the solution is single). With `velocity`, a solution without one raises
    ValueError, as do numbers that are not finite. Without `ambiguities` there are no columns of age and ratio: unknown.
    """
    values = [
        f"{math.degrees(solution.latitude_rad):14.9f}",
        f"{math.degrees(solution.longitude_rad):14.9f}",
        f"{solution.height_m:10.4f}",
        f"{solution.quality:3d}",
        f"{solution.satellites or 0:3d}",
        *_printed_covariance(solution.covariance_enu_m2, 4),
    ]
    if ambiguities:
        values += [f"{solution.age_s or 0.0:6.2f}", f"{solution.ratio or 0.0:6.1f}"]
    if velocity:
        if solution.velocity_enu_m_s is None:
            raise ValueError("solution has no velocity, expected one because velocity columns were asked for")
        east, north, up = solution.velocity_enu_m_s
        values += [f"{component:10.5f}" for component in (north, east, up)]
        values += _printed_covariance(solution.velocity_covariance_enu_m2_s2, 5)
    if any(text.strip() in ("nan", "inf", "-inf") for text in values):
        raise ValueError(f"solution has a number that is not finite: {solution}")
    time_text = text_from_calendar(gpst_from_gps_ns(solution.time_ns))
    return f"{time_text} {' '.join(values)}\n".encode("ascii")


def _printed_covariance(covariance: EnuCovariance | None, decimals: int) -> list[str]:
    """Return σn σe σu and the signed roots of ne, eu, un; known values are never printed as zero."""
    if covariance is None:
        return [f"{0.0:8.{decimals}f}"] * 6
    ee, en, eu, nn, nu, uu = covariance
    smallest = 10.0**-decimals
    deviations = [max(math.sqrt(variance), smallest) for variance in (nn, ee, uu)]
    return [f"{value:8.{decimals}f}" for value in (*deviations, *(signed_root(c) for c in (en, eu, nu)))]
