"""Planes of the road raster: fitted to the map's road cloud cell by cell, and continued outwards.

A cell holds a plane for each road that crosses it, fitted to the means of the cells around. Heights of different roads
are never averaged. Next to the roads their height is continued outwards: by the plane for `ALONG_PLANE_M`, from there
on level, so that crossfall and camber do not run away.
"""

from __future__ import annotations

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
ALONG_PLANE_M: Final = 1.5  # chosen: one and a half cells
_REACH: Final = 2  # chosen: cells around to which a plane is fitted
_SAME_ROAD_M: Final = 2.0  # chosen: a continuation ends where a road of about that height is
_LEAST_SIGMA_M: Final = 0.005  # chosen: roughness of a road


class RoadRaster(NamedTuple):
    """`planes` (k, 6): east, north of the cell's centre, height there, slopes, σ; `cell_of` (k,) its cell; `slots`
    (rows, columns, levels) numbers of planes, −1: none, those of the cell itself first; `road_count` (rows, columns)
    how many those are."""

    corner_m: Floats
    planes: Floats
    cell_of: Integers
    slots: Integers
    road_count: Integers


def road_raster(road_m: Floats) -> RoadRaster:
    """Build the raster from points of road surfaces (k, 3)."""
    points = np.ascontiguousarray(road_m, np.float64).reshape(-1, 3)
    corner_m, rows, columns = np.zeros(2), 1, 1
    if len(points):
        corner_m = np.floor(points[:, :2].min(axis=0) / CELL_M) * CELL_M - OUTWARDS_M
        extent = np.ceil((points[:, :2].max(axis=0) - corner_m + OUTWARDS_M) / CELL_M).astype(int) + 1
        columns, rows = extent.tolist()
    means, cell_of, slots, road_count = _cells(points, corner_m, rows, columns)
    planes = np.empty((len(means), 6))
    raster = RoadRaster(corner_m=corner_m, planes=planes, cell_of=cell_of, slots=slots, road_count=road_count)
    _fit_planes(means, raster)
    _continue_outwards(raster)
    return raster


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
def _fit_planes(means: Floats, raster: RoadRaster) -> None:
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
def _fit_plane(k: int, means: Floats, raster: RoadRaster, reach: int, off_m: float, off_per_m: float) -> int:
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
def plane_height(planes: Floats, k: int, east_m: float, north_m: float) -> float:
    """Return the height of a plane at a position: by its slope near its cell, level farther away."""
    east, north = east_m - planes[k, 0], north_m - planes[k, 1]
    far = np.hypot(east, north)
    if far > ALONG_PLANE_M:
        east *= ALONG_PLANE_M / far
        north *= ALONG_PLANE_M / far
    return float(planes[k, 2] + planes[k, 3] * east + planes[k, 4] * north)


@compiled_without_gil
def _continue_outwards(raster: RoadRaster) -> None:
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
            far = cells_between(row, column, k, raster)
            if far * CELL_M > OUTWARDS_M:
                continue
            east, north = centre_from(k, row, column, raster)
            height = plane_height(planes, k, east, north)
            for s in range(levels):
                other = slots[row, column, s]
                if other >= 0:
                    if abs(plane_height(planes, other, east, north) - height) > _SAME_ROAD_M:
                        continue
                    if s < raster.road_count[row, column] or cells_between(row, column, other, raster) <= far:
                        break
                slots[row, column, s] = k
                place = (row * columns + column) * levels + s
                if not queued[place]:
                    queue[(head + waiting) % size] = place
                    queued[place] = True
                    waiting += 1
                break


@compiled_without_gil
def cells_between(row: int, column: int, k: int, raster: RoadRaster) -> float:
    """Return the distance in cells from a cell to that of plane `k`."""
    cell, columns = raster.cell_of[k], raster.slots.shape[1]
    return float(np.hypot(row - cell // columns, column - cell % columns))


@compiled_without_gil
def centre_from(k: int, row: int, column: int, raster: RoadRaster) -> tuple[float, float]:
    """Return east and north of a cell's centre, relative to that of plane `k`."""
    cell, columns = raster.cell_of[k], raster.slots.shape[1]
    east = raster.planes[k, 0] + (column - cell % columns) * CELL_M
    return east, raster.planes[k, 1] + (row - cell // columns) * CELL_M
