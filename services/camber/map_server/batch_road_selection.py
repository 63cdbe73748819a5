"""Compiled selection of the road under each of many points of a tile; for one point `road_level_selection` does it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.tangent_planes import east_north_near
from camber.map_server.road_level_selection import TIE_M, Topology
from camber.map_server.tile_index import CELL_M, SurfaceTable, on_surface
from camber.road_map.height_interpolation import grid_plane

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

KNOWN, NO_SURFACE, LEVELS_AMBIGUOUS, UNDECIDED = 0, 1, 2, 3
"""Codes of the reason; the last: not decided yet."""


class Topologies(NamedTuple):
    """Topologies as tables: the candidates of topology t are `names[bounds[t, 0] : bounds[t, 1]]`, from there
    to `bounds[t, 2]` the connected links, and to `bounds[t, 3]` the levels."""

    names: Integers
    bounds: Integers


class PointColumns(NamedTuple):
    """Points (n,) with their candidate links (n, c) and last surfaces (n,); −1 means none."""

    latitude_rad: Floats
    longitude_rad: Floats
    links: Integers
    last: Integers


class SelectedRoads(NamedTuple):
    """Roads under n points, as columns (k,) of the known ones, whose points are `known`, ascending.

    `reason` (n,): why a road is unknown, one of the codes above. `elsewhere` (n,): all surfaces there are on levels
    without candidate links: by topology the vehicle is not there. During the selection all columns are (n,).
    """

    reason: NDArray[np.uint8]
    elsewhere: NDArray[np.bool_]
    known: Integers
    surface_id: Integers
    level: Integers
    elevation_m: Floats
    sigma_m: Floats
    slope_east: Floats
    slope_north: Floats
    extent_m: Floats

    @property
    def ambiguous(self) -> NDArray[np.bool_]:
        """Points (n,) with surfaces of which none could be selected."""
        ambiguous: NDArray[np.bool_] = self.reason == LEVELS_AMBIGUOUS
        return ambiguous

    def of_known(self) -> SelectedRoads:
        """Return the roads with the columns of the known ones."""
        known = np.flatnonzero(self.reason == KNOWN)
        columns = self[3:] if len(known) == len(self.reason) else (column[known] for column in self[3:])
        return SelectedRoads(self.reason, self.elsewhere, known, *columns)


def empty_roads(count: int) -> SelectedRoads:
    """Return arrays for n points, each with the reason NO_SURFACE."""
    integers = ("surface_id", "level")
    columns: dict[str, Any] = {
        name: np.empty(count, np.int64 if name in integers else np.float64)
        for name in SelectedRoads._fields[3:]
    }
    reason, elsewhere = np.full(count, NO_SURFACE, np.uint8), np.zeros(count, np.bool_)
    return SelectedRoads(reason=reason, elsewhere=elsewhere, known=np.empty(0, np.int64), **columns)


def topologies(each: Sequence[Topology]) -> Topologies:
    """Return topologies as tables."""
    names = [name for one in each for names in (one.candidates, one.connected, one.levels) for name in names]
    sizes = np.array(
        [[0, len(one.candidates), len(one.connected), len(one.levels)] for one in each], np.int64
    )
    sizes = sizes.reshape(-1, 4)
    begin = np.cumsum(sizes.sum(axis=1)) - sizes.sum(axis=1)
    return Topologies(np.array(names, np.int64), begin[:, None] + np.cumsum(sizes, axis=1))


@compiled
def select_roads(
    table: SurfaceTable,
    columns: PointColumns,
    points: Integers,
    topology: Integers,
    known: Topologies,
    roads: SelectedRoads,
) -> None:
    """Fill the rows `points` (k,) of `roads`, all of them points of the table's tile, each by its topology (k,)."""
    latitude_rad, longitude_rad = columns.latitude_rad, columns.longitude_rad
    # Surfaces at a point: rows, coordinates of the point on them, and whether they are still candidates.
    row, at = np.empty(table.most_in_cell, np.int64), np.empty((table.most_in_cell, 2))
    inside, left = np.empty(table.most_in_cell, np.bool_), np.empty(table.most_in_cell, np.bool_)
    on_candidate, is_connected = left.copy(), left.copy()
    for place in range(len(points)):
        i = points[place]
        hits = _hits(table, (latitude_rad[i], longitude_rad[i]), row=row, at=at, inside=inside)
        if hits == 0:
            continue
        reason, roads.elsewhere[i] = _left_by_topology(
            names=table.names,
            row=row,
            hits=hits,
            known=known.names,
            bounds=known.bounds[topology[place]],
            left=left,
            on_candidate=on_candidate,
            is_connected=is_connected,
        )
        roads.reason[i] = reason
        if reason != KNOWN:
            continue
        best = _nearest(at, inside, left, hits)
        k = row[best]
        height_m, slope_u, slope_v = _plane(table, k, at[best, 0], at[best, 1])
        agree = True
        for h in range(hits):
            if left[h] and h != best:
                other = row[h]
                other_m, _, _ = _plane(table, other, at[h, 0], at[h, 1])
                agree &= abs(other_m - height_m) <= table.shape[other, 6] + table.shape[k, 6]
        if not agree:
            roads.reason[i] = LEVELS_AMBIGUOUS
            continue
        cos, sin = table.shape[k, 2], table.shape[k, 3]
        roads.surface_id[i], roads.level[i] = table.names[k, 0], table.names[k, 2]
        roads.elevation_m[i], roads.sigma_m[i] = height_m, table.shape[k, 6]
        roads.slope_east[i] = slope_u * cos - slope_v * sin
        roads.slope_north[i] = slope_u * sin + slope_v * cos
        roads.extent_m[i] = table.shape[k, 7]


@compiled
def _plane(table: SurfaceTable, k: int, u: float, v: float) -> tuple[float, float, float]:
    grid = table.grid[k, 0], table.grid[k, 1], table.grid[k, 2]
    return grid_plane(table.heights_m, grid, (table.shape[k, 4], table.shape[k, 5]), (u, v))


@compiled
def _hits(
    table: SurfaceTable, point: tuple[float, float], row: Integers, at: Floats, inside: NDArray[np.bool_]
) -> int:
    """Return the number of surfaces at a point; fills their rows, the point on them, and whether it is inside."""
    east_m, north_m = east_north_near(table.series, table.origin, point[0], point[1])
    if east_m == math.inf:
        return 0
    column = math.floor((east_m - table.west_m) / CELL_M)
    line = math.floor((north_m - table.south_m) / CELL_M)
    if not (0 <= column < table.columns and 0 <= line < table.lines):
        return 0
    cell = line * table.columns + column
    hits = 0
    for nth in range(table.cell_start[cell], table.cell_start[cell + 1]):
        k = table.cell_rows[nth]
        u, v, near, within = on_surface(
            (east_m - table.shape[k, 0], north_m - table.shape[k, 1]),
            (table.shape[k, 2], table.shape[k, 3]),
            (table.shape[k, 4], table.shape[k, 5]),
        )
        if not near:
            continue
        row[hits], at[hits, 0], at[hits, 1], inside[hits] = k, u, v, within
        hits += 1
    return hits


@compiled
def _left_by_topology(
    names: Integers,
    row: Integers,
    hits: int,
    known: Integers,
    bounds: Integers,
    left: NDArray[np.bool_],
    on_candidate: NDArray[np.bool_],
    is_connected: NDArray[np.bool_],
) -> tuple[int, bool]:
    """Mark the surfaces `left` by topology; returns KNOWN or LEVELS_AMBIGUOUS, and whether all are `elsewhere`."""
    begin, connected, levels, end = bounds
    plausible, both, elsewhere = False, False, False
    for h in range(hits):
        link = names[row[h], 1]
        on_candidate[h] = _holds(known, begin, connected, link)
        is_connected[h] = _holds(known, connected, levels, link)
        plausible |= on_candidate[h] if connected > begin else is_connected[h]
        both |= on_candidate[h] and is_connected[h]
    for h in range(hits):
        if not plausible:
            left[h] = True
        elif connected == begin:
            left[h] = is_connected[h]
        else:
            left[h] = on_candidate[h] and (is_connected[h] or not both)
    if connected > begin and end > levels and not plausible:
        elsewhere = True
        for h in range(hits):
            elsewhere &= not _holds(known, levels, end, names[row[h], 2])
    clear = _on_one_level(names, row, left=left, is_connected=is_connected, hits=hits) and (
        plausible or _all_levels_present(known[levels:end], names, row, hits)
    )
    return KNOWN if clear else LEVELS_AMBIGUOUS, elsewhere


@compiled
def _holds(names: Integers, begin: int, end: int, name: int) -> bool:
    for k in range(begin, end):  # noqa: SIM110 (any() over a generator is not compiled)
        if names[k] == name:
            return True
    return False


@compiled
def _on_one_level(
    names: Integers, row: Integers, left: NDArray[np.bool_], is_connected: NDArray[np.bool_], hits: int
) -> bool:
    """Whether the surfaces left are on one level, or all connected to the last surface."""
    several, unconnected, level = False, False, np.int64(0)
    first = True
    for h in range(hits):
        if left[h]:
            several |= not first and names[row[h], 2] != level
            unconnected |= not is_connected[h]
            level, first = names[row[h], 2], False
    return not (several and unconnected)


@compiled
def _all_levels_present(levels: Integers, names: Integers, row: Integers, hits: int) -> bool:
    """Whether each level known by topology is that of a surface at the point."""
    for level in levels:
        present = False
        for h in range(hits):
            present |= names[row[h], 2] == level
        if not present:
            return False
    return True


@compiled
def _nearest(at: Floats, inside: NDArray[np.bool_], left: NDArray[np.bool_], hits: int) -> int:
    """Return the surface left with the nearest centre line, of those that contain the point if any does.

    Rows are in the order of surface ids, so the first of equally near ones has the smallest id.
    """
    contained = False
    for h in range(hits):
        contained |= left[h] and inside[h]
    best, least = -1, math.inf
    for h in range(hits):
        left[h] &= inside[h] or not contained
        tie = np.rint(abs(at[h, 1]) / TIE_M)
        if left[h] and tie < least:
            best, least = h, tie
    return best
