"""The map's elevation about a place, as the relief's estimators use it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

from camber.localizer.arrays import Floats


class TerrainHeights(NamedTuple):
    """The map's road at places (...): elevation (m) and its slopes to east and north; NaN where no road is known."""

    elevation_m: Floats
    slope_east: Floats
    slope_north: Floats


TerrainAt: TypeAlias = Callable[[Floats, Floats], TerrainHeights]
"""The road of each of n observations at places east, north (..., n) in m near it: of the surface that it is driven
on, chosen without any height."""
