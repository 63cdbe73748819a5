"""The satellites of one epoch as a receiver itself reports them: direction, C/N0, and use in its position."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from camber.formats.receiver.solution import SolutionQuality
from camber.schemas.gnss import SatelliteUse


class ReportedSatellite(NamedTuple):
    """One satellite, numbered as in `camber.formats.observations`; None where the receiver does not report a value.

    `direction_rad` is azimuth, clockwise from north, and elevation; `cn0_dbhz` that of its strongest signal, None also
    where none is tracked.
    """

    satellite: int
    direction_rad: tuple[float, float] | None
    cn0_dbhz: float | None
    use: SatelliteUse


@dataclass(frozen=True, slots=True, kw_only=True)
class SatelliteReport:
    """All satellites that the receiver lists at one epoch, each once; `quality` None: it has no position then."""

    time_ns: int
    quality: SolutionQuality | None
    satellites: tuple[ReportedSatellite, ...]


def direction_rad(azimuth_deg: float | None, elevation_deg: float | None) -> tuple[float, float] | None:
    """Return azimuth and elevation; None where one is not known, or no angle, as receivers write the unknown."""
    if azimuth_deg is None or elevation_deg is None:
        return None
    if not (0.0 <= azimuth_deg <= 360.0 and -90.0 <= elevation_deg <= 90.0):
        return None
    return math.radians(azimuth_deg), math.radians(elevation_deg)
