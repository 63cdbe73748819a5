"""Roads of a release near a track, as numbers that the report's map draws: polygons of surfaces and lines of links."""

from __future__ import annotations

from typing import Any

import numpy as np

from camber.live.map_tiles import ReleaseSource, TilePlace, link_layers, surface_layers
from camber.live.vector_tiles import EXTENT, TileLayer
from camber.road_map.release import Release
from camber.road_map.tile_grid import LIMIT_LATITUDE_RAD, Tile
from camber.schemas.base import Float64, Int64
from camber.schemas.road import ZOOM

_CELLS = 2  # of a tile's side: roads of the track's own cells, about 250 m wide, and of those around them are drawn
_MOST_SURFACES = 20_000
"""Chosen: about 1 MB of the page, and some 80 km of road; of more only the links are drawn."""


def road_shapes(release: Release, latitude_rad: Float64, longitude_rad: Float64) -> dict[str, Any]:
    """Roads near the places (n,): corners and vertices in units of 1/`extent` of the tile `origin` at `zoom`.

    Raises ReleaseError.
    """
    cells = _cells_of(latitude_rad, longitude_rad)
    tiles = sorted({(x // _CELLS, y // _CELLS) for x, y in cells})
    origin = tiles[0] if tiles else (0, 0)
    place, source = TilePlace(ZOOM, *origin), ReleaseSource(release)
    within = [tile for tile in source.tiles() if tile in set(tiles)]
    surfaces: list[list[int]] = []
    sigma_m: list[float] = []
    for layer in surface_layers(source, within, place):
        near, surfaces = _near_track(layer, cells, origin)
        sigma_m = layer.properties["sigma"][near].tolist()
    links = [
        line for layer in link_layers(source, within, place) for line in _near_track(layer, cells, origin)[1]
    ]
    shown = len(surfaces) <= _MOST_SURFACES
    return {
        "zoom": ZOOM,
        "extent": EXTENT,
        "origin": origin,
        "surfaces": surfaces if shown else [],
        "sigma": sigma_m if shown else [],
        "links": links,
        "note": "" if shown else f"{len(surfaces):,} road surfaces are left out; their links are drawn",
    }


def _near_track(layer: TileLayer, cells: set[Tile], origin: Tile) -> tuple[Int64, list[list[int]]]:
    """Features with a point in one of the cells: their rows, and the points of each one after another."""
    of_point = layer.points * _CELLS // EXTENT + np.multiply(origin, _CELLS)
    is_near = np.array([tuple(cell) in cells for cell in of_point.tolist()], np.bool_)
    begins = layer.first[:-1]
    near = np.flatnonzero(np.add.reduceat(is_near, begins)) if len(begins) else np.zeros(0, np.int64)
    return near, [
        layer.points[layer.first[row] : layer.first[row + 1]].ravel().tolist() for row in near.tolist()
    ]


def _cells_of(latitude_rad: Float64, longitude_rad: Float64) -> set[Tile]:
    """Cells of the places and those around them."""
    known = (np.abs(latitude_rad) < LIMIT_LATITUDE_RAD) & np.isfinite(longitude_rad)
    latitude, longitude = latitude_rad[known], longitude_rad[known]
    column = (longitude + np.pi) / (2.0 * np.pi)
    row = 0.5 - np.arcsinh(np.tan(latitude)) / (2.0 * np.pi)
    cells = np.floor(np.column_stack((column, row)) * (_CELLS << ZOOM)).astype(np.int64)
    visited = {tuple(cell) for cell in cells.tolist()}
    return {(x + dx, y + dy) for x, y in visited for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
