"""Broadcast ephemerides as the integers that each system transmits, in RTCM messages and in subframes alike.

Sources of widths and scale factors: IS-GPS-200, tables 20-I to 20-III (QZSS the same: IS-QZSS-PNT, 5.4); Galileo OS SIS
ICD, tables 60 to 69; BDS-SIS-ICD-B1I, tables 5-6 to 5-11.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from camber.formats.broadcast.bit_fields import BitField, quantize
from camber.formats.observations import GPS_MINUS_BDT_NS, MAX_SATELLITE_NUMBER, Ephemeris, satellite_name
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssTimeScale:
    """A system's week count: its first week in GPS weeks, GPS time minus system time, number of weeks to roll-over."""

    first_gps_week: int
    gps_offset_ns: int
    weeks: int


# IS-GPS-200, 20.3.3.3.1.1; Galileo OS SIS ICD, 5.1.2 (1999-08-22); BDS-SIS-ICD-B1I, 3.2 (2006-01-01) and 5.2.4.4.
GNSS_TIME_SCALES = {
    "G": GnssTimeScale(first_gps_week=0, gps_offset_ns=0, weeks=1024),
    "J": GnssTimeScale(first_gps_week=0, gps_offset_ns=0, weeks=1024),
    "E": GnssTimeScale(first_gps_week=1024, gps_offset_ns=0, weeks=4096),
    "C": GnssTimeScale(first_gps_week=1356, gps_offset_ns=GPS_MINUS_BDT_NS, weeks=8192),
}


def _unsigned(**widths: int) -> dict[str, BitField]:
    return {name: BitField(width) for name, width in widths.items()}


def _signed(**fields: tuple[int, float]) -> dict[str, BitField]:
    return {name: BitField(width, resolution, signed=True) for name, (width, resolution) in fields.items()}


_CYCLIC = BitField(32, math.pi * 2.0**-31, signed=True, cyclic=True)
_ORBIT = {
    "sqrt_a": BitField(32, 2.0**-19),
    "eccentricity": BitField(32, 2.0**-33),
    **dict.fromkeys(("ascending_node_rad", "perigee_rad", "mean_anomaly_rad"), _CYCLIC),
    **_signed(
        inclination_rad=(32, math.pi * 2.0**-31),
        inclination_rate_rad_s=(14, math.pi * 2.0**-43),
        ascending_node_rate_rad_s=(24, math.pi * 2.0**-43),
        mean_motion_difference_rad_s=(16, math.pi * 2.0**-43),
    ),
}


def _harmonics(width: int, angle: float, length_m: float) -> dict[str, BitField]:
    angles = dict.fromkeys(("cuc", "cus", "cic", "cis"), BitField(width, angle, signed=True))
    return angles | dict.fromkeys(("crc_m", "crs_m"), BitField(width, length_m, signed=True))


def _times(width: int, resolution_s: float) -> dict[str, BitField]:
    return dict.fromkeys(("toe_s", "toc_s"), BitField(width, resolution_s))


_GPS = {
    **_ORBIT,
    **_harmonics(16, 2.0**-29, 2.0**-5),
    **_times(16, 16.0),
    **_signed(af0_s=(22, 2.0**-31), af1=(16, 2.0**-43), af2=(8, 2.0**-55), tgd_s=(8, 2.0**-31)),
    **_unsigned(
        satellite=6, week=10, iode=8, iodc=10, accuracy=4, health=6, fit=1, codes_on_l2=2, l2_p_data=1
    ),
}
FIELDS: dict[str, dict[str, BitField]] = {
    "G": _GPS,
    "J": {**_GPS, "satellite": BitField(4)},
    "E": {
        **_ORBIT,
        **_harmonics(16, 2.0**-29, 2.0**-5),
        **_times(14, 60.0),
        **_signed(af0_s=(31, 2.0**-34), af1=(21, 2.0**-46), af2=(6, 2.0**-59)),
        **_signed(bgd_e5a_s=(10, 2.0**-32), bgd_e5b_s=(10, 2.0**-32)),
        **_unsigned(satellite=6, week=12, iode=10, accuracy=8),
        **_unsigned(e1b_invalid=1, e1b_health=2, e5a_invalid=1, e5a_health=2, e5b_invalid=1, e5b_health=2),
    },
    "C": {
        **_ORBIT,
        **_harmonics(18, 2.0**-31, 2.0**-6),
        **_times(17, 8.0),
        **_signed(af0_s=(24, 2.0**-33), af1=(22, 2.0**-50), af2=(11, 2.0**-66)),
        **_signed(tgd1_s=(10, 1e-10), tgd2_s=(10, 1e-10)),
        **_unsigned(satellite=6, week=13, iode=5, aodc=5, accuracy=4, health=1),
    },
}
_SYSTEM_SPECIFIC = ("iodc", "aodc", "tgd_s", "bgd_e5a_s", "bgd_e5b_s", "tgd1_s", "tgd2_s")
# Galileo's health word of RINEX 3.04 (table A8), from its lowest bit on.
_GALILEO_HEALTH = ("e1b_invalid", "e1b_health", "e5a_invalid", "e5a_health", "e5b_invalid", "e5b_health")
# IS-GPS-200, 20.3.3.4.3.1; IS-QZSS-PNT, 4.1: a set flag means more than this many hours.
_NOMINAL_FIT_H = {"G": 4.0, "J": 2.0}
# IS-GPS-200 20.3.3.3.1.3: the greatest URA of each index; index 15 is "no prediction". BeiDou's are the same.
_URA_M = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24.0, 48.0, 96.0, 192.0, 384.0, 768.0, 1536.0, 3072.0, 6144.0)
# The same section, nominal values for users: 2^(1 + N/2), rounded, up to index 6, then 2^(N − 2).
_NOMINAL_URA_M = (2.0, 2.8, 4.0, 5.7, 8.0, 11.3, 16.0, *(2.0 ** (n - 2) for n in range(7, 15)))
# Galileo OS SIS ICD, table 76: the SISA of each index up to 125; 255 is "no accuracy prediction available".
_SISA_M = (
    *(0.01 * n for n in range(50)),
    *(0.50 + 0.02 * n for n in range(25)),
    *(1.00 + 0.04 * n for n in range(25)),
    *(2.00 + 0.16 * n for n in range(26)),
)
_NO_SISA = 255  # same table
# √m; derivation: √ of the Earth's radius is 2526, so an orbit below is impossible (satellites that send zeros).
_MIN_SQRT_A = 2600.0


def system_week(system: str, time_ns: int) -> tuple[int, int]:
    """Return the system's full week number and the time of week [ns] of a GPS time."""
    scale = GNSS_TIME_SCALES[system]
    week, of_week_ns = divmod(time_ns - scale.gps_offset_ns, NS_PER_WEEK)
    return week - scale.first_gps_week, of_week_ns


def gps_ns_near(system: str, of_week_ns: int, near_ns: int) -> int:
    """Return the GPS time nearest to `near_ns` with this time of week of the system."""
    difference_ns = of_week_ns - system_week(system, near_ns)[1]
    return near_ns + (difference_ns + NS_PER_WEEK // 2) % NS_PER_WEEK - NS_PER_WEEK // 2


def integers_from_ephemeris(ephemeris: Ephemeris) -> dict[str, int]:
    """Return each field of `FIELDS` of the satellite's system as the integer that is transmitted.

    `week` is that of the ephemeris' reference time, modulo the field's range. Accuracies become the lowest index that
    does not claim a better accuracy. Without a `fit_interval_h` it is nominal; the code on L2 is always P.

    Raises ValueError where a value does not fit its field, a reference time is no multiple of its resolution, or a
    field that the system requires is missing in `other`.
    """
    name = satellite_name(ephemeris.satellite)
    system, number = name[0], ephemeris.satellite & 255
    fields = FIELDS.get(system)
    if fields is None or not 1 <= number <= MAX_SATELLITE_NUMBER[system]:
        raise ValueError(f"satellite {name}: no broadcast ephemeris of this number, expected G, J, E or C")
    values: dict[str, float] = {
        "satellite": number,
        "week": system_week(system, ephemeris.toe_ns)[0] % GNSS_TIME_SCALES[system].weeks,
        "af0_s": ephemeris.clock[0],
        "af1": ephemeris.clock[1],
        "af2": ephemeris.clock[2],
        **{attribute: float(getattr(ephemeris, attribute)) for attribute in _attributes(fields)},
        **_health_fields(system, name, ephemeris.health),
        "codes_on_l2": 1,
        "l2_p_data": 0,
        "accuracy": _accuracy_index(system, ephemeris.accuracy_m),
    }
    for time, time_ns in (("toe_s", ephemeris.toe_ns), ("toc_s", ephemeris.toc_ns)):
        of_week_ns = system_week(system, time_ns)[1]
        if of_week_ns % int(fields[time].resolution * NS_PER_SECOND):
            raise ValueError(
                f"{name}: {time} is {of_week_ns / NS_PER_SECOND} s of the week,"
                f" expected a multiple of {fields[time].resolution:.0f} s"
            )
        values[time] = of_week_ns / NS_PER_SECOND
    if "fit" in fields:
        nominal_h = _NOMINAL_FIT_H[system]
        values["fit"] = float(ephemeris.other.get("fit_interval_h", nominal_h) > nominal_h)
    for field in _SYSTEM_SPECIFIC:
        if field in fields:
            if field not in ephemeris.other:
                raise ValueError(f"{name}: the ephemeris has no {field}")
            values[field] = ephemeris.other[field]
    return {field: _integer(f"{name} {field}", values[field], fields[field]) for field in fields}


def ephemeris_from_integers(system: str, integers: Mapping[str, int], near_ns: int) -> Ephemeris:
    """Return the ephemeris of these integers, its weeks being those nearest to `near_ns` (GPS time).

    `transmission_ns` is `near_ns`, as the integers do not contain it. A missing field of the orbit is NaN, another one
    is absent from `other`.
    """
    fields = FIELDS[system]
    values = {name: integers[name] * fields[name].resolution for name in fields if name in integers}
    other: dict[str, float] = {name: values[name] for name in _SYSTEM_SPECIFIC if name in values}
    if "fit" in values:
        other["fit_interval_h"] = _NOMINAL_FIT_H[system] * (1.0 if values["fit"] == 0 else 1.5)
    health, shift = 0, 0
    for name in _GALILEO_HEALTH if system == "E" else ("health",):
        health |= integers.get(name, 0) << shift
        shift += fields[name].width
    return Ephemeris(
        satellite=ord(system) * 256 + integers["satellite"],
        toe_ns=gps_ns_near(system, int(values["toe_s"]) * NS_PER_SECOND, near_ns),
        toc_ns=gps_ns_near(system, int(values["toc_s"]) * NS_PER_SECOND, near_ns),
        transmission_ns=near_ns,
        iode=integers["iode"],
        clock=(values["af0_s"], values["af1"], values["af2"]),
        accuracy_m=_accuracy_m(system, integers["accuracy"]),
        health=health,
        other=other,
        **{name: values.get(name, math.nan) for name in _attributes(fields) if name != "iode"},
    )


def plausible_ephemeris(system: str, integers: Mapping[str, int], near_ns: int) -> Ephemeris:
    """Return `ephemeris_from_integers`; ValueError for times after the end of the week, and orbits inside the Earth."""
    fields = FIELDS[system]
    for time in ("toe_s", "toc_s"):
        if integers[time] * fields[time].resolution * NS_PER_SECOND >= NS_PER_WEEK:
            raise ValueError(f"{time} is after the end of the week")
    ephemeris = ephemeris_from_integers(system, integers, near_ns)
    if ephemeris.sqrt_a < _MIN_SQRT_A:
        raise ValueError(f"square root of the semi-major axis is {ephemeris.sqrt_a}")
    return ephemeris


def _attributes(fields: Mapping[str, BitField]) -> list[str]:
    """Return the fields that are attributes of `Ephemeris` with the same meaning."""
    return [name for name in fields if name in Ephemeris.__slots__ and name not in ("satellite", "health")]


def _integer(name: str, value: float, field: BitField) -> int:
    if field.cyclic and math.isfinite(value):
        # Whole turns are dropped; just below +π may round to +π, which is −π.
        turns = round(value / field.resolution) & (1 << field.width) - 1
        return turns - (1 << field.width) if turns >> (field.width - 1) else turns
    return quantize(name, value, field.resolution, field.width, signed=field.signed)


def _health_fields(system: str, name: str, health: int) -> dict[str, float]:
    if system != "E":
        return {"health": health}
    if not 0 <= health < 512:
        raise ValueError(f"{name}: health is {health}, expected 0 to 511")
    values, shift = dict[str, float](), 0
    for field in _GALILEO_HEALTH:
        width = FIELDS["E"][field].width
        values[field] = health >> shift & (1 << width) - 1
        shift += width
    return values


def _accuracy_index(system: str, accuracy_m: float) -> int:
    limits_m, unknown = (_SISA_M, _NO_SISA) if system == "E" else (_URA_M, len(_URA_M))
    if not accuracy_m >= 0.0:  # NaN, and −1, RINEX's "no accuracy prediction"
        return unknown
    return next((index for index, limit_m in enumerate(limits_m) if accuracy_m <= limit_m + 1e-9), unknown)


def _accuracy_m(system: str, index: int) -> float:
    accuracies_m = _SISA_M if system == "E" else _NOMINAL_URA_M
    return accuracies_m[index] if index < len(accuracies_m) else math.nan
