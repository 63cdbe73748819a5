"""Fast path of the road selection: points whose candidate links alone decide.

If the surfaces on candidate links are all on one link, they are all connected to the last surface or none is: the
topology changes nothing. The map alone decides if neither links nor last surface are given. All other points are
UNDECIDED and left to `road_selection`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.tangent_planes import east_north_near
from camber.map_server.batch_road_selection import (
    KNOWN,
    LEVELS_AMBIGUOUS,
    NO_SURFACE,
    UNDECIDED,
    PointColumns,
    SelectedRoads,
)
from camber.map_server.road_level_selection import TIE_M
from camber.map_server.tile_index import CELL_M, SurfaceTable, on_surface
from camber.road_map.height_interpolation import grid_plane

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@compiled
def select_roads_by_links(
    table: SurfaceTable, columns: PointColumns, points: Integers, roads: SelectedRoads, begin: int
) -> None:
    """Fill `roads` from row `begin` on with the roads under `points` (k,), all of them in the table's tile."""
    latitude_rad, longitude_rad, links, last = columns
    # One function that passes no arrays on: numba's reference counting would take most of the time.
    series, origin, shape, grid, names = table.series, table.origin, table.shape, table.grid, table.names
    cell_start, cell_rows, heights_m = table.cell_start, table.cell_rows, table.heights_m
    candidates = links.shape[1]
    most = table.most_in_cell
    row, inside = np.empty(most, np.int64), np.empty(most, np.bool_)
    along, across = np.empty(most), np.empty(most)
    for place in range(len(points)):
        i, to = points[place], begin + place
        roads.elsewhere[to] = False
        roads.reason[to] = NO_SURFACE
        east_m, north_m = east_north_near(series, origin, latitude_rad[i], longitude_rad[i])
        if east_m == math.inf:
            continue
        column = math.floor((east_m - table.west_m) / CELL_M)
        line = math.floor((north_m - table.south_m) / CELL_M)
        if not (0 <= column < table.columns and 0 <= line < table.lines):
            continue
        named = False
        for c in range(candidates):
            named |= links[i, c] >= 0
        # `hits` surfaces at the point; `left` of them are candidates, on `link` and `level` if these are equal.
        hits, left, link, level = 0, 0, np.int64(0), np.int64(0)
        one_link, one_level, contained = True, True, False
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
            hits += 1
            wanted = not named
            for c in range(candidates):
                wanted |= (links[i, c] >= 0) & (links[i, c] == names[k, 1])
            if wanted:
                one_link &= (left == 0) | (names[k, 1] == link)
                one_level &= (left == 0) | (names[k, 2] == level)
                link, level = names[k, 1], names[k, 2]
                row[left], along[left], across[left], inside[left] = k, u, v, within
                contained |= within
                left += 1
        if hits == 0:
            continue
        if (named and not (left > 0 and one_link and one_level)) or (not named and last[i] >= 0):
            roads.reason[to] = UNDECIDED
            continue
        roads.reason[to] = LEVELS_AMBIGUOUS
        if not one_level:
            continue
        # As `_nearest` of road_selection.
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
        roads.surface_id[to], roads.level[to] = names[k, 0], level
        roads.elevation_m[to], roads.sigma_m[to], roads.extent_m[to] = height_m, shape[k, 6], shape[k, 7]
        roads.slope_east[to] = slope_u * shape[k, 2] - slope_v * shape[k, 3]
        roads.slope_north[to] = slope_u * shape[k, 3] + slope_v * shape[k, 2]


@compiled
def restore_order(sorted_place: Integers, source: SelectedRoads, target: SelectedRoads, begin: int) -> None:
    """Fill `target` from row `begin` on with the rows `sorted_place` (k,) of `source`."""
    for place in range(len(sorted_place)):
        i, j = begin + place, sorted_place[place]
        target.reason[i], target.elsewhere[i] = source.reason[j], source.elsewhere[j]
        target.surface_id[i], target.level[i] = source.surface_id[j], source.level[j]
        target.elevation_m[i], target.sigma_m[i] = source.elevation_m[j], source.sigma_m[j]
        target.slope_east[i], target.slope_north[i] = source.slope_east[j], source.slope_north[j]
        target.extent_m[i] = source.extent_m[j]
