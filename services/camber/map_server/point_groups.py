"""Group points by tile and by topology."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.road_map.tile_grid import LIMIT_LATITUDE_RAD, TILES

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SPREAD = -7046029254386353131
"""2⁶⁴ divided by the golden ratio, as a signed number: its multiples are spread evenly (Knuth, The Art of Computer
Programming, volume 3, section 6.4)."""

_TILES_RAD = TILES / (2.0 * math.pi)
_SERIES_REACH_RAD = 1e-3  # chosen with _EDGE
_EDGE = 1e-3  # share of a tile; at 85° the error of the series at the end of its reach is a twentieth of it


@compiled
def tile_numbers(latitude_rad: Floats, longitude_rad: Floats) -> Integers:
    """Return `x × TILES + y` of the tiles (n,) of n points, as `tile_of`; −1 beyond 85.05° and for NaN.

    y is computed by a Taylor series about a nearby point, and exactly only near the edge of a tile.
    """
    number = np.full(len(latitude_rad), -1, np.int64)
    about, y_0, y_1, y_2, y_3 = math.nan, 0.0, 0.0, 0.0, 0.0
    for i in range(len(number)):
        latitude = latitude_rad[i]
        if abs(latitude) < LIMIT_LATITUDE_RAD and abs(longitude_rad[i]) < math.inf:
            x = math.floor((longitude_rad[i] + math.pi) / (2.0 * math.pi) * TILES)
            away = latitude - about
            if not abs(away) <= _SERIES_REACH_RAD:
                about, away, sec = latitude, 0.0, 1.0 / math.cos(latitude)
                y_0, y_1 = _tile_y(latitude), -_TILES_RAD * sec
                y_2 = 0.5 * y_1 * math.tan(latitude)
                y_3 = y_1 * (2.0 * sec * sec - 1.0) / 6.0
            y = y_0 + away * (y_1 + away * (y_2 + away * y_3))
            row = math.floor(y)
            if not _EDGE < y - row < 1.0 - _EDGE:
                row = math.floor(_tile_y(latitude))
            number[i] = x % TILES * TILES + min(max(row, 0), TILES - 1)
    return number


@compiled
def _tile_y(latitude_rad: float) -> float:
    return (0.5 - math.asinh(math.tan(latitude_rad)) / (2.0 * math.pi)) * TILES


@compiled
def sort_by_tile(number: Integers) -> tuple[Integers, Integers, Integers, Integers]:
    """Sort points by tile: the tiles (t,), the points `points[start[k] : start[k + 1]]` of tile k, and the position of
    each point in `points` (n,).
    """
    n, size = len(number), 16
    while size < 2 * n:
        size *= 2
    in_slot, tiles, group = np.full(size, -1, np.int32), np.empty(n, np.int64), np.empty(n, np.int32)
    start = np.zeros(n + 1, np.int64)
    count = 0
    for i in range(n):
        slot = ((number[i] * np.int64(_SPREAD)) >> 32) & (size - 1)
        while in_slot[slot] >= 0 and tiles[in_slot[slot]] != number[i]:
            slot = (slot + 1) & (size - 1)
        if in_slot[slot] < 0:
            tiles[count], in_slot[slot] = number[i], count
            count += 1
        group[i] = in_slot[slot]
        start[group[i] + 1] += 1
    for k in range(count):
        start[k + 1] += start[k]
    points, sorted_place, free = np.empty(n, np.int64), np.empty(n, np.int64), start[:count].copy()
    for i in range(n):
        sorted_place[i] = free[group[i]]
        points[sorted_place[i]] = i
        free[group[i]] += 1
    return tiles[:count].copy(), points, start[: count + 1].copy(), sorted_place


@compiled
def group_rows(rows: Integers) -> tuple[Integers, Integers]:
    """Return the group (n,) of equal rows (n, k) of each row, and the first row (groups,) of each group.

    Groups are numbered in the order of their first rows.
    """
    n, k = rows.shape
    # Small as long as there are few groups, so that it stays in the processor's cache.
    in_slot, distinct = np.full(16, -1, np.int32), np.empty((8, k), np.int64)
    group, first = np.empty(n, np.int64), np.empty(n, np.int64)
    count = 0
    for i in range(n):
        if i > 0 and _equal(rows[i], rows[i - 1]):
            group[i] = group[i - 1]
            continue
        slot = _slot(rows[i], in_slot, distinct)
        if in_slot[slot] < 0:
            if count == len(distinct):
                distinct = np.concatenate((distinct, np.empty((count, k), np.int64)))
                in_slot = np.full(4 * count, -1, np.int32)
                for g in range(count):
                    in_slot[_slot(distinct[g], in_slot, distinct)] = g
                slot = _slot(rows[i], in_slot, distinct)
            for j in range(k):
                distinct[count, j] = rows[i, j]
            first[count], in_slot[slot] = i, count
            count += 1
        group[i] = in_slot[slot]
    return group, first[:count].copy()


@compiled
def _slot(row: Integers, in_slot: NDArray[np.int32], distinct: Integers) -> np.int64:
    """Return the hash table's slot of a row, or the free slot for it."""
    mixed = np.int64(0)
    for j in range(len(row)):
        mixed = (mixed ^ row[j]) * np.int64(_SPREAD)
        mixed ^= mixed >> 29
    slot = mixed & (len(in_slot) - 1)
    while in_slot[slot] >= 0 and not _equal(row, distinct[in_slot[slot]]):
        slot = (slot + 1) & (len(in_slot) - 1)
    return slot


@compiled
def _equal(a: Integers, b: Integers) -> bool:
    for k in range(len(a)):  # noqa: SIM110 (all() over a generator is not compiled)
        if a[k] != b[k]:
            return False
    return True
