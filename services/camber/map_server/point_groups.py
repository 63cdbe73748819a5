"""Points that are asked for together: those of one tile and one topology, by number."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.formats.map_tiles import LIMIT_LATITUDE_RAD, TILES
from camber.geodesy.compiled import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SPREAD = -7046029254386353131
"""2⁶⁴ divided by the golden ratio, as a signed number: its multiples are spread evenly (Knuth, The Art of Computer
Programming, volume 3, section 6.4)."""


@compiled
def tile_numbers(latitude_rad: Floats, longitude_rad: Floats) -> Integers:
    """`x × TILES + y` of the tiles (n,) of n points, as `tile_of`; −1 beyond 85.05° and where a point is no number."""
    number = np.full(len(latitude_rad), -1, np.int64)
    for i in range(len(number)):
        if abs(latitude_rad[i]) < LIMIT_LATITUDE_RAD and abs(longitude_rad[i]) < math.inf:
            x = math.floor((longitude_rad[i] + math.pi) / (2.0 * math.pi) * TILES)
            y = math.floor((0.5 - math.asinh(math.tan(latitude_rad[i])) / (2.0 * math.pi)) * TILES)
            number[i] = x % TILES * TILES + min(max(y, 0), TILES - 1)
    return number


@compiled
def group_rows(rows: Integers) -> tuple[Integers, Integers]:
    """Number (n,) of the group of equal rows (n, k) that each row is in, and the first row (groups,) of each.

    Groups are numbered as they are met.
    """
    n, k = rows.shape
    # Small as long as there are few groups: then it stays near the processor.
    in_slot, met = np.full(16, -1, np.int32), np.empty((8, k), np.int64)
    group, first = np.empty(n, np.int64), np.empty(n, np.int64)
    count = 0
    for i in range(n):
        if i > 0 and _equal(rows[i], rows[i - 1]):
            group[i] = group[i - 1]
            continue
        slot = _slot(rows[i], in_slot, met)
        if in_slot[slot] < 0:
            if count == len(met):
                met = np.concatenate((met, np.empty((count, k), np.int64)))
                in_slot = np.full(4 * count, -1, np.int32)
                for g in range(count):
                    in_slot[_slot(met[g], in_slot, met)] = g
                slot = _slot(rows[i], in_slot, met)
            met[count], first[count], in_slot[slot] = rows[i], i, count
            count += 1
        group[i] = in_slot[slot]
    return group, first[:count].copy()


@compiled
def _slot(row: Integers, in_slot: NDArray[np.int32], met: Integers) -> np.int64:
    """Where a row is among those met, or where it is to be put."""
    mixed = np.int64(0)
    for j in range(len(row)):
        mixed = (mixed ^ row[j]) * np.int64(_SPREAD)
        mixed ^= mixed >> 29
    slot = mixed & (len(in_slot) - 1)
    while in_slot[slot] >= 0 and not _equal(row, met[in_slot[slot]]):
        slot = (slot + 1) & (len(in_slot) - 1)
    return slot


@compiled
def members(group: Integers, groups: int) -> tuple[Integers, Integers]:
    """Rows of group g, ascending: `rows[start[g] : start[g + 1]]`; returns rows (n,) and start (groups + 1,)."""
    start = np.zeros(groups + 1, np.int64)
    for i in range(len(group)):
        start[group[i] + 1] += 1
    for g in range(groups):
        start[g + 1] += start[g]
    rows, free = np.empty(len(group), np.int64), start.copy()
    for i in range(len(group)):
        rows[free[group[i]]] = i
        free[group[i]] += 1
    return rows, start


@compiled
def _equal(a: Integers, b: Integers) -> bool:
    for k in range(len(a)):  # noqa: SIM110 (all() over a generator is not compiled)
        if a[k] != b[k]:
            return False
    return True
