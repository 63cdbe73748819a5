"""Point clouds of the map: what a survey vehicle's scanner hits from all roads on the survey day.

A scan every few metres, from the lane, without motion during the scan; the range errs, positions do not. Of the points
in one voxel the first is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from camber.formats.map_tiles import MARGIN_M, tile_frame, tiles_of_boxes
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
_KEY_HALF = 1 << 20
_LAYERS: tuple[tuple[Layer, bool], ...] = (("environment_cloud", False), ("road_cloud", True))


def surveyed_clouds(
    roads: Roads, tracer: Tracer, frame: LocalFrame, seed: int, spacing_m: float, voxel_m: float, seen_ns: int
) -> list[CloudTile]:
    """Two clouds of each tile: the roads' surfaces, and all else."""
    tiles: list[CloudTile] = []
    points, on_road = _scanned(roads, tracer, seed, spacing_m, voxel_m)
    for layer, road in _LAYERS:
        kept = points[on_road == road]
        kept = kept[_first_of_voxels(kept, voxel_m)]
        tiles += _tiles(kept, frame, layer, seen_ns)
    return tiles


def _scanned(
    roads: Roads, tracer: Tracer, seed: int, spacing_m: float, voxel_m: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Points (n, 3) in the world frame, and which of them lie on a road."""
    found, on_road = [np.zeros((0, 3))], [np.zeros(0, bool)]
    rng = stream(seed, "survey scans")
    for place, yaw in _stations(roads, spacing_m):
        azimuth = (
            yaw[:, None]
            + rng.uniform(0.0, 2.0 * math.pi / _AZIMUTHS, len(yaw))[:, None]
            + np.arange(_AZIMUTHS) * 2.0 * math.pi / _AZIMUTHS
        )
        flat = np.cos(_ELEVATIONS_RAD)[None, :, None]
        direction = np.stack(
            np.broadcast_arrays(
                flat * np.cos(azimuth)[:, None, :],
                flat * np.sin(azimuth)[:, None, :],
                np.sin(_ELEVATIONS_RAD)[None, :, None],
            ),
            axis=3,
        ).reshape(-1, 3)
        origin = np.repeat(place, len(direction) // len(place), axis=0)
        hits = tracer.first_hits(origin, direction, _RANGE_M)
        met = np.isfinite(hits.distance_m)
        distance = hits.distance_m[met] + _RANGE_SIGMA_M * rng.standard_normal(int(met.sum()))
        points = origin[met] + distance[:, None] * direction[met]
        road = hits.material[met] == Material.ROAD
        thin = _first_of_voxels(
            points, voxel_m
        )  # scans near one another: most of what is thinned out is theirs
        found.append(points[thin])
        on_road.append(road[thin])
    return np.concatenate(found), np.concatenate(on_road)


def _stations(roads: Roads, spacing_m: float) -> Iterator[tuple[Floats, Floats]]:
    """Places (n, 3) and yaws (n,) of the scanner, some at a time; never more of one link than fit."""
    for link in range(len(roads.link_id)):
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
    latitude, longitude, _ = frame.geodetic_from_east_north_array(points_m[:, :2], np.zeros(len(points_m)))
    margin = np.full(len(points_m), MARGIN_M)
    row, x, y = tiles_of_boxes(latitude, longitude, margin, margin)
    tiles = []
    for tile_x, tile_y in np.unique(np.column_stack((x, y)), axis=0).tolist():
        rows = np.sort(row[(x == tile_x) & (y == tile_y)])
        own = tile_frame(tile_x, tile_y)
        plane = own.east_north_from_geodetic_array(latitude[rows], longitude[rows], np.zeros(len(rows)))
        height = points_m[rows, 2]
        base = float(np.round(np.median(height)))
        about = np.column_stack((plane, height - base))
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
