"""The height model of JP7707657B2: at which height the antenna must be, from road and antenna height.

All heights are ellipsoidal metres, `h_a` is above the road.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camber.schemas.pose import Road, RoadPatch


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadPoint:
    """The road at one point: elevation `h_m` and its σ in metres, slope to east and north, which surface it is."""

    elevation_m: float
    sigma_m: float
    slope_east: float = 0.0
    slope_north: float = 0.0
    surface_id: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightModel:
    """Of the antenna above the road: `h_a`, the correction `h_e`, and the σ of both together, metres."""

    antenna_m: float
    correction_m: float
    sigma_m: float

    def expected_m(self, road: RoadPoint) -> float:
        """Where the antenna must be: `(h_m + h_a) + h_e`.

        The difference `(h_m + h_a) + h_e − h_r` is JP7707657B2 eq. (3) in the form that goes to zero. It prints `(h_m +
        h_a) − h_r − h_e`; with `h_e → h_r − (h_m + h_a)` of eq. (4) that would go to `−2 h_e`.
        """
        return road.elevation_m + self.antenna_m + self.correction_m

    def variance_m2(self, road: RoadPoint) -> float:
        """Of that height, in m²."""
        return road.sigma_m**2 + self.sigma_m**2


def road_at(road: Road, east_m: float, north_m: float) -> RoadPoint | None:
    """The road at an offset from the pose's antenna position; None where the surface's plane does not reach.

    The offset is that of the fix under test: the level and the surface were chosen without it, only the place on that
    surface is taken from it. A wrong fix some metres off is so compared with the road some metres off, an error of
    slope × metres that is far below what it is wrong by in height; a right one loses nothing to the pose's own error.
    """
    if road.status != "known" or road.elevation_m is None or road.sigma_m is None:
        return None
    if road.patch is not None:
        return _sampled(road.patch, east_m, north_m)
    if road.slope_east is None or road.slope_north is None or road.extent_m is None:
        return None
    if not math.hypot(east_m, north_m) <= road.extent_m:
        return None
    elevation_m = road.elevation_m + road.slope_east * east_m + road.slope_north * north_m
    return RoadPoint(
        elevation_m=elevation_m,
        sigma_m=road.sigma_m,
        slope_east=road.slope_east,
        slope_north=road.slope_north,
        surface_id=road.surface_id,
    )


def _sampled(patch: RoadPatch, east_m: float, north_m: float) -> RoadPoint | None:
    """The plane of the nearest sample, where one is in reach."""
    if not len(patch.east_m):
        return None
    east, north = east_m - patch.east_m, north_m - patch.north_m
    k = int(np.argmin(east**2 + north**2))
    if not math.hypot(east[k], north[k]) <= patch.reach_m:
        return None
    slope_east, slope_north = float(patch.slope_east[k]), float(patch.slope_north[k])
    elevation_m = float(patch.elevation_m[k]) + slope_east * float(east[k]) + slope_north * float(north[k])
    return RoadPoint(
        elevation_m=elevation_m,
        sigma_m=float(patch.sigma_m[k]),
        slope_east=slope_east,
        slope_north=slope_north,
        surface_id=int(patch.surface_id[k]),
    )
