"""The points of a scan match and how far each is from the map, thinned, as a message for viewers."""

from __future__ import annotations

import numpy as np

from camber.geodesy.se3 import transform_points
from camber.localizer.map_clouds.voxel_grid import rows_thinned_evenly
from camber.localizer.matching.layered_matching import MatchOptions
from camber.localizer.matching.match_candidate import MatchCandidate
from camber.localizer.matching.match_view import layer_residuals
from camber.schemas.pose import ScanMatchPoints

MOST_POINTS = 2000
"""Chosen: a wall is seen as a line at any scale of the live page, and the message has 26 kB."""


def match_points(candidate: MatchCandidate, options: MatchOptions) -> ScanMatchPoints | None:
    """The points of the layers where the match has placed them; None where it has not."""
    match, scan = candidate.match, candidate.scan
    if match.status == "lost":
        return None
    lowest_m, highest_m = options.bounds_m[0][0], options.bounds_m[-1][1]
    layered = np.flatnonzero((scan.heights_m >= lowest_m) & (scan.heights_m < highest_m))
    rows = layered[rows_thinned_evenly(scan.points_m[layered], MOST_POINTS)]
    points_m = transform_points(match.map_from_local, scan.points_m[rows])
    _, residual_m = layer_residuals(
        points_m, scan.heights_m[rows], scan.targets, from_m=match.map_from_local[:3, 3], options=options
    )
    latitude_rad, longitude_rad = candidate.place.block.geodetic(match.east_m, match.north_m)
    return ScanMatchPoints(
        time_ns=candidate.time_ns,
        status=match.status,
        latitude_rad=latitude_rad,
        longitude_rad=longitude_rad,
        east_m=(points_m[:, 0] - match.east_m).astype(np.float32),
        north_m=(points_m[:, 1] - match.north_m).astype(np.float32),
        paired=(~np.isnan(residual_m)).astype(np.uint8),
        residual_m=np.nan_to_num(residual_m).astype(np.float32),
    )
