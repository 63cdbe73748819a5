"""Strap-down integration in the earth-fixed frame: where a unit goes by its rates and forces, without Camber's frames.

Source: P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., 5.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
EARTH_RATE_RAD_S = np.array([0.0, 0.0, 7.292115e-5])
_GM_M3_S2, _RADIUS_M = 3.986004418e14, 6378137.0
_J2, _J4 = 1.082629821e-3, -2.37091222e-6  # of the normal field of WGS 84


def earth_gravity_m_s2(place_m: Floats) -> Floats:
    """Gravitation by the zonal harmonics J2 and J4, and the centrifugal force, at an earth-fixed place (3,)."""
    x, y, z = place_m
    r = float(np.linalg.norm(place_m))
    s2, a2 = (z / r) ** 2, (_RADIUS_M / r) ** 2
    level = 1.0 + 1.5 * _J2 * a2 * (1.0 - 5.0 * s2) - 1.875 * _J4 * a2**2 * (1.0 - 14.0 * s2 + 21.0 * s2**2)
    polar = 1.0 + 1.5 * _J2 * a2 * (3.0 - 5.0 * s2) - 0.625 * _J4 * a2**2 * (15.0 - 70.0 * s2 + 63.0 * s2**2)
    pull = -_GM_M3_S2 / r**3 * np.array([x * level, y * level, z * polar])
    rate = EARTH_RATE_RAD_S[2]
    return pull + rate**2 * np.array([x, y, 0.0])


def turned_by(angle_rad: Floats) -> Floats:
    """The rotation (3, 3) of a rotation vector (Rodrigues)."""
    size = float(np.linalg.norm(angle_rad))
    x, y, z = angle_rad
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if size < 1e-12:
        return np.eye(3) + cross
    return np.eye(3) + np.sin(size) / size * cross + (1.0 - np.cos(size)) / size**2 * cross @ cross


def integrate(
    time_s: Floats, rate_rad_s: Floats, force_m_s2: Floats, *, place_m: Floats, earth_from_unit: Floats
) -> Floats:
    """Places (n, 3) of a unit that is at rest on the earth in the beginning, by samples (n, 3) in its axes."""
    places, velocity, turn = [place_m], np.zeros(3), earth_from_unit
    force = turn @ force_m_s2[0]
    for k, dt in enumerate(np.diff(time_s).tolist()):
        first, second = rate_rad_s[k], rate_rad_s[k + 1]
        angle = 0.5 * (first + second) * dt + np.cross(first, second) * dt**2 / 12.0
        turn = turned_by(-EARTH_RATE_RAD_S * dt) @ turn @ turned_by(angle)
        force, before = turn @ force_m_s2[k + 1], force
        field = earth_gravity_m_s2(places[-1]) - 2.0 * np.cross(EARTH_RATE_RAD_S, velocity)
        changed = velocity + (0.5 * (before + force) + field) * dt
        places.append(places[-1] + 0.5 * (velocity + changed) * dt)
        velocity = changed
    return np.array(places)
