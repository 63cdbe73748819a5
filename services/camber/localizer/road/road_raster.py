"""Road raster: the height of the road from the map's road cloud, roads above one another kept apart.

A cell of the raster holds a plane for each road that crosses it, fitted to the means of the cells around. Heights of
different roads are never averaged. Next to the roads their height is continued outwards: by the plane for
`_ALONG_PLANE_M`, from there on level, so that crossfall and camber do not run away.

`RoadHeights` holds all roads of a block; `RoadSurface` is the one that can be driven from a position on it, with its
continuation: one height for each position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

LEVELS: Final = 3
"""Chosen: roads above one another that one cell can hold; of more the lowest are kept."""
LEAST_GAP_M: Final = 0.35
"""Derived: points of one cell this far apart in height are of different roads; a grade of 20 % makes 0.28 m."""
# Chosen: a cell holds several points of a thinned cloud; a local map's ground may lie 30 m off the mapped road.
CELL_M: Final = 1.0
OUTWARDS_M: Final = 30.0
_ALONG_PLANE_M: Final = 1.5  # chosen: one and a half cells
_REACH: Final = 2  # chosen: cells around to which a plane is fitted
_JOIN_M: Final = 0.2  # chosen: planes of neighbouring cells that meet within this are of one road
_SAME_ROAD_M: Final = 2.0  # chosen: a continuation ends where a road of about that height is
_LEAST_SIGMA_M: Final = 0.005  # chosen: roughness of a road
_CROSSFALL: Final = 0.03  # chosen: error of a continued height per metre


class RoadElevation(NamedTuple):
    """The road at a position: height and slopes, σ of the height, and distance to the nearest cell with this road."""

    height_m: float
    slope_east: float
    slope_north: float
    sigma_m: float
    distance_m: float


class _RoadRaster(NamedTuple):
    """`planes` (k, 6): east, north of the cell's centre, height there, slopes, σ; `cell_of` (k,) its cell; `slots`
    (rows, columns, levels) numbers of planes, −1: none, those of the cell itself first; `road_count` (rows, columns)
    how many those are."""

    corner_m: Floats
    planes: Floats
    cell_of: Integers
    slots: Integers
    road_count: Integers


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RoadSurface:
    """One road from where the vehicle is, one height for each position: a raster with a single level."""

    _raster: _RoadRaster
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

    _raster: _RoadRaster
    _last: RoadSurface | None = None

    @classmethod
    def of(cls, road_m: Floats) -> RoadHeights:
        """Build the raster from points of road surfaces (k, 3)."""
        points = np.ascontiguousarray(road_m, np.float64).reshape(-1, 3)
        if not len(points):
            empty = np.full((1, 1, LEVELS), -1, np.int32)
            no_roads = np.zeros((1, 1), np.int32)
            return cls(_RoadRaster(np.zeros(2), np.zeros((0, 6)), no_roads[0, :0], empty, no_roads))
        corner = np.floor(points[:, :2].min(axis=0) / CELL_M) * CELL_M - OUTWARDS_M
        extent = np.ceil((points[:, :2].max(axis=0) - corner + OUTWARDS_M) / CELL_M).astype(int) + 1
        columns, rows = extent.tolist()
        means, cell_of, slots, road_count = _cells(points, corner, rows, columns)
        raster = _RoadRaster(corner, np.empty((len(means), 6)), cell_of, slots, road_count)
        _fit_planes(means, raster)
        _continue_outwards(raster)
        return cls(raster)

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
def _cells(
    points_m: Floats, corner_m: Floats, rows: int, columns: int
) -> tuple[Floats, Integers, Integers, Integers]:
    """Return means (k, 4) of the points of one road in one cell with their count; cell of each, slots, road counts."""
    n = len(points_m)
    cell = np.empty(n, np.int64)
    count = np.zeros(rows * columns + 1, np.int64)
    for i in range(n):
        column = int((points_m[i, 0] - corner_m[0]) / CELL_M)
        row = int((points_m[i, 1] - corner_m[1]) / CELL_M)
        cell[i] = row * columns + column
        count[cell[i] + 1] += 1
    begin = np.cumsum(count)
    at = begin[:-1].copy()
    sorted_rows = np.empty(n, np.int64)
    for i in range(n):
        sorted_rows[at[cell[i]]] = i
        at[cell[i]] += 1
    slots = np.full((rows, columns, LEVELS), -1, np.int32)
    road_count = np.zeros((rows, columns), np.int32)
    means = np.empty((n, 4))
    cell_of = np.empty(n, np.int32)
    n_planes = 0
    for c in range(rows * columns):
        if begin[c] == begin[c + 1]:
            continue
        members = sorted_rows[begin[c] : begin[c + 1]]
        members = members[np.argsort(points_m[members, 2])]
        first = 0
        levels = 0
        for i in range(1, len(members) + 1):
            ends = i == len(members)
            if ends or points_m[members[i], 2] - points_m[members[i - 1], 2] > LEAST_GAP_M:
                if levels < LEVELS:
                    for axis in range(3):
                        total = 0.0
                        for j in range(first, i):
                            total += points_m[members[j], axis]
                        means[n_planes, axis] = total / (i - first)
                    means[n_planes, 3] = i - first
                    cell_of[n_planes] = c
                    slots[c // columns, c % columns, levels] = n_planes
                    n_planes += 1
                    levels += 1
                first = i
        road_count[c // columns, c % columns] = levels
    return means[:n_planes].copy(), cell_of[:n_planes].copy(), slots, road_count


@compiled_without_gil
def _fit_planes(means: Floats, raster: _RoadRaster) -> None:
    """Fit the planes by weighted least squares, in place: through the next cells first, then through those around that
    agree with it, so that a neighbouring road that is a little higher does not raise it."""
    columns, planes = raster.slots.shape[1], raster.planes
    for k in range(len(means)):
        planes[k, 0] = raster.corner_m[0] + (raster.cell_of[k] % columns + 0.5) * CELL_M
        planes[k, 1] = raster.corner_m[1] + (raster.cell_of[k] // columns + 0.5) * CELL_M
        planes[k, 2] = means[k, 2]
        planes[k, 3:] = 0.0
        if _fit_plane(k, means, raster, reach=1, off_m=0.05, off_per_m=0.2) < 4:
            _fit_plane(k, means, raster, reach=_REACH, off_m=0.05, off_per_m=0.2)
        else:
            _fit_plane(k, means, raster, reach=_REACH, off_m=0.04, off_per_m=0.02)


@compiled_without_gil
def _fit_plane(k: int, means: Floats, raster: _RoadRaster, reach: int, off_m: float, off_per_m: float) -> int:
    """Fit plane `k` again to the cells in reach that are off it by no more than this; return their number."""
    slots, planes = raster.slots, raster.planes
    rows, columns, _ = slots.shape
    row, column = raster.cell_of[k] // columns, raster.cell_of[k] % columns
    m = np.zeros((3, 3))
    v = np.zeros(3)
    square = 0.0
    weights = 0.0
    cells = 0
    base = means[k, 2]
    for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
        for c in range(max(column - reach, 0), min(column + reach + 1, columns)):
            best, least = -1, np.inf
            for s in range(raster.road_count[r, c]):
                other = slots[r, c, s]
                e, n = means[other, 0] - planes[k, 0], means[other, 1] - planes[k, 1]
                off = abs(means[other, 2] - planes[k, 2] - planes[k, 3] * e - planes[k, 4] * n)
                if off < least:
                    best, least = other, off
            if best < 0:
                continue
            e, n, z = means[best, 0] - planes[k, 0], means[best, 1] - planes[k, 1], means[best, 2] - base
            away_m = np.hypot(means[best, 0] - means[k, 0], means[best, 1] - means[k, 1])
            if least > off_m + off_per_m * away_m:
                continue
            weight = min(means[best, 3], 10.0)
            a = (1.0, e, n)
            for i in range(3):
                for j in range(3):
                    m[i, j] += weight * a[i] * a[j]
                v[i] += weight * a[i] * z
            square += weight * z * z
            weights += weight
            cells += 1
    if not cells:
        return 0
    # A road of a single cell has no observable slope: it is level.
    m[1, 1] += 0.5
    m[2, 2] += 0.5
    x = _solved(m, v)
    planes[k, 2], planes[k, 3], planes[k, 4] = base + x[0], x[1], x[2]
    left = max(square - (x[0] * v[0] + x[1] * v[1] + x[2] * v[2]), 0.0)
    planes[k, 5] = np.sqrt(left / weights + _LEAST_SIGMA_M**2)
    return cells


@compiled_without_gil
def _solved(m: Floats, v: Floats) -> Floats:
    """Solve m x = v of a symmetric, positive matrix (3, 3) by Cramer's rule."""
    a = m[1, 1] * m[2, 2] - m[1, 2] ** 2
    b = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    d = m[0, 0] * m[2, 2] - m[0, 2] ** 2
    e = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    f = m[0, 0] * m[1, 1] - m[0, 1] ** 2
    determinant = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c
    x = np.empty(3)
    x[0] = (a * v[0] + b * v[1] + c * v[2]) / determinant
    x[1] = (b * v[0] + d * v[1] + e * v[2]) / determinant
    x[2] = (c * v[0] + e * v[1] + f * v[2]) / determinant
    return x


@compiled_without_gil
def _height(planes: Floats, k: int, east_m: float, north_m: float) -> float:
    """Return the height of a plane at a position: by its slope near its cell, level farther away."""
    east, north = east_m - planes[k, 0], north_m - planes[k, 1]
    far = np.hypot(east, north)
    if far > _ALONG_PLANE_M:
        east *= _ALONG_PLANE_M / far
        north *= _ALONG_PLANE_M / far
    return float(planes[k, 2] + planes[k, 3] * east + planes[k, 4] * north)


@compiled_without_gil
def _continue_outwards(raster: _RoadRaster) -> None:
    """Fill the slots next to the roads with the plane of the nearest cell of each road, in place."""
    planes, slots = raster.planes, raster.slots
    rows, columns, levels = slots.shape
    size = rows * columns * levels
    queue = np.empty(size, np.int32)  # of slots, as a ring; none is in it twice
    queued = np.zeros(size, np.bool_)
    head, waiting = 0, 0
    for k in range(len(planes)):
        row, column = raster.cell_of[k] // columns, raster.cell_of[k] % columns
        for s in range(raster.road_count[row, column]):
            if slots[row, column, s] == k:
                queue[waiting] = raster.cell_of[k] * levels + s
                queued[queue[waiting]] = True
                waiting += 1
    while waiting:
        cell, slot = queue[head] // levels, queue[head] % levels
        queued[queue[head]] = False
        head = (head + 1) % size
        waiting -= 1
        k = slots[cell // columns, cell % columns, slot]
        for step in range(9):
            row, column = cell // columns + step // 3 - 1, cell % columns + step % 3 - 1
            if not (0 <= row < rows and 0 <= column < columns):
                continue
            far = _cells_between(row, column, k, raster)
            if far * CELL_M > OUTWARDS_M:
                continue
            east, north = _centre_from(k, row, column, raster)
            height = _height(planes, k, east, north)
            for s in range(levels):
                other = slots[row, column, s]
                if other >= 0:
                    if abs(_height(planes, other, east, north) - height) > _SAME_ROAD_M:
                        continue
                    if (
                        s < raster.road_count[row, column]
                        or _cells_between(row, column, other, raster) <= far
                    ):
                        break
                slots[row, column, s] = k
                place = (row * columns + column) * levels + s
                if not queued[place]:
                    queue[(head + waiting) % size] = place
                    queued[place] = True
                    waiting += 1
                break


@compiled_without_gil
def _cells_between(row: int, column: int, k: int, raster: _RoadRaster) -> float:
    """Return the distance in cells from a cell to that of plane `k`."""
    cell, columns = raster.cell_of[k], raster.slots.shape[1]
    return float(np.hypot(row - cell // columns, column - cell % columns))


@compiled_without_gil
def _centre_from(k: int, row: int, column: int, raster: _RoadRaster) -> tuple[float, float]:
    """Return east and north of a cell's centre, relative to that of plane `k`."""
    cell, columns = raster.cell_of[k], raster.slots.shape[1]
    east = raster.planes[k, 0] + (column - cell % columns) * CELL_M
    return east, raster.planes[k, 1] + (row - cell // columns) * CELL_M


@compiled_without_gil
def _cell(east_m: float, north_m: float, raster: _RoadRaster) -> tuple[int, int]:
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
    raster: _RoadRaster,
) -> int:
    """Return the number of a cell's plane that is nearest to a height at a position; −1: none within."""
    best, least = -1, within_m
    for s in range(raster.slots.shape[2]):
        k = raster.slots[cell[0], cell[1], s]
        if k < 0:
            continue
        away = abs(_height(raster.planes, k, position_m[0], position_m[1]) - height_m)
        if away < least:
            best, least = k, away
    return best


@compiled_without_gil
def _nearest_plane(
    east_m: float, north_m: float, height_m: float, within_m: float, raster: _RoadRaster
) -> int:
    """Return the number of the plane at a position that is nearest to a height; −1: none within."""
    cell = _cell(east_m, north_m, raster)
    if cell[0] < 0:
        return -1
    return _nearest_in_cell(cell, (east_m, north_m), height_m, within_m=within_m, raster=raster)


@compiled_without_gil
def _reached_from(start: int, raster: _RoadRaster) -> Integers:
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
            far = _cells_between(row, column, k, raster)
            if far * CELL_M > OUTWARDS_M:
                continue
            best = _continued_by(k, row, column, from_road, raster)
            if best >= 0:
                reached[row, column, 0] = best
                on_road[row, column] = True
                road[road_tail] = row * columns + column
                road_tail += 1
                continue
            known = reached[row, column, 0]
            if known >= 0 and _cells_between(row, column, known, raster) <= far:
                continue
            reached[row, column, 0] = k
            place = row * columns + column
            if not queued[place]:
                outside[(head + waiting) % size] = place
                queued[place] = True
                waiting += 1
    return reached


@compiled_without_gil
def _continued_by(k: int, row: int, column: int, from_road: bool, raster: _RoadRaster) -> int:
    """Return the plane of a cell in which the road of plane `k` continues; −1: none.

    A gap in the cloud is bridged where the road continues as it ended, within the error of its slope.
    """
    planes = raster.planes
    east, north = _centre_from(k, row, column, raster)
    far = _cells_between(row, column, k, raster)
    best, least = -1, _JOIN_M if from_road else min(_JOIN_M + 0.05 * far, 1.0)
    for s in range(raster.road_count[row, column]):
        other = raster.slots[row, column, s]
        if from_road:
            e, n = 0.5 * (planes[k, 0] + east), 0.5 * (planes[k, 1] + north)
            gap = abs(_height(planes, other, e, n) - _height(planes, k, e, n))
        else:
            gap = abs(planes[other, 2] - _height(planes, k, east, north))
        if gap < least:
            best, least = other, gap
    return best


@compiled_without_gil
def _roads_at(east_m: float, north_m: float, raster: _RoadRaster) -> Floats:
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
def _blend(position_m: tuple[float, float], first: int, raster: _RoadRaster, out: Floats) -> None:
    """Fill `out` (5,) with the mean at a position of the planes around that continue plane `first`."""
    planes, (east_m, north_m) = raster.planes, position_m
    near = _height(planes, first, east_m, north_m)
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
        out[0] += weight * _height(planes, best, east_m, north_m)
        if far <= _ALONG_PLANE_M:
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
def _nearest_heights(points_m: Floats, raster: _RoadRaster) -> Floats:
    """Return the height (n,) of the road at points (n, 3) that is nearest to each; NaN where there is none."""
    heights = np.full(len(points_m), np.nan)
    for i in range(len(points_m)):
        east, north = points_m[i, 0], points_m[i, 1]
        k = _nearest_plane(east, north, points_m[i, 2], within_m=np.inf, raster=raster)
        if k >= 0:
            heights[i] = _height(raster.planes, k, east, north)
    return heights


@compiled_without_gil
def _heights_below(points_m: Floats, raster: _RoadRaster) -> Floats:
    """Return the height (n,) of the highest road not more than 0.3 m above each point (n, 3), else of the lowest."""
    heights = np.full(len(points_m), np.nan)
    for i in range(len(points_m)):
        row, column = _cell(points_m[i, 0], points_m[i, 1], raster)
        below = -np.inf
        lowest = np.inf
        for s in range(raster.slots.shape[2] if row >= 0 else 0):
            k = raster.slots[row, column, s]
            if k >= 0:
                height = _height(raster.planes, k, points_m[i, 0], points_m[i, 1])
                lowest = min(lowest, height)
                if height <= points_m[i, 2] + 0.3:
                    below = max(below, height)
        if np.isfinite(lowest):
            heights[i] = below if np.isfinite(below) else lowest
    return heights


@compiled_without_gil
def _between(points_m: Floats, raster: _RoadRaster, low_m: float, high_m: float) -> NDArray[np.bool_]:
    between = np.zeros(len(points_m), np.bool_)
    for i in range(len(points_m)):
        row, column = _cell(points_m[i, 0], points_m[i, 1], raster)
        for s in range(raster.slots.shape[2] if row >= 0 else 0):
            k = raster.slots[row, column, s]
            if k >= 0:
                height = points_m[i, 2] - _height(raster.planes, k, points_m[i, 0], points_m[i, 1])
                if low_m <= height <= high_m:
                    between[i] = True
                    break
    return between
