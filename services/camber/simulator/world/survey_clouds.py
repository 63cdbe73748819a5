"""Point clouds of the map: what a survey vehicle's scanner hits from all roads on the survey day.

A scan every few metres, from the lane, without motion during the scan; the range errs, positions do not. Of the points
in one voxel the first is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.road_map.cloud_tiles import cloud_tiles, first_of_voxels
from camber.schemas.road import CloudTile, Layer
from camber.simulator.random_streams import stream
from camber.simulator.scene import Booleans, Floats, Material
from camber.simulator.world.ray_tracing import ShapeTracer
from camber.simulator.world.roads import Roads

_ELEVATIONS_RAD = np.deg2rad(np.concatenate((np.linspace(-28.0, 0.0, 32), np.linspace(2.0, 32.0, 16))))
# Chosen: a scanner on the roof of a car, denser than a LiDAR that drives by; blocks that fit into the cache.
SENSOR_HEIGHT_M = 2.2
_AZIMUTHS = 240
_RANGE_M = 80.0
_RANGE_SIGMA_M = 0.01
_SWEEPS_AT_ONCE = 40
_THREADS = 2
Station = tuple[Floats, Floats]
"""Places (n, 3) of the scanner, some at a time, and its yaws (n,)."""
_LAYERS: tuple[tuple[Layer, bool], ...] = (("environment_cloud", False), ("road_cloud", True))


def surveyed_clouds(
    stations: Iterator[Station],
    tracer: ShapeTracer,
    frame: LocalFrame,
    *,
    seed: int,
    voxel_m: float,
    seen_ns: int,
) -> list[CloudTile]:
    """Two clouds of each tile: the roads' surfaces, and all else."""
    tiles: list[CloudTile] = []
    points, on_road = _scanned(stations, tracer, seed, voxel_m)
    for layer, road in _LAYERS:
        kept = points[on_road == road]
        tiles += cloud_tiles(kept[first_of_voxels(kept, voxel_m)], frame, layer, seen_ns)
    return tiles


def _scanned(
    stations: Iterator[Station], tracer: ShapeTracer, seed: int, voxel_m: float
) -> tuple[Floats, Booleans]:
    """Points (n, 3) in the world frame, and which of them lie on a road."""

    def scan(numbered: tuple[int, Station]) -> tuple[Floats, Booleans]:
        number, (place_m, yaw_rad) = numbered
        points, road = _scan(tracer, place_m, yaw_rad, stream(seed, f"survey scans {number}"))
        # Scans near one another: most of what is thinned out is theirs.
        thin = first_of_voxels(points, voxel_m)
        return points[thin], road[thin]

    # Tracing holds no lock of the interpreter; results come in the order of the stations, whichever is done first.
    with ThreadPoolExecutor(_THREADS) as pool:
        parts = list(pool.map(scan, enumerate(stations)))
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _scan(
    tracer: ShapeTracer, place_m: Floats, yaw_rad: Floats, rng: np.random.Generator
) -> tuple[Floats, Booleans]:
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


def scan_stations(roads: Roads, links: Sequence[int], spacing_m: float) -> Iterator[Station]:
    """Along the lanes of some links (row numbers)."""
    for link in links:
        length = float(roads.length_m[link])
        s = np.linspace(0.0, length, max(2, math.ceil(length / spacing_m) + 1))[:-1] + 0.5 * spacing_m
        s = s[s < length]
        east, north, yaw = roads.at_offset(link, s, float(roads.lane_offset_m[link]))
        up = roads.link_height_m(np.array(link), east, north) + SENSOR_HEIGHT_M
        for k in range(0, len(s), _SWEEPS_AT_ONCE):
            part = slice(k, k + _SWEEPS_AT_ONCE)
            yield np.column_stack((east, north, up))[part], yaw[part]
