"""View of a scan match for a picture: the local map as matched, the map, and the residuals between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import transform_points
from camber.localizer.arrays import Floats, Integers
from camber.localizer.map_clouds.map_blocks import MapBlock
from camber.localizer.matching.layered_matching import LayeredMatch, MatchInput, MatchOptions
from camber.localizer.matching.registration import LayerTarget


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MatchView:
    """One match. All points are in the block's frame; heights are above the road, NaN far from any road."""

    time_ns: int
    match: LayeredMatch
    frame: LocalFrame
    base_height_m: float
    points_m: Floats
    """(n, 3) the local map, as matched."""
    heights_m: Floats
    """(n,) of them above the road."""
    layer: Integers
    """(n,) their layer of the match, −1: none."""
    residual_m: Floats
    """(n,) from the plane of the nearest map point of the layer; NaN beyond the largest distance of a
    correspondence."""
    map_m: Floats
    """(k, 3) the environment."""
    map_heights_m: Floats
    """(k,) of it above the road."""


def match_view(
    time_ns: int, scan: MatchInput, block: MapBlock, match: LayeredMatch, *, options: MatchOptions
) -> MatchView:
    """Return the view of a match of `scan` to the block's layers."""
    points_m = transform_points(match.map_from_local, scan.points_m)
    layer, residual_m = layer_residuals(
        points_m,
        scan.heights_m,
        block.layers(options.bounds_m),
        from_m=match.map_from_local[:3, 3],
        options=options,
    )
    return MatchView(
        time_ns=time_ns,
        match=match,
        frame=block.frame,
        base_height_m=block.base_height_m,
        points_m=points_m,
        heights_m=scan.heights_m,
        layer=layer,
        residual_m=np.abs(residual_m),
        map_m=block.environment_m,
        map_heights_m=block.height_above_road_m,
    )


def layer_residuals(
    points_m: Floats,
    heights_m: Floats,
    targets: Sequence[LayerTarget],
    *,
    from_m: Floats,
    options: MatchOptions,
) -> tuple[Integers, Floats]:
    """Layer (n,) of matched points (n, 3) with heights (n,) above the road, −1: none, and distance (n,) from its plane.

    A distance is positive beyond the plane of the nearest map point as seen from `from_m` (3,), negative before it, NaN
    beyond the largest distance of a correspondence.
    """
    layer, residual_m = np.full(len(points_m), -1), np.full(len(points_m), np.nan)
    for number, ((low_m, high_m), target) in enumerate(zip(options.bounds_m, targets, strict=True)):
        rows = np.flatnonzero((heights_m >= low_m) & (heights_m < high_m))
        layer[rows] = number
        if target.empty or not len(rows):
            continue
        nearest, distance_m = target.nearest(points_m[rows])
        normal, on_plane_m = target.normals[nearest], target.points_m[nearest]
        outward = np.where(np.einsum("ij,ij->i", normal, on_plane_m - from_m) < 0.0, -1.0, 1.0)
        offset_m = outward * np.einsum("ij,ij->i", normal, points_m[rows] - on_plane_m)
        residual_m[rows] = np.where(distance_m <= options.max_distance_m, offset_m, np.nan)
    return layer, residual_m
