"""Decoded navigation messages: GPSNav, QZSNav, GALNav, BDSNav, GLONav, GPSIon.

Source: Septentrio mosaic-X5 reference guide, blocks of decoded messages. They contain what the satellites transmit,
scaled, angles in semicircles: it is turned back to the transmitted integers, which single precision holds exactly.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace

from camber.formats.broadcast.bit_fields import BitField, quantize
from camber.formats.broadcast.ephemeris_fields import FIELDS, gps_ns_near, plausible_ephemeris
from camber.formats.broadcast.glonass_time import quarter_of_day
from camber.formats.broadcast.klobuchar_coefficients import (
    IONOSPHERE_FIELDS,
    IonosphereCoefficients,
    coefficients_from_integers,
)
from camber.formats.observations import (
    GLONASS_CHANNELS,
    BroadcastEphemeris,
    Ephemeris,
    GlonassEphemeris,
)
from camber.formats.sbf.block_time import TIME_STAMP
from camber.formats.sbf.signal_numbers import satellite_of_svid
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK

# Names of `FIELDS` in the blocks' order; other names belong to this module.
_ORBIT_NAMES = (
    *("crs_m", "mean_motion_difference_rad_s", "mean_anomaly_rad", "cuc", "eccentricity", "cus", "sqrt_a"),
    *("toe_s", "cic", "ascending_node_rad", "cis", "inclination_rad", "crc_m", "perigee_rad"),
    *("ascending_node_rate_rad_s", "inclination_rate_rad_s"),
)
_ORBIT_FORM = "2fdfdfdIfdfdfdff"
_GPS = struct.Struct(f"<BxHBBBBHBBBxfI3f{_ORBIT_FORM}")
_GPS_NAMES = (
    *("svid", "week", "codes_on_l2", "accuracy", "health", "l2_p_data", "iodc", "iode", "iode_of_3", "fit"),
    *("tgd_s", "toc_s", "af2", "af1", "af0_s", *_ORBIT_NAMES),
)
_BEIDOU = struct.Struct(f"<BxHBBBB2xffI3f{_ORBIT_FORM}")
_BEIDOU_NAMES = (
    *(
        "svid",
        "week",
        "accuracy",
        "health",
        "aodc",
        "iode",
        "tgd1_s",
        "tgd2_s",
        "toc_s",
        "af2",
        "af1",
        "af0_s",
    ),
    *_ORBIT_NAMES,
)
_GALILEO = struct.Struct("<BB6d9fII2fdHHHHBBBx2f")
_GALILEO_NAMES = (
    *("svid", "source", "sqrt_a", "mean_anomaly_rad", "eccentricity", "inclination_rad", "perigee_rad"),
    *("ascending_node_rad", "ascending_node_rate_rad_s", "inclination_rate_rad_s"),
    *("mean_motion_difference_rad_s", "cuc", "cus", "crc_m", "crs_m", "cic", "cis", "toe_s", "toc_s"),
    *("af2", "af1", "af0_s", "week", "week_of_toc", "iode", "health", "health_prs"),
    *("sisa_e5a", "sisa_e5b", "bgd_e5a_s", "bgd_e5b_s"),
)
_GLONASS = struct.Struct("<BB3d9fIHBBBBHBBBxHHB")
_GLONASS_NAMES = (
    *("svid", "channel", "x_km", "y_km", "z_km", "vx_km_s", "vy_km_s", "vz_km_s"),
    *("ax_km_s2", "ay_km_s2", "az_km_s2", "gamma", "tau_s", "delta_tau_s", "toe_s", "week_of_toe"),
    *("p1", "p2", "age", "health", "tb", "m", "p", "health_now", "day", "accuracy", "c"),
)
_CHANNEL_OFFSET = 8  # mosaic-X5 reference guide, GLONav, `FreqNr`
# `Source`: I/NAV, F/NAV; the data sources of RINEX 3.04, table A8, with the clock of E5b, E1 and of E5a, E1.
_DATA_SOURCES = {2: 517.0, 16: 258.0}
_FNAV = 16  # mosaic-X5 reference guide, GALNav, `Source`
# `Health_OSSOL`: four bits of each signal: valid, data validity, two of health.
_HEALTH_SHIFTS = {"e1b": 0, "e5b": 4, "e5a": 8}
_NOT_AVAILABLE = -2e10  # mosaic-X5 reference guide, do-not-use values
_IONOSPHERE = struct.Struct("<Bx8f")


def read_gps_ephemeris(body: bytes, near_ns: int) -> Ephemeris:
    """Decode GPSNav; ValueError or struct.error where it is malformed."""
    return _read_lnav(body, near_ns, "G")


def read_qzss_ephemeris(body: bytes, near_ns: int) -> Ephemeris:
    """Decode QZSNav; ValueError or struct.error where it is malformed."""
    return _read_lnav(body, near_ns, "J")


def read_galileo_ephemeris(body: bytes, near_ns: int) -> Ephemeris:
    """Decode GALNav, of I/NAV or F/NAV; ValueError or struct.error where it is malformed."""
    values = _values(_GALILEO, _GALILEO_NAMES, body)
    source, health = int(values["source"]), int(values["health"])
    if source not in _DATA_SOURCES:
        raise ValueError(f"GALNav of source {source}, expected one of {sorted(_DATA_SOURCES)}")
    integers = _integers("E", {name: v for name, v in values.items() if v != _NOT_AVAILABLE})
    integers["accuracy"] = int(values["sisa_e5a" if source == _FNAV else "sisa_e5b"])
    for signal, shift in _HEALTH_SHIFTS.items():
        if health >> shift & 1:
            integers[f"{signal}_invalid"] = health >> shift + 1 & 0b1
            integers[f"{signal}_health"] = health >> shift + 2 & 0b11
    ephemeris = plausible_ephemeris("E", integers, near_ns)
    return replace(ephemeris, other={**ephemeris.other, "data_sources": _DATA_SOURCES[source]})


def read_beidou_ephemeris(body: bytes, near_ns: int) -> Ephemeris:
    """Decode BDSNav; ValueError or struct.error where it is malformed."""
    return plausible_ephemeris("C", _integers("C", _values(_BEIDOU, _BEIDOU_NAMES, body)), near_ns)


def read_glonass_ephemeris(body: bytes, near_ns: int) -> GlonassEphemeris:
    """Decode GLONav, whose times are GPS time; ValueError or struct.error where it is malformed."""
    values = _values(_GLONASS, _GLONASS_NAMES, body)
    letter, number = satellite_of_svid(int(values["svid"]))
    channel, of_week_ns = int(values["channel"]) - _CHANNEL_OFFSET, int(values["toe_s"]) * NS_PER_SECOND
    if letter != "R" or channel not in GLONASS_CHANNELS or of_week_ns >= NS_PER_WEEK:
        raise ValueError(f"satellite {values['svid']}, channel {channel}, t_oe {values['toe_s']} s")
    toe_ns = gps_ns_near("G", of_week_ns, near_ns)
    return GlonassEphemeris(
        satellite=ord(letter) * 256 + number,
        toe_ns=toe_ns,
        transmission_ns=near_ns,
        iode=quarter_of_day(toe_ns),
        channel=channel,
        position_m=_metres(values, "x_km", "y_km", "z_km"),
        velocity_m_s=_metres(values, "vx_km_s", "vy_km_s", "vz_km_s"),
        acceleration_m_s2=_metres(values, "ax_km_s2", "ay_km_s2", "az_km_s2"),
        clock=(-values["tau_s"], values["gamma"]),
        # The first of the three bits of B_n: not to be used.
        health=int(values["health"]) >> 2 & 1 | int(values["health_now"]) & 1,
        group_delay_s=values["delta_tau_s"] if values["delta_tau_s"] != _NOT_AVAILABLE else math.nan,
    )


def read_ionosphere(body: bytes, near_ns: int) -> IonosphereCoefficients:
    """Decode GPSIon; ValueError or struct.error where it is malformed."""
    _, *values = _IONOSPHERE.unpack_from(body, TIME_STAMP.size)
    pairs = zip(IONOSPHERE_FIELDS.items(), values, strict=True)
    return coefficients_from_integers("G", {name: _integer(name, v, field) for (name, field), v in pairs})


NAVIGATION_BLOCKS: Mapping[int, Callable[[bytes, int], BroadcastEphemeris | IonosphereCoefficients]] = {
    5891: read_gps_ephemeris,
    4004: read_glonass_ephemeris,
    4002: read_galileo_ephemeris,
    4081: read_beidou_ephemeris,
    4095: read_qzss_ephemeris,
    5893: read_ionosphere,
}
"""By number of the block: its decoder, given the body and the block's time."""


def _read_lnav(body: bytes, near_ns: int, system: str) -> Ephemeris:
    values = _values(_GPS, _GPS_NAMES, body)
    if not int(values["iodc"]) & 0xFF == values["iode"] == values["iode_of_3"]:
        raise ValueError(f"issues {values['iodc']}, {values['iode']}, {values['iode_of_3']} of one ephemeris")
    return plausible_ephemeris(system, _integers(system, values), near_ns)


def _values(layout: struct.Struct, names: tuple[str, ...], body: bytes) -> dict[str, float]:
    return dict(zip(names, layout.unpack_from(body, TIME_STAMP.size), strict=True))


def _metres(values: Mapping[str, float], x: str, y: str, z: str) -> tuple[float, float, float]:
    return values[x] * 1e3, values[y] * 1e3, values[z] * 1e3


def _integers(system: str, values: Mapping[str, float]) -> dict[str, int]:
    """Return the fields that the satellite transmits; ValueError for another system's satellite."""
    letter, number = satellite_of_svid(int(values["svid"]))
    if letter != system:
        raise ValueError(f"satellite {values['svid']}, expected one of {system}")
    fields = FIELDS[system]
    known = ((name, value) for name, value in values.items() if name in fields and name != "week")
    return {"satellite": number, **{name: _integer(name, value, fields[name]) for name, value in known}}


def _integer(name: str, value: float, field: BitField) -> int:
    # Angles are in semicircles.
    per_unit = math.pi if "_rad" in name else 1.0
    return quantize(name, value * per_unit, field.resolution, field.width, signed=field.signed)
