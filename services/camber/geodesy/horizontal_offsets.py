"""Small offsets between points some hundred metres apart at most, in east and north metres."""

from __future__ import annotations

import math

from camber.geodesy.angles import wrap_pi
from camber.geodesy.ellipsoid import meridian_radius_m, prime_vertical_radius_m


def east_north_between(
    from_latitude_rad: float,
    from_longitude_rad: float,
    to_latitude_rad: float,
    to_longitude_rad: float,
    height_m: float = 0.0,
) -> tuple[float, float]:
    """East and north metres from one point to another near it, at an ellipsoidal height.

    First order in the radii of curvature at the mean latitude, the same there and back. East and north turn with the
    meridians: against the tangent plane at the first point that is distance² × tan(latitude) / 2 earth radii, at 35°
    half a millimetre at 100 m and 5 cm at 1 km. Farther away use `LocalFrame`.
    """
    middle = 0.5 * (from_latitude_rad + to_latitude_rad)
    east = (prime_vertical_radius_m(middle) + height_m) * math.cos(middle)
    north = meridian_radius_m(middle) + height_m
    return east * wrap_pi(to_longitude_rad - from_longitude_rad), north * (
        to_latitude_rad - from_latitude_rad
    )


def place_at(
    latitude_rad: float, longitude_rad: float, east_m: float, north_m: float, *, height_m: float = 0.0
) -> tuple[float, float]:
    """Latitude and longitude [rad] of the point that far from another: the inverse of `east_north_between`."""
    to_latitude_rad = latitude_rad + north_m / (meridian_radius_m(latitude_rad) + height_m)
    middle = 0.5 * (latitude_rad + to_latitude_rad)
    around_m = (prime_vertical_radius_m(middle) + height_m) * math.cos(middle)
    return to_latitude_rad, wrap_pi(longitude_rad + east_m / around_m)
