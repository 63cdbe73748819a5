"""The map as vector tiles: road surfaces with σ, level and age, and links; what is too small to draw is left out.

Zoom 15 and above: surfaces and links. 12 to 14: links. Below: the squares in which there is a map.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np

from camber.geodesy.gps_time import NS_PER_DAY, UNIX_OF_GPS_EPOCH_NS
from camber.live.vector_tiles import EXTENT, TileLayer, encode_tile
from camber.road_map.release import Release
from camber.road_map.road_tiles import grid_nodes, surface_corners_m, surface_heights_m
from camber.road_map.tile_grid import Tile, tile_frame, world_shares
from camber.schemas.base import Float64, Int64
from camber.schemas.road import ZOOM, CloudTile, Layer, LinkTile, SurfaceTile

SURFACE_ZOOM, LINK_ZOOM, LEAST_ZOOM = 15, 12, 6
"""Least zoom at which each is drawn. Chosen: at zoom 14 a road of 8 m is two pixels wide and hidden by its outline, and
a screen has 70,000 surfaces of a town; a tile at zoom 12 has links of 256."""
_CACHED = 512  # chosen: some megabytes
_CLOUDS_CACHED = 4  # chosen: of at most 5 MB each
_MOST_POINTS = 400_000  # of a tile; chosen: more are not distinguished on a screen
_MILLIMETRE_DECIMALS = 3  # of σ: few different values make small tiles
_HEIGHT_DECIMALS = 2  # chosen: a centimetre, as for σ
_CORNERS = 4  # of a surface, and of a square


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
        layers = link_layers(self.source, within, place)
        if zoom >= SURFACE_ZOOM:
            layers += surface_layers(self.source, within, place)
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


def surface_layers(
    source: MapSource, within: Iterable[Tile], place: TilePlace, *, with_height: bool = False
) -> list[TileLayer]:
    """The layer of surfaces, with their mean heights where these are asked for; none where there are none."""
    read = [(tile, source.surface_tile(*tile)) for tile in within]
    tiles = [(tile, surfaces) for tile, surfaces in read if surfaces is not None]
    if not tiles:
        return []
    units = np.concatenate(
        [
            _units(surface_corners_m(surfaces)[:, ::-1].reshape(-1, 2), tile, place)  # clockwise
            for tile, surfaces in tiles
        ]
    )

    def column(name: str) -> Any:
        return np.concatenate([getattr(surfaces, name) for _, surfaces in tiles])

    # What touches two tiles stands in both.
    numbers, once = np.unique(column("surface_id"), return_index=True)
    heights = {"height": np.concatenate([_heights_m(tile) for _, tile in tiles])[once]} if with_height else {}
    return [
        TileLayer(
            name="surfaces",
            kind="Polygon",
            numbers=numbers,
            points=units.reshape(-1, _CORNERS, 2)[once].reshape(-1, 2),
            first=np.arange(len(once) + 1) * _CORNERS,
            properties={
                "sigma": np.round(column("sigma_m")[once].astype(np.float64), _MILLIMETRE_DECIMALS),
                "level": column("level")[once],
                # Leap seconds do not matter to the age of a road.
                "day": (column("last_seen_ns")[once] + UNIX_OF_GPS_EPOCH_NS) // NS_PER_DAY,
            }
            | heights,
        )
    ]


def _heights_m(tile: SurfaceTile) -> Float64:
    """Mean height of each surface (n,)."""
    nodes, of_surface = grid_nodes(tile, np.arange(len(tile.rows)))
    sums = np.bincount(of_surface, surface_heights_m(tile)[nodes], len(tile.rows))
    points = (tile.rows.astype(np.int64) * tile.columns).astype(np.float64)
    heights_m: Float64 = np.round(sums / points, _HEIGHT_DECIMALS)
    return heights_m


def link_layers(source: MapSource, within: Iterable[Tile], place: TilePlace) -> list[TileLayer]:
    """The layer of links; none where there are none."""
    read = [(tile, source.link_tile(*tile)) for tile in within]
    tiles = [(tile, links) for tile, links in read if links is not None]
    if not tiles:
        return []
    units = [_units(np.column_stack((links.east_m, links.north_m)), tile, place) for tile, links in tiles]
    vertices = np.concatenate([np.diff(links.first_vertex) for _, links in tiles])
    numbers, once = np.unique(np.concatenate([links.link_id for _, links in tiles]), return_index=True)
    begins = (np.cumsum(vertices) - vertices)[once]
    first = np.append(0, np.cumsum(vertices[once]))
    return [
        TileLayer(
            name="links",
            kind="LineString",
            numbers=numbers,
            points=np.concatenate(units)[
                np.arange(first[-1]) + np.repeat(begins - first[:-1], vertices[once])
            ],
            first=first,
            properties={"level": np.concatenate([links.level for _, links in tiles])[once]},
        )
    ]


def _squares(within: Sequence[Tile], place: TilePlace) -> TileLayer:
    finer = ZOOM - place.zoom
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    at = np.array(within, np.int64).reshape(-1, 1, 2) - (np.array((place.x, place.y)) << finer)
    return TileLayer(
        name="squares",
        kind="Polygon",
        numbers=np.arange(len(within)),
        points=(at + corners).reshape(-1, 2) * (EXTENT >> finer),
        first=np.arange(len(within) + 1) * _CORNERS,
        properties={},
    )


def _units(east_north_m: Float64, tile: Tile, place: TilePlace) -> Int64:
    """Points (n, 2) of a tile's plane in units of another tile, y downwards."""
    return np.round(_shares(east_north_m, tile, place) * EXTENT).astype(np.int64)


def _shares(east_north_m: Float64, tile: Tile, place: TilePlace) -> Float64:
    """Points (n, 2) of a tile's plane in shares of another tile's side, y downwards."""
    if not len(east_north_m):
        return np.zeros((0, 2))
    latitude, longitude, _ = tile_frame(*tile).geodetic_from_east_north_array(east_north_m, 0.0)
    number = float(1 << place.zoom)
    return world_shares(latitude, longitude) * number - (place.x, place.y)
