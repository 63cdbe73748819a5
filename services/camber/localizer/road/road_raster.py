"""Road raster: the height of the road from the map's road cloud, roads above one another kept apart.

A cell of the raster holds a plane for each road that crosses it, fitted to the means of the cells around. Heights of
different roads are never averaged. Next to the roads their height is continued outwards: by the plane for
`_ALONG_PLANE_M`, from there on level, so that crossfall and camber do not run away.

`RoadHeights` holds all roads of a block; `RoadSurface` is the one that can be driven from a position on it, with its
continuation: one height for each position.
"""

from __future__ import annotations

from dataclasses import dataclass, field
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
    """The road at a place: height and slopes, with the sigma of the height.

    `distance_m`: to the nearest cell with this road; `other_height_m`: of the next other road there, from which only a
    height known to half the difference separates it.
    """

    height_m: float
    slope_east: float
    slope_north: float
    sigma_m: float
    distance_m: float
    other_height_m: float | None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RoadSurface:
    """One road from where the vehicle is, one height for each place; as `RoadHeights`, with a single level."""

    _raster: _RoadRaster
    _slots: Integers  # (rows, columns, 1) number of the plane that holds there, −1: none
    _start: int

    def height_above(self, points_m: Floats) -> Floats:
        """Height of points (n, 3) above this road (n,); NaN where it is not known."""
        raster = self._raster
        return points_m[:, 2] - _nearest_heights(
            points_m=points_m,
            corner_m=raster.corner_m,
            planes=raster.planes,
            slots=self._slots,
            near_m=points_m[:, 2],
        )

    def holds(self, plane: int) -> bool:
        """Is a plane of the raster part of this surface?"""
        row, column = divmod(int(self._raster.cell_of[plane]), self._slots.shape[1])
        return bool(self._slots[row, column, 0] == plane)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _RoadRaster:
    """`planes` (k, 6): east, north of the cell's centre, height there, slopes, sigma; `slots` (rows, columns, LEVELS)
    numbers of planes, those of the cell itself first; `road_count` (rows, columns) how many those are."""

    corner_m: Floats
    planes: Floats
    cell_of: Integers
    slots: Integers
    road_count: Integers


@dataclass(slots=True, eq=False)
class RoadHeights:
    """All roads of a block, heights and places in its frame."""

    _raster: _RoadRaster
    _last: RoadSurface | None = field(default=None)

    @classmethod
    def of(cls, road_m: Floats) -> RoadHeights:
        """From points of road surfaces (k, 3)."""
        points = np.ascontiguousarray(road_m, np.float64).reshape(-1, 3)
        if not len(points):
            empty = np.full((1, 1, LEVELS), -1, np.int32)
            return cls(
                _RoadRaster(
                    corner_m=np.zeros(2),
                    planes=np.zeros((0, 6)),
                    cell_of=np.zeros(0, np.int32),
                    slots=empty,
                    road_count=np.zeros((1, 1), np.int32),
                )
            )
        corner = np.floor(points[:, :2].min(axis=0) / CELL_M) * CELL_M - OUTWARDS_M
        columns, rows = (
            np.ceil((points[:, :2].max(axis=0) - corner + OUTWARDS_M) / CELL_M).astype(int) + 1
        ).tolist()
        means, cell_of, slots, road_count = _cells(points, corner, rows, columns)
        planes = _planes(means=means, cell_of=cell_of, slots=slots, road_count=road_count, corner_m=corner)
        _continue_outwards(planes, cell_of, slots, road_count)
        return cls(
            _RoadRaster(corner_m=corner, planes=planes, cell_of=cell_of, slots=slots, road_count=road_count)
        )

    @property
    def known(self) -> bool:
        """Is there any road?"""
        return len(self._raster.planes) > 0

    def elevation(self, east_m: float, north_m: float, near_height_m: float) -> RoadElevation | None:
        """The road at a place, of those above one another the one nearest to a height; None: none is known there."""
        raster = self._raster
        here = np.array([[east_m, north_m, near_height_m]])
        roads = _roads_at(here[0], raster.corner_m, raster.planes, raster.slots)
        if not len(roads):
            return None
        order = np.argsort(np.abs(roads[:, 0] - near_height_m), kind="stable")
        height, slope_east, slope_north, sigma, distance = roads[order[0]].tolist()
        other = float(roads[order[1], 0]) if len(order) > 1 else None
        return RoadElevation(
            height_m=height,
            slope_east=slope_east,
            slope_north=slope_north,
            sigma_m=sigma,
            distance_m=distance,
            other_height_m=other,
        )

    def surface_through(self, east_m: float, north_m: float, height_m: float) -> RoadSurface | None:
        """The road that passes a place within 1.5 m of a height, and what can be driven to from it; None: none does.

        Where two of its parts lie above one another, the one that is fewer metres of road away is taken.
        """
        raster = self._raster
        start = _start_plane(
            east_m=east_m,
            north_m=north_m,
            height_m=height_m,
            corner_m=raster.corner_m,
            planes=raster.planes,
            slots=raster.slots,
        )
        if start < 0:
            return None
        last = self._last
        if last is not None and (last._start == start or (self._single and last.holds(start))):
            return last
        slots = _reached_from(
            start=start,
            planes=raster.planes,
            cell_of=raster.cell_of,
            slots=raster.slots,
            road_count=raster.road_count,
        )
        self._last = RoadSurface(_raster=raster, _slots=slots, _start=start)
        return self._last

    def height_above_road(self, points_m: Floats, near_height_m: float | None = None) -> Floats:
        """Height of points (n, 3) above the road below them (n,); NaN where none is known.

        Of several roads the highest that is not more than 0.3 m above the point (else the lowest), or, with
        `near_height_m`, the nearest to that height.
        """
        raster = self._raster
        if near_height_m is None:
            road = _heights_below(points_m, raster.corner_m, raster.planes, raster.slots)
        else:
            near = np.full(len(points_m), near_height_m)
            road = _nearest_heights(
                points_m=points_m,
                corner_m=raster.corner_m,
                planes=raster.planes,
                slots=raster.slots,
                near_m=near,
            )
        return points_m[:, 2] - road

    def within(self, points_m: Floats, low_m: float, high_m: float) -> NDArray[np.bool_]:
        """Which points (n, 3) are between two heights above any of the roads there."""
        raster = self._raster
        return _between(
            points_m=points_m,
            corner_m=raster.corner_m,
            planes=raster.planes,
            slots=raster.slots,
            low_m=low_m,
            high_m=high_m,
        )

    @property
    def _single(self) -> bool:
        return bool((self._raster.road_count <= 1).all())


@compiled_without_gil
def _cells(
    points_m: Floats, corner_m: Floats, rows: int, columns: int
) -> tuple[Floats, Integers, Integers, Integers]:
    """Means (k, 4) of the points of one road in one cell and their count, the cell of each, and who is in each cell."""
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
def _planes(
    means: Floats, cell_of: Integers, slots: Integers, road_count: Integers, corner_m: Floats
) -> Floats:
    """Planes (k, 6) by weighted least squares: through the cells next to each first, then through those around that
    agree with it, so that a road beside it that is a little higher does not draw it up."""
    columns = slots.shape[1]
    planes = np.empty((len(means), 6))
    for k in range(len(means)):
        planes[k, 0] = corner_m[0] + (cell_of[k] % columns + 0.5) * CELL_M
        planes[k, 1] = corner_m[1] + (cell_of[k] // columns + 0.5) * CELL_M
        planes[k, 2] = means[k, 2]
        planes[k, 3:] = 0.0
        if (
            _lay_plane(
                k,
                reach=1,
                off_m=0.05,
                off_per_m=0.2,
                means=means,
                cell_of=cell_of,
                slots=slots,
                road_count=road_count,
                planes=planes,
            )
            < 4
        ):
            _lay_plane(
                k,
                reach=_REACH,
                off_m=0.05,
                off_per_m=0.2,
                means=means,
                cell_of=cell_of,
                slots=slots,
                road_count=road_count,
                planes=planes,
            )
        else:
            _lay_plane(
                k,
                reach=_REACH,
                off_m=0.04,
                off_per_m=0.02,
                means=means,
                cell_of=cell_of,
                slots=slots,
                road_count=road_count,
                planes=planes,
            )
    return planes


@compiled_without_gil
def _lay_plane(
    k: int,
    reach: int,
    off_m: float,
    off_per_m: float,
    means: Floats,
    cell_of: Integers,
    slots: Integers,
    road_count: Integers,
    planes: Floats,
) -> int:
    """Lay plane `k` anew through the cells in reach that are off it by no more than this; how many they are."""
    rows, columns, _ = slots.shape
    row, column = cell_of[k] // columns, cell_of[k] % columns
    m = np.zeros((3, 3))
    v = np.zeros(3)
    square = 0.0
    weights = 0.0
    cells = 0
    base = means[k, 2]
    for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
        for c in range(max(column - reach, 0), min(column + reach + 1, columns)):
            best, least = -1, np.inf
            for s in range(road_count[r, c]):
                other = slots[r, c, s]
                e, n = means[other, 0] - planes[k, 0], means[other, 1] - planes[k, 1]
                off = abs(means[other, 2] - planes[k, 2] - planes[k, 3] * e - planes[k, 4] * n)
                if off < least:
                    best, least = other, off
            if best < 0:
                continue
            e, n, z = means[best, 0] - planes[k, 0], means[best, 1] - planes[k, 1], means[best, 2] - base
            if least > off_m + off_per_m * np.hypot(
                means[best, 0] - means[k, 0], means[best, 1] - means[k, 1]
            ):
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
    """Cramer's rule; of a symmetric, positive 3 × 3 matrix."""
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
    """Height of a plane at a place: by its slope near its own cell, from there on level."""
    east, north = east_m - planes[k, 0], north_m - planes[k, 1]
    far = np.hypot(east, north)
    if far > _ALONG_PLANE_M:
        east *= _ALONG_PLANE_M / far
        north *= _ALONG_PLANE_M / far
    return float(planes[k, 2] + planes[k, 3] * east + planes[k, 4] * north)


@compiled_without_gil
def _continue_outwards(planes: Floats, cell_of: Integers, slots: Integers, road_count: Integers) -> None:
    """Fill the slots beside the roads with the plane of the nearest cell of each road, in place."""
    rows, columns, levels = slots.shape
    size = rows * columns * levels
    queue = np.empty(size, np.int32)  # of slots, as a ring; none stands in it twice
    queued = np.zeros(size, np.bool_)
    head, waiting = 0, 0
    for k in range(len(planes)):
        for s in range(road_count[cell_of[k] // columns, cell_of[k] % columns]):
            if slots[cell_of[k] // columns, cell_of[k] % columns, s] == k:
                queue[waiting] = cell_of[k] * levels + s
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
            far = _cells_between(row, column, cell_of[k], columns)
            if far * CELL_M > OUTWARDS_M:
                continue
            east, north = _centre_from(
                planes=planes, cell_of=cell_of, k=k, row=row, column=column, columns=columns
            )
            height = _height(planes, k, east, north)
            for s in range(levels):
                other = slots[row, column, s]
                if other >= 0:
                    if abs(_height(planes, other, east, north) - height) > _SAME_ROAD_M:
                        continue
                    if (
                        s < road_count[row, column]
                        or _cells_between(row, column, cell_of[other], columns) <= far
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
def _cells_between(row: int, column: int, cell: int, columns: int) -> float:
    return float(np.hypot(row - cell // columns, column - cell % columns))


@compiled_without_gil
def _centre_from(
    planes: Floats, cell_of: Integers, k: int, row: int, column: int, columns: int
) -> tuple[float, float]:
    """East and north of a cell's centre, as seen from the one of plane `k`."""
    east = planes[k, 0] + (column - cell_of[k] % columns) * CELL_M
    north = planes[k, 1] + (row - cell_of[k] // columns) * CELL_M
    return east, north


@compiled_without_gil
def _cell(east_m: float, north_m: float, corner_m: Floats, slots: Integers) -> tuple[int, int]:
    """Row and column of the raster's cell that holds a place; (−1, −1) outside."""
    row, column = int((north_m - corner_m[1]) // CELL_M), int((east_m - corner_m[0]) // CELL_M)
    if 0 <= row < slots.shape[0] and 0 <= column < slots.shape[1]:
        return row, column
    return -1, -1


@compiled_without_gil
def _start_plane(
    east_m: float, north_m: float, height_m: float, corner_m: Floats, planes: Floats, slots: Integers
) -> int:
    """Number of the plane at a place that is nearest to a height, within 1.5 m; −1: none."""
    row, column = _cell(east_m, north_m, corner_m, slots)
    if row < 0:
        return -1
    best, least = -1, 1.5
    for s in range(slots.shape[2]):
        k = slots[row, column, s]
        if k >= 0 and abs(_height(planes, k, east_m, north_m) - height_m) < least:
            best, least = k, abs(_height(planes, k, east_m, north_m) - height_m)
    return best


@compiled_without_gil
def _reached_from(
    start: int, planes: Floats, cell_of: Integers, slots: Integers, road_count: Integers
) -> Integers:
    """For each cell the plane (rows, columns, 1) that is reached first: over the road before over what is beside it."""
    rows, columns, _ = slots.shape
    size = rows * columns
    reached = np.full((rows, columns, 1), -1, np.int32)
    on_road = np.zeros((rows, columns), np.bool_)
    road = np.empty(size + 1, np.int32)  # cells in the order in which the road reaches them
    road_head, road_tail = 0, 1
    road[0] = cell_of[start]
    reached[road[0] // columns, road[0] % columns, 0] = start
    on_road[road[0] // columns, road[0] % columns] = True
    outside = np.empty(size, np.int32)  # cells beside it, as a ring; none stands in it twice
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
            far = _cells_between(row, column, cell_of[k], columns)
            if far * CELL_M > OUTWARDS_M:
                continue
            east, north = _centre_from(
                planes=planes, cell_of=cell_of, k=k, row=row, column=column, columns=columns
            )
            # A gap in the cloud is bridged where the road goes on as it ended, within what its slope may be off by.
            best, least = -1, _JOIN_M if from_road else min(_JOIN_M + 0.05 * far, 1.0)
            for s in range(road_count[row, column]):
                other = slots[row, column, s]
                if from_road:
                    e, n = 0.5 * (planes[k, 0] + east), 0.5 * (planes[k, 1] + north)
                    gap = abs(_height(planes, other, e, n) - _height(planes, k, e, n))
                else:
                    gap = abs(planes[other, 2] - _height(planes, k, east, north))
                if gap < least:
                    best, least = other, gap
            if best >= 0:
                reached[row, column, 0] = best
                on_road[row, column] = True
                road[road_tail] = row * columns + column
                road_tail += 1
                continue
            known = reached[row, column, 0]
            if known >= 0 and _cells_between(row, column, cell_of[known], columns) <= far:
                continue
            reached[row, column, 0] = k
            place = row * columns + column
            if not queued[place]:
                outside[(head + waiting) % size] = place
                queued[place] = True
                waiting += 1
    return reached


@compiled_without_gil
def _blended(
    east_m: float, north_m: float, corner_m: Floats, planes: Floats, slots: Integers, first: int, out: Floats
) -> None:
    """Into `out`: height, slopes, sigma and distance at a place, of the planes about it that go with plane `first`."""
    near = _height(planes, first, east_m, north_m)
    x, y = (east_m - corner_m[0]) / CELL_M - 0.5, (north_m - corner_m[1]) / CELL_M - 0.5
    column, row = int(np.floor(x)), int(np.floor(y))
    u, v = x - column, y - row
    out[:] = 0.0
    total = 0.0
    for corner in range(4):
        r, c = row + corner // 2, column + corner % 2
        if not (0 <= r < slots.shape[0] and 0 <= c < slots.shape[1]):
            continue
        best, least = -1, 0.5
        for s in range(slots.shape[2]):
            k = slots[r, c, s]
            if k >= 0 and abs(_height(planes, k, east_m, north_m) - near) < least:
                best, least = k, abs(_height(planes, k, east_m, north_m) - near)
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
def _roads_at(place_m: Floats, corner_m: Floats, planes: Floats, slots: Integers) -> Floats:
    """The roads at a place (levels, 5): height, slopes, sigma, distance."""
    roads = np.empty((slots.shape[2], 5))
    row, column = _cell(place_m[0], place_m[1], corner_m, slots)
    if row < 0:
        return roads[:0]
    at = 0
    for s in range(slots.shape[2]):
        if slots[row, column, s] >= 0:
            _blended(
                place_m[0],
                place_m[1],
                corner_m=corner_m,
                planes=planes,
                slots=slots,
                first=slots[row, column, s],
                out=roads[at],
            )
            at += 1
    return roads[:at]


@compiled_without_gil
def _nearest_heights(
    points_m: Floats, corner_m: Floats, planes: Floats, slots: Integers, near_m: Floats
) -> Floats:
    """Height (n,) of the road at points (n, 3) that is nearest to a height for each (n,); NaN where there is none."""
    heights = np.full(len(points_m), np.nan)
    for i in range(len(points_m)):
        row, column = _cell(points_m[i, 0], points_m[i, 1], corner_m, slots)
        if row < 0:
            continue
        least = np.inf
        for s in range(slots.shape[2]):
            k = slots[row, column, s]
            if k >= 0:
                height = _height(planes, k, points_m[i, 0], points_m[i, 1])
                if abs(height - near_m[i]) < least:
                    heights[i], least = height, abs(height - near_m[i])
    return heights


@compiled_without_gil
def _heights_below(points_m: Floats, corner_m: Floats, planes: Floats, slots: Integers) -> Floats:
    """Height (n,) of the highest road at points (n, 3) not more than 0.3 m above them, else of the lowest; or NaN."""
    heights = np.full(len(points_m), np.nan)
    for i in range(len(points_m)):
        row, column = _cell(points_m[i, 0], points_m[i, 1], corner_m, slots)
        if row < 0:
            continue
        below = -np.inf
        lowest = np.inf
        for s in range(slots.shape[2]):
            k = slots[row, column, s]
            if k >= 0:
                height = _height(planes, k, points_m[i, 0], points_m[i, 1])
                lowest = min(lowest, height)
                if height <= points_m[i, 2] + 0.3:
                    below = max(below, height)
        if np.isfinite(lowest):
            heights[i] = below if np.isfinite(below) else lowest
    return heights


@compiled_without_gil
def _between(
    points_m: Floats, corner_m: Floats, planes: Floats, slots: Integers, low_m: float, high_m: float
) -> NDArray[np.bool_]:
    between = np.zeros(len(points_m), np.bool_)
    for i in range(len(points_m)):
        row, column = _cell(points_m[i, 0], points_m[i, 1], corner_m, slots)
        if row < 0:
            continue
        for s in range(slots.shape[2]):
            k = slots[row, column, s]
            if k >= 0:
                height = points_m[i, 2] - _height(planes, k, points_m[i, 0], points_m[i, 1])
                if low_m <= height <= high_m:
                    between[i] = True
                    break
    return between
