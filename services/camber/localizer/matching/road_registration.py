"""Height, roll and pitch by registration of the local map's ground to the map's road cloud.

JP2016-109650A, step 10, determines them along the vehicle by a line (`road_line`); this is the same for a whole
surface and both slopes. Ground are the points of the local map within 0.3 m of the road, where the map has road:
pavements and verges are as low, but do not count for or against the road.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from camber.localizer.arrays import Floats
from camber.localizer.map_clouds.voxel_grid import thinned_evenly, voxel_count
from camber.localizer.matching.icp import (
    IcpOptions,
    find_correspondences,
    icp_point_to_plane,
    normal_equations,
)
from camber.localizer.matching.match_covariance import PATCH_M
from camber.localizer.matching.registration import LayerTarget

GROUND_M: Final = 0.3
"""Chosen: a point is ground within this height of the road, above or below."""
NEAR_M: Final = 25.0
"""Chosen: ground beyond this is hit at too flat an angle to be separated from what is on it."""
# Chosen: best σ of a road surface's height and slopes, by its crown, ruts and grass.
FLOOR_M: Final = 0.01
FLOOR_RAD: Final = 1.0e-3
_UNSEEN = np.array([10.0, 0.2, 0.2])
_FLOOR: Floats = np.diag([FLOOR_M**2, FLOOR_RAD**2, FLOOR_RAD**2])
# Chosen: for speed, for a fit worth its name, and as `MatchOptions.max_residual`.
_MAX_POINTS: Final = 1500
_MIN_POINTS: Final = 50
_MAX_RESIDUAL: Final = 3.0
_ICP = IcpOptions(free="vertical", max_distance_m=0.6, first_scale_m=0.3)


@dataclass(frozen=True, eq=False, kw_only=True)
class RoadFit:
    """`map_from_local` (4, 4) with up, roll and pitch by the road, and east, north and yaw of the guess.

    Lost: it is the guess. `covariance` (3, 3) of up [m], roll, pitch [rad] about L's axes.
    """

    status: Literal["converged", "ambiguous", "lost"]
    map_from_local: Floats
    covariance: Floats


def fit_road(local_points_m: Floats, heights_m: Floats, road: LayerTarget, guess: Floats) -> RoadFit:
    """Fit the ground of a local map (n, 3) [m] in the local frame, heights (n,) above the road at `guess`, to the
    road cloud.

    `guess` is map_from_local (4, 4). Ambiguous: a slope is not observed (a narrow strip of road) and stays the guess's.
    """
    near = np.hypot(local_points_m[:, 0], local_points_m[:, 1]) < NEAR_M
    ground = thinned_evenly(local_points_m[near & (np.abs(heights_m) < GROUND_M)], _MAX_POINTS)
    ground = ground[find_correspondences(road, ground, guess)[1] <= _ICP.max_distance_m]
    lost = RoadFit(status="lost", map_from_local=guess.copy(), covariance=np.diag(_UNSEEN**2))
    if len(ground) < _MIN_POINTS:
        return lost
    fit = icp_point_to_plane([(road, ground)], guess, _ICP)
    correspondences = find_correspondences(road, ground, fit.transform)
    equations = normal_equations(road, ground, fit.transform, correspondences, free=_ICP.free)
    inliers, residual = int(np.count_nonzero(equations.inliers)), equations.rms()
    if not fit.converged or 2 * inliers < len(ground) or residual > _MAX_RESIDUAL:
        return lost
    patches = voxel_count(ground[equations.inliers], PATCH_M)
    information = np.diag(_UNSEEN**-2) + equations.information() * (patches / inliers / max(1.0, residual**2))
    covariance = _FLOOR + np.linalg.inv(information)
    observed = bool((np.diag(covariance) < 0.01 * _UNSEEN**2).all())
    status: Literal["converged", "ambiguous"] = "converged" if observed else "ambiguous"
    return RoadFit(status=status, map_from_local=fit.transform, covariance=covariance)
