"""Small maps for tests: rectangles and links given in metres about a point, written as releases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.road_map.release import RoadLinks, RoadSurfaces, write_release
from camber.road_map.tile_grid import tile_of
from camber.schemas.road import CloudTile, Layer, ReleaseRoot

FRAME = LocalFrame(math.radians(35.17), math.radians(136.9), 0.0)
TILE = tile_of(FRAME.latitude_rad, FRAME.longitude_rad) or (0, 0)
DAY_NS = 86_400 * 1_000_000_000
MADE_NS = 1_400_000_000 * 1_000_000_000


def at(east_m: float, north_m: float, frame: LocalFrame = FRAME) -> tuple[float, float]:
    """Latitude and longitude of a point given in metres about the frame's origin."""
    latitude, longitude, _ = frame.geodetic_from_east_north(east_m, north_m, 0.0)
    return latitude, longitude


def surface(
    surface_id: int,
    east_m: float = 0.0,
    north_m: float = 0.0,
    *,
    link_id: int = 1,
    level: int = 0,
    yaw_rad: float = 0.0,
    half_length_m: float = 10.0,
    half_width_m: float = 2.0,
    sigma_m: float = 0.03,
    heights_m: Any = 50.0,
    frame: LocalFrame = FRAME,
) -> dict[str, Any]:
    """One row of RoadSurfaces; a single height stands for a level grid of 2 × 2."""
    latitude_rad, longitude_rad = at(east_m, north_m, frame)
    grid = np.full((2, 2), float(heights_m)) if np.ndim(heights_m) == 0 else np.asarray(heights_m, float)
    return {
        "surface_id": surface_id,
        "link_id": link_id,
        "level": level,
        "latitude_rad": latitude_rad,
        "longitude_rad": longitude_rad,
        "yaw_rad": yaw_rad,
        "half_length_m": half_length_m,
        "half_width_m": half_width_m,
        "sigma_m": sigma_m,
        "vehicles": 3,
        "last_seen_ns": MADE_NS - DAY_NS,
        "heights_m": grid,
    }


def surfaces(rows: Sequence[dict[str, Any]]) -> RoadSurfaces:
    """Rows as columns."""
    names = surface(0)
    return RoadSurfaces(**{name: [row[name] for row in rows] for name in names})


def link(
    link_id: int, nodes: tuple[int, int], line_m: Sequence[tuple[float, float]], *, level: int = 0
) -> dict[str, Any]:
    """One row of RoadLinks; the line in metres about the origin."""
    return {
        "link_id": link_id,
        "start_node": nodes[0],
        "end_node": nodes[1],
        "level": level,
        "sigma_m": 0.5,
        "vertices": np.array([at(*point) for point in line_m]),
    }


def links(rows: Sequence[dict[str, Any]]) -> RoadLinks:
    """Rows as columns."""
    return RoadLinks(**{name: [row[name] for row in rows] for name in link(0, (0, 0), [])})


def cloud(
    x: int, y: int = 2, layer: Layer = "road_cloud", *, points: int = 50, limit: int = 9000, seed: int = 2
) -> CloudTile:
    """A tile of points anywhere within `limit` steps of 2 cm."""
    quanta = np.random.default_rng(seed).integers(-limit, limit, (points, 3)).astype(np.int32)
    return CloudTile(
        time_ns=MADE_NS, x=x, y=y, layer=layer, base_height_m=50.0, resolution_m=0.02, quanta=quanta
    )


def write(
    folder: Path,
    surface_rows: Sequence[dict[str, Any]],
    link_rows: Sequence[dict[str, Any]] = (),
    **changed: Any,
) -> ReleaseRoot:
    """Write a release of these rows."""
    arguments: dict[str, Any] = {
        "region": "test",
        "map_version": 7,
        "datum": "WGS84",
        "epoch_year": 2024.5,
        "time_ns": MADE_NS,
        "surfaces": surfaces(surface_rows),
        "links": links(link_rows),
    }
    return write_release(folder, **arguments | changed)
