"""Registering a cloud to a map cloud: `LayerTarget`, built once, and `register`, by small_gicp's three methods.

Point-to-point is the ICP of M (JP2016-109650A, paragraphs 0053 to 0059): nearest neighbours, pairs farther apart
than d_max dropped, least squares, until converged or the limit of iterations. It, plane-to-plane (generalised ICP)
and VGICP move all six degrees of freedom. The fourth method, point-to-plane, is `plane_fit`, which moves only what it
is told to. small_gicp computes in one thread, so that the same input gives the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import small_gicp
from numpy.typing import NDArray

from camber.geodesy.se3 import transform_points
from camber.localizer.map_clouds.surface_normals import planes_of_neighbours

Floats = NDArray[np.float64]
CloudMethod = Literal["point_to_point", "plane_to_plane", "vgicp"]
Method = CloudMethod | Literal["point_to_plane"]

NEIGHBOURS = 10
"""Points that a plane is laid through: on a 0.2 m grid a disc of 0.7 m, smaller than most things with a face."""
VOXEL_M = 1.0
"""Edge of VGICP's voxels."""
OVERLAP_DISTANCE_M = 0.3
"""A point with map within this distance overlaps: one and a half grid steps of a map thinned to 0.2 m."""
ROTATION_EPSILON_RAD = 1.0e-3
TRANSLATION_EPSILON_M = 1.0e-3
"""An iteration that moves less has converged; 1 mrad is 3 cm at 30 m, which the steps after it no longer move."""

_OF_SMALL_GICP = {"point_to_point": "ICP", "plane_to_plane": "GICP"}


@dataclass(frozen=True, eq=False)
class LayerTarget:
    """The map's side of a layer with its search structures. Fewer than `NEIGHBOURS` points: nothing to match to."""

    points_m: Floats
    """(n, 3) in the frame of the map."""
    normals: Floats
    """(n, 3), unit, of no particular sign."""
    thickness_m: Floats
    """(n,) standard deviation of a point's neighbours from its plane."""
    normal_variance_rad2: Floats
    """(n,) variance of the normal, at most 1."""
    tree: Any = field(repr=False)
    """small_gicp.KdTree, None where there are too few points."""

    @classmethod
    def of(cls, points_m: Floats) -> LayerTarget:
        """Of points (n, 3) [m], thinned to an even grid (0.2 m)."""
        points_m = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
        n = len(points_m)
        if n < NEIGHBOURS:
            return cls(points_m, np.zeros((n, 3)), np.full(n, np.inf), np.ones(n), None)
        tree = small_gicp.KdTree(points_m, num_threads=1)
        neighbours, _ = tree.batch_knn_search(points_m, NEIGHBOURS, num_threads=1)
        return cls(points_m, *planes_of_neighbours(points_m, neighbours), tree)

    @property
    def empty(self) -> bool:
        """Too few points to match to."""
        return self.tree is None

    def nearest(self, points_m: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Of points (m, 3) in the map's frame: the row of the nearest map point, and the distance [m]."""
        rows, square_m2 = self.tree.batch_knn_search(points_m, 1, num_threads=1)
        return rows[:, 0].astype(np.int64), np.sqrt(square_m2[:, 0])

    @cached_property
    def cloud(self) -> Any:
        """small_gicp.PointCloud with covariances, made when a method first asks for them."""
        cloud = small_gicp.PointCloud(self.points_m)
        small_gicp.estimate_covariances(cloud, self.tree, NEIGHBOURS, 1)
        return cloud

    @cached_property
    def voxels(self) -> Any:
        """small_gicp.GaussianVoxelMap, made when VGICP first asks for it."""
        voxels = small_gicp.GaussianVoxelMap(VOXEL_M)
        voxels.insert(self.cloud)
        return voxels


@dataclass(frozen=True, eq=False)
class LayerFit:
    """What registering one layer gave. Without points or pairs the transform is the guess and nothing converged."""

    transform: Floats
    """map_from_local (4, 4), M's Mᵢ composed with the guess."""
    converged: bool
    iterations: int
    points: int
    """Source points put in."""
    pairs: int
    """Of them with a map point within d_max."""
    mean_distance_m: float
    """eᵢ (7): mean distance of the pairs; infinite without pairs."""
    overlap: float
    """Share of the points with a map point within `OVERLAP_DISTANCE_M`."""


def register(
    target: LayerTarget,
    source_m: Floats,
    guess: Floats,
    method: CloudMethod,
    max_distance_m: float,
    max_iterations: int = 30,
) -> LayerFit:
    """Fit a cloud (n, 3) [m] to a layer of the map, from `guess`, map_from_local (4, 4)."""
    source_m = np.ascontiguousarray(source_m, dtype=np.float64)
    if target.empty or len(source_m) < NEIGHBOURS:
        return LayerFit(guess.copy(), False, 0, len(source_m), 0, np.inf, 0.0)
    source = small_gicp.PointCloud(source_m)
    limits = (max_distance_m, 1, max_iterations, ROTATION_EPSILON_RAD, TRANSLATION_EPSILON_M)
    if method in ("plane_to_plane", "vgicp"):
        small_gicp.estimate_covariances(source, small_gicp.KdTree(source, 1), NEIGHBOURS, 1)
    if method == "vgicp":
        result = small_gicp.align(target.voxels, source, guess, *limits)
    else:
        result = small_gicp.align(target.cloud, source, target.tree, guess, _OF_SMALL_GICP[method], *limits)
    transform = result.T_target_source
    if not np.isfinite(transform).all():
        return LayerFit(guess.copy(), False, 0, len(source_m), 0, np.inf, 0.0)
    _, distance_m = target.nearest(transform_points(transform, source_m))
    return fit_of(transform, bool(result.converged), int(result.iterations), distance_m, max_distance_m)


def fit_of(
    transform: Floats, converged: bool, iterations: int, distance_m: Floats, max_distance_m: float
) -> LayerFit:
    """The fit that ends at `transform`, where its points (n,) have map at these distances."""
    paired = distance_m <= max_distance_m
    return LayerFit(
        transform,
        converged and bool(paired.any()),
        iterations,
        len(distance_m),
        int(np.count_nonzero(paired)),
        float(distance_m[paired].mean()) if paired.any() else np.inf,
        float(np.mean(distance_m <= OVERLAP_DISTANCE_M)) if len(distance_m) else 0.0,
    )
