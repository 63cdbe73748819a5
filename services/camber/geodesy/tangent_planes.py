"""Positions in tangent planes, compiled: for loops over many points, each perhaps in a plane of its own.

The same plane as `LocalFrame` at height zero gives with `east_north_from_geodetic`, in closed form: with φ, λ the point
and φ₀, λ₀ the origin, r = N cos φ the distance from the earth's axis and z = N (1 − e²) sin φ the one from the equator,

    east  = r sin(λ − λ₀)
    north = (z − z₀) cos φ₀ − (r cos(λ − λ₀) − r₀) sin φ₀

That is the conversion to earth-centred coordinates (see `ellipsoid`), turned into the plane's axes. Within 600 m of the
origin the series of r and z about φ₀ to the third order, and of sin and cos, say the same to 0.1 nm and need no sine:
from dr/dφ = −M sin φ and dz/dφ = M cos φ, M the radius of curvature along the meridian.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.ellipsoid import ECCENTRICITY_SQUARED, SEMI_MAJOR_AXIS_M

_COS_REACH = math.cos(0.016)  # 100 km
_SERIES_REACH_RAD = 1e-4  # derived: 600 m


def plane_origins(latitude_rad: ArrayLike, longitude_rad: ArrayLike) -> NDArray[np.float64]:
    """What `east_north` takes of n origins at height zero: (n, 5)."""
    latitude, longitude = np.asarray(latitude_rad, np.float64), np.asarray(longitude_rad, np.float64)
    sin, cos = np.sin(latitude), np.cos(latitude)
    normal_m = SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin * sin)
    return np.column_stack(
        (sin, cos, longitude, normal_m * cos, normal_m * (1.0 - ECCENTRICITY_SQUARED) * sin)
    )


@compiled
def east_north(origin: NDArray[np.float64], latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
    """East and north [m] of a point in the tangent plane of an origin (5,).

    Infinite where the point is more than 100 km off, so that nothing of the other side of the earth seems near, and
    where it is not a number.
    """
    sin, cos = math.sin(latitude_rad), math.cos(latitude_rad)
    turn_rad = longitude_rad - origin[2]
    cos_turn = math.cos(turn_rad)
    if not sin * origin[0] + cos * origin[1] * cos_turn > _COS_REACH:
        return math.inf, math.inf
    normal_m = SEMI_MAJOR_AXIS_M / math.sqrt(1.0 - ECCENTRICITY_SQUARED * sin * sin)
    axis_m, z_m = normal_m * cos, normal_m * (1.0 - ECCENTRICITY_SQUARED) * sin
    north_m = (z_m - origin[4]) * origin[1] - (axis_m * cos_turn - origin[3]) * origin[0]
    return axis_m * math.sin(turn_rad), north_m


def plane_series(latitude_rad: float, longitude_rad: float) -> NDArray[np.float64]:
    """What `east_north_near` takes of an origin: (9,), φ₀, λ₀, and the coefficients of r, from the zeroth, and of z."""
    sin, cos = math.sin(latitude_rad), math.cos(latitude_rad)
    w = 1.0 - ECCENTRICITY_SQUARED * sin * sin
    m = SEMI_MAJOR_AXIS_M * (1.0 - ECCENTRICITY_SQUARED) / (w * math.sqrt(w))
    m_1 = 3.0 * ECCENTRICITY_SQUARED * m * sin * cos / w
    turn = (
        m_1 * sin * cos + m * (cos * cos - sin * sin) + 2.0 * ECCENTRICITY_SQUARED * m * (sin * cos) ** 2 / w
    )
    m_2 = 3.0 * ECCENTRICITY_SQUARED * turn / w
    r = (-m * sin, (-m_1 * sin - m * cos) / 2.0, (-m_2 * sin - 2.0 * m_1 * cos + m * sin) / 6.0)
    z = (m * cos, (m_1 * cos - m * sin) / 2.0, (m_2 * cos - 2.0 * m_1 * sin - m * cos) / 6.0)
    return np.array([latitude_rad, longitude_rad, SEMI_MAJOR_AXIS_M / math.sqrt(w) * cos, *r, *z])


@compiled
def east_north_near(
    series: NDArray[np.float64], origin: NDArray[np.float64], latitude_rad: float, longitude_rad: float
) -> tuple[float, float]:
    """`east_north`, several times as fast near the origin."""
    up_rad, turn_rad = latitude_rad - series[0], longitude_rad - series[1]
    if not (abs(up_rad) <= _SERIES_REACH_RAD and abs(turn_rad) <= _SERIES_REACH_RAD):
        return east_north(origin, latitude_rad, longitude_rad)
    farther_m = up_rad * (series[3] + up_rad * (series[4] + up_rad * series[5]))
    higher_m = up_rad * (series[6] + up_rad * (series[7] + up_rad * series[8]))
    axis_m, turn_2 = series[2] + farther_m, turn_rad * turn_rad
    north_m = higher_m * origin[1] - (farther_m - 0.5 * axis_m * turn_2) * origin[0]
    return axis_m * turn_rad * (1.0 - turn_2 / 6.0), north_m
