"""The recording `street-lidar` as map and query: the map from its even sweeps, ten odd ones overlaid as the query.

The pseudo truth is good to about 2 cm, and map and query share it: no smaller error can be resolved.
"""

from __future__ import annotations

import os
from collections import deque
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camber.formats.map_exchange.pcd import cloud_from_pcd, read_header
from camber.geodesy.se3 import invert, map_from_vehicle, transform_points
from camber.localizer.matching.registration import LayerBounds, LayerTarget
from camber.localizer.matching.road_registration import fit_road
from support.moved_objects import Change, changed

Floats = NDArray[np.float64]

SENSOR_HEIGHT_M = 1.73
SWEEPS = 10
MAP_VOXEL_M = 0.2
LOCAL_VOXEL_M = 0.3
_POINT_BYTES = 16  # x y z intensity
_NEAR_M, _FAR_M = 2.5, 60.0
_CELL_M = 1.0
_STEEPEST = 0.15
QUERIES = range(2 * SWEEPS - 1, 40, 2)


def folder() -> Path | None:
    data = os.environ.get("CAMBER_DATA")
    path = Path(data) / "street-lidar" if data else None
    return path if path is not None and path.is_dir() else None


@cache
def poses() -> Floats:
    """map_from_vehicle (40, 4, 4): the vehicle stands on the road, below the sensor."""
    path = folder()
    assert path is not None
    rows = np.loadtxt(path / "poses.csv", delimiter=",", comments="#").reshape(-1, 3, 4)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows
    # Six decimals are no rotation to twelve digits.
    u, _, v = np.linalg.svd(poses[:, :3, :3])
    poses[:, :3, :3] = u @ v
    sensor_from_vehicle = np.eye(4)
    sensor_from_vehicle[2, 3] = -SENSOR_HEIGHT_M
    return poses @ sensor_from_vehicle


@cache
def sweep(k: int) -> Floats:
    """Points (n, 3) [m] of sweep k in the vehicle frame, without the vehicle itself."""
    path = folder()
    assert path is not None
    name = f"{k:010d}.pcd"
    data = (path / name).read_bytes()
    header = read_header(data, name)
    # These files carry padding after their last point, which the reader refuses.
    points = cloud_from_pcd(data[: header.begin + _POINT_BYTES * header.points], name).points_m.astype(
        np.float64
    )
    range_m = np.linalg.norm(points, axis=1)
    return points[(range_m > _NEAR_M) & (range_m < _FAR_M)] + np.array([0.0, 0.0, SENSOR_HEIGHT_M])


def thinned(points_m: Floats, voxel_m: float) -> Floats:
    """The mean of the points of each voxel, in the order in which the voxels are first met."""
    cell = np.floor(points_m / voxel_m).astype(np.int64) + (1 << 20)
    key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    _, first, member, count = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(member, points_m[:, d]) for d in range(3)], axis=1) / count[:, None]
    return np.ascontiguousarray(mean[np.argsort(first)])


@cache
def overlaid(k: int) -> Floats:
    """The ten odd sweeps up to sweep k in the vehicle frame of sweep k, thinned."""
    ks = range(k - 2 * (SWEEPS - 1), k + 1, 2)
    return overlay([thinned(sweep(j), LOCAL_VOXEL_M) for j in ks], [poses()[j] for j in ks])


def overlay(sweeps: list[Floats], map_from_vehicle: list[Floats]) -> Floats:
    here = invert(map_from_vehicle[-1])
    moved = [transform_points(here @ at, points) for points, at in zip(sweeps, map_from_vehicle, strict=True)]
    return thinned(np.concatenate(moved), LOCAL_VOXEL_M)


@cache
def map_points() -> Floats:
    """The map (n, 3) [m] from the even sweeps."""
    at = poses()
    parts = [transform_points(at[k], thinned(sweep(k), MAP_VOXEL_M)) for k in range(0, 40, 2)]
    return thinned(np.concatenate(parts), MAP_VOXEL_M)


@dataclass(frozen=True, eq=False)
class Ground:
    """Elevation of the ground (m) by cells of a metre, grown outwards from under the vehicle's track."""

    origin_m: Floats
    elevation_m: Floats

    def height_above(self, points_m: Floats) -> Floats:
        """Heights (n,) [m] of points in the map's frame."""
        cell = np.floor((points_m[:, :2] - self.origin_m) / _CELL_M).astype(np.int64)
        cell = np.clip(cell, 0, np.array(self.elevation_m.shape) - 1)
        height_m: Floats = points_m[:, 2] - self.elevation_m[cell[:, 0], cell[:, 1]]
        return height_m


@cache
def ground() -> Ground:
    points = map_points()
    origin = np.floor(points[:, :2].min(axis=0))
    cell = np.floor((points[:, :2] - origin) / _CELL_M).astype(np.int64)
    shape = tuple(cell.max(axis=0) + 1)
    order = np.lexsort((points[:, 2], cell[:, 1], cell[:, 0]))
    flat = (cell[:, 0] * shape[1] + cell[:, 1])[order]
    begin = np.flatnonzero(np.diff(flat, prepend=-1))
    count = np.diff(np.append(begin, len(flat)))
    low = np.full(shape[0] * shape[1], np.nan)
    low[flat[begin]] = points[order, 2][begin + count // 10]
    return Ground(origin, _grown(low.reshape(shape), poses()[:, :3, 3], origin))


def _grown(low: Floats, track_m: Floats, origin_m: Floats) -> Floats:
    """Lowest points where they go on from a neighbour at less than the steepest slope, the neighbour's elsewhere."""
    ground = np.full(low.shape, np.nan)
    queue: deque[tuple[int, int]] = deque()
    for x, y, z in track_m:
        i, j = int((x - origin_m[0]) // _CELL_M), int((y - origin_m[1]) // _CELL_M)
        if np.isnan(ground[i, j]):
            ground[i, j] = z
            queue.append((i, j))
    while queue:
        i, j = queue.popleft()
        for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
            if 0 <= a < low.shape[0] and 0 <= b < low.shape[1] and np.isnan(ground[a, b]):
                goes_on = abs(low[a, b] - ground[i, j]) <= _STEEPEST * _CELL_M
                ground[a, b] = low[a, b] if goes_on else ground[i, j]
                queue.append((a, b))
    return ground


@cache
def targets(bounds_m: LayerBounds) -> tuple[LayerTarget, ...]:
    """The layers of the map, with a margin of 0.2 m."""
    points = map_points()
    h = ground().height_above(points)
    return tuple(LayerTarget.of(points[(h >= low - 0.2) & (h < high + 0.2)]) for low, high in bounds_m)


@cache
def road() -> LayerTarget:
    """The map's ground."""
    points = map_points()
    return LayerTarget.of(points[np.abs(ground().height_above(points)) < 0.3])


@dataclass(frozen=True, eq=False)
class Query:
    """A local map in the local frame, its heights above the road at the guess, and the guess and the pseudo
    truth, map_from_local."""

    points_m: Floats
    heights_m: Floats
    guess: Floats
    truth: Floats

    def error(self, result: Floats) -> Floats:
        """East, north [m], yaw [rad] of a pose against the pseudo truth."""
        turned = result[:3, :3] @ self.truth[:3, :3].T
        return np.array([*(result[:2, 3] - self.truth[:2, 3]), np.arctan2(turned[1, 0], turned[0, 0])])


def queries(
    off_m: float, off_deg: float, each: int, change: Change | None = None, seed: int = 5
) -> list[Query]:
    """Starts off by so much in every direction, height, roll and pitch by the road from 5 cm and 0.3° off."""
    random = np.random.default_rng(seed)
    result = []
    for k in QUERIES:
        for _ in range(each):
            truth, points_m = poses()[k], overlaid(k)
            if change is not None:
                above_m = ground().height_above(transform_points(truth, points_m))
                points_m = changed(points_m, above_m, change, random)
            guess = _next_to(truth, off_m, off_deg, random)
            heights_m = ground().height_above(transform_points(guess, points_m))
            guess = fit_road(points_m, heights_m, road(), guess).map_from_local
            heights_m = ground().height_above(transform_points(guess, points_m))
            result.append(Query(points_m, heights_m, guess, truth))
    return result


def _next_to(truth: Floats, off_m: float, off_deg: float, random: np.random.Generator) -> Floats:
    offset, turn = random.uniform(-np.pi, np.pi), np.radians(off_deg) * random.choice([-1.0, 1.0])
    roll, pitch = random.normal(0.0, np.radians(0.3), 2)
    tilted = truth @ map_from_vehicle(
        0.0, 0.0, random.normal(0.0, 0.05), float(roll), float(pitch), float(turn)
    )
    tilted[:2, 3] += off_m * np.array([np.cos(offset), np.sin(offset)])
    return tilted
