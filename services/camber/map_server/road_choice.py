"""The road under each of many points of a tile, in one pass over the points: `topology.choose`, compiled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.formats.map_surface_heights import grid_plane
from camber.geodesy.compiled import compiled
from camber.geodesy.tangent_planes import east_north
from camber.map_server.tile_index import CELL_M, EDGE_M, TOLERANCE_M, SurfaceTable
from camber.map_server.topology import TIE_M, Topology

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

KNOWN, NO_SURFACE, LEVELS_AMBIGUOUS = 0, 1, 2
"""Codes of why a road is not known."""


class Topologies(NamedTuple):
    """Topologies one after the other: of number t the candidates are `names[bounds[t, 0] : bounds[t, 1]]`, from there
    to `bounds[t, 2]` the connected links, and to `bounds[t, 3]` the levels."""

    names: Integers
    bounds: Integers


class FoundRoads(NamedTuple):
    """The roads under n points; where `reason` is not KNOWN, `names` and `numbers` say nothing.

    `elsewhere`: all surfaces there are on levels that no candidate is on: by topology the vehicle is not there.
    `names` (n, 2): surface and level; `numbers` (n, 5): elevation, σ, slope to the east and to the north, extent.
    """

    reason: NDArray[np.uint8]
    elsewhere: NDArray[np.bool_]
    names: Integers
    numbers: Floats


def nothing_found(count: int) -> FoundRoads:
    """No surface at any of n points."""
    return FoundRoads(
        reason=np.full(count, NO_SURFACE, np.uint8),
        elsewhere=np.zeros(count, np.bool_),
        names=np.zeros((count, 2), np.int64),
        numbers=np.zeros((count, 5)),
    )


def topologies(each: Sequence[Topology]) -> Topologies:
    """Topologies as tables."""
    names = [name for one in each for names in (one.candidates, one.connected, one.levels) for name in names]
    sizes = np.array(
        [[0, len(one.candidates), len(one.connected), len(one.levels)] for one in each], np.int64
    )
    sizes = sizes.reshape(-1, 4)
    begin = np.cumsum(sizes.sum(axis=1)) - sizes.sum(axis=1)
    return Topologies(np.array(names, np.int64), begin[:, None] + np.cumsum(sizes, axis=1))


@compiled
def find_roads(
    table: SurfaceTable,
    points: Integers,
    latitude_rad: Floats,
    longitude_rad: Floats,
    topology: Integers,
    known: Topologies,
    found: FoundRoads,
) -> None:
    """Fill the rows `points` (k,) of `found`, all of them points of the table's tile, each by its topology (k,).

    Positions are columns (n,), as those of `found`.
    """
    # Of the surfaces at a point: their rows, where on them it is, and what of them is still to be chosen from.
    row, at = np.empty(table.most_in_cell, np.int64), np.empty((table.most_in_cell, 2))
    inside, left = np.empty(table.most_in_cell, np.bool_), np.empty(table.most_in_cell, np.bool_)
    on_candidate, is_connected = left.copy(), left.copy()
    for place in range(len(points)):
        i = points[place]
        east_m, north_m = east_north(table.origin, latitude_rad[i], longitude_rad[i])
        if east_m == math.inf:
            continue
        column = math.floor((east_m - table.west_m) / CELL_M)
        line = math.floor((north_m - table.south_m) / CELL_M)
        if not (0 <= column < table.columns and 0 <= line < table.lines):
            continue
        cell = line * table.columns + column
        hits = 0
        for nth in range(table.cell_start[cell], table.cell_start[cell + 1]):
            k = table.cell_rows[nth]
            centre_east, centre_north, cos, sin = (
                table.shape[k, 0],
                table.shape[k, 1],
                table.shape[k, 2],
                table.shape[k, 3],
            )
            half_length, half_width = table.shape[k, 4], table.shape[k, 5]
            de, dn = east_m - centre_east, north_m - centre_north
            u, v = cos * de + sin * dn, cos * dn - sin * de
            beyond_u, beyond_v = abs(u) - half_length, abs(v) - half_width
            if beyond_u > TOLERANCE_M or beyond_v > TOLERANCE_M:
                continue
            if beyond_u > 0.0 and beyond_v > 0.0 and math.hypot(beyond_u, beyond_v) > TOLERANCE_M:
                continue
            row[hits], at[hits, 0], at[hits, 1] = k, u, v
            inside[hits] = beyond_u <= EDGE_M and beyond_v <= EDGE_M
            hits += 1
        if hits == 0:
            continue
        begin, connected, levels, end = known.bounds[topology[place]]
        plausible = False
        both = False
        for h in range(hits):
            link = table.names[row[h], 1]
            on_candidate[h] = _holds(known.names, begin, connected, link)
            is_connected[h] = _holds(known.names, connected, levels, link)
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
            found.elsewhere[i] = True
            for h in range(hits):
                if _holds(known.names, levels, end, table.names[row[h], 2]):
                    found.elsewhere[i] = False
        found.reason[i] = LEVELS_AMBIGUOUS
        if not _on_one_level(table.names, row, left, is_connected, hits):
            continue
        if not plausible and not _all_there(known.names, levels, end, table.names, row, hits):
            continue
        best = _nearest(at, inside, left, hits)
        k = row[best]
        height_m, slope_u, slope_v = grid_plane(
            table.heights_m, table.grid[k], table.shape[k, 4], table.shape[k, 5], at[best, 0], at[best, 1]
        )
        agree = True
        for h in range(hits):
            if left[h] and h != best:
                other = row[h]
                other_m, _, _ = grid_plane(
                    table.heights_m,
                    table.grid[other],
                    table.shape[other, 4],
                    table.shape[other, 5],
                    at[h, 0],
                    at[h, 1],
                )
                agree &= abs(other_m - height_m) <= table.shape[other, 6] + table.shape[k, 6]
        if not agree:
            continue
        found.reason[i] = KNOWN
        found.names[i, 0], found.names[i, 1] = table.names[k, 0], table.names[k, 2]
        cos, sin = table.shape[k, 2], table.shape[k, 3]
        found.numbers[i, 0], found.numbers[i, 1] = height_m, table.shape[k, 6]
        found.numbers[i, 2] = slope_u * cos - slope_v * sin
        found.numbers[i, 3] = slope_u * sin + slope_v * cos
        found.numbers[i, 4] = table.shape[k, 7]


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
    """Are the surfaces left on one level, or all connected to the last surface?"""
    several, strange, level = False, False, np.int64(0)
    first = True
    for h in range(hits):
        if left[h]:
            several |= not first and names[row[h], 2] != level
            strange |= not is_connected[h]
            level, first = names[row[h], 2], False
    return not (several and strange)


@compiled
def _all_there(names: Integers, begin: int, end: int, of_rows: Integers, row: Integers, hits: int) -> bool:
    """Is each of the levels known by topology that of a surface here?"""
    for k in range(begin, end):
        there = False
        for h in range(hits):
            there |= of_rows[row[h], 2] == names[k]
        if not there:
            return False
    return True


@compiled
def _nearest(at: Floats, inside: NDArray[np.bool_], left: NDArray[np.bool_], hits: int) -> int:
    """Of the surfaces left that with the nearest centre line; where one contains the point only such are left.

    Rows are in the order of surface ids, so the first of those equally near has the smallest.
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
