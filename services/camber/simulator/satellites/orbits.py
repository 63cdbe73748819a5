"""Positions, velocities and clocks of satellites from broadcast ephemerides, many at a time.

Sources: IS-GPS-200N, table 20-IV (position) and 20.3.3.3.3.1 (clock, relativistic term); B. Remondi, "Computing
satellite velocity using the broadcast ephemeris", GPS Solutions 8 (2004); BDS-SIS-ICD-B1I 3.0, 5.2.4.12 (geostationary
satellites); Galileo OS SIS ICD 2.1, 5.1.1; QZSS IS-QZSS-PNT-004, 5.5.1 (as GPS).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camber.formats.observations import Ephemeris
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.simulator.scene import Booleans, Floats, Integers

SPEED_OF_LIGHT_M_S = 299792458.0  # exact, SI
EARTH_ROTATION_RAD_S = 7.2921151467e-5  # as IS-GPS-200 and Galileo have it; BeiDou's is 7.292115e-5
BDT_MINUS_GPS_NS = -14 * NS_PER_SECOND  # BeiDou time runs 14 s behind GPS time

_KEPLER_STEPS = 8  # Newton's method squares the error; e < 0.1
_ELEMENTS = (
    "sqrt_a", "eccentricity", "inclination_rad", "inclination_rate_rad_s", "ascending_node_rad",
    "ascending_node_rate_rad_s", "perigee_rad", "mean_anomaly_rad", "mean_motion_difference_rad_s",
    "cuc", "cus", "crc_m", "crs_m", "cic", "cis",
)  # fmt: skip
_TILT_RAD = np.deg2rad(-5.0)  # of the geostationary satellites' orbital frame


def gravity_m3_s2(system: str) -> float:
    """The earth's gravitational constant in a system's interface document."""
    return 3.9860050e14 if system in "GJ" else 3.986004418e14


def rotation_rad_s(system: str) -> float:
    """The earth's rate of rotation in a system's interface document."""
    return 7.292115e-5 if system == "C" else EARTH_ROTATION_RAD_S


def is_geostationary(satellite: int) -> bool:
    """BeiDou's C01 to C05 and C59 and above: their orbital frame is tilted."""
    return satellite >> 8 == ord("C") and ((satellite & 255) <= 5 or (satellite & 255) >= 59)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OrbitTable:
    """Ephemerides as columns (m,): names and units are those of `Ephemeris`; `toe_of_week_s` in the system's time."""

    satellite: Integers
    toe_ns: Integers
    toc_ns: Integers
    toe_of_week_s: Floats
    gravity_m3_s2: Floats
    rotation_rad_s: Floats
    geostationary: Booleans
    clock: Floats
    elements: dict[str, Floats]

    @classmethod
    def of(cls, ephemerides: Sequence[Ephemeris]) -> OrbitTable:
        """From single ephemerides, in their order."""
        systems = [chr(e.satellite >> 8) for e in ephemerides]
        toe_ns = np.array([e.toe_ns for e in ephemerides], np.int64)
        shift_ns = np.array([BDT_MINUS_GPS_NS if s == "C" else 0 for s in systems], np.int64)
        return cls(
            satellite=np.array([e.satellite for e in ephemerides], np.int64),
            toe_ns=toe_ns,
            toc_ns=np.array([e.toc_ns for e in ephemerides], np.int64),
            toe_of_week_s=((toe_ns + shift_ns) % NS_PER_WEEK) / NS_PER_SECOND,
            gravity_m3_s2=np.array([gravity_m3_s2(s) for s in systems]),
            rotation_rad_s=np.array([rotation_rad_s(s) for s in systems]),
            geostationary=np.array([is_geostationary(e.satellite) for e in ephemerides], np.bool_),
            clock=np.array([e.clock for e in ephemerides], np.float64).reshape(-1, 3),
            elements={
                name: np.array([getattr(e, name) for e in ephemerides], np.float64) for name in _ELEMENTS
            },
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OrbitStates:
    """At n times, of m satellites: ECEF of the time itself, `position_m`, `velocity_m_s` (n, m, 3).

    `clock_s`, `clock_rate` (n, m): the satellite's clock minus system time, with the relativistic term and without
    group delays.
    """

    position_m: Floats
    velocity_m_s: Floats
    clock_s: Floats
    clock_rate: Floats


def newest_in_use(ephemerides: Sequence[Ephemeris], time_ns: int) -> list[Ephemeris]:
    """For each satellite, in the order of their numbers, the set whose toe is nearest to a time."""
    nearest: dict[int, Ephemeris] = {}
    for e in ephemerides:
        other = nearest.get(e.satellite)
        if other is None or abs(e.toe_ns - time_ns) < abs(other.toe_ns - time_ns):
            nearest[e.satellite] = e
    return [nearest[s] for s in sorted(nearest)]


def satellite_states(table: OrbitTable, time_ns: Integers, offset_s: Floats) -> OrbitStates:
    """States at the times `time_ns` (n,) + `offset_s` (n, m), for all m rows of the table.

    The time is that of the system's own scale for the orbit and the clock alike (transmission time).
    """
    el = table.elements
    tk = (time_ns[:, None] - table.toe_ns) / NS_PER_SECOND + offset_s
    a = el["sqrt_a"] ** 2
    e = el["eccentricity"]
    n = np.sqrt(table.gravity_m3_s2 / a**3) + el["mean_motion_difference_rad_s"]
    mean = el["mean_anomaly_rad"] + n * tk
    anomaly = mean + e * np.sin(mean)
    for _ in range(_KEPLER_STEPS):
        step = (anomaly - e * np.sin(anomaly) - mean) / (1.0 - e * np.cos(anomaly))
        anomaly = anomaly - step
        if not step.size or float(np.max(np.abs(step))) < 1e-15:
            break
    sin_e, cos_e = np.sin(anomaly), np.cos(anomaly)
    root = np.sqrt(1.0 - e * e)
    phi = np.arctan2(root * sin_e, cos_e - e) + el["perigee_rad"]
    s2, c2 = np.sin(2.0 * phi), np.cos(2.0 * phi)
    u = phi + el["cus"] * s2 + el["cuc"] * c2
    r = a * (1.0 - e * cos_e) + el["crs_m"] * s2 + el["crc_m"] * c2
    i = el["inclination_rad"] + el["cis"] * s2 + el["cic"] * c2 + el["inclination_rate_rad_s"] * tk
    node_rate = el["ascending_node_rate_rad_s"] - np.where(table.geostationary, 0.0, table.rotation_rad_s)
    node = el["ascending_node_rad"] + node_rate * tk - table.rotation_rad_s * table.toe_of_week_s
    anomaly_rate = n / (1.0 - e * cos_e)
    phi_rate = root * anomaly_rate / (1.0 - e * cos_e)
    u_rate = phi_rate * (1.0 + 2.0 * (el["cus"] * c2 - el["cuc"] * s2))
    r_rate = a * e * sin_e * anomaly_rate + 2.0 * phi_rate * (el["crs_m"] * c2 - el["crc_m"] * s2)
    i_rate = el["inclination_rate_rad_s"] + 2.0 * phi_rate * (el["cis"] * c2 - el["cic"] * s2)

    su, cu, si, ci, so, co = np.sin(u), np.cos(u), np.sin(i), np.cos(i), np.sin(node), np.cos(node)
    xp, yp = r * cu, r * su
    xp_rate, yp_rate = r_rate * cu - yp * u_rate, r_rate * su + xp * u_rate
    x, y, z = xp * co - yp * ci * so, xp * so + yp * ci * co, yp * si
    vx = xp_rate * co - yp_rate * ci * so + yp * si * so * i_rate - node_rate * y
    vy = xp_rate * so + yp_rate * ci * co - yp * si * co * i_rate + node_rate * x
    vz = yp_rate * si + yp * ci * i_rate
    position = np.stack((x, y, z), axis=-1)
    velocity = np.stack((vx, vy, vz), axis=-1)
    if table.geostationary.any():
        g = table.geostationary
        position[:, g], velocity[:, g] = _from_tilted(
            position[:, g], velocity[:, g], table.rotation_rad_s[g], tk[:, g]
        )

    tc = (time_ns[:, None] - table.toc_ns) / NS_PER_SECOND + offset_s
    af0, af1, af2 = table.clock.T
    f = -2.0 * np.sqrt(table.gravity_m3_s2) / SPEED_OF_LIGHT_M_S**2 * e * el["sqrt_a"]
    clock = af0 + (af1 + af2 * tc) * tc + f * sin_e
    clock_rate = af1 + 2.0 * af2 * tc + f * cos_e * anomaly_rate
    return OrbitStates(position_m=position, velocity_m_s=velocity, clock_s=clock, clock_rate=clock_rate)


def _from_tilted(position: Floats, velocity: Floats, rate: Floats, tk: Floats) -> tuple[Floats, Floats]:
    """BDS-SIS-ICD-B1I: X = Rz(ω tk) Rx(−5°) X_GK, and its derivative."""
    st, ct = np.sin(_TILT_RAD), np.cos(_TILT_RAD)
    sr, cr = np.sin(rate * tk), np.cos(rate * tk)

    def turned(v: Floats) -> Floats:
        x, y, z = v[..., 0], ct * v[..., 1] + st * v[..., 2], -st * v[..., 1] + ct * v[..., 2]
        return np.stack((cr * x + sr * y, -sr * x + cr * y, z), axis=-1)

    p, v = turned(position), turned(velocity)
    v[..., 0] += rate * p[..., 1]
    v[..., 1] -= rate * p[..., 0]
    return p, v
