"""A position solved inside a receiver or by another program: what `.pos` files and NMEA streams both say."""

from dataclasses import dataclass
from enum import IntEnum

from camber.geodesy.covariance import EnuCovariance


class SolutionQuality(IntEnum):
    """How a solution was made, in the numbers of RTKLIB's `.pos` (solution status Q). NMEA numbers differ."""

    FIX = 1
    FLOAT = 2
    SBAS = 3
    DGPS = 4
    SINGLE = 5
    PPP = 6
    DEAD_RECKONING = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceiverSolution:
    """One epoch of a receiver-side solution. What the source did not say is None.

    `time_ns` is GPS time, `height_m` above the ellipsoid (WGS 84). Covariances are (ee, en, eu, nn, nu, uu).
    `age_s` is the age of the corrections, `ratio` the ratio of the ambiguity test,
    `station` the reference station of the corrections as the source calls it.
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
