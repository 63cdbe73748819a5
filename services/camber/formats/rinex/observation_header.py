"""Headers of RINEX 3 and 4 observation files, line by line.

Source: IGS/RTCM, "RINEX, The Receiver Independent Exchange Format", versions 3.04 (2018) and 4.02 (2024), tables A1 and
A2. Phase shifts of the header are not applied: the phases of a file are already shifted by them (3.04, section 9.1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from camber.formats.errors import FormatError
from camber.formats.observations import CARRIER_OF_BAND_HZ

SYSTEMS_SKIPPED = "RSI"
"""GLONASS, SBAS, NavIC: their satellites are counted and left out."""
_TIME_OFFSETS_NS = {"GPS": 0, "GAL": 0, "QZS": 0, "IRN": 0, "BDT": 14_000_000_000}
_TIME_SYSTEM_OF_FILE = {"G": "GPS", "E": "GAL", "J": "QZS", "C": "BDT", "R": "GLO", "I": "IRN"}
_SCALES = (1, 10, 100, 1000)
_MOST_LINES = 20_000
_OLD_BEIDOU_VERSION = 3.04
_LABEL = slice(60, 80)


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationType:
    """One column of a system's lines: what is observed (`C`, `L`, `D`, `S`), of which signal, and the value's divisor.

    `kind` is empty where the column is not read: pseudo-observables such as channel numbers, units that are not known.
    """

    name: str
    kind: str
    signal: str
    divisor: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationHeader:
    """What the header says; None where it says nothing.

    `types` are the columns by system letter, a system that cannot be read has none. `signals` have RINEX 3.04's names
    (B1I is `2I`, which 3.02 called `1I`). The antenna's `delta_hen_m` is height, east, north of its reference point
    from the marker. `time_offset_ns` is to be added to the file's times to have GPS time.
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

    @property
    def time_offset_ns(self) -> int:
        """GPS time less the file's."""
        return _TIME_OFFSETS_NS[self.time_system]

    @property
    def signals(self) -> dict[str, tuple[str, ...]]:
        """By system letter, each once, in the order of the columns."""
        return {
            system: tuple(dict.fromkeys(t.signal for t in types if t.kind))
            for system, types in self.types.items()
        }


@dataclass(slots=True)
class _SystemTypes:
    """The columns of a system as far as they were read; `announced` is None where the number cannot be read."""

    announced: int | None
    names: list[str] = field(default_factory=list)


class HeaderReader:
    """Takes the lines of a header, and those that events inside the file bring; `header()` is what they say.

    `line` raises FormatError where the file cannot be read at all: another format, version or time system. Lesser
    faults are added to `problems`, and what they concern stays unknown.
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
        """One line without its newline. Raises FormatError where the file cannot be read."""
        self._line_number = line_number
        self._lines += 1
        text = line.decode("latin-1").rstrip("\r")
        label = text[_LABEL].strip()
        if self._version is None:
            self._first(text, label)
            return
        if self._lines > _MOST_LINES and not self.ended:
            raise self._error("header", f"END OF HEADER within {_MOST_LINES} lines")
        if label == "SYS / # / OBS TYPES":
            self._observation_types(text)
        elif label == "SYS / SCALE FACTOR":
            self._scale_factor(text)
        elif label == "TIME OF FIRST OBS":
            self._time_system(text)
        elif label == "END OF HEADER":
            self._end()
        elif label in _FIELDS:
            self._values[label] = text[:60]

    def header(self) -> ObservationHeader:
        """What the lines so far say. What of it cannot be read is added to `problems`, but not at each call anew."""
        assert self._version is not None
        values = self._values
        before, self._faults = self._faults, {}
        header = ObservationHeader(
            version=self._version,
            types={system: self._columns(system) for system in self._types},
            marker=_text(values.get("MARKER NAME", "")),
            receiver=_text(values.get("REC # / TYPE / VERS", "")[20:40]),
            antenna=_text(values.get("ANT # / TYPE", "")[20:40]),
            position_ecef_m=self._position(),
            delta_hen_m=self._three("ANTENNA: DELTA H/E/N"),
            interval_s=self._interval(),
            leap_seconds=self._leap_seconds(),
            time_system=self._system_of_times(),
        )
        self.problems += [error for fault, error in self._faults.items() if fault not in before]
        return header

    def _fault(self, what: str, expected: str, found: str | None = None) -> None:
        self._faults[what, found] = self._error(what, expected, found)

    def _error(self, what: str, expected: str, found: str | None = None) -> FormatError:
        return FormatError(
            self._source_name, what, expected, actual=found, line_number=self._line_number or None
        )

    def _first(self, text: str, label: str) -> None:
        if label.startswith("CRINEX"):
            raise self._error("format", "RINEX text, not its Hatanaka compression", text[:40].strip())
        version = decimal_number(text[:9])
        if label != "RINEX VERSION / TYPE" or version is None:
            raise self._error("first line", "'RINEX VERSION / TYPE' in columns 61 to 80", text)
        if not 3.0 <= version < 5.0:
            raise self._error("RINEX version", "3 or 4", text[:9].strip())
        if text[20:21] != "O":
            raise self._error("file type", "observation data (O)", text[20:40].strip())
        self._version = version
        self._file_system = text[40:41]

    def _end(self) -> None:
        if not self.ended and not set(self._types) & set(CARRIER_OF_BAND_HZ):
            raise self._error("SYS / # / OBS TYPES", f"one of the systems {', '.join(CARRIER_OF_BAND_HZ)}")
        self._system_of_times()
        self.ended = True

    def _observation_types(self, text: str) -> None:
        system = text[:1]
        if system.strip():
            count = text[3:6].strip()
            self._types[system] = _SystemTypes(int(count) if _is_count(count) else None)
            self._system = system
        names = [text[k : k + 3] for k in range(7, 59, 4)]
        of_system = self._types.get(self._system)
        if of_system is None:
            self.problems.append(self._error("SYS / # / OBS TYPES", "a system letter in column 1", text))
            return
        left = None if of_system.announced is None else of_system.announced - len(of_system.names)
        given = [n.strip() for n in names if n.strip()]
        of_system.names += given if left is None else given[: max(left, 0)]
        if left is not None and len(given) > max(left, 0):
            of_system.announced = None

    def _columns(self, system: str) -> tuple[ObservationType, ...]:
        """Empty where the number of types is not the one announced: nobody knows then which column is which."""
        of_system = self._types[system]
        if system in SYSTEMS_SKIPPED:
            return ()
        if of_system.announced != len(of_system.names) or system not in CARRIER_OF_BAND_HZ:
            self._fault(f"SYS / # / OBS TYPES of {system}", "as many types of a known system as announced")
            return ()
        columns: list[ObservationType] = []
        seen: set[str] = set()
        for name in of_system.names:
            column = self._column(system, name)
            if column.kind and column.kind + column.signal in seen:
                self._fault(f"SYS / # / OBS TYPES of {system}", "each type once", name)
                column = ObservationType(name=name, kind="", signal="")
            seen.add(column.kind + column.signal)
            columns.append(column)
        return tuple(columns)

    def _column(self, system: str, name: str) -> ObservationType:
        if name[:1] in "XI":
            return ObservationType(name=name, kind="", signal="")
        known = len(name) == 3 and name[0] in "CLDS" and name[1] in "123456789" and name[2].isupper()
        signal = self._signal(system, name[1:])
        if not known or signal[0] not in CARRIER_OF_BAND_HZ[system]:
            self._fault(f"SYS / # / OBS TYPES of {system}", "C, L, D or S, band, attribute", name)
            return ObservationType(name=name, kind="", signal="")
        unit = self._values.get("SIGNAL STRENGTH UNIT", "DBHZ").strip()
        kind = "" if name[0] == "S" and unit != "DBHZ" else name[0]
        divisor = self._scales.get((system, name), self._scales.get((system, ""), 1))
        return ObservationType(name=name, kind=kind, signal=signal, divisor=divisor)

    def _signal(self, system: str, code: str) -> str:
        """B1 was band 1 in RINEX 3.02; since 3.04 band 1 is B1C, of which there is no 1I and 1Q."""
        assert self._version is not None
        old = self._version < _OLD_BEIDOU_VERSION and code in ("1I", "1Q", "1X")
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

    def _time_system(self, text: str) -> None:
        self._values["TIME OF FIRST OBS"] = text[48:51].strip()

    def _system_of_times(self) -> str:
        said = self._values.get("TIME OF FIRST OBS") or _TIME_SYSTEM_OF_FILE.get(self._file_system, "GPS")
        if said not in _TIME_OFFSETS_NS:
            raise self._error("time system", f"one of {', '.join(_TIME_OFFSETS_NS)}", said)
        return said

    def _position(self) -> tuple[float, float, float] | None:
        """Zeros stand for a position that is not known."""
        position = self._three("APPROX POSITION XYZ")
        return None if position == (0.0, 0.0, 0.0) else position

    def _three(self, label: str) -> tuple[float, float, float] | None:
        text = self._values.get(label)
        if text is None or not text.strip():
            return None
        a, b, c = (decimal_number(text[k : k + 14]) for k in (0, 14, 28))
        if a is None or b is None or c is None:
            self._fault(label, "three numbers of 14 columns", text)
            return None
        return a, b, c

    def _interval(self) -> float | None:
        text = self._values.get("INTERVAL", "")[:10]
        value = decimal_number(text)
        if text.strip() and value is None:
            self._fault("INTERVAL", "seconds", text)
        return value if value is not None and value > 0.0 else None

    def _leap_seconds(self) -> int | None:
        text = self._values.get("LEAP SECONDS", "")
        seconds = leap_seconds_from_text(text)
        if text.strip() and seconds is None:
            self._fault("LEAP SECONDS", "a number", text)
        return seconds


def leap_seconds_from_text(text: str) -> int | None:
    """GPS time less UTC, of the first 60 columns of `LEAP SECONDS`; BeiDou's are counted since 2006."""
    seconds = text[:6].strip()
    if not _is_count(seconds):
        return None
    return int(seconds) + (14 if text[24:27] == "BDS" else 0)


_FIELDS = {
    "MARKER NAME",
    "REC # / TYPE / VERS",
    "ANT # / TYPE",
    "APPROX POSITION XYZ",
    "ANTENNA: DELTA H/E/N",
    "INTERVAL",
    "LEAP SECONDS",
    "SIGNAL STRENGTH UNIT",
}


def _text(text: str) -> str | None:
    return text.strip() or None


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 6


def decimal_number(text: str) -> float | None:
    """A decimal number, its exponent after E or D; None for anything else, and for what is not finite."""
    if "_" in text or not text.isascii():
        return None
    try:
        value = float(text.upper().replace("D", "E"))
    except ValueError:
        return None
    return value if math.isfinite(value) else None
