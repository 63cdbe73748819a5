"""Height, roll and pitch by the road: the local map's ground fitted to the map's road cloud.

M's step 10 gives them along the vehicle by a line (`road_line`); this is the same for a whole surface and both
slopes, as exact as the road is known. Points of the ground are those of the local map within 0.3 m of the road, where
the map has road: pavements and verges are as low, but what lies there says nothing for the road or against it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from camber.localizer.map_clouds.downsampling import thinned_evenly, voxel_count
from camber.localizer.matching.match_covariance import PATCH_M
from camber.localizer.matching.point_to_plane import (
    find_correspondences,
    icp_point_to_plane,
    normal_equations,
)
from camber.localizer.matching.registration import LayerTarget

Floats = NDArray[np.float64]

GROUND_M = 0.3
"""A point is taken for ground within this height of the road, above or below."""
NEAR_M = 25.0
"""Ground beyond this is struck too flatly to be told from what stands on it."""
MAX_DISTANCE_M = 0.6
FLOOR_M = 0.01
FLOOR_RAD = 1.0e-3
"""What a road surface's height and slopes are off by at best: the crown, ruts and grass beside it."""
_FIRST_SCALE_M = 0.3
_AT_MOST = 1500
_MIN_POINTS = 50
_FLOOR: Floats = np.diag([FLOOR_M**2, FLOOR_RAD**2, FLOOR_RAD**2])
_UNSEEN = np.array([10.0, 0.2, 0.2])
_MAX_RESIDUAL = 3.0


@dataclass(frozen=True, eq=False)
class RoadFit:
    """`map_from_local` (4, 4) with up, roll and pitch by the road, east, north and yaw those of the guess.

    Lost: it is the guess. `covariance` (3, 3) of up [m], roll, pitch [rad] about L's axes.
    """

    status: Literal["converged", "ambiguous", "lost"]
    map_from_local: Floats
    covariance: Floats
    points: int
    kept: int
    residual: float
    """Root mean square of the residuals over their expected σ."""


def fit_road(local_points_m: Floats, heights_m: Floats, road: LayerTarget, guess: Floats) -> RoadFit:
    """Fit the ground of a local map (n, 3) [m] in L, heights (n,) above the road at `guess`, to the road cloud.

    `guess` is map_from_local (4, 4). Ambiguous: a slope is not seen (a narrow strip of road) and stays the guess's.
    """
    near = np.hypot(local_points_m[:, 0], local_points_m[:, 1]) < NEAR_M
    ground = thinned_evenly(local_points_m[near & (np.abs(heights_m) < GROUND_M)], _AT_MOST)
    ground = ground[find_correspondences(road, ground, guess)[1] <= MAX_DISTANCE_M]
    unseen = np.diag(_UNSEEN**2)
    if len(ground) < _MIN_POINTS:
        return RoadFit("lost", guess.copy(), unseen, len(ground), 0, math.inf)
    fit = icp_point_to_plane([(road, ground)], guess, "vertical", MAX_DISTANCE_M, _FIRST_SCALE_M)
    rows = normal_equations(
        road, ground, fit.transform, "vertical", find_correspondences(road, ground, fit.transform)
    )
    kept = int(np.count_nonzero(rows.kept))
    residual = math.sqrt(rows.square / rows.weight) if rows.weight else math.inf
    if not fit.converged or 2 * kept < len(ground) or residual > _MAX_RESIDUAL:
        return RoadFit("lost", guess.copy(), unseen, len(ground), kept, residual)
    patches = voxel_count(ground[rows.kept], PATCH_M)
    information = np.diag(_UNSEEN**-2) + rows.information() * (patches / kept / max(1.0, residual**2))
    covariance = _FLOOR + np.linalg.inv(information)
    seen = bool((np.diag(covariance) < 0.01 * _UNSEEN**2).all())
    return RoadFit(
        "converged" if seen else "ambiguous", fit.transform, covariance, len(ground), kept, residual
    )
