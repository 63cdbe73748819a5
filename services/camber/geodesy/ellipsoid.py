"""Latitude, longitude and ellipsoidal height on WGS 84 to and from earth-centred, earth-fixed coordinates.

Each conversion comes twice: for arrays, and as `…_scalar` for one point on plain floats, which is many times
faster than a numpy call on one element and is what runs at every epoch.

Sources: NIMA TR8350.2, "Department of Defense World Geodetic System 1984", table 3.1 (constants);
B. R. Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23 (1976), eq. 5.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

SEMI_MAJOR_AXIS_M = 6378137.0  # NIMA TR8350.2
FLATTENING = 1.0 / 298.257223563  # NIMA TR8350.2
SEMI_MINOR_AXIS_M = SEMI_MAJOR_AXIS_M * (1.0 - FLATTENING)
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)

# Deeper than any position on the road and far outside the evolute (43 km), where the inverse is ambiguous.
# It also refuses the (0, 0, 0) by which receivers say "no solution".
MINIMUM_RADIUS_M = 6.0e6

# From the first guess, which is exact on the surface, each step gains a factor of about e⁴ h / R: after three
# the error is below the rounding of a double from 350 km under the surface up to the satellites.
_BOWRING_STEPS = 3

_ONE_MINUS_F = 1.0 - FLATTENING
_POLAR_TERM_M = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED) * SEMI_MINOR_AXIS_M
_EQUATORIAL_TERM_M = ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS_M


def meridian_radius_m(latitude_rad: float) -> float:
    """Radius of curvature along the meridian, M = a (1 − e²) / (1 − e² sin²φ)^(3/2)."""
    s = math.sin(latitude_rad)
    w = 1.0 - ECCENTRICITY_SQUARED * s * s
    return SEMI_MAJOR_AXIS_M * (1.0 - ECCENTRICITY_SQUARED) / (w * math.sqrt(w))


def prime_vertical_radius_m(latitude_rad: float) -> float:
    """Radius of curvature across the meridian, N = a / √(1 − e² sin²φ)."""
    s = math.sin(latitude_rad)
    return SEMI_MAJOR_AXIS_M / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s * s)


def ecef_from_geodetic_scalar(
    latitude_rad: float, longitude_rad: float, height_m: float
) -> tuple[float, float, float]:
    """ECEF x, y, z in metres of one point; `height_m` is above the ellipsoid."""
    sin_latitude, cos_latitude = math.sin(latitude_rad), math.cos(latitude_rad)
    normal_m = SEMI_MAJOR_AXIS_M / math.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_latitude * sin_latitude)
    axis_distance_m = (normal_m + height_m) * cos_latitude
    return (
        axis_distance_m * math.cos(longitude_rad),
        axis_distance_m * math.sin(longitude_rad),
        (normal_m * (1.0 - ECCENTRICITY_SQUARED) + height_m) * sin_latitude,
    )


def geodetic_from_ecef_scalar(x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
    """Latitude [rad], longitude [rad] in (−π, π] and ellipsoidal height [m] of one ECEF point.

    Good to the rounding of a double (1e-9 m near the surface), at the poles and the antimeridian too. On the
    axis itself the longitude is that of atan2(0, 0), zero.
    Raises ValueError below `MINIMUM_RADIUS_M` from the centre and for anything that is not finite.
    """
    radius_m = math.sqrt(x_m * x_m + y_m * y_m + z_m * z_m)
    if not MINIMUM_RADIUS_M <= radius_m < math.inf:
        raise ValueError(
            f"point is {radius_m} m from the centre of the earth, expected {MINIMUM_RADIUS_M} m or more"
        )
    latitude_rad, height_m = latitude_height(math.hypot(x_m, y_m), z_m)
    longitude_rad = math.atan2(y_m, x_m)
    return latitude_rad, longitude_rad if longitude_rad > -math.pi else math.pi, height_m


def latitude_height(axis_distance_m: float, z_m: float) -> tuple[float, float]:
    """Latitude [rad] and ellipsoidal height [m] of a point at a distance from the axis; may be compiled.

    No check: only outside `MINIMUM_RADIUS_M` is the result right.
    """
    # Sine and cosine of the parametric latitude β are carried, not β: no trigonometry, nothing special at
    # poles.
    s, c = z_m, axis_distance_m * _ONE_MINUS_F
    for _ in range(_BOWRING_STEPS):
        norm = math.hypot(s, c)
        sin_beta, cos_beta = s / norm, c / norm
        sin_part = z_m + _POLAR_TERM_M * sin_beta * sin_beta * sin_beta
        cos_part = axis_distance_m - _EQUATORIAL_TERM_M * cos_beta * cos_beta * cos_beta
        s, c = _ONE_MINUS_F * sin_part, cos_part
    norm = math.hypot(sin_part, cos_part)
    sin_latitude, cos_latitude = sin_part / norm, cos_part / norm
    height_m = (
        axis_distance_m * cos_latitude
        + z_m * sin_latitude
        - SEMI_MAJOR_AXIS_M * math.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_latitude * sin_latitude)
    )
    return math.atan2(sin_part, cos_part), height_m


def ecef_from_geodetic(
    latitude_rad: ArrayLike, longitude_rad: ArrayLike, height_m: ArrayLike
) -> NDArray[np.float64]:
    """ECEF coordinates (n, 3) in metres of points given as three arrays (n,) (or broadcastable to it)."""
    latitude, longitude, height = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(a, dtype=np.float64)) for a in (latitude_rad, longitude_rad, height_m))
    )
    if latitude.ndim != 1:
        raise ValueError(f"latitude, longitude and height have shape {latitude.shape}, expected (n,)")
    sin_latitude = np.sin(latitude)
    normal_m = SEMI_MAJOR_AXIS_M / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_latitude**2)
    axis_distance_m = (normal_m + height) * np.cos(latitude)
    return np.column_stack(
        (
            axis_distance_m * np.cos(longitude),
            axis_distance_m * np.sin(longitude),
            (normal_m * (1.0 - ECCENTRICITY_SQUARED) + height) * sin_latitude,
        )
    )


def geodetic_from_ecef(
    ecef_m: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Latitudes [rad], longitudes (−π, π] [rad], ellipsoidal heights [m], each (n,), of ECEF points (n, 3).

    As `geodetic_from_ecef_scalar`, and raises ValueError where any point would raise there.
    """
    points = np.asarray(ecef_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"ecef_m has shape {points.shape}, expected (n, 3)")
    x, y, z = points.T
    axis_distance_m = np.hypot(x, y)
    radius_m = np.hypot(axis_distance_m, z)
    if not bool(np.all((radius_m >= MINIMUM_RADIUS_M) & (radius_m < np.inf))):
        raise ValueError(
            f"ecef_m has a point that is not finite or nearer than {MINIMUM_RADIUS_M} m to the centre"
        )
    sin_part, cos_part = z, axis_distance_m
    s, c = z, axis_distance_m * _ONE_MINUS_F
    for _ in range(_BOWRING_STEPS):
        norm = np.hypot(s, c)
        sin_part = z + _POLAR_TERM_M * (s / norm) ** 3
        cos_part = axis_distance_m - _EQUATORIAL_TERM_M * (c / norm) ** 3
        s, c = _ONE_MINUS_F * sin_part, cos_part
    norm = np.hypot(sin_part, cos_part)
    sin_latitude, cos_latitude = sin_part / norm, cos_part / norm
    height_m = (
        axis_distance_m * cos_latitude
        + z * sin_latitude
        - SEMI_MAJOR_AXIS_M * np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_latitude**2)
    )
    longitude_rad = np.arctan2(y, x)
    longitude_rad = np.where(longitude_rad > -np.pi, longitude_rad, np.pi)
    return np.arctan2(sin_part, cos_part), longitude_rad, height_m
