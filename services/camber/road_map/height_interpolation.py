"""Heights of road surfaces given by id, for millions of points on a whole map.

Which surface a point is on is selected in map_server; here it is known. A surface's axes: u along (yaw,
counter-clockwise from east), v across (positive to the left), metres from its centre in the tangent plane there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from camber.compiled.decorator import compiled
from camber.geodesy.tangent_planes import east_north, plane_origins
from camber.road_map.road_columns import Floats, Integers, RoadSurfaces, rows_of_ids


class SurfaceHeights:
    """Height grids of all surfaces of a map; rows are those of the `RoadSurfaces` given."""

    def __init__(self, surfaces: RoadSurfaces) -> None:
        self._order = np.argsort(surfaces.surface_id, kind="stable")
        self._sorted_id = surfaces.surface_id[self._order]
        self._origin = plane_origins(surfaces.latitude_rad, surfaces.longitude_rad)
        yaw_rad = surfaces.yaw_rad
        self._shape = np.column_stack(
            (np.cos(yaw_rad), np.sin(yaw_rad), surfaces.half_length_m, surfaces.half_width_m)
        )
        shapes = np.array([grid.shape for grid in surfaces.heights_m], np.int64).reshape(-1, 2)
        sizes = shapes[:, 0] * shapes[:, 1]
        self._grid = np.column_stack((np.cumsum(sizes) - sizes, shapes))
        self._heights_m = np.concatenate([np.zeros(0), *(grid.ravel() for grid in surfaces.heights_m)])

    def __len__(self) -> int:
        return len(self._sorted_id)

    def rows_of(self, surface_id: ArrayLike) -> Integers:
        """Return the rows (n,) of surfaces; −1 for unknown ids."""
        row = rows_of_ids(self._sorted_id, np.asarray(surface_id, np.int64))
        return np.where(row >= 0, self._order[row], -1) if len(self) else row

    def heights_m(
        self, row: ArrayLike, latitude_rad: ArrayLike, longitude_rad: ArrayLike
    ) -> tuple[Floats, Floats]:
        """Return ellipsoidal heights (n,) [m] of surfaces at n points, and the distance of each point to its surface.

        Outside its rectangle a surface is extrapolated with the slope at its edge; the caller decides how far. For row
        −1, and for a point that is NaN or 100 km away, the distance is infinite and the height NaN. Raises ValueError
        for columns of different length and invalid rows.
        """
        rows = np.ascontiguousarray(row, np.int64)
        latitude = np.ascontiguousarray(latitude_rad, np.float64)
        longitude = np.ascontiguousarray(longitude_rad, np.float64)
        if rows.ndim != 1 or not rows.shape == latitude.shape == longitude.shape:
            shapes = f"{rows.shape}, {latitude.shape}, {longitude.shape}"
            raise ValueError(f"row, latitude_rad, longitude_rad: expected three of (n,), got {shapes}")
        if len(rows) and not -1 <= rows.min() <= rows.max() < len(self):
            raise ValueError(f"row: expected −1 to {len(self) - 1}, got {rows.min()} to {rows.max()}")
        return _heights(
            origin=self._origin,
            shape=self._shape,
            grid=self._grid,
            heights_m=self._heights_m,
            row=rows,
            latitude_rad=latitude,
            longitude_rad=longitude,
        )


@compiled
def _heights(
    origin: Floats,
    shape: Floats,
    grid: Integers,
    heights_m: Floats,
    row: Integers,
    latitude_rad: Floats,
    longitude_rad: Floats,
) -> tuple[Floats, Floats]:
    height_m, outside_m = np.full(len(row), np.nan), np.full(len(row), np.inf)
    for i in range(len(row)):
        k = row[i]
        if k < 0:
            continue
        east_m, north_m = east_north(origin[k], latitude_rad[i], longitude_rad[i])
        if east_m == math.inf:
            continue
        cos, sin, half_length, half_width = shape[k, 0], shape[k, 1], shape[k, 2], shape[k, 3]
        u, v = cos * east_m + sin * north_m, cos * north_m - sin * east_m
        beyond_u, beyond_v = max(abs(u) - half_length, 0.0), max(abs(v) - half_width, 0.0)
        outside_m[i] = math.sqrt(beyond_u * beyond_u + beyond_v * beyond_v)
        shape_of_grid = grid[k, 0], grid[k, 1], grid[k, 2]
        height_m[i], _, _ = grid_plane(heights_m, shape_of_grid, (half_length, half_width), (u, v))
    return height_m, outside_m


@compiled
def grid_plane(
    heights_m: Floats, grid: tuple[int, int, int], half_size: tuple[float, float], uv: tuple[float, float]
) -> tuple[float, float, float]:
    """Return height [m], slope along and slope across of a surface at `uv`, extrapolated beyond its edge.

    `grid`: index of the first height in `heights_m`, number of rows along and of columns across; bilinear between.
    """
    first, rows, columns = grid
    half_length, half_width = half_size
    u, v = uv
    at_u, at_v = min(max(u, -half_length), half_length), min(max(v, -half_width), half_width)
    step_u, step_v = 2.0 * half_length / (rows - 1), 2.0 * half_width / (columns - 1)
    p, q = (at_u + half_length) / step_u, (at_v + half_width) / step_v
    i, j = min(int(p), rows - 2), min(int(q), columns - 2)
    p, q = p - i, q - j
    k = first + i * columns + j
    a, b, c, d = heights_m[k], heights_m[k + 1], heights_m[k + columns], heights_m[k + columns + 1]
    slope_u = ((c - a) * (1.0 - q) + (d - b) * q) / step_u
    slope_v = ((b - a) * (1.0 - p) + (d - c) * p) / step_v
    height_m = (a * (1.0 - q) + b * q) * (1.0 - p) + (c * (1.0 - q) + d * q) * p
    return height_m + slope_u * (u - at_u) + slope_v * (v - at_v), slope_u, slope_v
