"""The map as vector tiles: road surfaces with σ, level and age, and links; what is too small to draw is left out.

Zoom 14 and above: surfaces and links. 12 and 13: links. Below: the squares in which there is a map.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.live.vector_tiles import EXTENT, TileLayer, encode_tile
from camber.road_map.release import Release
from camber.road_map.tile_grid import Tile, tile_frame
from camber.schemas.base import Float64, Int64
from camber.schemas.road import ZOOM, CloudTile, Layer, LinkTile, SurfaceTile

SURFACE_ZOOM, LINK_ZOOM, LEAST_ZOOM = 14, 12, 6
"""Least zoom at which each is drawn. Chosen: a road of 8 m is a pixel wide at zoom 14; a tile at zoom 12
has links of 256."""
_CACHED = 512  # chosen: some megabytes
_CLOUDS_CACHED = 4  # chosen: of at most 5 MB each
_MOST_POINTS = 400_000  # of a tile; chosen: more are not distinguished on a screen
_MILLIMETRE_DECIMALS = 3  # of σ: few different values make small tiles
_DAY_NS = 86_400_000_000_000  # nanoseconds of a day


class TilePlace(NamedTuple):
    """Number of a tile at any zoom."""

    zoom: int
    x: int
    y: int


class MapSource(Protocol):
    """Where tiles of a release come from; raises ReleaseError for what cannot be read."""

    def surface_tile(self, x: int, y: int) -> SurfaceTile | None:
        """Road surfaces of a tile at `ZOOM`."""

    def link_tile(self, x: int, y: int) -> LinkTile | None:
        """Links of a tile at `ZOOM`."""

    def cloud_tile(self, layer: Layer, x: int, y: int) -> CloudTile | None:
        """Points of a tile at `ZOOM`."""

    def tiles(self) -> list[Tile] | None:
        """All tiles with surfaces or links; None where nobody knows."""

    def describe(self) -> dict[str, Any]:
        """Region, version, datum, and where there is a map, for the page."""


class ReleaseSource:
    """The tiles of a release in a folder."""

    def __init__(self, release: Release) -> None:
        self._release = release
        self._tiles = sorted({*release.tiles("surfaces"), *release.tiles("links")})

    def surface_tile(self, x: int, y: int) -> SurfaceTile | None:
        """Road surfaces of a tile."""
        return self._release.surface_tile(x, y)

    def link_tile(self, x: int, y: int) -> LinkTile | None:
        """Links of a tile."""
        return self._release.link_tile(x, y)

    def cloud_tile(self, layer: Layer, x: int, y: int) -> CloudTile | None:
        """Points of a tile."""
        return self._release.cloud_tile(layer, x, y)

    def tiles(self) -> list[Tile]:
        """All tiles with surfaces or links."""
        return self._tiles

    def describe(self) -> dict[str, Any]:
        """Region, version, datum and the bounds west, south, east, north in degrees."""
        manifest = self._release.manifest
        facts: dict[str, Any] = {
            "region": manifest.region,
            "version": manifest.map_version,
            "datum": manifest.datum,
            "surrogate": manifest.surrogate,
        }
        if self._tiles:
            x, y = np.array(self._tiles).T
            west, north = degrees_of(float(x.min()), float(y.min()))
            east, south = degrees_of(float(x.max() + 1), float(y.max() + 1))
            facts["bounds"] = [west, south, east, north]
        return facts


class MapTiles:
    """Encodes and keeps tiles."""

    def __init__(self, source: MapSource) -> None:
        self.source = source
        self.tile = lru_cache(maxsize=_CACHED)(self._tile)
        self.points = lru_cache(maxsize=_CLOUDS_CACHED)(self._points)

    def _tile(self, zoom: int, x: int, y: int) -> bytes:
        """A tile; empty where there is no map. Raises ReleaseError."""
        if not LEAST_ZOOM <= zoom <= ZOOM:
            return b""
        within, place = self._within(zoom, x, y), TilePlace(zoom, x, y)
        if zoom < LINK_ZOOM:
            return encode_tile([_squares(within, place)])
        layers = [_links(self.source, within, place)]
        if zoom >= SURFACE_ZOOM:
            layers.append(_surfaces(self.source, within, place))
        return encode_tile(layers)

    def _points(self, x: int, y: int) -> bytes:
        """Points of the environment in a tile at `ZOOM`, of many some: three float32 each. Raises ReleaseError.

        Place from west and from north in shares of the tile, and height [m] above the lowest point.
        """
        cloud = self.source.cloud_tile("environment_cloud", x, y)
        if cloud is None or not len(cloud.quanta):
            return b""
        quanta = cloud.quanta[:: -(-len(cloud.quanta) // _MOST_POINTS)]
        points_m = quanta.astype(np.float64) * cloud.resolution_m
        places = _shares(points_m[:, :2], (x, y), TilePlace(ZOOM, x, y))
        heights_m = points_m[:, 2] - points_m[:, 2].min()
        return np.column_stack((places, heights_m)).astype("<f4").tobytes()

    def _within(self, zoom: int, x: int, y: int) -> list[Tile]:
        size = 1 << (ZOOM - zoom)
        known = self.source.tiles()
        if known is None:
            columns, rows = range(x * size, (x + 1) * size), range(y * size, (y + 1) * size)
            return [(a, b) for a in columns for b in rows] if zoom >= LINK_ZOOM else []
        return [tile for tile in known if tile[0] // size == x and tile[1] // size == y]


def degrees_of(x: float, y: float) -> tuple[float, float]:
    """Longitude and latitude [°] of a place in numbers of tiles at `ZOOM`."""
    share = math.pi * (1.0 - 2.0 * y / (1 << ZOOM))
    return x / (1 << ZOOM) * 360.0 - 180.0, math.degrees(math.atan(math.sinh(share)))


def _surfaces(source: MapSource, within: Iterable[Tile], place: TilePlace) -> TileLayer:
    layer, drawn = TileLayer(name="surfaces", kind="Polygon"), set[int]()
    for tile in within:
        surfaces = source.surface_tile(*tile)
        if surfaces is None:
            continue
        corners = _units(_corners(surfaces).reshape(-1, 2), tile, place).reshape(-1, 4, 2)
        sigma = np.round(surfaces.sigma_m.astype(np.float64), _MILLIMETRE_DECIMALS).tolist()
        levels, numbers = surfaces.level.tolist(), surfaces.surface_id.tolist()
        for row, number in enumerate(numbers):
            if number in drawn:  # what touches two tiles stands in both
                continue
            drawn.add(number)
            day = unix_ns_from_gps_ns(int(surfaces.last_seen_ns[row])) // _DAY_NS
            layer.add(number, corners[row], {"sigma": sigma[row], "level": levels[row], "day": day})
    return layer


def _corners(surfaces: SurfaceTile) -> Float64:
    """Corners (n, 4, 2) of the rectangles in the tile's plane, clockwise."""
    signs = np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)])
    along = surfaces.half_length_m[:, None] * signs[:, 0]
    across = surfaces.half_width_m[:, None] * signs[:, 1]
    cos, sin = np.cos(surfaces.yaw_rad)[:, None], np.sin(surfaces.yaw_rad)[:, None]
    east = surfaces.centre_east_m[:, None] + along * cos - across * sin
    north = surfaces.centre_north_m[:, None] + along * sin + across * cos
    return np.stack((east, north), axis=2)


def _links(source: MapSource, within: Iterable[Tile], place: TilePlace) -> TileLayer:
    layer, drawn = TileLayer(name="links", kind="LineString"), set[int]()
    for tile in within:
        links = source.link_tile(*tile)
        if links is None:
            continue
        units = _units(np.column_stack((links.east_m, links.north_m)), tile, place)
        for row, line in enumerate(np.split(units, links.first_vertex[1:-1]) if len(links.link_id) else []):
            number = int(links.link_id[row])
            if number not in drawn:
                drawn.add(number)
                layer.add(number, line, {"level": int(links.level[row])})
    return layer


def _squares(within: Iterable[Tile], place: TilePlace) -> TileLayer:
    layer = TileLayer(name="squares", kind="Polygon")
    finer = ZOOM - place.zoom
    scale = EXTENT >> finer
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    for number, tile in enumerate(within):
        at = np.array(tile) - (np.array((place.x, place.y)) << finer)
        layer.add(number, (at + corners) * scale, {})
    return layer


def _units(east_north_m: Float64, tile: Tile, place: TilePlace) -> Int64:
    """Points (n, 2) of a tile's plane in units of another tile, y downwards."""
    return np.round(_shares(east_north_m, tile, place) * EXTENT).astype(np.int64)


def _shares(east_north_m: Float64, tile: Tile, place: TilePlace) -> Float64:
    """Points (n, 2) of a tile's plane in shares of another tile's side, y downwards."""
    if not len(east_north_m):
        return np.zeros((0, 2))
    latitude, longitude, _ = tile_frame(*tile).geodetic_from_east_north_array(east_north_m, 0.0)
    number = float(1 << place.zoom)
    column = (longitude + math.pi) / (2.0 * math.pi) * number - place.x
    row = (0.5 - np.arcsinh(np.tan(latitude)) / (2.0 * math.pi)) * number - place.y
    return np.column_stack((column, row))
