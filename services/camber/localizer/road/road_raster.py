"""The height of the road from the map's road cloud, roads above one another kept apart.

`RoadHeights` holds all roads of a block; `RoadSurface` is the one that can be driven from a position on it, with its
continuation: one height for each position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.localizer.road.road_planes import (
    ALONG_PLANE_M,
    CELL_M,
    OUTWARDS_M,
    Floats,
    Integers,
    RoadRaster,
    cells_between,
    centre_from,
    plane_height,
    road_raster,
)

_JOIN_M: Final = 0.2  # chosen: planes of neighbouring cells that meet within this are of one road
_CROSSFALL: Final = 0.03  # chosen: error of a continued height per metre


class RoadElevation(NamedTuple):
    """The road at a position: height and slopes, σ of the height, and distance to the nearest cell with this road."""

    height_m: float
    slope_east: float
    slope_north: float
    sigma_m: float
    distance_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RoadSurface:
    """One road from where the vehicle is, one height for each position: a raster with a single level."""

    _raster: RoadRaster
    _start: int

    def height_above(self, points_m: Floats) -> Floats:
        """Return the height of points (n, 3) above this road (n,); NaN where it is not known."""
        return points_m[:, 2] - _nearest_heights(points_m, self._raster)

    def holds(self, plane: int) -> bool:
        """Whether a plane of the raster is part of this surface."""
        row, column = divmod(int(self._raster.cell_of[plane]), self._raster.slots.shape[1])
        return bool(self._raster.slots[row, column, 0] == plane)


@dataclass(slots=True, eq=False)
class RoadHeights:
    """All roads of a block, heights and positions in its frame."""

    _raster: RoadRaster
    _last: RoadSurface | None = None

    @classmethod
    def of(cls, road_m: Floats) -> RoadHeights:
        """Build the raster from points of road surfaces (k, 3)."""
        return cls(road_raster(road_m))

    def elevation(self, east_m: float, north_m: float, near_height_m: float) -> RoadElevation | None:
        """Return the road at a position, of several the one nearest to a height; None: no road is known there."""
        roads = _roads_at(east_m, north_m, self._raster)
        if not len(roads):
            return None
        return RoadElevation(*roads[np.argmin(np.abs(roads[:, 0] - near_height_m))].tolist())

    def surface_through(self, east_m: float, north_m: float, height_m: float) -> RoadSurface | None:
        """Return the road that passes a position within 1.5 m of a height, and all that can be reached from it.

        Where two of its parts lie above one another, the nearer one along the road is taken. None: no road
        passes there.
        """
        start = _nearest_plane(east_m, north_m, height_m, within_m=1.5, raster=self._raster)
        if start < 0:
            return None
        last = self._last
        if last is not None and (last._start == start or (self._is_single() and last.holds(start))):
            return last
        reached = self._raster._replace(slots=_reached_from(start, self._raster))
        self._last = RoadSurface(_raster=reached, _start=start)
        return self._last

    def height_above_road(self, points_m: Floats) -> Floats:
        """Return the height of points (n, 3) above the road below them (n,); NaN where none is known.

        Of several roads the highest that is not more than 0.3 m above the point, else the lowest.
        """
        return points_m[:, 2] - _heights_below(points_m, self._raster)

    def within(self, points_m: Floats, low_m: float, high_m: float) -> NDArray[np.bool_]:
        """Return which points (n, 3) are between two heights above any of the roads there."""
        return _between(points_m, self._raster, low_m, high_m)

    def _is_single(self) -> bool:
        return bool((self._raster.road_count <= 1).all())


@compiled_without_gil
def _cell(east_m: float, north_m: float, raster: RoadRaster) -> tuple[int, int]:
    """Return row and column of the cell at a position; (−1, −1) outside."""
    row, column = int((north_m - raster.corner_m[1]) // CELL_M), int((east_m - raster.corner_m[0]) // CELL_M)
    if 0 <= row < raster.slots.shape[0] and 0 <= column < raster.slots.shape[1]:
        return row, column
    return -1, -1


@compiled_without_gil
def _nearest_in_cell(
    cell: tuple[int, int],
    position_m: tuple[float, float],
    height_m: float,
    within_m: float,
    raster: RoadRaster,
) -> int:
    """Return the number of a cell's plane that is nearest to a height at a position; −1: none within."""
    best, least = -1, within_m
    for s in range(raster.slots.shape[2]):
        k = raster.slots[cell[0], cell[1], s]
        if k < 0:
            continue
        away = abs(plane_height(raster.planes, k, position_m[0], position_m[1]) - height_m)
        if away < least:
            best, least = k, away
    return best


@compiled_without_gil
def _nearest_plane(
    east_m: float, north_m: float, height_m: float, within_m: float, raster: RoadRaster
) -> int:
    """Return the number of the plane at a position that is nearest to a height; −1: none within."""
    cell = _cell(east_m, north_m, raster)
    if cell[0] < 0:
        return -1
    return _nearest_in_cell(cell, (east_m, north_m), height_m, within_m=within_m, raster=raster)


@compiled_without_gil
def _reached_from(start: int, raster: RoadRaster) -> Integers:
    """Return for each cell the plane (rows, columns, 1) that is reached first: over the road, then over the rest."""
    cell_of = raster.cell_of
    rows, columns, _ = raster.slots.shape
    size = rows * columns
    reached = np.full((rows, columns, 1), -1, np.int32)
    on_road = np.zeros((rows, columns), np.bool_)
    road = np.empty(size + 1, np.int32)  # cells in the order in which the road reaches them
    road_head, road_tail = 0, 1
    road[0] = cell_of[start]
    reached[road[0] // columns, road[0] % columns, 0] = start
    on_road[road[0] // columns, road[0] % columns] = True
    outside = np.empty(size, np.int32)  # cells next to it, as a ring; none is in it twice
    queued = np.zeros(size, np.bool_)
    head, waiting = 0, 0
    while road_head < road_tail or waiting:
        from_road = road_head < road_tail
        if from_road:
            cell = road[road_head]
            road_head += 1
        else:
            cell = outside[head]
            queued[cell] = False
            head = (head + 1) % size
            waiting -= 1
        k = reached[cell // columns, cell % columns, 0]
        for step in range(9):
            row, column = cell // columns + step // 3 - 1, cell % columns + step % 3 - 1
            if not (0 <= row < rows and 0 <= column < columns) or on_road[row, column]:
                continue
            far = cells_between(row, column, k, raster)
            if far * CELL_M > OUTWARDS_M:
                continue
            best = _continued_by(k, row, column, from_road, raster=raster)
            if best >= 0:
                reached[row, column, 0] = best
                on_road[row, column] = True
                road[road_tail] = row * columns + column
                road_tail += 1
                continue
            known = reached[row, column, 0]
            if known >= 0 and cells_between(row, column, known, raster) <= far:
                continue
            reached[row, column, 0] = k
            place = row * columns + column
            if not queued[place]:
                outside[(head + waiting) % size] = place
                queued[place] = True
                waiting += 1
    return reached


@compiled_without_gil
def _continued_by(k: int, row: int, column: int, from_road: bool, raster: RoadRaster) -> int:
    """Return the plane of a cell in which the road of plane `k` continues; −1: none.

    A gap in the cloud is bridged where the road continues as it ended, within the error of its slope.
    """
    planes = raster.planes
    east, north = centre_from(k, row, column, raster)
    far = cells_between(row, column, k, raster)
    best, least = -1, _JOIN_M if from_road else min(_JOIN_M + 0.05 * far, 1.0)
    for s in range(raster.road_count[row, column]):
        other = raster.slots[row, column, s]
        if from_road:
            e, n = 0.5 * (planes[k, 0] + east), 0.5 * (planes[k, 1] + north)
            gap = abs(plane_height(planes, other, e, n) - plane_height(planes, k, e, n))
        else:
            gap = abs(planes[other, 2] - plane_height(planes, k, east, north))
        if gap < least:
            best, least = other, gap
    return best


@compiled_without_gil
def _roads_at(east_m: float, north_m: float, raster: RoadRaster) -> Floats:
    """Return the roads at a position (levels, 5): height, slopes, σ, distance."""
    roads = np.empty((raster.slots.shape[2], 5))
    row, column = _cell(east_m, north_m, raster)
    at = 0
    for s in range(raster.slots.shape[2] if row >= 0 else 0):
        if raster.slots[row, column, s] >= 0:
            _blend((east_m, north_m), raster.slots[row, column, s], raster, out=roads[at])
            at += 1
    return roads[:at]


@compiled_without_gil
def _blend(position_m: tuple[float, float], first: int, raster: RoadRaster, out: Floats) -> None:
    """Fill `out` (5,) with the mean at a position of the planes around that continue plane `first`."""
    planes, (east_m, north_m) = raster.planes, position_m
    near = plane_height(planes, first, east_m, north_m)
    x, y = (east_m - raster.corner_m[0]) / CELL_M - 0.5, (north_m - raster.corner_m[1]) / CELL_M - 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    u, v = x - column, y - row
    out[:] = 0.0
    total = 0.0
    for corner in range(4):
        r, c = row + corner // 2, column + corner % 2
        if not (0 <= r < raster.slots.shape[0] and 0 <= c < raster.slots.shape[1]):
            continue
        best = _nearest_in_cell((r, c), position_m, near, within_m=0.5, raster=raster)
        if best < 0:
            continue
        weight = (v if corner // 2 else 1.0 - v) * (u if corner % 2 else 1.0 - u)
        far = np.hypot(planes[best, 0] - east_m, planes[best, 1] - north_m)
        total += weight
        out[0] += weight * plane_height(planes, best, east_m, north_m)
        if far <= ALONG_PLANE_M:
            out[1] += weight * planes[best, 3]
            out[2] += weight * planes[best, 4]
        outside = max(far - CELL_M, 0.0)
        out[3] += weight * (planes[best, 5] + _CROSSFALL * outside)
        out[4] += weight * outside
    if total > 0.0:
        out /= total
    else:
        out[0] = near


@compiled_without_gil
def _nearest_heights(points_m: Floats, raster: RoadRaster) -> Floats:
    """Return the height (n,) of the road at points (n, 3) that is nearest to each; NaN where there is none."""
    heights = np.full(len(points_m), np.nan)
    for i in range(len(points_m)):
        east, north = points_m[i, 0], points_m[i, 1]
        k = _nearest_plane(east, north, points_m[i, 2], within_m=np.inf, raster=raster)
        if k >= 0:
            heights[i] = plane_height(raster.planes, k, east, north)
    return heights


@compiled_without_gil
def _heights_below(points_m: Floats, raster: RoadRaster) -> Floats:
    """Return the height (n,) of the highest road not more than 0.3 m above each point (n, 3), else of the lowest."""
    heights = np.full(len(points_m), np.nan)
    for i in range(len(points_m)):
        row, column = _cell(points_m[i, 0], points_m[i, 1], raster)
        below = -np.inf
        lowest = np.inf
        for s in range(raster.slots.shape[2] if row >= 0 else 0):
            k = raster.slots[row, column, s]
            if k >= 0:
                height = plane_height(raster.planes, k, points_m[i, 0], points_m[i, 1])
                lowest = min(lowest, height)
                if height <= points_m[i, 2] + 0.3:
                    below = max(below, height)
        if np.isfinite(lowest):
            heights[i] = below if np.isfinite(below) else lowest
    return heights


@compiled_without_gil
def _between(points_m: Floats, raster: RoadRaster, low_m: float, high_m: float) -> NDArray[np.bool_]:
    between = np.zeros(len(points_m), np.bool_)
    for i in range(len(points_m)):
        row, column = _cell(points_m[i, 0], points_m[i, 1], raster)
        for s in range(raster.slots.shape[2] if row >= 0 else 0):
            k = raster.slots[row, column, s]
            if k >= 0:
                height = points_m[i, 2] - plane_height(raster.planes, k, points_m[i, 0], points_m[i, 1])
                if low_m <= height <= high_m:
                    between[i] = True
                    break
    return between
