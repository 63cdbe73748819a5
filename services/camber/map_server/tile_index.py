"""Spatial index of a tile's road surfaces: which are at a point, and their height and slope there.

A surface's axes: u along (yaw, counter-clockwise from east), v across (positive to the left), metres from its centre.
Its grid is interpolated bilinearly, and extrapolated with the slope at its edge within TOLERANCE_M.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.tangent_planes import plane_origins, plane_series
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
        self.frame = tile_frame(tile.x, tile.y)
        self.surface_id = tile.surface_id[order]
        self.link_id = tile.link_id[order]
        self.level = tile.level[order].astype(np.int64)
        self.sigma_m = tile.sigma_m[order].astype(np.float64)
        half_length_m = tile.half_length_m[order].astype(np.float64)
        half_width_m = tile.half_width_m[order].astype(np.float64)
        # Within the surface the tangent plane departs by at most the distance times the spread of slopes.
        spread = surface_slopes(tile)[1][order]
        reach_m = np.maximum(self.sigma_m, _LEAST_SIGMA_M) / np.maximum(spread, 1e-9)
        self.extent_m = np.minimum(reach_m, np.hypot(half_length_m, half_width_m))
        cos, sin = np.cos(tile.yaw_rad[order]), np.sin(tile.yaw_rad[order])
        self._heights_m = tile.base_height_m + tile.grid_m.astype(np.float64)
        self._shape = np.column_stack(
            (
                tile.centre_east_m[order],
                tile.centre_north_m[order],
                cos,
                sin,
                half_length_m,
                half_width_m,
                self.sigma_m,
                self.extent_m,
            )
        )
        self._grid = np.column_stack((tile.first_height, tile.rows, tile.columns)).astype(np.int64)[order]
        self._row_of = {int(surface): row for row, surface in enumerate(self.surface_id.tolist())}
        self._make_cells(tile.x, tile.y)
        self.table = SurfaceTable(
            origin=plane_origins([self.frame.latitude_rad], [self.frame.longitude_rad])[0],
            series=plane_series(self.frame.latitude_rad, self.frame.longitude_rad),
            west_m=self._west_m,
            south_m=self._south_m,
            columns=self._columns,
            lines=self._lines,
            most_in_cell=int(np.diff(self._cell_start).max(initial=0)),
            cell_start=self._cell_start,
            cell_rows=self._cell_rows,
            shape=self._shape,
            grid=self._grid,
            names=np.column_stack((self.surface_id, self.link_id, self.level)),
            heights_m=self._heights_m,
        )
        # The same as Python numbers: for a single point many times faster than numpy.
        self._plain_shape: list[list[float]] = self._shape.tolist()
        self._plain_grid: list[list[int]] = self._grid.tolist()
        columns = (self.surface_id, self.link_id, self.level, self.sigma_m, self.extent_m)
        self._plain: list[tuple[int, int, int, float, float]] = list(
            zip(*(column.tolist() for column in columns), strict=True)
        )

    def row_of(self, surface_id: int) -> int | None:
        """Return the row of a surface; None if it is not in this tile."""
        return self._row_of.get(surface_id)

    def hits(self, east_m: float, north_m: float) -> list[SurfaceHit]:
        """Return the surfaces at a point of the tile, by surface id."""
        hits = []
        for row in self._plain_cell(east_m, north_m):
            centre_east, centre_north, cos, sin, half_length, half_width, _, _ = self._plain_shape[row]
            de, dn = east_m - centre_east, north_m - centre_north
            u, v = cos * de + sin * dn, cos * dn - sin * de
            beyond_u, beyond_v = abs(u) - half_length, abs(v) - half_width
            if beyond_u <= TOLERANCE_M and beyond_v <= TOLERANCE_M and _near(beyond_u, beyond_v):
                inside = beyond_u <= EDGE_M and beyond_v <= EDGE_M
                height, slope_u, slope_v = self._plane(row, (u, v), (half_length, half_width))
                surface_id, link_id, level, sigma, extent = self._plain[row]
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

    def _plane(
        self, row: int, uv: tuple[float, float], half_size: tuple[float, float]
    ) -> tuple[float, float, float]:
        """Return height, slope along and slope across, as `grid_plane`."""
        first, rows, columns = self._plain_grid[row]
        (u, v), (half_length, half_width) = uv, half_size
        at_u, at_v = min(max(u, -half_length), half_length), min(max(v, -half_width), half_width)
        step_u, step_v = 2.0 * half_length / (rows - 1), 2.0 * half_width / (columns - 1)
        p, q = (at_u + half_length) / step_u, (at_v + half_width) / step_v
        i, j = min(int(p), rows - 2), min(int(q), columns - 2)
        p, q = p - i, q - j
        item = self._heights_m.item
        k = first + i * columns + j
        a, b, c, d = item(k), item(k + 1), item(k + columns), item(k + columns + 1)
        slope_u = ((c - a) * (1.0 - q) + (d - b) * q) / step_u
        slope_v = ((b - a) * (1.0 - p) + (d - c) * p) / step_v
        height = (a * (1.0 - q) + b * q) * (1.0 - p) + (c * (1.0 - q) + d * q) * p
        return height + slope_u * (u - at_u) + slope_v * (v - at_v), slope_u, slope_v

    def _plain_cell(self, east_m: float, north_m: float) -> Sequence[int]:
        column = math.floor((east_m - self._west_m) / CELL_M)
        line = math.floor((north_m - self._south_m) / CELL_M)
        if not (0 <= column < self._columns and 0 <= line < self._lines):
            return ()
        return self._cells.get(line * self._columns + column, ())

    def _make_cells(self, x: int, y: int) -> None:
        """Assign surfaces to cells: `_cell_start`, `_cell_rows` as in SurfaceTable, `_cells` for one point."""
        south, west, north, east = tile_corners_rad(x, y)
        corners_m = self.frame.east_north_from_geodetic_array(
            [south, south, north, north], [west, east, west, east], np.zeros(4)
        )
        self._west_m, self._south_m = (corners_m.min(axis=0) - MARGIN_M).tolist()
        size_m = np.ptp(corners_m, axis=0) + 2.0 * MARGIN_M
        self._columns, self._lines = (math.ceil(size / CELL_M) for size in size_m.tolist())
        centre_east, centre_north, cos, sin, half_length, half_width, _, _ = self._shape.T
        half_east = np.abs(cos) * half_length + np.abs(sin) * half_width + TOLERANCE_M + EDGE_M
        half_north = np.abs(sin) * half_length + np.abs(cos) * half_width + TOLERANCE_M + EDGE_M
        first_column, last_column = _span(centre_east - self._west_m, half_east, self._columns)
        first_line, last_line = _span(centre_north - self._south_m, half_north, self._lines)
        wide = np.maximum(last_column - first_column + 1, 0)
        count = wide * np.maximum(last_line - first_line + 1, 0)
        row = np.repeat(np.arange(len(count)), count)
        nth = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        line, column = first_line[row] + nth // wide[row], first_column[row] + nth % wide[row]
        cell = line * self._columns + column
        order = np.argsort(cell, kind="stable")  # stable: by row and so by surface id within a cell
        self._cell_rows = row[order]
        self._cell_start = np.searchsorted(cell[order], np.arange(self._columns * self._lines + 1))
        filled, begin = np.unique(cell[order], return_index=True)
        groups = np.split(self._cell_rows, begin[1:]) if len(filled) else []
        self._cells: dict[int, list[int]] = {
            int(number): group.tolist() for number, group in zip(filled, groups, strict=True)
        }


def _near(beyond_u: float, beyond_v: float) -> bool:
    """Whether a point is within the tolerance of the rectangle, also at its corners."""
    return beyond_u <= 0.0 or beyond_v <= 0.0 or math.hypot(beyond_u, beyond_v) <= TOLERANCE_M


def _span(centre_m: Floats, half_m: Floats, cells: int) -> tuple[Integers, Integers]:
    first = np.floor((centre_m - half_m) / CELL_M).astype(np.int64)
    last = np.floor((centre_m + half_m) / CELL_M).astype(np.int64)
    return np.maximum(first, 0), np.minimum(last, cells - 1)
