"""Registration of a cloud to a layer of the map by small_gicp: ICP, generalised ICP and VGICP.

Point-to-point is the ICP of JP2016-109650A, paragraphs 0053 to 0059: nearest neighbours, correspondences farther
apart than d_max dropped, least squares, until convergence or the limit of iterations. It, plane-to-plane
(generalised ICP) and VGICP move all six degrees of freedom. The fourth method, point-to-plane, is `icp`, which
moves three. small_gicp computes in one thread, so that the same input gives the same bits. It is imported
where it is used: a localizer without sweeps does without it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from camber.geodesy.se3 import transform_points
from camber.localizer.arrays import Floats, Integers
from camber.localizer.map_clouds.surface_normals import planes_of_neighbours

LayerBounds: TypeAlias = tuple[tuple[float, float], ...]
"""Lower and upper height above the road [m] of each layer."""
CloudMethod: TypeAlias = Literal["point_to_point", "plane_to_plane", "vgicp"]
Method: TypeAlias = Literal["point_to_point", "point_to_plane", "plane_to_plane", "vgicp"]

NEIGHBOURS: Final = 10
"""Chosen: points of a plane; on a 0.2 m grid a disc of 0.7 m, smaller than most surfaces."""
VOXEL_M: Final = 1.0  # chosen: edge of VGICP's voxels, small_gicp's default
OVERLAP_DISTANCE_M: Final = 0.3
"""Chosen: a point with map within it overlaps; one and a half steps of a map thinned to 0.2 m."""
# Chosen: an iteration that moves less has converged; 1 mrad is 3 cm at 30 m, below what a later iteration would move.
ROTATION_EPSILON_RAD: Final = 1.0e-3
TRANSLATION_EPSILON_M: Final = 1.0e-3

_SMALL_GICP_NAMES = {"point_to_point": "ICP", "plane_to_plane": "GICP"}


@dataclass(frozen=True, eq=False, kw_only=True)
class LayerTarget:
    """A layer of the map with its search structures. With fewer than `NEIGHBOURS` points it is empty."""

    points_m: Floats
    """(n, 3) in the frame of the map."""
    normals: Floats
    """(n, 3), unit, of arbitrary sign."""
    thickness_m: Floats
    """(n,) σ of a point's neighbours from its plane."""
    normal_variance_rad2: Floats
    """(n,) variance of the normal, at most 1."""
    tree: Any = field(repr=False)
    """small_gicp.KdTree, None where there are too few points."""

    @classmethod
    def of(cls, points_m: Floats) -> LayerTarget:
        """Build the target from points (n, 3) [m], thinned to an even grid (0.2 m)."""
        import small_gicp

        points_m = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
        n = len(points_m)
        if n < NEIGHBOURS:
            tree, planes = None, (np.zeros((n, 3)), np.full(n, np.inf), np.ones(n))
        else:
            tree = small_gicp.KdTree(points_m, num_threads=1)
            neighbours, _ = tree.batch_knn_search(points_m, NEIGHBOURS, num_threads=1)
            planes = planes_of_neighbours(points_m, neighbours)
        normals, thickness_m, normal_variance_rad2 = planes
        return cls(
            points_m=points_m,
            normals=normals,
            thickness_m=thickness_m,
            normal_variance_rad2=normal_variance_rad2,
            tree=tree,
        )

    @property
    def empty(self) -> bool:
        """Whether there are too few points to register to."""
        return self.tree is None

    def nearest(self, points_m: Floats) -> tuple[Integers, Floats]:
        """Return the row of the nearest map point of each point (m, 3), and the distance [m]."""
        rows, square_m2 = self.tree.batch_knn_search(points_m, 1, num_threads=1)
        return rows[:, 0].astype(np.int64), np.sqrt(square_m2[:, 0])

    @cached_property
    def cloud(self) -> Any:
        """small_gicp.PointCloud with covariances."""
        import small_gicp

        cloud = small_gicp.PointCloud(self.points_m)
        small_gicp.estimate_covariances(cloud, self.tree, NEIGHBOURS, 1)
        return cloud

    @cached_property
    def voxels(self) -> Any:
        """small_gicp.GaussianVoxelMap."""
        import small_gicp

        voxels = small_gicp.GaussianVoxelMap(VOXEL_M)
        voxels.insert(self.cloud)
        return voxels


@dataclass(frozen=True, eq=False, kw_only=True)
class LayerFit:
    """The registration of one layer. Without points or correspondences the transform is the guess, not converged."""

    transform: Floats
    """map_from_local (4, 4): Mᵢ of JP2016-109650A composed with the guess."""
    converged: bool
    points: int
    """Source points."""
    mean_distance_m: float
    """eᵢ of JP2016-109650A eq. (7): mean distance of the correspondences; infinite without any."""
    overlap: float
    """Share of the points with a map point within `OVERLAP_DISTANCE_M`."""

    @classmethod
    def of(cls, transform: Floats, distance_m: Floats, max_distance_m: float, *, converged: bool) -> LayerFit:
        """Evaluate the registration at `transform`, by the distances (n,) to the map there."""
        paired = distance_m <= max_distance_m
        return cls(
            transform=transform,
            converged=converged and bool(paired.any()),
            points=len(distance_m),
            mean_distance_m=float(distance_m[paired].mean()) if paired.any() else np.inf,
            overlap=float(np.mean(distance_m <= OVERLAP_DISTANCE_M)) if len(distance_m) else 0.0,
        )


def register(
    target: LayerTarget,
    source_m: Floats,
    guess: Floats,
    *,
    method: CloudMethod,
    max_distance_m: float,
    max_iterations: int = 30,
) -> LayerFit:
    """Register a cloud (n, 3) [m] to a layer of the map, from `guess`, map_from_local (4, 4)."""
    import small_gicp

    source_m = np.ascontiguousarray(source_m, dtype=np.float64)
    nothing = np.full(len(source_m), np.inf)
    if target.empty or len(source_m) < NEIGHBOURS:
        return LayerFit.of(guess.copy(), nothing, max_distance_m, converged=False)
    source = small_gicp.PointCloud(source_m)
    limits = (max_distance_m, 1, max_iterations, ROTATION_EPSILON_RAD, TRANSLATION_EPSILON_M)
    if method in ("plane_to_plane", "vgicp"):
        small_gicp.estimate_covariances(source, small_gicp.KdTree(source, 1), NEIGHBOURS, 1)
    if method == "vgicp":
        result = small_gicp.align(target.voxels, source, guess, *limits)
    else:
        kind = _SMALL_GICP_NAMES[method]
        result = small_gicp.align(target.cloud, source, target.tree, guess, kind, *limits)
    transform = result.T_target_source
    if not np.isfinite(transform).all():
        return LayerFit.of(guess.copy(), nothing, max_distance_m, converged=False)
    _, distance_m = target.nearest(transform_points(transform, source_m))
    return LayerFit.of(transform, distance_m, max_distance_m, converged=bool(result.converged))
