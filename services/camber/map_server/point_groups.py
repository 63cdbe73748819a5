"""Sort points by tile."""

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
def sort_by_tile(number: Integers) -> tuple[Integers, Integers, Integers]:
    """Sort points by tile: the tiles (t,), and the points `points[start[k] : start[k + 1]]` of tile k."""
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
    points, free = np.empty(n, np.int64), start[:count].copy()
    for i in range(n):
        points[free[group[i]]] = i
        free[group[i]] += 1
    return tiles[:count].copy(), points, start[: count + 1].copy()
