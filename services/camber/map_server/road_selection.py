"""Select the road surface at a point by links and levels, never by the height under test.

`select_surface` is for one point, the compiled `select_roads` for many points of a tile. It runs twice. First by
candidate links alone: if the surfaces on candidate links are all on one link, they are all connected to the last
surface or none is, and the map alone decides if neither links nor last surface are given. The points left UNDECIDED,
usually few, are selected with their topologies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.tangent_planes import east_north_near
from camber.map_server.tile_index import CELL_M, SurfaceHit, SurfaceTable, on_surface
from camber.road_map.surface_heights import grid_plane

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

TIE_M = 1e-6
"""Resolution of the distance to centre lines: among equally near ones the smaller id is taken; chosen: rounding."""

KNOWN, NO_SURFACE, LEVELS_AMBIGUOUS, UNDECIDED = 0, 1, 2, 3
"""Codes of the reason; the last: not decided yet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Topology:
    """Links and levels on which the vehicle may be.

    `candidates`: links it may be on; `connected`: the link of its last surface and those that share a node with it;
    `levels`: known levels of the candidates or, without candidates, of the last surface.
    """

    candidates: frozenset[int] = frozenset()
    connected: frozenset[int] = frozenset()
    levels: frozenset[int] = frozenset()


def select_surface(hits: Sequence[SurfaceHit], topology: Topology) -> SurfaceHit | None:
    """Return the surface among those at one point, or None if ambiguous.

    1. Surfaces of candidate links; among them, or without candidates, those connected to the last surface.
    2. If none is left: all, provided that no level known by topology differs from theirs.
    3. The surfaces left must be on one level, or all connected to the last surface: a road that changes its level.
    4. Of these the ones that contain the point, else those within the tolerance. They must agree within their σ; the
       one with the nearest centre line is selected.

    Step 4 compares heights of the map with one another; no measured height enters.
    """
    plausible = [hit for hit in hits if hit.link_id in topology.candidates]
    if plausible or not topology.candidates:
        plausible = [hit for hit in plausible or hits if hit.link_id in topology.connected] or plausible
    left = plausible or hits
    levels = {hit.level for hit in left}
    if len(levels) > 1 and any(hit.link_id not in topology.connected for hit in left):
        return None
    if not plausible and topology.levels - levels:
        return None
    left = [hit for hit in left if hit.inside] or left
    chosen = min(left, key=lambda hit: (round(hit.offset_m / TIE_M), hit.surface_id))
    agree = all(abs(hit.height_m - chosen.height_m) <= hit.sigma_m + chosen.sigma_m for hit in left)
    return chosen if agree else None


class Topologies(NamedTuple):
    """Topologies as tables: the connected links of topology t are `names[bounds[t, 0] : bounds[t, 1]]`, its levels
    from there to `bounds[t, 2]`."""

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
    """Return topologies as tables; their candidates are those of the points."""
    names = [name for one in each for names in (one.connected, one.levels) for name in names]
    sizes = np.array([[0, len(one.connected), len(one.levels)] for one in each], np.int64).reshape(-1, 3)
    begin = np.cumsum(sizes.sum(axis=1)) - sizes.sum(axis=1)
    return Topologies(np.array(names, np.int64), begin[:, None] + np.cumsum(sizes, axis=1))


@compiled
def select_roads(
    table: SurfaceTable,
    points: PointColumns,
    rows: Integers,
    topology: Integers,
    known: Topologies,
    roads: SelectedRoads,
    begin: int,
) -> None:
    """Fill `roads` from row `begin` on with the roads under the points `rows` (k,), all of them in the table's tile.

    `topology` (k,): row in `known` of each; empty: by candidate links alone.
    """
    latitude_rad, longitude_rad, links, last = points
    # One function that passes no arrays on: numba's reference counting would take most of the time.
    series, origin, shape, grid, names = table.series, table.origin, table.shape, table.grid, table.names
    cell_start, cell_rows, heights_m = table.cell_start, table.cell_rows, table.heights_m
    known_names, bounds, by_links = known.names, known.bounds, len(topology) == 0
    most = table.most_in_cell
    row, inside = np.empty(most, np.int64), np.empty(most, np.bool_)
    along, across = np.empty(most), np.empty(most)
    for place in range(len(rows)):
        i, to = rows[place], begin + place
        east_m, north_m = east_north_near(series, origin, latitude_rad[i], longitude_rad[i])
        if east_m == math.inf:
            continue
        column = math.floor((east_m - table.west_m) / CELL_M)
        line = math.floor((north_m - table.south_m) / CELL_M)
        if not (0 <= column < table.columns and 0 <= line < table.lines):
            continue
        named = False
        for c in range(links.shape[1]):
            named |= links[i, c] >= 0
        first_link, first_level, end = 0, 0, 0
        if not by_links:
            t = topology[place]
            first_link, first_level, end = bounds[t, 0], bounds[t, 1], bounds[t, 2]
        # `left` surfaces at the point are the most plausible ones, on `link` and `level` if these are equal.
        left, rank, link, level = 0, 0, np.int64(0), np.int64(0)
        one_link, one_level, all_connected, contained = True, True, True, False
        cell = line * table.columns + column
        for nth in range(cell_start[cell], cell_start[cell + 1]):
            k = cell_rows[nth]
            u, v, near, within = on_surface(
                (east_m - shape[k, 0], north_m - shape[k, 1]),
                (shape[k, 2], shape[k, 3]),
                (shape[k, 4], shape[k, 5]),
            )
            if not near:
                continue
            # 1 on a candidate link, 2 if also connected; without candidates 1 if connected.
            of_this, connected = 0, False
            for c in range(links.shape[1]):
                if (links[i, c] >= 0) & (links[i, c] == names[k, 1]):
                    of_this = 1
            for n in range(first_link, first_level):
                connected |= known_names[n] == names[k, 1]
            if connected and (of_this == 1 or not named):
                of_this += 1
            if of_this < rank:
                continue
            if of_this > rank:
                left, rank = 0, of_this
                one_link, one_level, all_connected, contained = True, True, True, False
            one_link &= (left == 0) | (names[k, 1] == link)
            one_level &= (left == 0) | (names[k, 2] == level)
            link, level = names[k, 1], names[k, 2]
            row[left], along[left], across[left], inside[left] = k, u, v, within
            all_connected &= connected
            contained |= within
            left += 1
        if left == 0:
            continue
        plain = (rank == 1 and one_link and one_level) if named else last[i] < 0
        if by_links and not plain:
            roads.reason[to] = UNDECIDED
            continue
        roads.reason[to] = LEVELS_AMBIGUOUS
        clear, on_known_level = one_level or all_connected, False
        if rank == 0:  # no surface is plausible, so that `row` has all at the point
            for n in range(first_level, end):
                present = False
                for h in range(left):
                    present |= names[row[h], 2] == known_names[n]
                clear &= present
                on_known_level |= present
            roads.elsewhere[to] = named and end > first_level and not on_known_level
        if not clear:
            continue
        # Rows are in the order of surface ids, so the first of equally near ones has the smallest id.
        best, least = 0, math.inf
        for h in range(left):
            tie = np.rint(abs(across[h]) / TIE_M)
            if (inside[h] or not contained) and tie < least:
                best, least = h, tie
        k = row[best]
        height_m, slope_u, slope_v = grid_plane(
            heights_m,
            (grid[k, 0], grid[k, 1], grid[k, 2]),
            (shape[k, 4], shape[k, 5]),
            (along[best], across[best]),
        )
        agree = True
        for h in range(left):
            if h != best and (inside[h] or not contained):
                o = row[h]
                other_m, _, _ = grid_plane(
                    heights_m,
                    (grid[o, 0], grid[o, 1], grid[o, 2]),
                    (shape[o, 4], shape[o, 5]),
                    (along[h], across[h]),
                )
                agree &= abs(other_m - height_m) <= shape[o, 6] + shape[k, 6]
        if not agree:
            continue
        roads.reason[to] = KNOWN
        roads.surface_id[to], roads.level[to] = names[k, 0], names[k, 2]
        roads.elevation_m[to], roads.sigma_m[to], roads.extent_m[to] = height_m, shape[k, 6], shape[k, 7]
        roads.slope_east[to] = slope_u * shape[k, 2] - slope_v * shape[k, 3]
        roads.slope_north[to] = slope_u * shape[k, 3] + slope_v * shape[k, 2]


@compiled
def copy_roads(source: SelectedRoads, target: SelectedRoads, rows: Integers) -> None:
    """Fill `rows` (k,) of `target` with the rows of `source`."""
    for place in range(len(rows)):
        i = rows[place]
        target.reason[i], target.elsewhere[i] = source.reason[place], source.elsewhere[place]
        target.surface_id[i], target.level[i] = source.surface_id[place], source.level[place]
        target.elevation_m[i], target.sigma_m[i] = source.elevation_m[place], source.sigma_m[place]
        target.slope_east[i], target.slope_north[i] = source.slope_east[place], source.slope_north[place]
        target.extent_m[i] = source.extent_m[place]
