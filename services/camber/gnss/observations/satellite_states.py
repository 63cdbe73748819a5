"""Satellite positions, velocities and clocks at transmission, and ranges to them; compiled, one epoch a call.

Sources: IS-GPS-200N, table 20-IV (orbit), 20.3.3.3.3.1 (clock, relativistic term); B. Remondi, "Computing satellite
velocity using the broadcast ephemeris", GPS Solutions 8 (2004); BDS-SIS-ICD-B1I 3.0, 5.2.4.12 (geostationary
satellites); Galileo OS SIS ICD 2.1, 5.1.1; IS-QZSS-PNT-004, 5.5.1 (as GPS); ICD GLONASS 5.1, 3.3.3 (clock).

Times stay integers until a reference time has been subtracted: the rest, some hours, fits a double to 4e-12 s.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats, Integers
from camber.geodesy.ellipsoid import MINIMUM_RADIUS_M, latitude_height
from camber.gnss.observations.glonass_orbit import integrate_state

EARTH_ROTATION_RAD_S = 7.2921151467e-5
"""IS-GPS-200N, for the frame of ranges; orbits use their system's rate, a column of the table."""

(
    TOE_OF_WEEK_S, SEMI_MAJOR_M, ECCENTRICITY, ROOT_ONE_MINUS_E2, MEAN_MOTION_RAD_S, MEAN_ANOMALY_RAD,
    SIN_PERIGEE, COS_PERIGEE, INCLINATION_RAD, INCLINATION_RATE_RAD_S, NODE_RAD, NODE_RATE_RAD_S,
    CUC, CUS, CRC_M, CRS_M, CIC, CIS, AF0_S, AF1, AF2, RELATIVITY_S, ROTATION_RAD_S, GEOSTATIONARY,
) = range(24)  # fmt: skip
"""Columns of `elements`. `MEAN_MOTION_RAD_S` is the corrected one, `RELATIVITY_S` is F e √A."""
ELEMENTS = 24  # columns, as above

_GLONASS = ord("R")
_KEPLER_STEPS = 10  # Newton's method squares the error: three suffice for e < 0.1; the store refuses e ≥ 0.5
_KEPLER_RAD = 1.0e-14  # derived: 0.3 µm of orbit
_SIN_TILT, _COS_TILT = math.sin(math.radians(-5.0)), math.cos(math.radians(-5.0))
_latitude_height = compiled(latitude_height)


class EphemerisTable(NamedTuple):
    """Broadcast ephemerides as r rows: `elements` (r, 24), `group_delay_s` (r, 10) by band, NaN where unknown.

    `state` (r, 9): of GLONASS, as in `glonass_orbit`, with AF0_S and AF1 its only elements; else NaN. `channel` (r,):
    its frequency channel, else 0.
    """

    satellite: Integers
    toe_ns: Integers
    toc_ns: Integers
    elements: Floats
    group_delay_s: Floats
    state: Floats
    channel: Integers


class SatelliteStates(NamedTuple):
    """States of m satellites at their times of transmission; NaN without an ephemeris or a pseudorange.

    `position_m`, `velocity_m_s` (m, 3): antenna's phase centre, ECEF of the **time of transmission**, not turned.
    `clock_s` (m,): satellite's clock minus its system's time (GPS time, BeiDou's too), with the relativistic term,
    without group delays; `clock_rate` (m,). GLONASS' γ_n contains the relativistic term;
    `channel` (m,) is its frequency channel, 0 for others.
    """

    position_m: Floats
    velocity_m_s: Floats
    clock_s: Floats
    clock_rate: Floats
    channel: Floats


@compiled
def states_at_transmission(
    table: EphemerisTable, rows: Integers, receive_time_ns: int, pseudorange_m: Floats
) -> SatelliteStates:
    """States of the satellites with these rows (m,) of the table, −1 for none; pseudoranges (m,), one a satellite.

    The satellite's clock read `receive_time_ns − P/c` when the signal left, both by the receiver's clock, whose offset
    therefore cancels; the time of transmission is that less the satellite's clock (IS-GPS-200N 20.3.3.3.3.1).
    A delay of P shifts the time: 100 m of delay move the range by at most 0.3 mm.
    """
    m = rows.size
    position, velocity = np.empty((m, 3)), np.empty((m, 3))
    clock, clock_rate, channel = np.empty(m), np.empty(m), np.empty(m)
    for k in range(m):
        row = rows[k]
        travel_s = pseudorange_m[k] / SPEED_OF_LIGHT_M_S
        # No satellite is a light second away; NaN fails too.
        if row < 0 or row >= table.toe_ns.size or not abs(travel_s) < 1.0:
            position[k, :], velocity[k, :] = np.nan, np.nan
            clock[k], clock_rate[k], channel[k] = np.nan, np.nan, np.nan
            continue
        since_toe_s = (receive_time_ns - table.toe_ns[row]) / 1e9 - travel_s
        since_toc_s = (receive_time_ns - table.toc_ns[row]) / 1e9 - travel_s
        channel[k] = table.channel[row]
        if table.satellite[row] >> 8 == _GLONASS:
            clock[k], clock_rate[k] = table.elements[row, AF0_S], table.elements[row, AF1]
            clock[k] += clock_rate[k] * since_toe_s
            integrate_state(table.state[row], since_toe_s - clock[k], position[k], velocity[k])
            continue
        clock[k], clock_rate[k] = _state(
            table.elements[row], since_toe_s, since_toc_s, position=position[k], velocity=velocity[k]
        )
    return SatelliteStates(position, velocity, clock, clock_rate=clock_rate, channel=channel)


@compiled
def _state(
    el: Floats, read_toe_s: float, read_toc_s: float, position: Floats, velocity: Floats
) -> tuple[float, float]:
    """Clock and its rate; position and velocity are written. Times are by the satellite's clock."""
    af0, af1, af2 = el[AF0_S], el[AF1], el[AF2]
    polynomial = af0 + (af1 + af2 * read_toc_s) * read_toc_s
    tc = read_toc_s - polynomial
    polynomial = af0 + (af1 + af2 * tc) * tc
    tk = read_toe_s - polynomial

    e, n = el[ECCENTRICITY], el[MEAN_MOTION_RAD_S]
    mean = el[MEAN_ANOMALY_RAD] + n * tk
    anomaly = mean + e * math.sin(mean)
    for _ in range(_KEPLER_STEPS):
        step = (anomaly - e * math.sin(anomaly) - mean) / (1.0 - e * math.cos(anomaly))
        anomaly -= step
        if abs(step) < _KEPLER_RAD:
            break
    sin_e, cos_e = math.sin(anomaly), math.cos(anomaly)
    # The relativistic term belongs to the clock that was read: at most 0.3 µs, 1 mm along the orbit.
    relativity = el[RELATIVITY_S] * sin_e
    anomaly_rate = n / (1.0 - e * cos_e)
    turned = anomaly_rate * relativity
    sin_e, cos_e = sin_e - cos_e * turned, cos_e + sin_e * turned
    tk -= relativity

    shape = 1.0 - e * cos_e
    anomaly_rate = n / shape
    sin_v, cos_v = el[ROOT_ONE_MINUS_E2] * sin_e / shape, (cos_e - e) / shape
    sin_phi = sin_v * el[COS_PERIGEE] + cos_v * el[SIN_PERIGEE]
    cos_phi = cos_v * el[COS_PERIGEE] - sin_v * el[SIN_PERIGEE]
    s2, c2 = 2.0 * sin_phi * cos_phi, cos_phi * cos_phi - sin_phi * sin_phi
    du = el[CUS] * s2 + el[CUC] * c2
    sin_du, cos_du = math.sin(du), math.cos(du)
    su, cu = sin_phi * cos_du + cos_phi * sin_du, cos_phi * cos_du - sin_phi * sin_du
    a = el[SEMI_MAJOR_M]
    r = a * shape + el[CRS_M] * s2 + el[CRC_M] * c2
    i = el[INCLINATION_RAD] + el[INCLINATION_RATE_RAD_S] * tk + el[CIS] * s2 + el[CIC] * c2
    earth_rate = el[ROTATION_RAD_S]
    geostationary = el[GEOSTATIONARY] > 0.0
    node_rate = el[NODE_RATE_RAD_S] - (0.0 if geostationary else earth_rate)
    node = el[NODE_RAD] + node_rate * tk - earth_rate * el[TOE_OF_WEEK_S]

    phi_rate = el[ROOT_ONE_MINUS_E2] * anomaly_rate / shape
    u_rate = phi_rate * (1.0 + 2.0 * (el[CUS] * c2 - el[CUC] * s2))
    r_rate = a * e * sin_e * anomaly_rate + 2.0 * phi_rate * (el[CRS_M] * c2 - el[CRC_M] * s2)
    i_rate = el[INCLINATION_RATE_RAD_S] + 2.0 * phi_rate * (el[CIS] * c2 - el[CIC] * s2)

    si, ci, so, co = math.sin(i), math.cos(i), math.sin(node), math.cos(node)
    xp, yp = r * cu, r * su
    xp_rate, yp_rate = r_rate * cu - yp * u_rate, r_rate * su + xp * u_rate
    x, y, z = xp * co - yp * ci * so, xp * so + yp * ci * co, yp * si
    vx = xp_rate * co - yp_rate * ci * so + yp * si * so * i_rate - node_rate * y
    vy = xp_rate * so + yp_rate * ci * co - yp * si * co * i_rate + node_rate * x
    vz = yp_rate * si + yp * ci * i_rate
    if geostationary:
        # X = Rz(ω tk) Rx(−5°) X_GK; the derivative of the first rotation is ω × to the other side.
        y, z = _COS_TILT * y + _SIN_TILT * z, -_SIN_TILT * y + _COS_TILT * z
        vy, vz = _COS_TILT * vy + _SIN_TILT * vz, -_SIN_TILT * vy + _COS_TILT * vz
        sr, cr = math.sin(earth_rate * tk), math.cos(earth_rate * tk)
        x, y = cr * x + sr * y, -sr * x + cr * y
        vx, vy = cr * vx + sr * vy + earth_rate * y, -sr * vx + cr * vy - earth_rate * x
    position[0], position[1], position[2] = x, y, z
    velocity[0], velocity[1], velocity[2] = vx, vy, vz
    return polynomial + relativity, af1 + 2.0 * af2 * tc + el[RELATIVITY_S] * cos_e * anomaly_rate


@compiled
def ranges(position_m: Floats, receiver_ecef_m: Floats) -> tuple[Floats, Floats]:
    """Distances (m,) [m] and unit vectors (m, 3) from a receiver (3,) to satellites (m, 3) of `SatelliteStates`.

    A satellite's position is turned into the ECEF frame of the time of reception, by the earth's rotation over the
    geometric travel time (IS-GPS-200N, 20.3.3.4.3.3.2); receiver and unit vectors are in that frame. Exact to 1 µm.
    """
    m = position_m.shape[0]
    distance, direction = np.empty(m), np.empty((m, 3))
    for k in range(m):
        distance[k] = range_to(position_m[k], receiver_ecef_m, direction[k])
    return distance, direction


@compiled
def range_to(position_m: Floats, receiver_ecef_m: Floats, direction: Floats) -> float:
    """As `ranges` for one satellite (3,); the unit vector is written to `direction` (3,)."""
    x, y, dz = position_m[0], position_m[1], position_m[2] - receiver_ecef_m[2]
    dx, dy = x - receiver_ecef_m[0], y - receiver_ecef_m[1]
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    # The first travel time is 0.13 µs off at most, which turns the satellite by 0.3 mm; the second leaves nothing.
    for _ in range(2):
        angle = EARTH_ROTATION_RAD_S * distance / SPEED_OF_LIGHT_M_S
        # Of 1e-5 rad: the next terms are below 1e-15.
        sine, cosine = angle - angle * angle * angle / 6.0, 1.0 - 0.5 * angle * angle
        dx, dy = cosine * x + sine * y - receiver_ecef_m[0], cosine * y - sine * x - receiver_ecef_m[1]
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    direction[0], direction[1], direction[2] = dx / distance, dy / distance, dz / distance
    return distance


@compiled
def geodetic(ecef_m: Floats) -> tuple[float, float, float]:
    """Latitude, longitude [rad], ellipsoidal height [m] of a point (3,), as `geodetic_from_ecef_scalar`.

    Three NaN within 6000 km of the earth's centre and where a number is not finite: no receiver is there.
    """
    axis = math.hypot(ecef_m[0], ecef_m[1])
    if not MINIMUM_RADIUS_M <= math.hypot(axis, ecef_m[2]) < np.inf:
        return np.nan, np.nan, np.nan
    latitude, height = _latitude_height(axis, ecef_m[2])
    return latitude, math.atan2(ecef_m[1], ecef_m[0]), height


@compiled
def enu_from_ecef_rotation(latitude_rad: float, longitude_rad: float) -> Floats:
    """Rotation (3, 3) that takes ECEF vectors to east, north, up at a place."""
    s, c = math.sin(latitude_rad), math.cos(latitude_rad)
    sl, cl = math.sin(longitude_rad), math.cos(longitude_rad)
    rotation = np.empty((3, 3))
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = -sl, cl, 0.0
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = -s * cl, -s * sl, c
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = c * cl, c * sl, s
    return rotation
