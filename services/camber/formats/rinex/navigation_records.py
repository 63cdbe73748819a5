"""Records of RINEX navigation files, lines of 80 columns, parsed to ephemerides and Klobuchar coefficients.

Source: IGS/RTCM, "RINEX", version 3.04 (2018), tables A6, A8, A10, A12, A14, the same in version 4.02 (2024); its
record of the Klobuchar ionosphere. A number must fill its 19 columns, so that a truncated one is an error and not
another value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from camber.formats.broadcast.ephemeris_fields import GNSS_TIME_SCALES, gps_ns_near
from camber.formats.broadcast.glonass_time import quarter_of_day
from camber.formats.broadcast.klobuchar_coefficients import IonosphereCoefficients
from camber.formats.observations import GLONASS_CHANNELS, GPS_MINUS_BDT_NS, Ephemeris, GlonassEphemeris
from camber.formats.rinex.observation_header import decimal_number
from camber.geodesy.gps_time import (
    NS_PER_DAY,
    NS_PER_SECOND,
    NS_PER_WEEK,
    CalendarTime,
    gps_minus_utc_s,
    gps_ns_from_gpst,
    gps_ns_from_utc,
)

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
_GLONASS_ROWS = (
    ("x_km", "vx_km_s", "ax_km_s2", "health"),
    ("y_km", "vy_km_s", "ay_km_s2", "channel"),
    ("z_km", "vz_km_s", "az_km_s2"),
)
_GLONASS_DELAY_COLUMN = (
    4 + _WIDTH
)  # of the line that 3.05 and 4 have in addition: status, delay, accuracy, health
_LARGEST_DELAY_S = (
    1e-7  # derived: Δτ_n has four bits of 0.93 ns; 0.999999999999e9 is "not known" (RINEX 4.02)
)


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


def parse_glonass_ephemeris(record: NavigationRecord) -> GlonassEphemeris:
    """Parse a record of a GLONASS satellite. Raises ValueError with the problem."""
    lines = record.lines
    if len(lines) not in (1 + len(_GLONASS_ROWS), 2 + len(_GLONASS_ROWS)):
        raise ValueError(f"{len(lines)} lines, not {1 + len(_GLONASS_ROWS)}")
    if lines[0][:3] != record.satellite:
        raise ValueError(f"satellite {lines[0][:3]!r} in its first line")
    clock_s, rate = (_required(lines[0], 23 + _WIDTH * k, name) for k, name in enumerate(("tau", "gamma")))
    values: dict[str, float] = {}
    for names, line in zip(_GLONASS_ROWS, lines[1:], strict=False):
        if line[:4].strip():
            raise ValueError(f"{line[:4]!r} at the begin of a line")
        values |= {name: _required(line, 4 + _WIDTH * k, name) for k, name in enumerate(names)}
    # Some writers count negative channels from 256 down, as RTKLIB (`rinex.c`) reads them.
    channel = values["channel"] - (256.0 if values["channel"] > 128.0 else 0.0)
    if channel not in GLONASS_CHANNELS:
        raise ValueError(f"frequency channel {channel}")
    if not (0.0 <= values["health"] < 2.0**16 and values["health"].is_integer()):
        raise ValueError(f"health {values['health']}")
    number = _digits(record.satellite[1:3], "satellite")
    if number == 0:
        raise ValueError("satellite 0")
    toe_ns = gps_ns_from_utc(_calendar(lines[0]))
    delay_s = _optional(lines[-1], _GLONASS_DELAY_COLUMN, "delay") if len(lines) > 4 else None
    return GlonassEphemeris(
        satellite=ord("R") * 256 + number,
        toe_ns=toe_ns,
        transmission_ns=_glonass_frame_ns(_optional(lines[0], 23 + 2 * _WIDTH, "frame time"), toe_ns),
        iode=quarter_of_day(toe_ns),
        channel=int(channel),
        position_m=_metres(values, "x_km", "y_km", "z_km"),
        velocity_m_s=_metres(values, "vx_km_s", "vy_km_s", "vz_km_s"),
        acceleration_m_s2=_metres(values, "ax_km_s2", "ay_km_s2", "az_km_s2"),
        clock=(clock_s, rate),
        health=int(values["health"]),
        group_delay_s=math.nan if delay_s is None or abs(delay_s) > _LARGEST_DELAY_S else delay_s,
    )


def _metres(values: Mapping[str, float], x: str, y: str, z: str) -> tuple[float, float, float]:
    return values[x] * 1e3, values[y] * 1e3, values[z] * 1e3


def _glonass_frame_ns(of_week_s: float | None, toe_ns: int) -> int:
    """Return the time nearest to t_b; RINEX 3 has seconds of UTC's week, RINEX 2 of its day. Unknown: t_b."""
    if of_week_s is None or not abs(of_week_s) < 2 * NS_PER_WEEK / NS_PER_SECOND:
        return toe_ns
    utc_ns = toe_ns - gps_minus_utc_s(toe_ns) * NS_PER_SECOND
    since_ns = (round(of_week_s * NS_PER_SECOND) - utc_ns + NS_PER_DAY // 2) % NS_PER_DAY - NS_PER_DAY // 2
    return toe_ns + since_ns


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
