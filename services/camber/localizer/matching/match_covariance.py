"""How well planes determine east, north and yaw: the covariance of a match, and the directions it does not see.

A thousand points on one wall do not err independently: what is wrong with the map there, with the sweep's motion or
with the thinning is wrong for all of them. So a metre of surface counts as one row, however many points it has.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.localizer.map_clouds.downsampling import voxel_count
from camber.localizer.matching.point_to_plane import NormalEquations

Floats = NDArray[np.float64]

PATCH_M = 1.0
"""Points within a cube of this edge err together."""
FLOOR_M = 0.01
FLOOR_RAD = 5.0e-4
"""What a layer's position and yaw are off by at best: deformation of the map, motion within the sweeps."""
COMMON_RAD = 4.0e-4
"""What the yaw of all layers together is off by: motion within the sweep and the sensor's mounting are one for all."""
UNSEEN_M = 10.0
UNSEEN_RAD = 0.35
"""Standard deviations that say: not known by this match."""
LEVER_M = 20.0
"""A turn is compared with a shift by what it moves at this distance, that of the houses."""
DEGENERATE_SIGMA_M = 0.5
"""A direction known less well than this is not known well enough to be called a match."""


def planar_covariance(rows: NormalEquations, source_m: Floats) -> Floats:
    """Covariance (3, 3) of east, north [m], yaw [rad] of a fit by these rows of a cloud (n, 3) [m].

    σ of the rows that turn out too small are scaled up to their residuals, never down.
    """
    kept = int(np.count_nonzero(rows.kept))
    information = np.diag([UNSEEN_M**-2, UNSEEN_M**-2, UNSEEN_RAD**-2])
    if kept:
        patches = voxel_count(source_m[rows.kept], PATCH_M)
        excess = max(1.0, rows.square / rows.weight)
        information = information + rows.information() * (patches / kept / excess)
    return np.linalg.inv(information) + floor()


def floor() -> Floats:
    """Covariance (3, 3) that no layer goes below."""
    return np.diag([FLOOR_M**2, FLOOR_M**2, FLOOR_RAD**2])


def common() -> Floats:
    """Covariance (3, 3) of what layers do not average away."""
    return np.diag([0.0, 0.0, COMMON_RAD**2])


def axes(covariance: Floats) -> tuple[Floats, Floats]:
    """Standard deviations (3,) [m], descending, of a covariance (3, 3) of east, north, yaw, and their directions.

    Directions (3, 3) are columns in east, north, yaw × `LEVER_M`.
    """
    lever = np.array([1.0, 1.0, LEVER_M])
    variances, directions = np.linalg.eigh(covariance * np.outer(lever, lever))
    return np.sqrt(np.maximum(variances[::-1], 0.0)), directions[:, ::-1]


def degenerate(covariance: Floats) -> bool:
    """Is there a direction that the rows leave open?"""
    return bool(axes(covariance)[0][0] > DEGENERATE_SIGMA_M)


def without_unseen(offset: Floats, covariance: Floats) -> Floats:
    """`offset` (3,) from a guess, less what it moves along directions that are left open: there the guess stands."""
    lever = np.array([1.0, 1.0, LEVER_M])
    sigmas, directions = axes(covariance)
    unseen: Floats = directions[:, sigmas > DEGENERATE_SIGMA_M]
    scaled = offset * lever
    left: Floats = (scaled - unseen @ (unseen.T @ scaled)) / lever
    return left
