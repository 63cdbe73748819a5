"""Which points of a cloud are road: outliers off, then planes along where a vehicle went (Open3D), then heights.

The road is looked for near the height that the trajectory says, stretch by stretch, so a bridge does not take part in
the road below it. Open3D comes with the extra `map` and is imported when it is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.tools.maps.importers.lanes import distance_along

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

_NEIGHBOURS, _STD_RATIO = 20, 3.0
# Chosen: a plane fits 8 m of road within its roughness; limits of distance, slope and counts are judgements.
_STRETCH_M = 8.0
_PLANE_M = 0.08
_ITERATIONS = 300
_NEAR_M = 0.6
_STEEPEST_RAD = math.radians(15.0)
# Chosen: a plane needs some tens of points, a local regression four cells; voxel keys have 21 bits.
_LEAST_POINTS = 30
_LEAST_CELLS = 4
_HALF = 1 << 20
_AROUND = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]


def open3d() -> Any:
    """The package. Raises FormatError where a library of the system that it needs is missing."""
    try:
        import open3d as package
    except ModuleNotFoundError:
        raise
    except (ImportError, OSError) as error:
        why = " ".join(str(error).split())[:120]
        expected = f"the libraries that it needs ({why}); on Debian: libusb-1.0-0 libgl1 libgomp1"
        raise FormatError("Open3D", "import", expected) from None
    return package


def thinned(points_m: Floats, voxel_m: float) -> Floats:
    """Points (n, 3) as means of voxels, those left out that stand alone among their neighbours."""
    package = open3d()
    cloud = package.geometry.PointCloud(package.utility.Vector3dVector(points_m))
    cloud = cloud.voxel_down_sample(voxel_m)
    if len(cloud.points) > _NEIGHBOURS:
        cloud, _ = cloud.remove_statistical_outlier(_NEIGHBOURS, _STD_RATIO)
    return np.array(cloud.points).reshape(-1, 3)


def levels_of_ground(points_m: Floats, path_m: Floats, level: Integers, half_width_m: float) -> Integers:
    """Level of the road that each point (n, 3) lies on; `NO_ROAD` for all others.

    `path_m` (k, 3): the road under a trajectory, a sample every few metres, each on a level (k,). Samples must be in
    the order driven; a stretch ends where the level changes.
    """
    package = open3d()
    package.utility.random.seed(0)
    level_of_point = np.full(len(points_m), NO_ROAD)
    order = np.argsort(points_m[:, 0], kind="stable")
    east_m = points_m[order, 0]
    for stretch in _stretches(path_m, level):
        places = path_m[stretch]
        reach = half_width_m + 1.0
        low, high = places[:, :2].min(axis=0) - reach, places[:, :2].max(axis=0) + reach
        rows = order[np.searchsorted(east_m, low[0]) : np.searchsorted(east_m, high[0])]
        rows = rows[(points_m[rows, 1] >= low[1]) & (points_m[rows, 1] <= high[1])]
        away2 = np.sum((points_m[rows, None, :2] - places[:, :2]) ** 2, axis=2)
        nearest = np.argmin(away2, axis=1) if len(rows) else np.zeros(0, np.int64)
        near = np.abs(points_m[rows, 2] - places[nearest, 2]) <= _NEAR_M
        near &= away2[np.arange(len(rows)), nearest] <= reach**2
        rows = rows[near]
        if len(rows) < _LEAST_POINTS:
            continue
        about = places.mean(axis=0)
        cloud = package.geometry.PointCloud(package.utility.Vector3dVector(points_m[rows] - about))
        (a, b, c, d), inside = cloud.segment_plane(_PLANE_M, 3, _ITERATIONS)
        if abs(c) < math.cos(_STEEPEST_RAD) * math.sqrt(a * a + b * b + c * c) or abs(d / c) > _NEAR_M:
            continue
        level_of_point[rows[inside]] = level[stretch[0]]
    return level_of_point


NO_ROAD = np.iinfo(np.int64).min
"""Of a point that is on no road."""


def _stretches(path_m: Floats, level: Integers) -> list[Integers]:
    """Rows of the samples of each stretch of some metres, which overlap by a sample."""
    number = np.floor(distance_along(path_m) / _STRETCH_M)
    cuts = np.flatnonzero((np.diff(number) != 0) | (np.diff(level) != 0)) + 1
    parts = np.split(np.arange(len(path_m)), cuts)
    joined = [np.append(a, b[0]) if level[a[0]] == level[b[0]] else a for a, b in pairwise(parts)]
    return [*joined, parts[-1]]


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundHeights:
    """Means of the road's points in square cells, by level: sorted keys, number, means (n, 3), variance of heights."""

    cell_m: float
    key: Integers
    count: Floats
    mean_m: Floats
    variance_m2: Floats

    @classmethod
    def of(cls, points_m: Floats, level: Integers, cell_m: float) -> GroundHeights:
        """Of points (n, 3), each on a level (n,)."""
        cell = np.floor(points_m[:, :2] / cell_m).astype(np.int64)
        key, inverse, count = np.unique(_keys(cell, level), return_inverse=True, return_counts=True)
        mean = np.column_stack(
            [np.bincount(inverse, points_m[:, axis], len(key)) / count for axis in range(3)]
        )
        off2 = (points_m[:, 2] - mean[inverse, 2]) ** 2
        return cls(
            cell_m=cell_m,
            key=key,
            count=count.astype(np.float64),
            mean_m=mean,
            variance_m2=np.bincount(inverse, off2, len(key)) / count,
        )

    def at(self, places_m: Floats, level: Integers) -> tuple[Floats, Floats]:
        """Heights at places (m, 2) by a plane through the nine cells around, and how far points are off it (m,).

        NaN where fewer than four of the cells have points, or all of them to one side.
        """
        if not len(self.key):
            return np.full(len(places_m), np.nan), np.full(len(places_m), np.nan)
        cell = np.floor(places_m / self.cell_m).astype(np.int64)
        keys = np.stack([_keys(cell + shift, level) for shift in _AROUND], axis=1)
        row = np.minimum(np.searchsorted(self.key, keys), len(self.key) - 1)
        there = self.key[row] == keys
        # However many points a cell has, it is one place: more than some say nothing new.
        weight = np.where(there, np.minimum(self.count[row], 10.0), 0.0)
        mean = self.mean_m[row]
        off = (mean[..., :2] - places_m[:, None, :]) / self.cell_m
        total = np.maximum(weight.sum(axis=1), 1e-9)
        columns = np.concatenate((np.ones((*keys.shape, 1)), off), axis=2)
        base = np.einsum("mk,mk->m", weight, mean[..., 2]) / total
        normal = np.einsum("mk,mki,mkj->mij", weight, columns, columns) + np.diag([1e-9, 1e-3, 1e-3])
        right = np.einsum("mk,mki,mk->mi", weight, columns, mean[..., 2] - base[:, None])
        solved = np.linalg.solve(normal, right[..., None])[..., 0]
        left = mean[..., 2] - base[:, None] - np.einsum("mki,mi->mk", columns, solved)
        sigma = np.sqrt(np.einsum("mk,mk->m", weight, left**2 + self.variance_m2[row]) / total)
        mean_off = np.einsum("mk,mki->mi", weight, off) / total[:, None]
        one_sided = np.abs(mean_off).max(axis=1, initial=0.0) > 0.75
        known = (there.sum(axis=1) >= _LEAST_CELLS) & ~one_sided
        return np.where(known, base + solved[:, 0], np.nan), np.where(known, sigma, np.nan)


def _keys(cell: Integers, level: Integers) -> Integers:
    keys: Integers = ((level + 32) << 42) | ((cell[:, 0] + _HALF) << 21) | (cell[:, 1] + _HALF)
    return keys
