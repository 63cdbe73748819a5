"""Headers of RINEX 2, 3 and 4 observation files, parsed line by line.

Source: IGS/RTCM, "RINEX, The Receiver Independent Exchange Format", versions 3.04 (2018) and 4.02 (2024), tables A1 and
A2; version 2.11 (2007), table A1. Phase shifts of the header are not applied: the phases of a file already contain them
(3.04, section 9.1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from camber.formats.errors import FormatError
from camber.formats.observations import CARRIER_OF_BAND_HZ, GPS_MINUS_BDT_NS
from camber.formats.rinex.version2_lines import Rinex2Lines, shared_phases, type_names
from camber.geodesy.gps_time import NS_PER_SECOND, UNIX_OF_GPS_EPOCH_NS, gps_ns_from_unix_ns

T = TypeVar("T")

SYSTEMS_SKIPPED = "SI"
"""SBAS, NavIC: their satellites are counted and skipped."""
MAX_HEADER_LINES = 20_000
"""Chosen: bounds the work for a file without END OF HEADER; real ones have below 1,000."""
_TIME_OFFSETS_NS = {"GPS": 0, "GAL": 0, "QZS": 0, "IRN": 0, "BDT": GPS_MINUS_BDT_NS}
_UTC = "GLO"  # RINEX 3.04, 4.1.2: the times of a file of GLONASS are UTC, not the system's of Moscow
_TIME_SYSTEMS = (*_TIME_OFFSETS_NS, _UTC)
_TIME_SYSTEM_OF_FILE = {"G": "GPS", "E": "GAL", "J": "QZS", "C": "BDT", "R": "GLO", "I": "IRN"}
_SCALES = (1, 10, 100, 1000)
_FIRST_WITH_SYSTEM_TYPES = 3.0  # RINEX 3.04, 8.1: before, one list for all systems
_BEIDOU_B1C_VERSION = 3.04  # RINEX 3.04, table 9: band 1 of BeiDou is B1C; in 3.02 it was B1I
_CODES_OF_VERSION_2 = {
    "G": {**dict.fromkeys(("C1", "L1", "D1", "S1"), "1C"), "P1": "1W", "C2": "2X", "P2": "2W"}
    | dict.fromkeys(("L2", "D2", "S2"), "2W"),
    "J": {**dict.fromkeys(("C1", "L1", "D1", "S1"), "1C"), **dict.fromkeys(("C2", "L2", "D2", "S2"), "2X")},
    "E": {kind + band: band + "X" for kind in "CLDS" for band in "15678"},
    "C": {kind + band: band + "X" for kind in "CLDS" for band in "267"},
    "R": {**dict.fromkeys(("C1", "L1", "D1", "S1"), "1C"), "P1": "1P", "C2": "2C"}
    | dict.fromkeys(("P2", "L2", "D2", "S2"), "2P"),
}
"""The signals of RINEX 2.11, 10.1.1: it does not name the tracking; as RTKLIB's `convcode` does (`rinex.c`)."""
_CODES_OF_VERSION_2["G"] |= {kind + "5": "5X" for kind in "CLDS"}
_CODES_OF_VERSION_2["J"] |= {kind + band: band + "X" for kind in "CLDS" for band in "56"}
_LABEL = slice(60, 80)
_LAST_VERSION_2 = 2.11  # 2.12 is an extension with other names of signals
_FIELDS = {
    *("MARKER NAME", "REC # / TYPE / VERS", "ANT # / TYPE", "APPROX POSITION XYZ", "ANTENNA: DELTA H/E/N"),
    *("INTERVAL", "LEAP SECONDS", "SIGNAL STRENGTH UNIT"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationType:
    """One column of a system's lines: the observable (`C`, `L`, `D`, `S`), its signal, and the divisor of the value.

    `kind` is empty where the column is not read: pseudo-observables such as channel numbers, unknown units.
    """

    name: str
    kind: str = ""
    signal: str = ""
    divisor: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationHeader:
    """The content of a header; None where a record is absent.

    `types` are the columns by system letter, none for a system that cannot be read. `signals` have RINEX 3.04's names
    (B1I is `2I`, in 3.02 `1I`). `delta_hen_m` is height, east, north of the antenna reference point from the marker.
    """

    version: float
    types: Mapping[str, tuple[ObservationType, ...]]
    marker: str | None = None
    receiver: str | None = None
    antenna: str | None = None
    position_ecef_m: tuple[float, float, float] | None = None
    delta_hen_m: tuple[float, float, float] | None = None
    interval_s: float | None = None
    leap_seconds: int | None = None
    time_system: str = "GPS"

    def gps_time_ns(self, time_ns: int) -> int:
        """Return the GPS time of a time of the file, ns since 1980-01-06 as if every day had 86,400 s."""
        if self.time_system == _UTC:
            return gps_ns_from_unix_ns(time_ns + UNIX_OF_GPS_EPOCH_NS)
        return time_ns + _TIME_OFFSETS_NS[self.time_system]

    @property
    def signals(self) -> dict[str, tuple[str, ...]]:
        """By system letter, each once, in the order of the columns."""
        return {
            system: tuple(dict.fromkeys(t.signal for t in types if t.kind))
            for system, types in self.types.items()
        }


@dataclass(slots=True)
class _SystemTypes:
    """The columns of a system read so far; `announced` is None where the number cannot be read."""

    announced: int | None
    names: list[str] = field(default_factory=list)


class HeaderParser:
    """Parses the lines of a header, and those of events inside the file; `header()` is their content.

    `line` raises FormatError where the file cannot be read at all: another format, version or time system. Lesser
    faults are appended to `problems`, and the fields they concern are unknown.
    """

    def __init__(self, source_name: str) -> None:
        self.problems: list[FormatError] = []
        self.ended = False
        self._source_name = source_name
        self._line_number = 0
        self._lines = 0
        self._version: float | None = None
        self._file_system = "M"
        self._values: dict[str, str] = {}
        self._types: dict[str, _SystemTypes] = {}
        self._scales: dict[tuple[str, str], int] = {}
        self._system = ""
        self._scaling: tuple[str, int, int] | None = None
        self._faults: dict[tuple[str, str | None], FormatError] = {}

    def line(self, line_number: int, line: bytes) -> None:
        """Parse one line without its newline. Raises FormatError where the file cannot be read."""
        self._line_number = line_number
        self._lines += 1
        text = line.decode("latin-1").rstrip("\r")
        label = text[_LABEL].strip()
        if self._version is None:
            self._first_line(text, label)
            return
        if self._lines > MAX_HEADER_LINES and not self.ended:
            raise self._error("header", f"END OF HEADER within {MAX_HEADER_LINES} lines")
        if label == "SYS / # / OBS TYPES":
            self._observation_types(text)
        elif label == "# / TYPES OF OBSERV" and self._version < _FIRST_WITH_SYSTEM_TYPES:
            self._types_of_all_systems(text)
        elif label == "WAVELENGTH FACT L1/2" and not {text[:6].strip(), text[6:12].strip()} <= {"", "0", "1"}:
            raise self._error(
                label, "1: phases with ambiguities of half cycles are not read", text[:12].strip()
            )
        elif label == "SYS / SCALE FACTOR":
            self._scale_factor(text)
        elif label == "TIME OF FIRST OBS":
            self._values[label] = text[48:51].strip()
        elif label == "END OF HEADER":
            self._end()
        elif label in _FIELDS:
            self._values[label] = text[:60]

    def header(self) -> ObservationHeader:
        """Return the content of the lines so far. New faults are appended to `problems`, once each."""
        assert self._version is not None
        values = self._values
        known_faults, self._faults = self._faults, {}
        position = self._vector("APPROX POSITION XYZ")
        interval_s = self._number("INTERVAL", lambda text: decimal_number(text[:10]), "seconds")
        header = ObservationHeader(
            version=self._version,
            types={system: self._columns(system) for system in self._types},
            marker=values.get("MARKER NAME", "").strip() or None,
            receiver=values.get("REC # / TYPE / VERS", "")[20:40].strip() or None,
            antenna=values.get("ANT # / TYPE", "")[20:40].strip() or None,
            # Zeros mean unknown.
            position_ecef_m=None if position == (0.0, 0.0, 0.0) else position,
            delta_hen_m=self._vector("ANTENNA: DELTA H/E/N"),
            interval_s=interval_s if interval_s is not None and interval_s > 0.0 else None,
            leap_seconds=self._number("LEAP SECONDS", leap_seconds_from_text, "a number"),
            time_system=self._time_system(),
        )
        self.problems += [error for fault, error in self._faults.items() if fault not in known_faults]
        return header

    def version_2_lines(self, line_number: int) -> Rinex2Lines | None:
        """Return what rearranges the lines after this header, from this number on; None but for RINEX 2."""
        assert self._version is not None
        if self._version >= _FIRST_WITH_SYSTEM_TYPES:
            return None
        system = self._file_system if self._file_system.strip() and self._file_system != "M" else "G"
        return Rinex2Lines(system, next(iter(self._types.values())).names, line_number)

    def _fault(self, field: str, expected: str, actual: str | None = None) -> None:
        self._faults[field, actual] = self._error(field, expected, actual)

    def _error(self, field: str, expected: str, actual: str | None = None) -> FormatError:
        line_number = self._line_number or None
        return FormatError(self._source_name, field, expected, actual=actual, line_number=line_number)

    def _first_line(self, text: str, label: str) -> None:
        if label.startswith("CRINEX"):
            raise self._error("format", "RINEX text, not its Hatanaka compression", text[:40].strip())
        self._version = rinex_version(text, "observation data (O)", self._error)
        self._file_system = text[40:41]

    def _end(self) -> None:
        if not self.ended and not set(self._types) & set(CARRIER_OF_BAND_HZ):
            assert self._version is not None
            if self._version < _FIRST_WITH_SYSTEM_TYPES:
                raise self._error("# / TYPES OF OBSERV", "this line")
            raise self._error("SYS / # / OBS TYPES", f"one of the systems {', '.join(CARRIER_OF_BAND_HZ)}")
        self._time_system()
        self.ended = True

    def _observation_types(self, text: str) -> None:
        system = text[:1]
        if system.strip():
            count = text[3:6].strip()
            self._types[system] = _SystemTypes(int(count) if _is_count(count) else None)
            self._system = system
        types = self._types.get(self._system)
        if types is None:
            self.problems.append(self._error("SYS / # / OBS TYPES", "a system letter in column 1", text))
            return
        names = [name for k in range(7, 59, 4) if (name := text[k : k + 3].strip())]
        if types.announced is None:
            types.names += names
            return
        left = max(types.announced - len(types.names), 0)
        types.names += names[:left]
        if len(names) > left:
            types.announced = None

    def _types_of_all_systems(self, text: str) -> None:
        """RINEX 2: the number, then nine types a line of six columns each."""
        if text[:6].strip():
            count = text[:6].strip()
            types = _SystemTypes(int(count) if _is_count(count) else None)
            self._types = dict.fromkeys(_CODES_OF_VERSION_2, types)
        types_of_all = next(iter(self._types.values()), None)
        if types_of_all is not None and len(types_of_all.names) <= (types_of_all.announced or 0):
            types_of_all.names += type_names(text)

    def _columns(self, system: str) -> tuple[ObservationType, ...]:
        """Return the columns; none where their number is not the announced one, as their positions are unknown then."""
        types = self._types[system]
        if system in SYSTEMS_SKIPPED:
            return ()
        assert self._version is not None
        version_2 = self._version < _FIRST_WITH_SYSTEM_TYPES
        label = "# / TYPES OF OBSERV" if version_2 else f"SYS / # / OBS TYPES of {system}"
        if types.announced != len(types.names) or system not in CARRIER_OF_BAND_HZ:
            self._fault(label, "as many types of a known system as announced")
            return ()
        columns: list[ObservationType] = []
        seen: set[str] = set()
        for name in types.names:
            column = self._column_of_version_2(system, name) if version_2 else self._column(system, name)
            if column.kind and column.kind + column.signal in seen:
                self._fault(label, "each type once", name)
                column = ObservationType(name=name)
            seen.add(column.kind + column.signal)
            columns.append(column)
        if version_2 and system in "GR":
            columns += _columns_of_shared_phases(types.names, system)
        return tuple(columns)

    def _column(self, system: str, name: str) -> ObservationType:
        if name[:1] in "XI":
            return ObservationType(name=name)
        known = len(name) == 3 and name[0] in "CLDS" and name[1] in "123456789" and name[2].isupper()
        signal = self._signal(system, name[1:])
        if not known or signal[0] not in CARRIER_OF_BAND_HZ[system]:
            self._fault(f"SYS / # / OBS TYPES of {system}", "C, L, D or S, band, attribute", name)
            return ObservationType(name=name)
        unit = self._values.get("SIGNAL STRENGTH UNIT", "DBHZ").strip()
        kind = "" if name[0] == "S" and unit != "DBHZ" else name[0]
        divisor = self._scales.get((system, name), self._scales.get((system, ""), 1))
        return ObservationType(name=name, kind=kind, signal=signal, divisor=divisor)

    def _column_of_version_2(self, system: str, name: str) -> ObservationType:
        if not (len(name) == 2 and name[0] in "CPLDST" and name[1] in "12345678"):
            self._fault("# / TYPES OF OBSERV", "C, P, L, D, S or T and a band", name)
        signal = _CODES_OF_VERSION_2[system].get(name, "")
        kind = "C" if name[:1] == "P" else name[:1]
        return ObservationType(name=name, kind=kind, signal=signal) if signal else ObservationType(name=name)

    def _signal(self, system: str, code: str) -> str:
        """Return the signal's name of 3.04, where band 1 of BeiDou is B1C, without 1I and 1Q; in 3.02 it was B1I."""
        assert self._version is not None
        old = self._version < _BEIDOU_B1C_VERSION and code in ("1I", "1Q", "1X")
        return "2" + code[1] if system == "C" and (old or code in ("1I", "1Q")) else code

    def _scale_factor(self, text: str) -> None:
        if text[:1].strip():
            factor, count = text[2:6].strip(), text[8:10].strip() or "0"
            if not _is_count(factor) or int(factor) not in _SCALES or not _is_count(count):
                self._scaling = None
                raise self._error("SYS / SCALE FACTOR", "1, 10, 100 or 1000 and a number of types", text[:10])
            self._scaling = (text[0], int(factor), int(count))
        if self._scaling is None:
            raise self._error("SYS / SCALE FACTOR", "a system letter in column 1", text[:10])
        system, divisor, count_of = self._scaling
        if count_of == 0:
            self._scales[system, ""] = divisor
        for k in range(11, 59, 4):
            if name := text[k : k + 3].strip():
                self._scales[system, name] = divisor

    def _time_system(self) -> str:
        default = _TIME_SYSTEM_OF_FILE.get(self._file_system, "GPS")
        time_system = self._values.get("TIME OF FIRST OBS") or default
        if time_system not in _TIME_SYSTEMS:
            raise self._error("time system", f"one of {', '.join(_TIME_SYSTEMS)}", time_system)
        return time_system

    def _vector(self, label: str) -> tuple[float, float, float] | None:
        text = self._values.get(label, "")
        a, b, c = (decimal_number(text[k : k + 14]) for k in (0, 14, 28))
        if a is not None and b is not None and c is not None:
            return a, b, c
        if text.strip():
            self._fault(label, "three numbers of 14 columns", text)
        return None

    def _number(self, label: str, number_of: Callable[[str], T | None], expected: str) -> T | None:
        text = self._values.get(label, "")
        number = number_of(text)
        if text.strip() and number is None:
            self._fault(label, expected, text)
        return number


def _columns_of_shared_phases(types: list[str], system: str) -> list[ObservationType]:
    return [
        ObservationType(name=types[k], kind=types[k][0], signal=shared.signals[system])
        for shared in shared_phases(types)
        for k in shared.columns
    ]


def rinex_version(text: str, file_type: str, error: Callable[[str, str, str], FormatError]) -> float:
    """Return the version in a file's first line; an error for another format, version or type such as `… data (O)`."""
    version = decimal_number(text[:9])
    if text[_LABEL].strip() != "RINEX VERSION / TYPE" or version is None:
        raise error("first line", "'RINEX VERSION / TYPE' in columns 61 to 80", text)
    if not (2.0 <= version <= _LAST_VERSION_2 or 3.0 <= version < 5.0):
        raise error("RINEX version", "2.0 to 2.11, 3 or 4", text[:9].strip())
    if text[20:21] != file_type[-2]:
        raise error("file type", file_type, text[20:40].strip())
    return version


def leap_seconds_from_text(text: str) -> int | None:
    """Return GPS time minus UTC from the first 60 columns of `LEAP SECONDS`; BeiDou's are counted since 2006."""
    seconds = text[:6].strip()
    if not _is_count(seconds):
        return None
    return int(seconds) + (GPS_MINUS_BDT_NS // NS_PER_SECOND if text[24:27] == "BDS" else 0)


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 6


def decimal_number(text: str) -> float | None:
    """Return a decimal number with exponent E or D; None for anything else, and for non-finite numbers."""
    if "_" in text or not text.isascii():
        return None
    try:
        value = float(text.upper().replace("D", "E"))
    except ValueError:
        return None
    return value if math.isfinite(value) else None
