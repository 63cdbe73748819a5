"""Voxel grid: the mean of the points in each voxel, or the first one, and downsampling by it; the same bits on every
run."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.localizer.arrays import Floats, Integers

_HALF = 1 << 20  # cells to each side of the origin along one axis: ±262 km at 0.25 m
_MASK = (1 << 21) - 1  # 21 bits per axis, 63 in a key
_COARSER = 1.1  # chosen: least growth of the voxel from one pass of downsampling to the next


def voxel_means(points_m: Floats, voxel_m: float) -> Floats:
    """Return the mean (m, 3) of the finite points (n, 3) in each voxel, by first appearance.

    Sums run in the order of the points, so equal input gives equal bytes.
    """
    means: Floats = _voxel_means(np.ascontiguousarray(points_m, np.float64), voxel_m)
    return means


def thinned_evenly(points_m: Floats, at_most: int, voxel_m: float = 0.3) -> Floats:
    """Return at most so many of the points (n, 3) [m], as `rows_thinned_evenly`."""
    thinned: Floats = np.ascontiguousarray(points_m, np.float64)[
        rows_thinned_evenly(points_m, at_most, voxel_m)
    ]
    return thinned


def rows_thinned_evenly(points_m: Floats, at_most: int, voxel_m: float = 0.3) -> Integers:
    """Return rows of at most so many of the points (n, 3) [m], one per voxel, ascending.

    Voxels grow from `voxel_m` until they are few enough. No means: the mean of points at a corner lies off both faces.
    """
    points_m = np.ascontiguousarray(points_m, dtype=np.float64)
    rows: Integers = np.arange(len(points_m))
    while len(rows) > at_most:
        first = first_of_voxels(points_m, voxel_m)
        rows, points_m = rows[first], points_m[first]
        voxel_m *= max(_COARSER, 0.9 * math.sqrt(len(rows) / at_most))
    return rows


def voxel_count(points_m: Floats, voxel_m: float) -> int:
    """Return the number of voxels that hold a point of (n, 3) [m]."""
    return len(first_of_voxels(np.ascontiguousarray(points_m), voxel_m))


def first_of_voxels(points_m: Floats, voxel_m: float) -> Integers:
    """Return rows of the first point of each voxel, ascending."""
    _, first = voxels(points_m, voxel_m)
    return first


@compiled_without_gil
def _voxel_means(points_m: Floats, voxel_m: float) -> Floats:
    row_of, first = voxels(points_m, voxel_m)
    means = points_m[first]
    counts = np.ones(len(first), np.int32)
    for i in range(len(points_m)):
        row = row_of[i]
        if first[row] != i:
            for axis in range(3):
                means[row, axis] += points_m[i, axis]
            counts[row] += 1
    for row in range(len(first)):
        if counts[row] > 1:
            for axis in range(3):
                means[row, axis] /= counts[row]
    return means


@compiled_without_gil
def voxels(points_m: Floats, voxel_m: float) -> tuple[NDArray[np.int32], Integers]:
    """Return the voxel of each point (n, 3), by first appearance, and the row of the first point of each, ascending."""
    n = len(points_m)
    bits = 4
    while (1 << bits) < 2 * n:
        bits += 1
    wrap = (1 << bits) - 1
    table = np.full(1 << bits, -1, np.int32)
    keys = np.empty(n, np.int64)
    row_of = np.empty(n, np.int32)
    first = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        a = int(np.floor(points_m[i, 0] / voxel_m)) + _HALF
        b = int(np.floor(points_m[i, 1] / voxel_m)) + _HALF
        c = int(np.floor(points_m[i, 2] / voxel_m)) + _HALF
        key = ((a & _MASK) << 42) | ((b & _MASK) << 21) | (c & _MASK)
        mixed = key * -7046029254386353131  # 2^64 / golden ratio: neighbours land far apart
        place = ((mixed >> 32) ^ mixed) & wrap
        row = table[place]
        while row >= 0 and keys[row] != key:
            place = (place + 1) & wrap
            row = table[place]
        if row < 0:
            row = count
            table[place] = row
            keys[row] = key
            first[row] = i
            count += 1
        row_of[i] = row
    return row_of, first[:count]
