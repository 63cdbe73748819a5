"""Convert columns of road surfaces and links to tiles and back.

Positions are rounded to 1e-11 rad (0.06 mm), heights to 0.1 mm, yaws to 1e-9 rad: a map that was read and is written
again gives the same bytes, so unchanged tiles stay the same blobs. Sizes and σ are 32-bit floats.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.road_map.road_columns import Floats, Integers, ReleaseError, RoadLinks, RoadSurfaces
from camber.road_map.tile_grid import MARGIN_M, Tile, tile_frame, tiles_of_boxes
from camber.schemas.base import EARLIEST_NS, LATEST_NS
from camber.schemas.road import LinkTile, SurfaceTile

_ANGLE_DECIMALS, _YAW_DECIMALS, _HEIGHT_DECIMALS = 11, 9, 4
_PLANE_DECIMALS = 6  # of metres: the last bits of sines differ between machines


def surface_tiles(surfaces: RoadSurfaces) -> list[SurfaceTile]:
    """Make the tiles of all surfaces; a surface within MARGIN_M of several tiles is whole in each.

    A tile's time is the newest observation of its surfaces, so that it does not depend on the release.
    """
    cos, sin = np.abs(np.cos(surfaces.yaw_rad)), np.abs(np.sin(surfaces.yaw_rad))
    half_east_m = cos * surfaces.half_length_m + sin * surfaces.half_width_m + MARGIN_M
    half_north_m = sin * surfaces.half_length_m + cos * surfaces.half_width_m + MARGIN_M
    row, x, y = tiles_of_boxes(surfaces.latitude_rad, surfaces.longitude_rad, half_east_m, half_north_m)
    return [_surface_tile(tile, rows, surfaces) for tile, rows in _by_tile(row, x, y, surfaces.surface_id)]


def _surface_tile(tile: Tile, rows: Integers, surfaces: RoadSurfaces) -> SurfaceTile:
    frame = tile_frame(*tile)
    latitude_rad = _rounded(surfaces.latitude_rad[rows])
    longitude_rad = _rounded(surfaces.longitude_rad[rows])
    plane_m = _plane(frame, latitude_rad, longitude_rad)
    yaw_rad = np.round(surfaces.yaw_rad[rows], _YAW_DECIMALS) + _convergence(frame, longitude_rad)
    heights_m = [np.round(surfaces.heights_m[row].ravel(), _HEIGHT_DECIMALS) for row in rows]
    sizes = np.array([len(heights) for heights in heights_m])
    all_m = np.concatenate(heights_m)
    base_m = float(np.round(np.median(all_m)))
    seen_ns = int(np.clip(surfaces.last_seen_ns[rows].max(), EARLIEST_NS, LATEST_NS))
    return SurfaceTile(
        time_ns=seen_ns,
        x=tile[0],
        y=tile[1],
        base_height_m=base_m,
        surface_id=surfaces.surface_id[rows],
        link_id=surfaces.link_id[rows],
        level=surfaces.level[rows].astype(np.int32),
        centre_east_m=plane_m[:, 0],
        centre_north_m=plane_m[:, 1],
        yaw_rad=np.round(yaw_rad, _YAW_DECIMALS + 3),
        half_length_m=surfaces.half_length_m[rows].astype(np.float32),
        half_width_m=surfaces.half_width_m[rows].astype(np.float32),
        rows=np.array([surfaces.heights_m[row].shape[0] for row in rows], np.int32),
        columns=np.array([surfaces.heights_m[row].shape[1] for row in rows], np.int32),
        first_height=(np.cumsum(sizes) - sizes).astype(np.int32),
        sigma_m=surfaces.sigma_m[rows].astype(np.float32),
        vehicles=surfaces.vehicles[rows].astype(np.int32),
        last_seen_ns=surfaces.last_seen_ns[rows],
        grid_m=(all_m - base_m).astype(np.float32),
    )


def link_tiles(links: RoadLinks) -> list[LinkTile]:
    """Make the tiles of all links; a link within MARGIN_M of several tiles is whole in each.

    Links have no time: their tiles have the earliest valid one.
    """
    if not len(links):
        return []
    count = np.array([len(line) for line in links.vertices])
    points = _rounded(np.concatenate(list(links.vertices)))
    begins = np.ones(len(points), bool)
    begins[np.cumsum(count) - 1] = False  # a link's last vertex starts no segment
    first = np.flatnonzero(begins)
    a, b = points[first], points[first + 1]
    # A step over the antimeridian takes the shorter direction.
    step = b - a
    step[:, 1] = (step[:, 1] + math.pi) % (2.0 * math.pi) - math.pi
    half_m = np.abs(step) * 0.5 * 6.4e6 + MARGIN_M  # more than the larger radius of curvature
    middle = a + 0.5 * step
    segment, x, y = tiles_of_boxes(middle[:, 0], middle[:, 1], half_m[:, 1], half_m[:, 0])
    link = np.repeat(np.arange(len(count)), count)[first][segment]
    return [_link_tile(tile, rows, links) for tile, rows in _by_tile(link, x, y, links.link_id)]


def _link_tile(tile: Tile, rows: Integers, links: RoadLinks) -> LinkTile:
    points = _rounded(np.concatenate([links.vertices[row] for row in rows]))
    plane_m = _plane(tile_frame(*tile), points[:, 0], points[:, 1])
    count = [len(links.vertices[row]) for row in rows]
    return LinkTile(
        time_ns=EARLIEST_NS,
        x=tile[0],
        y=tile[1],
        link_id=links.link_id[rows],
        start_node=links.start_node[rows],
        end_node=links.end_node[rows],
        level=links.level[rows].astype(np.int32),
        sigma_m=links.sigma_m[rows].astype(np.float32),
        first_vertex=np.concatenate(([0], np.cumsum(count))).astype(np.int32),
        east_m=plane_m[:, 0],
        north_m=plane_m[:, 1],
    )


def _by_tile(row: Integers, x: Integers, y: Integers, ids: Integers) -> Iterable[tuple[Tile, Integers]]:
    """Return the rows of each tile in the order of their ids, each once; tiles in the order of their numbers."""
    if not len(row):
        return
    triples = np.unique(np.column_stack((x, y, ids[row], row)), axis=0)
    change = np.flatnonzero((np.diff(triples[:, :2], axis=0) != 0).any(axis=1)) + 1
    for group in np.split(triples, change):
        yield (int(group[0, 0]), int(group[0, 1])), group[:, 3]


def grid_nodes(tile: SurfaceTile, surfaces: Integers) -> tuple[Integers, Integers]:
    """Return the rows (m,) of `grid_m` of some surfaces (k,), and the place in `surfaces` of each."""
    sizes = tile.rows[surfaces].astype(np.int64) * tile.columns[surfaces]
    of_surface = np.repeat(np.arange(len(surfaces)), sizes)
    nth = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return tile.first_height[surfaces].astype(np.int64)[of_surface] + nth, of_surface


def changed_tile(
    tile: SurfaceTile, *, time_ns: int, raised: tuple[Integers, Floats], **columns: tuple[Integers, Any]
) -> SurfaceTile:
    """Return a tile with other values of some rows of `columns`; `raised`: rows of `grid_m`, by how much [m]."""
    nodes, raised_m = raised
    grid_m = tile.grid_m.copy()
    heights_m = np.round(tile.base_height_m + grid_m[nodes].astype(np.float64), _HEIGHT_DECIMALS)
    heights_m = np.round(heights_m + raised_m, _HEIGHT_DECIMALS)
    grid_m[nodes] = (heights_m - tile.base_height_m).astype(np.float32)
    changed = {name: getattr(tile, name).copy() for name in columns}
    for name, (rows, values) in columns.items():
        changed[name][rows] = values
    return SurfaceTile(**tile.__dict__ | changed | {"time_ns": time_ns, "grid_m": grid_m})


def surfaces_from_tiles(tiles: Iterable[SurfaceTile]) -> RoadSurfaces:
    """Return all surfaces of some tiles, each once, in the order of their ids."""
    return RoadSurfaces(**_each_once(map(_surface_columns, tiles), RoadSurfaces, ragged="heights_m"))


def links_from_tiles(tiles: Iterable[LinkTile]) -> RoadLinks:
    """Return all links of some tiles, each once, in the order of their ids."""
    return RoadLinks(**_each_once(map(_link_columns, tiles), RoadLinks, ragged="vertices"))


def surface_places(tile: SurfaceTile) -> tuple[Floats, Floats, Floats]:
    """Return latitudes, longitudes and yaws of a tile's surfaces (n,), as RoadSurfaces has them."""
    frame = tile_frame(tile.x, tile.y)
    latitude_rad, longitude_rad = _geodetic(frame, tile.centre_east_m, tile.centre_north_m)
    yaw_rad = np.round(tile.yaw_rad - _convergence(frame, longitude_rad), _YAW_DECIMALS)
    return latitude_rad, longitude_rad, yaw_rad


def surface_corners_m(tile: SurfaceTile) -> Floats:
    """Return the corners (n, 4, 2) of rectangles in the tile's plane, counter-clockwise from the rear right one."""
    signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    along = tile.half_length_m[:, None] * signs[:, 0]
    across = tile.half_width_m[:, None] * signs[:, 1]
    cos, sin = np.cos(tile.yaw_rad)[:, None], np.sin(tile.yaw_rad)[:, None]
    east = tile.centre_east_m[:, None] + along * cos - across * sin
    north = tile.centre_north_m[:, None] + along * sin + across * cos
    return np.stack((east, north), axis=2)


def surface_heights_m(tile: SurfaceTile) -> Floats:
    """Return the ellipsoidal heights of `grid_m`."""
    heights_m: Floats = np.round(tile.base_height_m + tile.grid_m.astype(np.float64), _HEIGHT_DECIMALS)
    return heights_m


def link_vertices(tile: LinkTile) -> Floats:
    """Return the vertices (m, 2) of all links of a tile, latitude and longitude in radians."""
    return np.column_stack(_geodetic(tile_frame(tile.x, tile.y), tile.east_m, tile.north_m))


def _surface_columns(tile: SurfaceTile) -> dict[str, Any]:
    latitude_rad, longitude_rad, yaw_rad = surface_places(tile)
    heights_m = surface_heights_m(tile)
    shapes = zip(tile.first_height.tolist(), tile.rows.tolist(), tile.columns.tolist(), strict=True)
    return tile.__dict__ | {
        "latitude_rad": latitude_rad,
        "longitude_rad": longitude_rad,
        "yaw_rad": yaw_rad,
        "heights_m": [heights_m[i : i + n * m].reshape(n, m) for i, n, m in shapes],
    }


def _link_columns(tile: LinkTile) -> dict[str, Any]:
    return tile.__dict__ | {"vertices": np.split(link_vertices(tile), tile.first_vertex[1:-1])}


def _each_once(
    tiles: Iterable[dict[str, Any]], table: type[RoadSurfaces | RoadLinks], *, ragged: str
) -> dict[str, Any]:
    """Return the columns of a table from those of tiles, by its ids, which are its first column."""
    names = [field.name for field in fields(table)]
    parts = list(tiles)
    if not parts:
        return {name: [] for name in names}
    columns = {name: np.concatenate([part[name] for part in parts]) for name in names if name != ragged}
    _, first = np.unique(columns[names[0]], return_index=True)
    lists = [item for part in parts for item in part[ragged]]
    return {name: column[first] for name, column in columns.items()} | {ragged: [lists[i] for i in first]}


def _rounded(angle_rad: Floats) -> Floats:
    rounded: Floats = np.round(angle_rad, _ANGLE_DECIMALS)
    return rounded


def _plane(frame: LocalFrame, latitude_rad: Floats, longitude_rad: Floats) -> Floats:
    plane_m = frame.east_north_from_geodetic_array(latitude_rad, longitude_rad, 0.0)
    return np.round(plane_m, _PLANE_DECIMALS) + 0.0  # no −0.0, so that equal values have equal bytes


def _geodetic(frame: LocalFrame, east_m: Floats, north_m: Floats) -> tuple[Floats, Floats]:
    try:
        latitude, longitude, _ = frame.geodetic_from_east_north_array(np.column_stack((east_m, north_m)), 0.0)
    except ValueError as error:
        raise ReleaseError("tile", "east, north", str(error)) from None
    # Rounding may step over the antimeridian by some 1e-12 rad.
    return _rounded(latitude), np.clip(_rounded(longitude), -math.pi, math.pi)


def _convergence(frame: LocalFrame, longitude_rad: Floats) -> Floats:
    """Return the meridian convergence: rotation of local north against the frame's, counter-clockwise."""
    step = (longitude_rad - frame.longitude_rad + math.pi) % (2.0 * math.pi) - math.pi
    return step * math.sin(frame.latitude_rad)
