"""What a scan match was made of, for a picture of it: the local map where it was put, the map, and what is between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import transform_points
from camber.localizer.map_clouds.map_blocks import Block
from camber.localizer.matching.layered_matching import LayeredMatch, MatchOptions

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MatchView:
    """One match. All points are in the block's frame; heights are above the road, NaN far from any road."""

    time_ns: int
    match: LayeredMatch
    frame: LocalFrame
    base_height_m: float
    points_m: Floats
    """(n, 3) the local map, where the match has put it."""
    heights_m: Floats
    """(n,) of them above the road."""
    layer: NDArray[np.int64]
    """(n,) which of the match's layers they are in, −1 in none."""
    residual_m: Floats
    """(n,) from the plane of the nearest map point of the layer; NaN where that is farther off than a pair may be."""
    map_m: Floats
    """(k, 3) the environment."""
    map_heights_m: Floats
    """(k,) of it above the road."""


def match_view(
    time_ns: int,
    local_points_m: Floats,
    heights_m: Floats,
    block: Block,
    match: LayeredMatch,
    options: MatchOptions,
) -> MatchView:
    """`local_points_m` (n, 3) and `heights_m` (n,) as `match_layers` was given them, with the block's layers."""
    points_m = transform_points(match.map_from_local, local_points_m)
    layer = np.full(len(points_m), -1)
    residual_m = np.full(len(points_m), np.nan)
    targets = block.layers(options.bounds_m)
    for number, ((low_m, high_m), target) in enumerate(zip(options.bounds_m, targets, strict=True)):
        mine = np.flatnonzero((heights_m >= low_m) & (heights_m < high_m))
        layer[mine] = number
        if target.empty or not len(mine):
            continue
        rows, distance_m = target.nearest(points_m[mine])
        apart_m = np.einsum("ij,ij->i", target.normals[rows], points_m[mine] - target.points_m[rows])
        residual_m[mine] = np.where(distance_m <= options.max_distance_m, np.abs(apart_m), np.nan)
    return MatchView(
        time_ns,
        match,
        block.frame,
        block.base_height_m,
        points_m,
        heights_m,
        layer,
        residual_m,
        block.environment_m,
        block.height_above_road_m,
    )
