"""The map in a panel of a figure: clouds, outlines of road surfaces and links of a release."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from camber.formats.observations import Floats
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import Release
from camber.road_map.tile_grid import Tile, tile_frame, tiles_of_boxes
from camber.schemas.road import Layer, LinkTile, SurfaceTile
from camber.validation.plots import draw_lines

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CLOUDS: tuple[tuple[Layer, tuple[int, int, int], float], ...] = (
    ("road_cloud", (214, 205, 180), 1.0),
    ("environment_cloud", (92, 104, 122), 8.0),
)
"""In drawing order: layer, colour, and the number of points in a pixel that gives the full colour.
Chosen by eye: the environment darkest, since matching rests on it."""
_LINK, _SURFACE = "#9aa5b4", "#d8cfae"
_MAX_SURFACES = 3000  # chosen: more outlines hide the clouds


def draw_map(axes: Axes, release: Release, frame: LocalFrame) -> None:
    """Draw what of a release lies within the limits of axes, which are metres east and north in a frame.

    Raises ReleaseError.
    """
    draw_clouds(axes, release, frame)
    surfaces = [tile for xy in _tiles(frame, axes) if (tile := release.surface_tile(*xy)) is not None]
    outlines = [outline for tile in surfaces for outline in _outlines(tile, frame)]
    if len(outlines) <= _MAX_SURFACES:
        draw_lines(axes, outlines, _SURFACE, 0.6)
    draw_lines(axes, link_lines(release, frame, axes), _LINK, 1.0)


def draw_clouds(axes: Axes, release: Release, frame: LocalFrame) -> None:
    """Draw the clouds as images of the axes' size, the darker the more points. Raises ReleaseError."""
    box = axes.get_window_extent()
    shape = (max(round(box.height), 1), max(round(box.width), 1))
    x_limits, y_limits = axes.get_xlim(), axes.get_ylim()
    for layer, colour, full_count in _CLOUDS:
        counts = np.zeros(shape)
        for x, y in _tiles(frame, axes):
            cloud = release.cloud_tile(layer, x, y)
            if cloud is not None:
                plane_m = _to_frame(x, y, np.multiply(cloud.quanta[:, :2], cloud.resolution_m), frame)
                counts += np.histogram2d(
                    plane_m[:, 1], plane_m[:, 0], bins=shape, range=(y_limits, x_limits)
                )[0]
        if counts.any():
            image = np.zeros((*shape, 4))
            image[..., :3] = np.array(colour) / 255.0
            image[..., 3] = np.clip(counts / full_count, 0.0, 1.0)
            extent = (*x_limits, *y_limits)
            axes.imshow(
                image, extent=extent, origin="lower", aspect="auto", interpolation="nearest", zorder=0.5
            )


def link_lines(release: Release, frame: LocalFrame, axes: Axes) -> list[Floats]:
    """Lines (k, 2) in the frame of the links of all tiles within the limits of axes. Raises ReleaseError."""
    tiles = [tile for xy in _tiles(frame, axes) if (tile := release.link_tile(*xy)) is not None]
    return [line for tile in tiles for line in _links(tile, frame)]


def _tiles(frame: LocalFrame, axes: Axes) -> list[Tile]:
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    centre_m, half_m = limits.mean(axis=1), 0.5 * (limits[:, 1] - limits[:, 0])
    latitude, longitude, _ = frame.geodetic_from_east_north_array(centre_m[None], 0.0)
    _, x, y = tiles_of_boxes(latitude, longitude, half_m[:1], half_m[1:])
    return list(zip(x.tolist(), y.tolist(), strict=True))


def _outlines(tile: SurfaceTile, frame: LocalFrame) -> Iterator[Floats]:
    """The rectangles of a tile's road surfaces, closed (5, 2)."""
    corners = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)])
    cos, sin = np.cos(tile.yaw_rad)[:, None], np.sin(tile.yaw_rad)[:, None]
    along = tile.half_length_m[:, None] * corners[:, 0]
    across = tile.half_width_m[:, None] * corners[:, 1]
    east_m = tile.centre_east_m[:, None] + along * cos - across * sin
    north_m = tile.centre_north_m[:, None] + along * sin + across * cos
    plane_m = _to_frame(tile.x, tile.y, np.column_stack((east_m.ravel(), north_m.ravel())), frame)
    yield from plane_m.reshape(-1, 5, 2)


def _links(tile: LinkTile, frame: LocalFrame) -> Iterator[Floats]:
    plane_m = _to_frame(tile.x, tile.y, np.column_stack((tile.east_m, tile.north_m)), frame)
    yield from np.split(plane_m, tile.first_vertex[1:-1]) if len(tile.link_id) else []


def _to_frame(x: int, y: int, east_north_m: Floats, frame: LocalFrame) -> Floats:
    """Points (n, 2) of a tile's plane in the plane of a frame."""
    if not len(east_north_m):
        return np.zeros((0, 2))
    # Between two planes a few kilometres apart an affine map is right to a decimetre at their ends: less than a pixel.
    corners = np.array([[0.0, 0.0], [300.0, 0.0], [0.0, 300.0]])
    latitude, longitude, _ = tile_frame(x, y).geodetic_from_east_north_array(corners, 0.0)
    base = frame.east_north_from_geodetic_array(latitude, longitude, np.zeros(3))
    rotation = (base[1:] - base[0]).T / 300.0
    moved: Floats = base[0] + east_north_m @ rotation.T
    return moved
