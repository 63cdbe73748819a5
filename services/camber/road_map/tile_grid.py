"""Web-Mercator tiles of the map: tile of a point, tiles around it, and the local frame of a tile.

Tiles are numbered z/x/y as in OGC 17-083r4 (Two Dimensional Tile Matrix Set), annex D.1, "WebMercatorQuad": x from
the antimeridian eastwards, y from 85.05° north southwards. The projection serves to *name* tiles only; geometry is
in the tangent plane about a tile's centre (`tile_frame`).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camber.geodesy.ellipsoid import meridian_radius_m, prime_vertical_radius_m
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.road import ZOOM

TILES = 1 << ZOOM
"""Number of tiles around the earth, and from its northern to its southern limit."""
LIMIT_LATITUDE_RAD = math.atan(math.sinh(math.pi))
"""Beyond this latitude (85.05°) there are no tiles."""
MARGIN_M = 1.0
"""Geometry within this distance of a tile is stored in it, so that one tile suffices for a search; chosen: larger
than the 0.5 m tolerance of a surface (`TOLERANCE_M`)."""

Tile = tuple[int, int]
"""Numbers x, y of a tile at ZOOM."""

# Margin for taking the sides of a box of some kilometres as straight; the error is far below a thousandth.
_BOX_FACTOR = 1.001


def tile_of(latitude_rad: float, longitude_rad: float) -> Tile | None:
    """Return the tile of a point, None beyond 85.05° of latitude. A point on a border has the larger number."""
    if not abs(latitude_rad) < LIMIT_LATITUDE_RAD:
        return None
    x = math.floor((longitude_rad + math.pi) / (2.0 * math.pi) * TILES)
    y = math.floor((0.5 - math.asinh(math.tan(latitude_rad)) / (2.0 * math.pi)) * TILES)
    return x % TILES, min(max(y, 0), TILES - 1)


def tiles_of(
    latitude_rad: ArrayLike, longitude_rad: ArrayLike
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return tile numbers x, y (n,) of n points, as `tile_of`; both are −1 beyond 85.05° of latitude."""
    latitude, longitude = np.asarray(latitude_rad, np.float64), np.asarray(longitude_rad, np.float64)
    has_tile = np.abs(latitude) < LIMIT_LATITUDE_RAD
    x = np.floor(_column(longitude)).astype(np.int64) % TILES
    y = np.clip(np.floor(_row(np.where(has_tile, latitude, 0.0))), 0, TILES - 1).astype(np.int64)
    return np.where(has_tile, x, -1), np.where(has_tile, y, -1)


def world_shares(
    latitude_rad: NDArray[np.float64], longitude_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return places (n, 2) in shares of the whole projection, from west and from north."""
    return np.column_stack((_column(longitude_rad), _row(latitude_rad))) / TILES


@lru_cache(maxsize=4096)
def tile_frame(x: int, y: int) -> LocalFrame:
    """Return the frame of a tile: tangent at ellipsoidal height zero to its centre (in the projection)."""
    latitude_rad = math.atan(math.sinh(math.pi * (1.0 - 2.0 * (y + 0.5) / TILES)))
    return LocalFrame(latitude_rad, 2.0 * math.pi * (x + 0.5) / TILES - math.pi, 0.0)


def tile_corners_rad(x: int, y: int) -> tuple[float, float, float, float]:
    """Return south, west, north, east of a tile in radians."""
    north, south = (math.atan(math.sinh(math.pi * (1.0 - 2.0 * row / TILES))) for row in (y, y + 1))
    return south, 2.0 * math.pi * x / TILES - math.pi, north, 2.0 * math.pi * (x + 1) / TILES - math.pi


def tiles_around(latitude_rad: float, longitude_rad: float, radius_m: float) -> list[Tile]:
    """Return the tiles within `radius_m` of a point, possibly some more; none beyond 85.05° of latitude."""
    if not abs(latitude_rad) < LIMIT_LATITUDE_RAD:
        return []
    latitude, longitude, radius = (np.array([value]) for value in (latitude_rad, longitude_rad, radius_m))
    _, x, y = tiles_of_boxes(latitude, longitude, radius, radius)
    return list(zip(x.tolist(), y.tolist(), strict=True))


def tiles_of_boxes(
    latitude_rad: NDArray[np.float64],
    longitude_rad: NDArray[np.float64],
    half_east_m: NDArray[np.float64],
    half_north_m: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the tiles that boxes about n centres touch: (box, x, y), one row per pair, by box, then y, then x.

    Boxes extend `half_east_m`, `half_north_m` to each side, and are cut off north and south of all tiles.
    """
    # Both radii of curvature are least at the equator, so a box is never taken for too small.
    d_latitude = half_north_m * _BOX_FACTOR / meridian_radius_m(0.0)
    # The parallel is shortest at the end of the box that is nearer to a pole.
    widest = np.minimum(np.abs(latitude_rad) + d_latitude, LIMIT_LATITUDE_RAD)
    d_longitude = half_east_m * _BOX_FACTOR / (prime_vertical_radius_m(0.0) * np.cos(widest))
    x0 = np.floor(_column(longitude_rad - d_longitude)).astype(np.int64)
    x1 = np.floor(_column(longitude_rad + d_longitude)).astype(np.int64)
    y0 = np.floor(_row(_within(latitude_rad + d_latitude))).astype(np.int64)
    y1 = np.floor(_row(_within(latitude_rad - d_latitude))).astype(np.int64)
    y0, y1 = np.clip(y0, 0, TILES - 1), np.clip(y1, 0, TILES - 1)
    wide, high = np.minimum(x1 - x0 + 1, TILES), y1 - y0 + 1
    box = np.repeat(np.arange(len(x0)), wide * high)
    number = np.arange(len(box)) - np.repeat(np.cumsum(wide * high) - wide * high, wide * high)
    return box, (x0[box] + number % wide[box]) % TILES, y0[box] + number // wide[box]


def _column(longitude_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    return (longitude_rad + math.pi) / (2.0 * math.pi) * TILES


def _row(latitude_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    return (0.5 - np.arcsinh(np.tan(latitude_rad)) / (2.0 * math.pi)) * TILES


def _within(latitude_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.clip(latitude_rad, -LIMIT_LATITUDE_RAD, LIMIT_LATITUDE_RAD)
