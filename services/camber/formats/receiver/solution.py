"""A position solved by a receiver or another program, as `.pos` files, NMEA and UBX streams contain it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from camber.geodesy.covariance import EnuCovariance

Fields = dict[str, Any]
"""Fields of a `ReceiverSolution`, or of a `ReceiverIntegrity`, that one message of a receiver contains."""


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
