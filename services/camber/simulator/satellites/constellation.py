"""GPS, QZSS, Galileo and BeiDou in their nominal constellations, as the broadcast ephemerides of some hours.

Sources: GPS SPS Performance Standard, 5th edition, tables 3.2-1 and 3.2-2 (slots, without the drift of the planes since
their epoch); Galileo OS Service Definition Document 1.3, annex on the reference constellation (24/3/1 and its epoch);
BDS-OS-PS 3.0, 2.2 (24/3/1, inclined and geostationary satellites), longitudes as in the IGS list of BeiDou's
satellites and in IMO MSC.379(93), 1.1; IS-QZSS-PNT-004, 4 (eccentric inclined orbits over Japan), nodes as in the
two-line elements of November 2017 (right ascensions 157°, 287°, 24°); S. Aoki et al., "The new definition of universal
time", A&A 105 (1982) (sidereal time).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from camber.formats.observations import Ephemeris, satellite_number
from camber.geodesy.gps_time import NS_PER_DAY, NS_PER_SECOND, NS_PER_WEEK, CalendarTime, gps_ns_from_gpst
from camber.simulator.random_streams import stream
from camber.simulator.satellites.orbits import (
    BDT_MINUS_GPS_NS,
    SPEED_OF_LIGHT_M_S,
    gravity_m3_s2,
    is_geostationary,
    rotation_rad_s,
)

_HOUR_NS = 3600 * NS_PER_SECOND
_STEP_NS = {"G": 2 * _HOUR_NS, "J": 2 * _HOUR_NS, "E": _HOUR_NS // 2, "C": _HOUR_NS}
_SYNCHRONOUS_S = 86164.0905  # one sidereal day
# −3/2 J2 n (R / a)² cos i; Galileo's is published, −0.0276° a day (European GNSS Service Centre, orbital parameters).
_NODE_RATE_RAD_S = {"G": -7.8e-9, "E": -5.58e-9, "C": -7.0e-9}
_GPS_NODES_DEG = (272.847, 332.847, 32.847, 92.847, 152.847, 212.847)
_GPS_SLOTS_DEG = (
    (268.126, 161.786, 11.676, 41.806),
    (94.916, 66.356, 173.336, 309.976, 204.376),
    (111.876, 11.796, 339.666, 241.556),
    (135.226, 282.676, 257.976, 35.156, 167.356),
    (197.046, 302.596, 66.066, 333.686),
    (238.886, 0.456, 334.016, 105.206, 135.346),
)
_GPS_SURPLUS_DEG = ((0, 100.0), (2, 60.0), (3, 90.0), (4, 15.0))  # plane, argument of latitude
_GALILEO_PRN = (
    2, 3, 4, 5, 7, 8, 9, 10, 11, 12, 13, 15, 16, 19, 21, 23, 24, 25, 26, 27, 29, 30, 31, 33, 34, 36,
)  # fmt: skip
_BEIDOU_MEO_PRN = (
    19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 32, 33, 34, 35, 36, 37, 41, 42, 43, 44, 45, 46,
)  # fmt: skip
# Number, longitude of the figure of eight, phase: of the third generation and of the second one, still in use.
_BEIDOU_IGSO = (
    (38, 118.0, 0.0), (39, 118.0, 120.0), (40, 118.0, 240.0), (6, 118.0, 60.0), (7, 118.0, 180.0),
    (8, 118.0, 300.0), (9, 95.0, 20.0), (10, 95.0, 140.0), (13, 95.0, 260.0), (16, 112.0, 330.0),
)  # fmt: skip
_BEIDOU_GEO = ((1, 140.0), (2, 80.0), (3, 110.5), (4, 160.0), (5, 58.75))
_QZSS = ((2, 0.0), (3, 263.0), (4, 130.0))  # number, phase of the figure of eight over 135° E
_QZSS_GEO = (7, 127.0)


_Orbit = tuple[str, float, float, float, float, float, float]
"""Satellite; period [s]; eccentricity; inclination, longitude of the node in ECEF (of a GEO its longitude), perigee and
mean argument of latitude at a time [°]."""
_GPS_EPOCH_NS = gps_ns_from_gpst(CalendarTime(1993, 7, 1, *(0, 0, 0)))
_GALILEO_EPOCH_NS = gps_ns_from_gpst(CalendarTime(2016, 11, 21, *(0, 0, 0)))
_J2000_NS = gps_ns_from_gpst(CalendarTime(2000, 1, 1, *(12, 0, 0)))


def true_ephemerides(begin_ns: int, end_ns: int, seed: int) -> list[Ephemeris]:
    """Sets that cover `begin_ns` to `end_ns`, all sets of one satellite describing one and the same orbit.

    Their ages stay within what receivers accept (GPS, QZSS 2 h, Galileo 4 h, BeiDou 6 h), Galileo's and BeiDou's
    toe lies before the time of use. The constellation at a time is nominal with small deviations drawn from the seed.
    """
    reference_ns = begin_ns // NS_PER_DAY * NS_PER_DAY
    sets: list[Ephemeris] = []
    for orbit in _orbits(reference_ns):
        base = _reference_set(orbit, reference_ns, seed)
        system = chr(base.satellite >> 8)
        step_ns = _STEP_NS[system]
        shift_ns = BDT_MINUS_GPS_NS if system == "C" else 0
        # The newest set that has begun before; GPS and QZSS send toe up to two hours ahead.
        first = (begin_ns + shift_ns) // step_ns - (0 if system in "GJ" else 1)
        last = (end_ns + shift_ns) // step_ns + (1 if system in "GJ" else 0)
        sets += [_moved(base, k * step_ns - shift_ns, reference_ns, k) for k in range(first, last + 1)]
    return sets


def broadcast_ephemerides(true: Sequence[Ephemeris], seed: int) -> list[Ephemeris]:
    """What the satellites say: the true sets with each set's own errors of orbit (1 m along, 0.3 m across) and clock.

    (Montenbruck, Steigenberger, Hauschild, "Broadcast versus precise ephemerides", GPS Solutions 19 (2015).)
    """
    broadcast = []
    for e in true:
        draw = stream(seed, f"satellites/broadcast/{e.satellite}/{e.toe_ns}").normal(size=4)
        radius_m = e.sqrt_a**2
        broadcast.append(
            replace(
                e,
                mean_anomaly_rad=e.mean_anomaly_rad + 1.0 / radius_m * draw[0],
                inclination_rad=e.inclination_rad + 0.3 / radius_m * draw[1],
                ascending_node_rad=e.ascending_node_rad + 0.3 / radius_m * draw[2],
                clock=(e.clock[0] + 0.5 / SPEED_OF_LIGHT_M_S * draw[3], e.clock[1], e.clock[2]),
            )
        )
    return broadcast


def _orbits(time_ns: int) -> list[_Orbit]:
    """The nominal constellations at a time."""
    turned_deg = _sidereal_deg(time_ns)

    def since_deg(epoch_ns: int, period_s: float) -> float:
        return 360.0 * (((time_ns - epoch_ns) / NS_PER_SECOND / period_s) % 1.0)

    orbits: list[_Orbit] = []
    period = 0.5 * _SYNCHRONOUS_S
    since = since_deg(_GPS_EPOCH_NS, period)
    slots = [(p, u) for p, plane in enumerate(_GPS_SLOTS_DEG) for u in plane] + list(_GPS_SURPLUS_DEG)
    for prn, (plane, u) in enumerate(slots, start=1):
        perigee = 360.0 * ((prn * 0.381966) % 1.0)
        node = _GPS_NODES_DEG[plane] - turned_deg
        orbits.append((f"G{prn:02d}", period, 0.008, 55.0, node, perigee, u + since))
    period = 2.0 * math.pi * math.sqrt(29599801.0**3 / gravity_m3_s2("E"))
    since = since_deg(_GALILEO_EPOCH_NS, period)
    for k, prn in enumerate(_GALILEO_PRN):
        plane, slot = (k // 8, float(k % 8)) if k < 24 else (k - 24, 3.5)
        u = 225.153 + 15.0 * plane + 45.0 * slot + since
        orbits.append((f"E{prn:02d}", period, 0.0002, 56.0, 317.632 + 120.0 * plane - turned_deg, 40.0, u))
    period = _SYNCHRONOUS_S * 7.0 / 13.0
    since = since_deg(_GALILEO_EPOCH_NS, period)
    for k, prn in enumerate(_BEIDOU_MEO_PRN):
        plane, slot = divmod(k, 8)
        u = 15.0 * plane + 45.0 * slot + since
        orbits.append((f"C{prn:02d}", period, 0.0007, 55.0, 25.0 + 120.0 * plane - turned_deg, 20.0, u))
    for prn, longitude, phase in _BEIDOU_IGSO:
        u = turned_deg + phase
        orbits.append((f"C{prn:02d}", _SYNCHRONOUS_S, 0.002, 55.0, longitude - u, 190.0, u))
    period = 2.0 * math.pi / rotation_rad_s("C")
    orbits += [(f"C{prn:02d}", period, 0.0003, 0.0, longitude, 0.0, 0.0) for prn, longitude in _BEIDOU_GEO]
    for prn, phase in _QZSS:
        u = turned_deg + phase
        orbits.append((f"J{prn:02d}", _SYNCHRONOUS_S, 0.075, 41.0, 135.0 - u, 270.0, u))
    prn, longitude = _QZSS_GEO
    orbits.append((f"J{prn:02d}", _SYNCHRONOUS_S, 0.0003, 0.5, longitude - turned_deg, 0.0, turned_deg))
    return orbits


def _sidereal_deg(time_ns: int) -> float:
    """Greenwich mean sidereal time, UT1 taken as GPS time: planes turn by 0.08° of it."""
    return (280.46061837 + 360.98564736629 * ((time_ns - _J2000_NS) / NS_PER_DAY)) % 360.0


def _reference_set(orbit: _Orbit, reference_ns: int, seed: int) -> Ephemeris:
    """The orbit with toe at the reference time, deviations drawn."""
    name, period_s, eccentricity, inclination_deg, node_deg, perigee_deg, argument_deg = orbit
    number, system = satellite_number(name), name[0]
    geo = is_geostationary(number)
    free = 0.0 if geo else 1.0
    draw = stream(seed, f"satellites/orbit/{name}").normal(size=4)
    rng = stream(seed, f"satellites/elements/{number}")
    h = rng.normal(size=6) * free
    clock = rng.normal(size=2)
    delays = rng.normal(size=2)
    semi_major_m = (gravity_m3_s2(system) * (period_s / (2.0 * math.pi)) ** 2) ** (1.0 / 3.0)
    node_deg += 0.0 if geo else 0.3 * draw[2]
    # In the tilted frame an equatorial orbit has inclination 5° and its node at 180°, where longitude is u − 180°.
    tilt, tilted_deg = math.radians(5.0), 180.0 + node_deg if geo else 0.0
    perigee = math.radians(perigee_deg + tilted_deg)
    argument = math.radians(argument_deg + 0.5 * draw[3] * (0.05 if geo else 1.0) + tilted_deg)
    synchronous = semi_major_m > 4.0e7
    return Ephemeris(
        satellite=number,
        toe_ns=reference_ns,
        toc_ns=reference_ns,
        transmission_ns=reference_ns,
        iode=0,
        clock=(2.0e-4 * float(clock[0]), 3.0e-12 * float(clock[1]), 0.0),
        sqrt_a=math.sqrt(semi_major_m),
        eccentricity=eccentricity * (1.0 + 0.2 * float(np.clip(draw[0], -2.0, 2.0))),
        inclination_rad=tilt if geo else math.radians(inclination_deg + 0.3 * draw[1]),
        inclination_rate_rad_s=0.0 if geo else 1.0e-10 * float(h[5]),
        ascending_node_rad=math.pi if geo else math.radians(node_deg),
        ascending_node_rate_rad_s=0.0 if synchronous else _NODE_RATE_RAD_S[system],
        perigee_rad=perigee,
        mean_anomaly_rad=argument - perigee,
        mean_motion_difference_rad_s=0.0 if synchronous else 4.0e-9,
        cuc=2.0e-6 * float(h[0]),
        cus=6.0e-6 * float(h[1]),
        crc_m=0.0 if geo else 200.0 + 60.0 * float(h[2]),
        crs_m=40.0 * float(h[3]),
        cic=1.0e-7 * float(h[4]),
        cis=1.0e-7 * float(h[0]),
        accuracy_m=3.12 if system == "E" else 2.0,
        health=0,
        other=_other(system, delays),
    )


def _other(system: str, delays: np.ndarray[tuple[int], np.dtype[np.float64]]) -> dict[str, float]:
    first, second = 4.0e-9 * float(delays[0]), 4.0e-9 * float(delays[1])
    if system in "GJ":
        return {"tgd_s": first, "fit_interval_h": 4.0 if system == "G" else 2.0, "iodc": 0.0}
    if system == "E":
        # I/NAV from E1-B and E5b-I, clock for E5b, E1 (RINEX 3.04, table A8: bits 0, 2, 9).
        return {"bgd_e5a_s": first, "bgd_e5b_s": 1.15 * first, "data_sources": 517.0}
    return {"tgd1_s": first, "tgd2_s": second, "aodc": 1.0}


def _moved(e: Ephemeris, toe_ns: int, reference_ns: int, number: int) -> Ephemeris:
    """The same orbit with another toe: the node counts from the week's beginning, IS-GPS-200 table 20-IV."""
    system = chr(e.satellite >> 8)
    rotation = rotation_rad_s(system)
    since_s = (toe_ns - reference_ns) / NS_PER_SECOND
    shift_ns = BDT_MINUS_GPS_NS if system == "C" else 0
    of_week_s = ((toe_ns + shift_ns) % NS_PER_WEEK) / NS_PER_SECOND
    n = math.sqrt(gravity_m3_s2(system) / e.sqrt_a**6) + e.mean_motion_difference_rad_s
    if is_geostationary(e.satellite):
        # Its frame stands with the earth at toe: in it the perigee goes backwards.
        node = e.ascending_node_rad + rotation * of_week_s
        perigee = e.perigee_rad - rotation * since_s
    else:
        node = e.ascending_node_rad + (e.ascending_node_rate_rad_s - rotation) * since_s
        node, perigee = node + rotation * of_week_s, e.perigee_rad
    iode = {"G": number % 240, "J": number % 240, "E": number % 1024, "C": 1}[system]
    other = dict(e.other)
    if "iodc" in other:
        other["iodc"] = float(iode)
    delay_ns = {"G": -2 * _HOUR_NS, "J": -2 * _HOUR_NS, "E": _HOUR_NS // 6, "C": 30 * NS_PER_SECOND}[system]
    return replace(
        e,
        toe_ns=toe_ns,
        toc_ns=toe_ns,
        transmission_ns=toe_ns + delay_ns,
        iode=iode,
        clock=(e.clock[0] + e.clock[1] * since_s, e.clock[1], 0.0),
        inclination_rad=e.inclination_rad + e.inclination_rate_rad_s * since_s,
        ascending_node_rad=_wrapped(node),
        perigee_rad=_wrapped(perigee),
        mean_anomaly_rad=_wrapped(e.mean_anomaly_rad + n * since_s),
        other=other,
    )


def _wrapped(angle_rad: float) -> float:
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi
