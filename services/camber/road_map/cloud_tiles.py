"""Divide a map's point cloud into tiles of quantised points; a point is in every tile within MARGIN_M of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.ellipsoid import meridian_radius_m, prime_vertical_radius_m
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.tile_grid import MARGIN_M, TILES, Tile, tile_corners_rad, tile_frame, tiles_of_boxes
from camber.schemas.road import CloudTile, Layer

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

RESOLUTION_M = 0.005
"""Quantisation step of stored points; chosen: below the range noise of LiDAR sensors of about 2 cm."""
_NODES_M = 25.0  # interpolation error 25² / 8 R = 12 µm, see `_NodeGrid`
_KEY_HALF = 1 << 20  # offset that makes voxel indices of 21 bits positive


def first_of_voxels(points_m: Floats, voxel_m: float) -> Integers:
    """Return the rows of the first point in each voxel, ascending."""
    cell = np.floor(points_m / voxel_m).astype(np.int64) + _KEY_HALF
    key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    _, first = np.unique(key, return_index=True)
    rows: Integers = np.sort(first)
    return rows


def cloud_tiles(points_m: Floats, frame: LocalFrame, layer: Layer, seen_ns: int) -> list[CloudTile]:
    """Make the tiles of points (n, 3): east, north in the frame's tangent plane, and *ellipsoidal height*.

    `seen_ns`: time of the newest observation. The frame must not be at the antimeridian.
    """
    if not len(points_m):
        return []
    nodes = _NodeGrid(points_m)
    latitude, longitude, _ = frame.geodetic_from_east_north_array(nodes.plane_m, 0.0)
    everything = np.arange(len(points_m))
    at_latitude, at_longitude = nodes.between(latitude, everything), nodes.between(longitude, everything)
    tiles = []
    for tile_x, tile_y in _tiles_near(latitude, longitude):
        south, west, north, east = tile_corners_rad(tile_x, tile_y)
        margin_north = MARGIN_M / meridian_radius_m(0.0)
        margin_east = MARGIN_M / (prime_vertical_radius_m(0.0) * math.cos(max(abs(south), abs(north))))
        rows = np.flatnonzero(
            (at_latitude > south - margin_north)
            & (at_latitude < north + margin_north)
            & (at_longitude > west - margin_east)
            & (at_longitude < east + margin_east)
        )
        if not len(rows):
            continue
        plane = tile_frame(tile_x, tile_y).east_north_from_geodetic_array(latitude, longitude, 0.0)
        height = points_m[rows, 2]
        base = float(np.round(np.median(height)))
        east_m, north_m = (nodes.between(axis, rows) for axis in plane.T)
        about = np.column_stack((east_m, north_m, height - base))
        tiles.append(
            CloudTile(
                time_ns=seen_ns,
                x=tile_x,
                y=tile_y,
                layer=layer,
                base_height_m=base,
                resolution_m=RESOLUTION_M,
                quanta=np.rint(about / RESOLUTION_M).astype(np.int32),
            )
        )
    return tiles


def _tiles_near(latitude: Floats, longitude: Floats) -> list[Tile]:
    """Return the tiles within two node spacings of the nodes, in order."""
    reach = np.full(len(latitude), 2.0 * _NODES_M)
    _, x, y = tiles_of_boxes(latitude, longitude, reach, reach)
    return [divmod(tile, TILES) for tile in np.unique(x * TILES + y).tolist()]


class _NodeGrid:
    """Grid of nodes every 25 m for bilinear interpolation of coordinates (not at the antimeridian).

    The second derivatives between two tangent planes are those of the earth's curvature, 1 / R, so that the
    interpolation error is 25² / 8 R = 12 µm.
    """

    def __init__(self, points_m: Floats) -> None:
        low = points_m[:, :2].min(axis=0)
        at = (points_m[:, :2] - low) / _NODES_M
        self._cell = at.astype(np.int64)
        self._share = at - self._cell
        self._columns, self._rows = (self._cell.max(axis=0) + 2).tolist()
        e, n = np.meshgrid(np.arange(self._columns), np.arange(self._rows), indexing="ij")
        self.plane_m: Floats = low + _NODES_M * np.column_stack((e.ravel(), n.ravel()))

    def between(self, at_nodes: Floats, rows: Integers) -> Floats:
        """Interpolate values at the nodes to the points `rows` (k,)."""
        value = at_nodes.reshape(self._columns, self._rows)
        i, j = self._cell[rows].T
        u, v = self._share[rows].T
        lower = (1.0 - u) * value[i, j] + u * value[i + 1, j]
        upper = (1.0 - u) * value[i, j + 1] + u * value[i + 1, j + 1]
        result: Floats = (1.0 - v) * lower + v * upper
        return result
