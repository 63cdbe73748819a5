"""Point clouds of the map: what a survey vehicle's scanner hits from all roads on the survey day.

A scan every few metres, from the lane, without motion during the scan; the range errs, positions do not. Of the points
in one voxel the first is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from camber.formats.map_tiles import MARGIN_M, TILES, Tile, tile_corners_rad, tile_frame, tiles_of_boxes
from camber.geodesy.ellipsoid import meridian_radius_m, prime_vertical_radius_m
from camber.geodesy.local_frame import LocalFrame
from camber.schemas.road import CloudTile, Layer
from camber.simulator.random_streams import stream
from camber.simulator.scene import Material, Tracer
from camber.simulator.world.roads import Roads

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SENSOR_HEIGHT_M = 2.2
_ELEVATIONS_RAD = np.deg2rad(np.concatenate((np.linspace(-28.0, 0.0, 32), np.linspace(2.0, 32.0, 16))))
_AZIMUTHS = 240
_RANGE_M = 80.0
_RANGE_SIGMA_M = 0.01
_RESOLUTION_M = 0.005
_SWEEPS_AT_ONCE = 40
_THREADS = 2
_NODES_M = 25.0
_KEY_HALF = 1 << 20
_LAYERS: tuple[tuple[Layer, bool], ...] = (("environment_cloud", False), ("road_cloud", True))


def surveyed_clouds(
    roads: Roads,
    links: Sequence[int],
    tracer: Tracer,
    frame: LocalFrame,
    *,
    seed: int,
    spacing_m: float,
    voxel_m: float,
    seen_ns: int,
) -> list[CloudTile]:
    """Two clouds of each tile, scanned from some links (row numbers): the roads' surfaces, and all else."""
    tiles: list[CloudTile] = []
    stations = _stations(roads, links, spacing_m)
    points, on_road = _scanned(stations, tracer, seed, voxel_m)
    for layer, road in _LAYERS:
        kept = points[on_road == road]
        kept = kept[_first_of_voxels(kept, voxel_m)]
        tiles += _tiles(kept, frame, layer, seen_ns)
    return tiles


def _scanned(
    stations: Iterator[tuple[Floats, Floats]], tracer: Tracer, seed: int, voxel_m: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Points (n, 3) in the world frame, and which of them lie on a road."""

    def scan(numbered: tuple[int, tuple[Floats, Floats]]) -> tuple[Floats, NDArray[np.bool_]]:
        number, (place_m, yaw_rad) = numbered
        points, road = _scan(tracer, place_m, yaw_rad, stream(seed, f"survey scans {number}"))
        # Scans near one another: most of what is thinned out is theirs.
        thin = _first_of_voxels(points, voxel_m)
        return points[thin], road[thin]

    # Tracing holds no lock of the interpreter; results come in the order of the stations, whichever is done first.
    with ThreadPoolExecutor(_THREADS) as pool:
        parts = list(pool.map(scan, enumerate(stations)))
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _scan(
    tracer: Tracer, place_m: Floats, yaw_rad: Floats, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.bool_]]:
    """What scans at places (n, 3) hit, and whether it is road."""
    step = 2.0 * math.pi / _AZIMUTHS
    azimuth = (yaw_rad + rng.uniform(0.0, step, len(yaw_rad)))[:, None] + np.arange(_AZIMUTHS) * step
    flat = np.cos(_ELEVATIONS_RAD)[None, :, None]
    axes = (
        flat * np.cos(azimuth)[:, None, :],
        flat * np.sin(azimuth)[:, None, :],
        np.sin(_ELEVATIONS_RAD)[None, :, None],
    )
    direction = np.stack(np.broadcast_arrays(*axes), axis=3).reshape(-1, 3)
    origin = np.repeat(place_m, len(direction) // len(place_m), axis=0)
    hits = tracer.first_hits(origin, direction, _RANGE_M)
    met = np.isfinite(hits.distance_m)
    distance = hits.distance_m[met] + _RANGE_SIGMA_M * rng.standard_normal(int(met.sum()))
    return origin[met] + distance[:, None] * direction[met], hits.material[met] == Material.ROAD


def _stations(roads: Roads, links: Sequence[int], spacing_m: float) -> Iterator[tuple[Floats, Floats]]:
    """Places (n, 3) and yaws (n,) of the scanner, some at a time; never more of one link than fit."""
    for link in links:
        length = float(roads.length_m[link])
        s = np.linspace(0.0, length, max(2, math.ceil(length / spacing_m) + 1))[:-1] + 0.5 * spacing_m
        s = s[s < length]
        east, north, yaw = roads.centre_line(link, s)
        left = float(roads.lane_offset_m[link])
        east, north = east - left * np.sin(yaw), north + left * np.cos(yaw)
        up = roads.link_height_m(np.array(link), east, north) + SENSOR_HEIGHT_M
        for k in range(0, len(s), _SWEEPS_AT_ONCE):
            part = slice(k, k + _SWEEPS_AT_ONCE)
            yield np.column_stack((east, north, up))[part], yaw[part]


def _first_of_voxels(points_m: Floats, voxel_m: float) -> Integers:
    """Rows of the first point in each voxel, ascending."""
    cell = np.floor(points_m / voxel_m).astype(np.int64) + _KEY_HALF
    key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    _, first = np.unique(key, return_index=True)
    rows: Integers = np.sort(first)
    return rows


def _tiles(points_m: Floats, frame: LocalFrame, layer: Layer, seen_ns: int) -> list[CloudTile]:
    if not len(points_m):
        return []
    nodes = _NodeGrid(points_m)
    latitude, longitude, _ = frame.geodetic_from_east_north_array(nodes.plane_m, np.zeros(len(nodes.plane_m)))
    everything = np.arange(len(points_m))
    at_latitude, at_longitude = nodes.between(latitude, everything), nodes.between(longitude, everything)
    tiles = []
    for tile_x, tile_y in _tiles_near(latitude, longitude):
        # What comes within the margin of a tile stands in it too.
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
        own = tile_frame(tile_x, tile_y)
        plane = own.east_north_from_geodetic_array(latitude, longitude, np.zeros(len(latitude)))
        height = points_m[rows, 2]
        base = float(np.round(np.median(height)))
        about = np.column_stack(
            (nodes.between(plane[:, 0], rows), nodes.between(plane[:, 1], rows), height - base)
        )
        tiles.append(
            CloudTile(
                time_ns=seen_ns,
                x=tile_x,
                y=tile_y,
                layer=layer,
                base_height_m=base,
                resolution_m=_RESOLUTION_M,
                quanta=np.rint(about / _RESOLUTION_M).astype(np.int32),
            )
        )
    return tiles


def _tiles_near(latitude: Floats, longitude: Floats) -> list[Tile]:
    """Tiles that come within two node spacings of the nodes, in order."""
    reach = np.full(len(latitude), 2.0 * _NODES_M)
    _, x, y = tiles_of_boxes(latitude, longitude, reach, reach)
    return [divmod(tile, TILES) for tile in np.unique(x * TILES + y).tolist()]


class _NodeGrid:
    """Nodes every 25 m under some points (not at the antimeridian): what is known there is bilinear between them.

    From one tangent plane to another the second derivatives are those of the earth's curvature, 1 / R, so that this
    misses by 25² / 8 R = 12 µm, for a fraction of the time.
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
        """Values (k,) at some of the points, from those at the nodes."""
        value = at_nodes.reshape(self._columns, self._rows)
        i, j = self._cell[rows].T
        u, v = self._share[rows].T
        lower = (1.0 - u) * value[i, j] + u * value[i + 1, j]
        upper = (1.0 - u) * value[i, j + 1] + u * value[i + 1, j + 1]
        result: Floats = (1.0 - v) * lower + v * upper
        return result
