"""A position solved by a receiver or another program, as `.pos` files, NMEA, UBX and SBF streams contain it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from camber.geodesy.covariance import EnuCovariance

Fields = dict[str, Any]
"""Fields of a `ReceiverSolution`, or of a `ReceiverIntegrity`, that one message of a receiver contains."""
_MIN_HEIGHT_M, _MAX_HEIGHT_M = (
    -20_000.0,
    100_000.0,
)  # chosen: far beyond vehicles, so that only damage exceeds them


class SolutionQuality(IntEnum):
    """Type of a solution, in the numbers of RTKLIB's `.pos` (solution status Q). NMEA numbers differ."""

    FIX = 1
    FLOAT = 2
    SBAS = 3
    DGPS = 4
    SINGLE = 5
    PPP = 6
    DEAD_RECKONING = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceiverSolution:
    """One epoch of a receiver's solution; None where the source does not contain a value.

    `time_ns` is GPS time, `height_m` above the ellipsoid (WGS 84). Covariances are (ee, en, eu, nn, nu, uu).
    `age_s` is the correction age, `ratio` that of the ambiguity ratio test, `station` the source's name of the base
    station.
    """

    time_ns: int
    latitude_rad: float
    longitude_rad: float
    height_m: float
    quality: SolutionQuality
    satellites: int | None = None
    covariance_enu_m2: EnuCovariance | None = None
    age_s: float | None = None
    ratio: float | None = None
    velocity_enu_m_s: tuple[float, float, float] | None = None
    velocity_covariance_enu_m2_s2: EnuCovariance | None = None
    station: str | None = None


def checked_position(latitude_rad: float, longitude_rad: float, height_m: float) -> Fields:
    """Return the position as fields of `ReceiverSolution`; ValueError for one that is not near the Earth."""
    in_range = abs(latitude_rad) <= math.pi / 2 and abs(longitude_rad) <= math.pi
    if not (in_range and _MIN_HEIGHT_M <= height_m <= _MAX_HEIGHT_M):
        raise ValueError(f"position {latitude_rad} rad, {longitude_rad} rad, {height_m} m")
    return {"latitude_rad": latitude_rad, "longitude_rad": longitude_rad, "height_m": height_m}


def covariance_from_accuracies(horizontal_m: float, vertical_m: float) -> EnuCovariance:
    """Return the covariance of a horizontal error √(σ_e² + σ_n²) and a σ_u: σ_e = σ_n, uncorrelated, is assumed."""
    axis = 0.5 * horizontal_m * horizontal_m
    return axis, 0.0, 0.0, axis, 0.0, vertical_m * vertical_m
