"""The road under each of many points by its candidate links alone, where all else that is known leads to the same.

Where the surfaces on candidate links are on one of these links, they are all connected to the last surface or none of
them is: either way they are left, and none of the others. Where the map alone decides, nobody has named a link or a
last surface. What is neither is UNDECIDED, and for `road_choice` and its topologies.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.tangent_planes import east_north_near
from camber.map_server.road_selection import (
    KNOWN,
    LEVELS_AMBIGUOUS,
    NO_SURFACE,
    UNDECIDED,
    FoundRoads,
    on_surface,
)
from camber.map_server.tile_index import CELL_M, SurfaceTable
from camber.map_server.topology import TIE_M
from camber.road_map.surface_heights import grid_plane

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@compiled
def find_by_links(
    table: SurfaceTable,
    points: Integers,
    latitude_rad: Floats,
    longitude_rad: Floats,
    links: Integers,
    last: Integers,
    found: FoundRoads,
    begin: int,
) -> None:
    """Fill `found` from row `begin` on with the roads under `points` (k,), all of them of the table's tile, in order.

    Positions, candidate links (n, c) and last surface (n,) are columns; −1 stands for none.
    """
    # One function without arrays handed on: to count who holds them would take most of the time.
    series, origin, shape, grid, names = table.series, table.origin, table.shape, table.grid, table.names
    cell_start, cell_rows, heights_m = table.cell_start, table.cell_rows, table.heights_m
    candidates = links.shape[1]
    row, along, across = (
        np.empty(table.most_in_cell, np.int64),
        np.empty(table.most_in_cell),
        np.empty(table.most_in_cell),
    )
    inside = np.empty(table.most_in_cell, np.bool_)
    for place in range(len(points)):
        i, to = points[place], begin + place
        found.elsewhere[to] = False
        found.reason[to] = NO_SURFACE
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
        # `hits` surfaces are here; `left` of them, to choose from, on `link` and `level` if these are the same.
        hits, left, link, level = 0, 0, np.int64(0), np.int64(0)
        one_link, one_level, contained = True, True, False
        cell = line * table.columns + column
        for nth in range(cell_start[cell], cell_start[cell + 1]):
            k = cell_rows[nth]
            u, v, near, within = on_surface(
                east_m - shape[k, 0],
                north_m - shape[k, 1],
                shape[k, 2],
                shape[k, 3],
                shape[k, 4],
                shape[k, 5],
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
            found.reason[to] = UNDECIDED
            continue
        found.reason[to] = LEVELS_AMBIGUOUS
        if not one_level:
            continue
        # As `_nearest` of road_choice.
        best, least = 0, math.inf
        for h in range(left):
            tie = np.rint(abs(across[h]) / TIE_M)
            if (inside[h] or not contained) and tie < least:
                best, least = h, tie
        k = row[best]
        height_m, slope_u, slope_v = grid_plane(
            heights_m, grid[k, 0], grid[k, 1], grid[k, 2], shape[k, 4], shape[k, 5], along[best], across[best]
        )
        agree = True
        for h in range(left):
            if h != best and (inside[h] or not contained):
                o = row[h]
                other_m, _, _ = grid_plane(
                    heights_m,
                    grid[o, 0],
                    grid[o, 1],
                    grid[o, 2],
                    shape[o, 4],
                    shape[o, 5],
                    along[h],
                    across[h],
                )
                agree &= abs(other_m - height_m) <= shape[o, 6] + shape[k, 6]
        if not agree:
            continue
        found.reason[to] = KNOWN
        found.surface_id[to], found.level[to] = names[k, 0], level
        found.elevation_m[to], found.sigma_m[to], found.extent_m[to] = height_m, shape[k, 6], shape[k, 7]
        found.slope_east[to] = slope_u * shape[k, 2] - slope_v * shape[k, 3]
        found.slope_north[to] = slope_u * shape[k, 3] + slope_v * shape[k, 2]


@compiled
def put_back(gone_to: Integers, sorted_roads: FoundRoads, found: FoundRoads, begin: int) -> None:
    """Fill `found` from row `begin` on with the rows `gone_to` (k,) of `sorted_roads`."""
    for i in range(len(gone_to)):
        of, to = gone_to[i], begin + i
        found.reason[to], found.elsewhere[to] = sorted_roads.reason[of], sorted_roads.elsewhere[of]
        found.surface_id[to], found.level[to] = sorted_roads.surface_id[of], sorted_roads.level[of]
        found.elevation_m[to], found.sigma_m[to] = sorted_roads.elevation_m[of], sorted_roads.sigma_m[of]
        found.slope_east[to], found.slope_north[to] = (
            sorted_roads.slope_east[of],
            sorted_roads.slope_north[of],
        )
        found.extent_m[to] = sorted_roads.extent_m[of]
