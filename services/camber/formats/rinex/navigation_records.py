"""Records of RINEX navigation files, lines of 80 columns, parsed to ephemerides and Klobuchar coefficients.

Source: IGS/RTCM, "RINEX", version 3.04 (2018), tables A6, A8, A12, A14, the same in version 4.02 (2024); its record of
the Klobuchar ionosphere. A number must fill its 19 columns, so that a truncated one is an error and not another value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from camber.formats.broadcast.ephemeris_fields import GNSS_TIME_SCALES, gps_ns_near
from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import GPS_MINUS_BDT_NS, Ephemeris
from camber.formats.rinex.observation_header import decimal_number
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK, CalendarTime, gps_ns_from_gpst

_WIDTH = 19  # D19.12
_UNKNOWN_TIME_S = 0.9999e9  # RINEX 3.04, table A6: transmission time not known
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
    ("transmission_s", "fit"),
)
ROWS: dict[str, tuple[tuple[str, ...], ...]] = {
    "G": _GPS_ROWS,
    "J": _GPS_ROWS,
    "E": (
        *_ORBIT_ROWS,
        (_RATE, "data_sources", "week", ""),
        ("accuracy_m", "health", "bgd_e5a_s", "bgd_e5b_s"),
        ("transmission_s",),
    ),
    "C": (
        *_ORBIT_ROWS,
        (_RATE, "", "week", ""),
        ("accuracy_m", "health", "tgd1_s", "tgd2_s"),
        ("transmission_s", "aodc"),
    ),
}
"""By system letter the lines after that of the clock; an empty name is a spare column."""
_OTHER = ("tgd_s", "iodc", "bgd_e5a_s", "bgd_e5b_s", "data_sources", "tgd1_s", "tgd2_s", "aodc")
_MAY_BE_BLANK = {*_OTHER, "accuracy_m", "transmission_s", "fit", "codes_on_l2", "l2_p_data"}
ORBIT = [n for row in (*_ORBIT_ROWS, (_RATE,)) for n in row if n not in ("iode", "toe_s")]
"""Of these, those that are numbers of `Ephemeris` with the same name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NavigationRecord:
    """Lines of one record, and the content of the RINEX 4 line before it, such as `> EPH G01 LNAV`."""

    first_line: int
    kind: str
    satellite: str
    message: str
    lines: list[str] = field(default_factory=list)


def parse_ephemeris(record: NavigationRecord) -> Ephemeris:
    """Parse a record of a GPS, QZSS, Galileo or BeiDou satellite. Raises ValueError with the problem."""
    system = record.satellite[0]
    rows = ROWS[system]
    if len(record.lines) != 1 + len(rows):
        raise ValueError(f"{len(record.lines)} lines, not {1 + len(rows)}")
    head = record.lines[0]
    if head[:3] != record.satellite:
        raise ValueError(f"satellite {head[:3]!r} in its first line")
    af0, af1, af2 = (_required(head, 23 + _WIDTH * k, name) for k, name in enumerate(("af0", "af1", "af2")))
    values: dict[str, float] = {}
    for names, line in zip(rows, record.lines[1:], strict=True):
        if line[:4].strip():
            raise ValueError(f"{line[:4]!r} at the begin of a line")
        for k, name in enumerate(names):
            if name in _MAY_BE_BLANK:
                if (value := _optional(line, 4 + _WIDTH * k, name)) is not None:
                    values[name] = value
            elif name:
                values[name] = _required(line, 4 + _WIDTH * k, name)
    offset_ns = GPS_MINUS_BDT_NS if system == "C" else 0
    toc_ns = gps_ns_from_gpst(_calendar(head)) + offset_ns
    toe_ns = _toe_ns(system, values["toe_s"], toc_ns - offset_ns, values["week"]) + offset_ns
    _check(values)
    number = _digits(record.satellite[1:3], "satellite")
    if number == 0:
        raise ValueError("satellite 0")
    other = {name: values[name] for name in _OTHER if name in values}
    if system in "GJ":
        other["fit_interval_h"] = _fit_interval_h(system, values.get("fit", 0.0))
    accuracy_m = values.get("accuracy_m", math.nan)
    transmission_s = values.get("transmission_s", _UNKNOWN_TIME_S)
    return Ephemeris(
        satellite=ord(system) * 256 + number,
        toe_ns=toe_ns,
        toc_ns=toc_ns,
        transmission_ns=_transmission_ns(system, transmission_s, toe_ns),
        iode=int(values["iode"]),
        clock=(af0, af1, af2),
        # −1 of Galileo: no accuracy prediction.
        accuracy_m=accuracy_m if accuracy_m >= 0.0 else math.nan,
        health=int(values["health"]),
        other=other,
        **{name: values[name] for name in ORBIT},
    )


def parse_ionosphere(record: NavigationRecord) -> IonosphereCoefficients:
    """Parse a RINEX 4 Klobuchar record: three numbers after the time, four, one and the region."""
    if len(record.lines) < 3:
        raise ValueError(f"{len(record.lines)} lines, not 3")
    first = [_required(record.lines[0], 23 + _WIDTH * k, "alpha") for k in range(3)]
    second = [_required(record.lines[1], 4 + _WIDTH * k, "alpha, beta") for k in range(4)]
    last = _required(record.lines[2], 4, "beta")
    alpha, beta = (first[0], first[1], first[2], second[0]), (second[1], second[2], second[3], last)
    return IonosphereCoefficients(system=record.satellite[0], alpha=alpha, beta=beta)


def _calendar(head: str) -> CalendarTime:
    columns = ((4, 8), (9, 11), (12, 14), (15, 17), (18, 20), (21, 23))
    return CalendarTime(*(_digits(head[a:b], "time") for a, b in columns))


def _toe_ns(system: str, toe_s: float, toc_ns: int, week: float) -> int:
    """Return toe in the system's time since 1980: nearest to the clock's reference time, which has a date.

    The week, which writers define differently (full or modulo 1024, of toe or of transmission, BeiDou's or GPS's), must
    be consistent with it.
    """
    if not 0.0 <= toe_s <= NS_PER_WEEK / NS_PER_SECOND:
        raise ValueError(f"toe {toe_s} s of the week")
    toe_ns = gps_ns_near("G", round(toe_s * NS_PER_SECOND), toc_ns)
    toe_week = toe_ns // NS_PER_WEEK
    first_beidou_week = GNSS_TIME_SCALES["C"].first_gps_week
    expected = (toe_week, toe_week - first_beidou_week) if system == "C" else (toe_week,)
    if not any(abs((week - w + 512.0) % 1024.0 - 512.0) <= 1.0 for w in expected):
        raise ValueError(f"week {week:.0f} with a date in week {toe_week}")
    return toe_ns


def _transmission_ns(system: str, transmission_s: float, toe_ns: int) -> int:
    """Return the time nearest to toe: not all writers count from the week of toe. Unknown: toe, its upper bound."""
    if not abs(transmission_s) < 2 * NS_PER_WEEK / NS_PER_SECOND:
        return toe_ns
    return gps_ns_near(system, round(transmission_s * NS_PER_SECOND), toe_ns)


def _fit_interval_h(system: str, value: float) -> float:
    """Return hours; for QZSS, and some writers for GPS, the value is the flag of more than the nominal two or four."""
    nominal = 2.0 if system == "J" else 4.0
    return {0.0: nominal, 1.0: 1.5 * nominal}.get(value, value)


def _check(values: Mapping[str, float]) -> None:
    for name in ("iode", "health"):
        if not (0.0 <= values[name] < 2.0**16 and values[name].is_integer()):
            raise ValueError(f"{name} {values[name]}")
    if not (0.0 <= values["eccentricity"] < 1.0 and values["sqrt_a"] > 0.0):
        raise ValueError(f"eccentricity {values['eccentricity']}, square root of a {values['sqrt_a']} √m")


def _required(line: str, start: int, name: str) -> float:
    value = _optional(line, start, name)
    if value is None:
        raise ValueError(f"{name} is blank")
    return value


def _optional(line: str, start: int, name: str) -> float | None:
    """Return the number in 19 columns; None for blanks."""
    text = line[start : start + _WIDTH]
    if not text.strip():
        return None
    value = decimal_number(text) if len(text) == _WIDTH else None
    if value is None:
        raise ValueError(f"{name} {text.strip()!r}")
    return value


def _digits(text: str, name: str) -> int:
    stripped = text.strip()
    if not (stripped.isascii() and stripped.isdigit()):
        raise ValueError(f"{name} {text!r}")
    return int(stripped)
