"""Heights of a map where the surface is not given: those of the nearest one."""

from __future__ import annotations

import numpy as np

from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.road_columns import Floats, RoadSurfaces


def nearest_heights(
    surfaces: RoadSurfaces,
    latitude_rad: Floats,
    longitude_rad: Floats,
    *,
    near_m: float = np.inf,
    level: int | None = None,
) -> tuple[Floats, Floats]:
    """Heights (n,) [m], NaN where no surface (of the level) is within `near_m`, and distances outside the surfaces."""
    heights, n = SurfaceHeights(surfaces), len(latitude_rad)
    height_m, outside_m = np.full(n, np.nan), np.full(n, near_m)
    for row in np.flatnonzero(surfaces.level == (surfaces.level if level is None else level)):
        surface_m, off_m = heights.heights_m(np.full(n, row), latitude_rad, longitude_rad)
        nearer = off_m < outside_m
        height_m[nearer], outside_m[nearer] = surface_m[nearer], off_m[nearer]
    return height_m, outside_m
