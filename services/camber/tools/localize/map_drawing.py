"""The map under a track: what of a release lies within a panel, and how it is drawn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from camber.formats.observations import Floats
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import Release
from camber.road_map.tile_grid import Tile, tile_frame, tiles_of_boxes
from camber.schemas.road import CloudTile, Layer, LinkTile, SurfaceTile
from camber.validation.plot_frame import Panel
from camber.validation.raster import Raster

_CLOUDS: tuple[tuple[Layer, tuple[int, int, int], float], ...] = (
    ("road_cloud", (214, 205, 180), 1.0),
    ("environment_cloud", (92, 104, 122), 8.0),
)
"""From the lowest to the topmost: their colour, and how many points in a pixel are as dark as it gets."""
_LINK, _SURFACE = "#9aa5b4", "#d8cfae"
_MOST_SURFACES = 3000


@dataclass(frozen=True, slots=True, eq=False)
class MapDrawing:
    """What stands below everything else in a panel: the clouds as a picture, outlines and links as lines."""

    panel: Panel
    clouds: bytes
    surfaces: list[Floats]
    links: list[Floats]

    def parts(self) -> Iterator[str]:
        """From the lowest to the topmost."""
        yield self.panel.image(self.clouds)
        if len(self.surfaces) <= _MOST_SURFACES:
            yield from self.panel.lines(self.surfaces, _SURFACE, 0.6)
        yield from self.panel.lines(self.links, _LINK, 1.0)


def map_drawing(release: Release, frame: LocalFrame, panel: Panel) -> MapDrawing:
    """Of a panel whose values are metres east and north in a frame. Raises ReleaseError."""
    tiles = _tiles(frame, panel)
    surfaces = [surface for xy in tiles if (surface := release.surface_tile(*xy)) is not None]
    return MapDrawing(
        panel,
        cloud_raster(release, frame, panel).png(),
        [line for surface in surfaces for line in _outlines(surface, frame)],
        plane_links(release, frame, panel),
    )


def cloud_raster(release: Release, frame: LocalFrame, panel: Panel) -> Raster:
    """The clouds within a panel, a pixel of it one of the picture. Raises ReleaseError."""
    tiles = _tiles(frame, panel)
    raster = Raster(round(panel.width), round(panel.height))
    for layer, colour, full in _CLOUDS:
        counts = np.zeros(raster.pixels.shape[:2])
        for xy in tiles:
            cloud = release.cloud_tile(layer, *xy)
            if cloud is not None:
                counts += _counts(cloud, frame, panel)
        raster.shade(counts, colour, full)
    return raster


def plane_links(release: Release, frame: LocalFrame, panel: Panel) -> list[Floats]:
    """Lines (k, 2) in the frame of the links of all tiles within a panel. Raises ReleaseError."""
    tiles = [link for xy in _tiles(frame, panel) if (link := release.link_tile(*xy)) is not None]
    return [line for tile in tiles for line in _links(tile, frame)]


def _tiles(frame: LocalFrame, panel: Panel) -> list[Tile]:
    middle = np.array([[0.5 * sum(panel.x), 0.5 * sum(panel.y)]])
    latitude, longitude, _ = frame.geodetic_from_east_north_array(middle, 0.0)
    half = [np.array([0.5 * (high - low)]) for low, high in (panel.x, panel.y)]
    _, x, y = tiles_of_boxes(latitude, longitude, *half)
    return list(zip(x.tolist(), y.tolist(), strict=True))


def _counts(tile: CloudTile, frame: LocalFrame, panel: Panel) -> Floats:
    """Points in each pixel (rows, columns), the first row on top."""
    plane_m = _plane(tile.x, tile.y, np.multiply(tile.quanta[:, :2], tile.resolution_m), frame)
    shape = (round(panel.height), round(panel.width))
    counts: Floats
    counts, _, _ = np.histogram2d(plane_m[:, 1], plane_m[:, 0], bins=shape, range=(panel.y, panel.x))
    return counts[::-1]


def _outlines(tile: SurfaceTile, frame: LocalFrame) -> Iterator[Floats]:
    """The rectangles of a tile's road surfaces, closed (5, 2)."""
    sides = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)])
    cos, sin = np.cos(tile.yaw_rad)[:, None], np.sin(tile.yaw_rad)[:, None]
    along = tile.half_length_m[:, None] * sides[:, 0]
    across = tile.half_width_m[:, None] * sides[:, 1]
    east_m = tile.centre_east_m[:, None] + along * cos - across * sin
    north_m = tile.centre_north_m[:, None] + along * sin + across * cos
    corners = _plane(tile.x, tile.y, np.column_stack((east_m.ravel(), north_m.ravel())), frame)
    yield from corners.reshape(-1, 5, 2)


def _links(tile: LinkTile, frame: LocalFrame) -> Iterator[Floats]:
    plane_m = _plane(tile.x, tile.y, np.column_stack((tile.east_m, tile.north_m)), frame)
    yield from np.split(plane_m, tile.first_vertex[1:-1]) if len(tile.link_id) else []


def _plane(x: int, y: int, east_north_m: Floats, frame: LocalFrame) -> Floats:
    """From a tile's own metres to those of a frame."""
    if not len(east_north_m):
        return np.zeros((0, 2))
    # Between two planes a few kilometres apart a shift is right to a decimetre at their ends: less than a pixel.
    own = tile_frame(x, y)
    corners = np.array([[0.0, 0.0], [300.0, 0.0], [0.0, 300.0]])
    latitude, longitude, _ = own.geodetic_from_east_north_array(corners, 0.0)
    base = frame.east_north_from_geodetic_array(latitude, longitude, np.zeros(3))
    turn = (base[1:] - base[0]).T / 300.0
    moved: Floats = base[0] + east_north_m @ turn.T
    return moved
