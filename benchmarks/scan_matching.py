"""A ten-sweep local map of `street-lidar` matched in layers, beside Open3D's point-to-point ICP and KISS-ICP.

The peers get the same local map and the same map, split into the same layers, and stop as we do: at a step below 1 mm
and 0.1 mrad or after 30 iterations. Open3D has no such rule: the steps it needs are counted beforehand, untimed, and it
is timed doing as many. What is built once for a map (trees, voxel maps) is not timed, what is built for each local map
is. Both peers compute in as many threads as they like, Camber in one. A peer that is not installed is left out, and a
line says so.
"""

from __future__ import annotations

import importlib
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from figure import Figure, least_s, lower
from numpy.typing import NDArray

from camber.geodesy.se3 import invert, transform_points
from camber.localizer.map_clouds.voxel_grid import voxel_means
from camber.localizer.matching.layered_matching import MatchInput, MatchOptions, match_layers
from camber.localizer.matching.registration import LayerTarget, register
from camber.localizer.matching.road_registration import fit_road
from support import street_lidar

Floats = NDArray[np.float64]
Match = Callable[[Sequence[Floats], Floats], Floats]
"""Clouds of the layers and the guess to map_from_local."""

OPTIONS = MatchOptions()
MAX_ITERATIONS = 30
D_MAX_M = 1.0
STEP_M, STEP_RAD = 1.0e-3, 1.0e-4
QUERIES = tuple(street_lidar.QUERIES)[::2]
ROUNDS = 3
BUDGET_MS = 50.0


def layered(query: street_lidar.Query) -> list[Floats]:
    h = query.heights_m
    return [query.points_m[(h >= low) & (h < high)] for low, high in OPTIONS.bounds_m]


def everything_ms() -> float:
    """Overlay of ten sweeps that were thinned as they came, height and tilt by the road, heights, layers, choice."""
    took = []
    at, road, layers = street_lidar.poses(), street_lidar.road(), street_lidar.targets(OPTIONS.bounds_m)
    for query, k in zip(street_lidar.queries(0.5, 2.0, 1), street_lidar.QUERIES, strict=True):
        ks = range(k - 2 * (street_lidar.SWEEPS - 1), k + 1, 2)
        sweeps = [street_lidar.thinned(street_lidar.sweep(j), street_lidar.LOCAL_VOXEL_M) for j in ks]
        for _ in range(ROUNDS):
            began = time.perf_counter()
            here = invert(at[k])
            moved = [transform_points(here @ at[j], points) for j, points in zip(ks, sweeps, strict=True)]
            local = voxel_means(np.concatenate(moved), street_lidar.LOCAL_VOXEL_M)
            heights = street_lidar.ground().height_above(transform_points(query.guess, local))
            guess = fit_road(local, heights, road, query.guess).map_from_local
            heights = street_lidar.ground().height_above(transform_points(guess, local))
            scan = MatchInput(points_m=local, heights_m=heights, targets=layers, guess=guess)
            match_layers(scan, OPTIONS)
            took.append(1e3 * (time.perf_counter() - began))
    return statistics.median(took)


def of_open3d(targets: Sequence[LayerTarget], open3d: Any) -> Match:
    """Open3D's legacy point-to-point ICP, layer by layer; the layer of least distance."""
    registration = open3d.pipelines.registration
    maps = [_cloud(open3d, target.points_m) for target in targets]
    point_to_point = registration.TransformationEstimationPointToPoint()
    steps: dict[tuple[int, bytes], int] = {}

    def aligned(layer: int, cloud: Any, guess: Floats, iterations: int) -> Any:
        criteria = registration.ICPConvergenceCriteria(0.0, 0.0, iterations)
        return registration.registration_icp(cloud, maps[layer], D_MAX_M, guess, point_to_point, criteria)

    def needed(layer: int, cloud: Any, guess: Floats) -> int:
        at = guess
        for iteration in range(1, MAX_ITERATIONS + 1):
            then = np.asarray(aligned(layer, cloud, at, 1).transformation)
            step = invert(at) @ then
            at = then
            turn = np.linalg.norm(step[:3, :3] - np.eye(3)) / np.sqrt(2.0)
            if np.linalg.norm(step[:3, 3]) < STEP_M and turn < STEP_RAD:
                return iteration
        return MAX_ITERATIONS

    def match(clouds: Sequence[Floats], guess: Floats) -> Floats:
        results = []
        for layer, points in enumerate(clouds):
            cloud = _cloud(open3d, points)
            key = (layer, guess.tobytes() + points[:1].tobytes())
            if key not in steps:
                steps[key] = needed(layer, cloud, guess)
            results.append(aligned(layer, cloud, guess, steps[key]))
        return np.asarray(min(results, key=lambda result: float(result.inlier_rmse)).transformation)

    return match


def _cloud(open3d: Any, points_m: Floats) -> Any:
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points_m))


def of_kiss_icp(targets: Sequence[LayerTarget], registration: Any, mapping: Any) -> Match:
    """KISS-ICP's registration of all layers' points at once, its voxel map filled with all of the map's."""
    voxels = mapping.VoxelHashMap(voxel_size=1.0, max_distance=200.0, max_points_per_voxel=20)
    for target in targets:
        voxels.add_points(target.points_m)
    engine = registration.Registration(MAX_ITERATIONS, STEP_RAD)

    def match(clouds: Sequence[Floats], guess: Floats) -> Floats:
        points = np.concatenate(list(clouds))
        return np.asarray(engine.align_points_to_map(points, voxels, guess, D_MAX_M, D_MAX_M / 3.0))

    return match


def of_document(targets: Sequence[LayerTarget]) -> Match:
    """The document's ICP by small_gicp, on the whole of each layer."""

    def match(clouds: Sequence[Floats], guess: Floats) -> Floats:
        fits = [
            register(
                target,
                cloud,
                guess,
                method="point_to_point",
                max_distance_m=D_MAX_M,
                max_iterations=MAX_ITERATIONS,
            )
            for target, cloud in zip(targets, clouds, strict=True)
        ]
        return min(fits, key=lambda fit: fit.mean_distance_m).transform

    return match


def measured(
    asked: Sequence[street_lidar.Query], match: Callable[[street_lidar.Query], Floats]
) -> tuple[float, float]:
    """Median ms of the queries, each the least of three rounds, and the 95th percentile of the error in cm."""
    spent_ms, off_cm = [], []
    for query in asked:
        off_cm.append(100.0 * float(np.hypot(*query.error(match(query))[:2])))
        spent_ms.append(1e3 * least_s(partial(match, query), rounds=ROUNDS, clock=time.perf_counter))
    return statistics.median(spent_ms), float(np.percentile(off_cm, 95))


def figures() -> list[Figure]:
    if street_lidar.folder() is None:
        print("scan_matching: no figure without CAMBER_DATA/street-lidar", file=sys.stderr)
        return []
    asked = [
        q
        for q, k in zip(street_lidar.queries(0.5, 2.0, 1), street_lidar.QUERIES, strict=True)
        if k in QUERIES
    ]
    targets = street_lidar.targets(OPTIONS.bounds_m)
    clouds = {id(query): layered(query) for query in asked}

    def ours(query: street_lidar.Query) -> Floats:
        scan = MatchInput(
            points_m=query.points_m, heights_m=query.heights_m, targets=targets, guess=query.guess
        )
        return match_layers(scan, OPTIONS).map_from_local

    def of(match: Match) -> Callable[[street_lidar.Query], Floats]:
        return lambda query: match(clouds[id(query)], query.guess)

    ms, cm = measured(asked, ours)
    figures = [
        lower("ten sweeps overlaid and matched in layers", "ms", everything_ms(), BUDGET_MS, "half of 10 Hz")
    ]
    icp_ms, icp_cm = measured(asked, of(of_document(targets)))
    figures.append(lower("layers matched, planes", "ms", ms, icp_ms, "the document's ICP, small_gicp"))
    figures.append(lower("error p95 from 0.5 m, planes", "cm", cm, icp_cm, "the document's ICP, small_gicp"))
    for name, module, make in (
        ("Open3D point-to-point in layers", "open3d", lambda m: of_open3d(targets, m)),
        ("KISS-ICP registration", "kiss_icp", lambda _: of_kiss_icp(targets, *_of_kiss_icp())),
    ):
        try:
            peer = make(importlib.import_module(module))
        except ImportError as error:
            print(f"scan_matching: {module} is not installed, no figure beside it ({error})", file=sys.stderr)
            continue
        peer_ms, peer_cm = measured(asked, of(peer))
        figures.append(lower("layers matched", "ms", ms, peer_ms, name))
        figures.append(lower("layers matched, the document's ICP", "ms", icp_ms, peer_ms, name))
        figures.append(lower("error p95 from 0.5 m", "cm", cm, peer_cm, name))
    return figures


def _of_kiss_icp() -> tuple[Any, Any]:
    return importlib.import_module("kiss_icp.registration"), importlib.import_module("kiss_icp.mapping")
