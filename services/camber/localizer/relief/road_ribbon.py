"""The map's road along the driven way, as the planes that the pose's roads were: enough for shifts of tens of metres
along it and of a lane across."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.localizer.arrays import Floats, Integers
from camber.localizer.relief.terrain import TerrainHeights

_REACH_M = 6.0  # chosen: half of the spacing along, and to the edge of a lane across; there a road is a plane
_CELL_M = 2.0  # chosen: places of one cell have the same plane
_CHUNK = 128  # chosen: with 1,500 planes 1.5 MB of distances


class RibbonPlane(NamedTuple):
    """The map's road about a place (m): elevation and σ (m), slopes east and north. No height but the map's."""

    east_m: float
    north_m: float
    elevation_m: float
    sigma_m: float
    slope_east: float
    slope_north: float


class RoadRibbon:
    """Planes every few metres; unknown beyond the reach of the nearest one."""

    def __init__(self, planes: list[RibbonPlane]) -> None:
        self._planes: Floats = np.array(planes)
        self._middle = self._planes[:, :2].mean(axis=0)
        self._from_middle = self._planes[:, :2] - self._middle
        self._half_square = 0.5 * (self._from_middle**2).sum(axis=1)

    def at(self, east_m: Floats, north_m: Floats) -> TerrainHeights:
        """Return the road at places (..., n)."""
        places = np.stack(np.broadcast_arrays(east_m, north_m), axis=-1)
        cells, cell = np.unique(
            np.round(places.reshape(-1, 2) / _CELL_M).astype(np.int64), axis=0, return_inverse=True
        )
        centres = np.asarray(cells * _CELL_M, np.float64)
        nearest = self._planes[self._nearest(centres)[cell.reshape(places.shape[:-1])]]
        from_plane = places - nearest[..., :2]
        known = np.hypot(from_plane[..., 0], from_plane[..., 1]) <= _REACH_M
        rise = (from_plane * nearest[..., 4:]).sum(-1)
        elevation = np.where(known, nearest[..., 2] + rise, np.nan)
        return TerrainHeights(elevation, nearest[..., 4], nearest[..., 5])

    def _nearest(self, places: Floats) -> Integers:
        """Return the index (n,) of the plane that is nearest to each place (n, 2)."""
        index = np.empty(len(places), np.int64)
        for begin in range(0, len(places), _CHUNK):
            # |x - p|² = |x|² - 2 (x · p - |p|² / 2): the nearest plane has the largest difference.
            nearness = (
                places[begin : begin + _CHUNK] - self._middle
            ) @ self._from_middle.T - self._half_square
            index[begin : begin + _CHUNK] = np.argmax(nearness, axis=1)
        return index
