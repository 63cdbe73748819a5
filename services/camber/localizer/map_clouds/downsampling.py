"""Downsampling of a cloud to a maximum number of evenly spread points: the first point of each voxel."""

from __future__ import annotations

import math

import numpy as np

from camber.localizer.arrays import Floats, Integers
from camber.localizer.map_clouds.voxel_grid import voxels

_COARSER = 1.1  # chosen: least growth of the voxel from one pass to the next


def thinned_evenly(points_m: Floats, at_most: int, voxel_m: float = 0.3) -> Floats:
    """Return at most so many of the points (n, 3) [m], one per voxel, in their order.

    Voxels grow from `voxel_m` until they are few enough. No means: the mean of points at a corner lies off both faces.
    """
    points_m = np.ascontiguousarray(points_m, dtype=np.float64)
    while len(points_m) > at_most:
        points_m = points_m[first_of_voxels(points_m, voxel_m)]
        voxel_m *= max(_COARSER, 0.9 * math.sqrt(len(points_m) / at_most))
    return points_m


def voxel_count(points_m: Floats, voxel_m: float) -> int:
    """Return the number of voxels that hold a point of (n, 3) [m]."""
    return len(first_of_voxels(np.ascontiguousarray(points_m), voxel_m))


def first_of_voxels(points_m: Floats, voxel_m: float) -> Integers:
    """Return rows of the first point of each voxel, ascending."""
    _, first = voxels(points_m, voxel_m)
    return first
