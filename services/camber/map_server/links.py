"""Select the links around a point, as columns."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.road_map.tile_grid import tile_frame
from camber.schemas.codec import encode
from camber.schemas.road import LinksReply, LinksRequest, LinkTile

MAX_REPLY_BYTES = 256_000  # docs/conventions.md, delivery
_COLUMNS: dict[str, Any] = {
    **dict.fromkeys(("link_id", "start_node", "end_node"), np.int64),
    "level": np.int32,
    "sigma_m": np.float64,
}
"""Columns of links and their types in a reply."""


def links_around(
    tiles: Iterable[LinkTile], request: LinksRequest, *, map_version: int, time_ns: int
) -> LinksReply:
    """Return the links of some tiles within the radius of the request's point, each once, by id.

    Unknown without a tile (beyond the map), and if the reply would be too large for one message: a part of the links
    would look like all of them.
    """
    parts = [_near(tile, request) for tile in tiles]
    if not parts:
        return unknown_links("no links of the map are near", map_version=map_version, time_ns=time_ns)
    columns: dict[str, Any] = {name: np.concatenate([part[name] for part, _ in parts]) for name in _COLUMNS}
    lines = [line for _, tile_lines in parts for line in tile_lines]
    _, first = np.unique(columns["link_id"], return_index=True)
    chosen = [lines[i] for i in first.tolist()]
    points = np.concatenate([*chosen, np.zeros((0, 2))])
    reply = LinksReply(
        time_ns=time_ns,
        status="known",
        map_version=map_version,
        **{name: column[first] for name, column in columns.items()},
        first_vertex=np.cumsum([0, *(len(line) for line in chosen)]).astype(np.int32),
        latitude_rad=points[:, 0].copy(),
        longitude_rad=points[:, 1].copy(),
    )
    size = len(encode(reply))
    if size > MAX_REPLY_BYTES:
        reason = f"{len(first)} links in {size} bytes, at most {MAX_REPLY_BYTES} go into a reply: use a smaller radius"
        return unknown_links(reason, map_version=map_version, time_ns=time_ns)
    return reply


def unknown_links(reason: str, *, map_version: int, time_ns: int) -> LinksReply:
    """Return a reply with the reason why the links are unknown."""
    return LinksReply(
        time_ns=time_ns,
        status="unknown",
        reason=reason,
        map_version=map_version,
        first_vertex=np.zeros(1, np.int32),
        latitude_rad=np.zeros(0),
        longitude_rad=np.zeros(0),
        **{name: np.zeros(0, dtype) for name, dtype in _COLUMNS.items()},
    )


def _near(tile: LinkTile, request: LinksRequest) -> tuple[dict[str, NDArray[Any]], list[NDArray[np.float64]]]:
    """Return columns and lines (k, 2; latitude, longitude) of a tile's links within the radius."""
    frame = tile_frame(tile.x, tile.y)
    at = np.array(frame.east_north_from_geodetic(request.latitude_rad, request.longitude_rad, 0.0))
    points_m = np.column_stack((tile.east_m, tile.north_m))
    kept = _distances_m(points_m, tile.first_vertex, at) <= request.radius_m
    count = np.diff(tile.first_vertex)
    latitude, longitude, _ = frame.geodetic_from_east_north_array(points_m[np.repeat(kept, count)], 0.0)
    geodetic = np.column_stack((latitude, np.clip(longitude, -math.pi, math.pi)))
    lines = np.split(geodetic, np.cumsum(count[kept])[:-1]) if kept.any() else []
    columns = {name: getattr(tile, name)[kept].astype(dtype) for name, dtype in _COLUMNS.items()}
    return columns, lines


def _distances_m(
    points_m: NDArray[np.float64], first_vertex: NDArray[np.int32], at_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance (links,) of a point to each line of points (n, 2), of two points or more."""
    if len(first_vertex) < 2:
        return np.zeros(0)
    start, step = points_m[:-1], np.diff(points_m, axis=0)
    length_2 = np.maximum((step**2).sum(axis=1), 1e-18)
    along = np.clip(((at_m - start) * step).sum(axis=1) / length_2, 0.0, 1.0)
    to_segment_m = np.hypot(*(at_m - start - along[:, None] * step).T)
    # The step from one line's end to the next line's start is no segment.
    to_segment_m[first_vertex[1:-1] - 1] = np.inf
    nearest_m: NDArray[np.float64] = np.minimum.reduceat(to_segment_m, first_vertex[:-1])
    return nearest_m
