"""Spatial index of a tile's road surfaces: which are at a point, and their height and slope there.

A surface's axes: u along (yaw, counter-clockwise from east), v across (positive to the left), metres from its centre.
Its grid is interpolated bilinearly, and extrapolated with the slope at its edge within TOLERANCE_M.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.tangent_planes import plane_origins, plane_series
from camber.road_map.height_interpolation import grid_plane
from camber.road_map.tile_checks import surface_slopes
from camber.road_map.tile_grid import MARGIN_M, tile_corners_rad, tile_frame
from camber.schemas.road import SurfaceTile

TOLERANCE_M = 0.5
"""Extrapolation of a surface beyond its rectangle; chosen: closes gaps between rectangles of imported maps."""
CELL_M = 10.0
"""Side of the cells of the index; chosen: about half the 20 m of a surface."""
EDGE_M = 1e-6
"""Rounding tolerance of positions; chosen: a point on an edge is inside in both computations."""
_LEAST_SIGMA_M = 0.01  # chosen: a departure from the plane of less than a centimetre is ignored

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class SurfaceHit(NamedTuple):
    """A surface at a point and its tangent plane there; `offset_m`: distance from the centre line."""

    surface_id: int
    link_id: int
    level: int
    inside: bool
    offset_m: float
    height_m: float
    sigma_m: float
    slope_east: float
    slope_north: float
    extent_m: float


class SurfaceTable(NamedTuple):
    """The surfaces of a tile for compiled loops; rows by surface id.

    `origin` (5,), `series` (9,): of the tile's plane; `shape` (n, 8): centre east and north, cosine and sine of the
    yaw, half length, half width, σ and extent; `grid` (n, 3): first height, rows and columns; `names` (n, 3): surface,
    link and level. Rows of cell i: `cell_rows[cell_start[i] : cell_start[i + 1]]`, at most `most_in_cell`.
    """

    origin: Floats
    series: Floats
    west_m: float
    south_m: float
    columns: int
    lines: int
    most_in_cell: int
    cell_start: Integers
    cell_rows: Integers
    shape: Floats
    grid: Integers
    names: Integers
    heights_m: Floats


class TileIndex:
    """Index of one tile: cells of 10 m, each with the surfaces that reach into it."""

    def __init__(self, tile: SurfaceTile) -> None:
        order = np.argsort(tile.surface_id, kind="stable")
        names = np.column_stack((tile.surface_id, tile.link_id, tile.level)).astype(np.int64)[order]
        length_m, width_m, sigma_m = (
            column[order].astype(np.float64)
            for column in (tile.half_length_m, tile.half_width_m, tile.sigma_m)
        )
        # Within the surface the tangent plane departs by at most the distance times the spread of slopes.
        spread = surface_slopes(tile)[1][order]
        reach_m = np.maximum(sigma_m, _LEAST_SIGMA_M) / np.maximum(spread, 1e-9)
        extent_m = np.minimum(reach_m, np.hypot(length_m, width_m))
        east_m, north_m, yaw_rad = tile.centre_east_m[order], tile.centre_north_m[order], tile.yaw_rad[order]
        shape = np.column_stack(
            (east_m, north_m, np.cos(yaw_rad), np.sin(yaw_rad), length_m, width_m, sigma_m, extent_m)
        )
        grid = np.column_stack((tile.first_height, tile.rows, tile.columns)).astype(np.int64)[order]
        self.frame = tile_frame(tile.x, tile.y)
        self.table = SurfaceTable(
            origin=plane_origins([self.frame.latitude_rad], [self.frame.longitude_rad])[0],
            series=plane_series(self.frame.latitude_rad, self.frame.longitude_rad),
            shape=shape,
            grid=grid,
            names=names,
            heights_m=tile.base_height_m + tile.grid_m.astype(np.float64),
            **_cells(self.frame, tile_corners_rad(tile.x, tile.y), shape),
        )
        # The same as Python numbers: for a single point many times faster than numpy.
        self._row_of = {surface: row for row, surface in enumerate(names[:, 0].tolist())}
        self._shape: list[list[float]] = shape.tolist()
        self._grid: list[tuple[int, int, int]] = list(zip(*grid.T.tolist(), strict=True))
        self._names: list[list[int]] = names.tolist()
        self._cell_start: list[int] = self.table.cell_start.tolist()
        self._cell_rows: list[int] = self.table.cell_rows.tolist()

    def link_and_level(self, surface_id: int) -> tuple[int, int] | None:
        """Return link and level of a surface; None if it is not in this tile."""
        row = self._row_of.get(surface_id)
        return None if row is None else (self._names[row][1], self._names[row][2])

    def hits(self, east_m: float, north_m: float) -> list[SurfaceHit]:
        """Return the surfaces at a point of the tile, by surface id."""
        table = self.table
        column = math.floor((east_m - table.west_m) / CELL_M)
        line = math.floor((north_m - table.south_m) / CELL_M)
        if not (0 <= column < table.columns and 0 <= line < table.lines):
            return []
        cell = line * table.columns + column
        hits = []
        for row in self._cell_rows[self._cell_start[cell] : self._cell_start[cell + 1]]:
            centre_east, centre_north, cos, sin, half_length, half_width, sigma, extent = self._shape[row]
            half_size = half_length, half_width
            u, v, near, inside = on_surface(
                (east_m - centre_east, north_m - centre_north), (cos, sin), half_size
            )
            if not near:
                continue
            height, slope_u, slope_v = grid_plane(table.heights_m, self._grid[row], half_size, (u, v))
            surface_id, link_id, level = self._names[row]
            hits.append(
                SurfaceHit(
                    surface_id=surface_id,
                    link_id=link_id,
                    level=level,
                    inside=inside,
                    offset_m=abs(v),
                    height_m=height,
                    sigma_m=sigma,
                    slope_east=slope_u * cos - slope_v * sin,
                    slope_north=slope_u * sin + slope_v * cos,
                    extent_m=extent,
                )
            )
        return hits


@compiled
def on_surface(
    offset_m: tuple[float, float], direction: tuple[float, float], half_size: tuple[float, float]
) -> tuple[float, float, bool, bool]:
    """Return u and v of a point on a surface, whether it is within the tolerance, and whether inside.

    `offset_m`: east and north from the surface's centre; `direction`: cosine and sine of its yaw.
    """
    (east_m, north_m), (cos, sin), (half_length, half_width) = offset_m, direction, half_size
    u, v = cos * east_m + sin * north_m, cos * north_m - sin * east_m
    beyond_u, beyond_v = abs(u) - half_length, abs(v) - half_width
    near = (beyond_u <= TOLERANCE_M) & (beyond_v <= TOLERANCE_M)
    if beyond_u > 0.0 and beyond_v > 0.0:
        near &= math.hypot(beyond_u, beyond_v) <= TOLERANCE_M
    return u, v, near, (beyond_u <= EDGE_M) & (beyond_v <= EDGE_M)


def _cells(
    frame: LocalFrame, corners_rad: tuple[float, float, float, float], shape: Floats
) -> dict[str, Any]:
    """Assign surfaces to cells: the fields of SurfaceTable about cells."""
    south, west, north, east = corners_rad
    corners_m = frame.east_north_from_geodetic_array(
        [south, south, north, north], [west, east, west, east], np.zeros(4)
    )
    west_m, south_m = (corners_m.min(axis=0) - MARGIN_M).tolist()
    columns, lines = np.ceil((np.ptp(corners_m, axis=0) + 2.0 * MARGIN_M) / CELL_M).astype(int).tolist()
    centre_east, centre_north, cos, sin, half_length, half_width, _, _ = shape.T
    half_east = np.abs(cos) * half_length + np.abs(sin) * half_width + TOLERANCE_M + EDGE_M
    half_north = np.abs(sin) * half_length + np.abs(cos) * half_width + TOLERANCE_M + EDGE_M
    first_column, last_column = _span(centre_east - west_m, half_east, columns)
    first_line, last_line = _span(centre_north - south_m, half_north, lines)
    wide = np.maximum(last_column - first_column + 1, 0)
    count = wide * np.maximum(last_line - first_line + 1, 0)
    row = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    cell = (first_line[row] + nth // wide[row]) * columns + first_column[row] + nth % wide[row]
    order = np.argsort(cell, kind="stable")  # stable: by row and so by surface id within a cell
    start = np.searchsorted(cell[order], np.arange(columns * lines + 1))
    return {
        "west_m": west_m,
        "south_m": south_m,
        "columns": columns,
        "lines": lines,
        "most_in_cell": int(np.diff(start).max(initial=0)),
        "cell_start": start,
        "cell_rows": row[order],
    }


def _span(centre_m: Floats, half_m: Floats, cells: int) -> tuple[Integers, Integers]:
    first = np.floor((centre_m - half_m) / CELL_M).astype(np.int64)
    last = np.floor((centre_m + half_m) / CELL_M).astype(np.int64)
    return np.maximum(first, 0), np.minimum(last, cells - 1)
