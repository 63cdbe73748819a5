"""Covariance of a match by the planes it rests on, and its degenerate directions.

A thousand points on one wall do not err independently: an error of the map there, of the sweep's motion or of the
thinning is common to all of them. So a metre of surface counts as one observation, however many points it has.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.map_clouds.voxel_grid import voxel_count
from camber.localizer.matching.icp import NormalEquations

PATCH_M: Final = 1.0
"""Chosen: points within a cube of this edge err together."""
# Chosen: best σ of a layer's position and yaw, by deformation of the map and motion within the sweeps.
FLOOR_M: Final = 0.01
FLOOR_RAD: Final = 5.0e-4
COMMON_COVARIANCE: Final = np.diag([0.0, 0.0, 4.0e-4**2])
"""(3, 3), chosen: σ of the yaw common to all layers, by motion within the sweep and the sensor's mounting."""
# Chosen: σ of a direction that the match does not observe.
UNSEEN_M: Final = 10.0
UNSEEN_RAD: Final = 0.35
UNSEEN_COVARIANCE: Final = np.diag([UNSEEN_M**2, UNSEEN_M**2, UNSEEN_RAD**2])
LEVER_M: Final = 20.0
"""Chosen: a turn is compared with a shift by its motion at this distance, that of the houses."""
DEGENERATE_SIGMA_M: Final = 0.5
"""Chosen: a direction with a larger σ is degenerate."""


def planar_covariance(equations: NormalEquations, source_m: Floats) -> Floats:
    """Return the covariance (3, 3) of east, north [m], yaw [rad] of a cloud (n, 3) [m] by its normal equations.

    σ of residuals that turn out too small are scaled up to them, never down.
    """
    inliers = int(np.count_nonzero(equations.inliers))
    information = np.diag([UNSEEN_M**-2, UNSEEN_M**-2, UNSEEN_RAD**-2])
    if inliers:
        patches = voxel_count(source_m[equations.inliers], PATCH_M)
        excess = max(1.0, equations.square / equations.weight)
        information = information + equations.information() * (patches / inliers / excess)
    return np.linalg.inv(information) + np.diag([FLOOR_M**2, FLOOR_M**2, FLOOR_RAD**2])


def principal_axes(covariance: Floats) -> tuple[Floats, Floats]:
    """Return σ (3,) [m], descending, of a covariance (3, 3) of east, north, yaw, and their directions.

    Directions (3, 3) are columns in east, north, yaw × `LEVER_M`.
    """
    lever = np.array([1.0, 1.0, LEVER_M])
    variances, directions = np.linalg.eigh(covariance * np.outer(lever, lever))
    return np.sqrt(np.maximum(variances[::-1], 0.0)), directions[:, ::-1]


def is_degenerate(covariance: Floats) -> bool:
    """Whether a direction is not observed."""
    return bool(principal_axes(covariance)[0][0] > DEGENERATE_SIGMA_M)


def without_degenerate(offset: Floats, covariance: Floats) -> Floats:
    """Return `offset` (3,) from a guess without its part along degenerate directions: there the guess remains."""
    lever = np.array([1.0, 1.0, LEVER_M])
    sigmas, directions = principal_axes(covariance)
    degenerate: Floats = directions[:, sigmas > DEGENERATE_SIGMA_M]
    scaled = offset * lever
    observed: Floats = (scaled - degenerate @ (degenerate.T @ scaled)) / lever
    return observed
