"""Thinning a cloud to at most so many points that stand evenly: the first point of each voxel."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.localizer.map_clouds.voxel_grid import Floats, voxels

_COARSER = 1.1


def thinned_evenly(points_m: Floats, at_most: int, voxel_m: float = 0.3) -> Floats:
    """Of points (n, 3) [m] at most so many, one for each voxel, in their order; all where they are few enough.

    Voxels grow from `voxel_m` until they are few enough. A point is one of those put in, never a mean: the mean of
    points on a corner lies off both faces.
    """
    points_m = np.ascontiguousarray(points_m, dtype=np.float64)
    while len(points_m) > at_most:
        points_m = points_m[first_of_voxels(points_m, voxel_m)]
        voxel_m *= max(_COARSER, 0.9 * math.sqrt(len(points_m) / at_most))
    return points_m


def voxel_count(points_m: Floats, voxel_m: float) -> int:
    """How many voxels hold a point of (n, 3) [m]."""
    return len(first_of_voxels(np.ascontiguousarray(points_m), voxel_m))


def first_of_voxels(points_m: Floats, voxel_m: float) -> NDArray[np.int64]:
    """Rows of the first point of each voxel, ascending."""
    _, first = voxels(points_m, voxel_m)
    return first
