"""The simulator: rays beside numpy over every shape, a fleet beside its goal, making a drive beside its length."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from figure import Figure, camber, higher, least_s, lower
from numpy.typing import NDArray

from camber.simulator.output.fleet_folder import write_fleet
from camber.simulator.scenario import load_scenario
from camber.simulator.scene import Shapes
from camber.simulator.simulated_drive import district_of
from camber.simulator.world.ray_tracing import ShapeTracer

Floats = NDArray[np.float64]

RANGE_M = 120.0
BEAMS, COLUMNS = 32, 1800
PEER_RAYS = 100
GOAL_RECORDS_PER_S = 20_000.0
VEHICLES = 9
LIMIT_S = 600.0


def rays(origin_m: tuple[float, float, float]) -> tuple[Floats, Floats]:
    """One turn of a sensor: origins and directions (rays, 3)."""
    azimuth, elevation = np.meshgrid(
        np.linspace(0.0, 2.0 * np.pi, COLUMNS, endpoint=False), np.radians(np.linspace(-25.0, 15.0, BEAMS))
    )
    level = np.cos(elevation)
    towards = np.stack(
        (level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)), axis=-1
    ).reshape(-1, 3)
    return np.tile(np.array(origin_m), (len(towards), 1)), towards


def first(low: Floats, high: Floats) -> Floats:
    """Of spans inside convex shapes (shapes,): the nearest surface ahead."""
    ahead = np.where(low > 0.0, low, high)
    return np.where((low <= high) & (ahead > 0.0), ahead, np.inf)


def quadric(
    centre: Floats, radius: Floats, scale: Floats, origin: Floats, towards: Floats
) -> tuple[Floats, Floats]:
    p, d = (origin - centre) * scale, towards * scale
    a, b = np.sum(d * d, axis=-1), np.sum(p * d, axis=-1)
    root = np.sqrt(b * b - a * (np.sum(p * p, axis=1) - radius**2))  # NaN: passed by
    return (-b - root) / a, (-b + root) / a


def slab(least: Floats, most: Floats, at: Floats, step: Floats) -> tuple[Floats, Floats]:
    one, other = (least - at) / step, (most - at) / step
    return np.minimum(one, other), np.maximum(one, other)


def nearest(shapes: Shapes, origin: Floats, towards: Floats) -> float:
    """Distance along one ray to the first of all shapes, every one of them looked at."""
    e, n, base, length, width, height, yaw = shapes.boxes_m.T
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = origin[0] - e, origin[1] - n
    sides = [
        slab(-length, length, c * x + s * y, c * towards[0] + s * towards[1]),
        slab(-width, width, c * y - s * x, c * towards[1] - s * towards[0]),
        slab(base, base + height, origin[2], towards[2]),
    ]
    surfaces_m = [
        first(np.max([low for low, _ in sides], axis=0), np.min([high for _, high in sides], axis=0))
    ]

    cylinders = shapes.cylinders_m
    around = quadric(cylinders[:, :3], cylinders[:, 3], np.array([1.0, 1.0, 0.0]), origin, towards)
    ends = slab(cylinders[:, 2], cylinders[:, 2] + cylinders[:, 4], origin[2], towards[2])
    surfaces_m.append(first(np.maximum(around[0], ends[0]), np.minimum(around[1], ends[1])))

    crowns = shapes.crowns_m
    stretch = np.column_stack((np.ones((len(crowns), 2)), crowns[:, 3] / crowns[:, 4]))
    surfaces_m.append(first(*quadric(crowns[:, :3], crowns[:, 3], stretch, origin, towards)))

    corner = shapes.triangles_m[:, 0]
    one, other = shapes.triangles_m[:, 1] - corner, shapes.triangles_m[:, 2] - corner
    across = np.cross(towards, other)
    turned = np.cross(origin - corner, one)
    scale = np.sum(one * across, axis=1)
    u = np.sum((origin - corner) * across, axis=1) / scale
    v = turned @ towards / scale
    t = np.sum(other * turned, axis=1) / scale
    surfaces_m.append(np.where((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0), t, np.inf))

    least = min(float(np.nanmin(distances, initial=np.inf)) for distances in surfaces_m)
    return least if least <= RANGE_M else np.inf


def tracing() -> Figure:
    district = district_of(load_scenario("city"), {})
    shapes = district.shapes("drive")
    tracer = ShapeTracer(shapes)
    path = district.path()
    middle = len(path.east_m) // 3
    origin, towards = rays((path.east_m[middle], path.north_m[middle], path.up_m[middle] + 1.95))
    hits = tracer.first_hits(origin, towards, RANGE_M)
    ours_s = least_s(lambda: tracer.first_hits(origin, towards, RANGE_M), clock=time.perf_counter)

    chosen = np.random.default_rng(1).choice(len(towards), PEER_RAYS, replace=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        began = time.perf_counter()
        expected = [nearest(shapes, origin[k], towards[k]) for k in chosen]
        peer = PEER_RAYS / (time.perf_counter() - began)
    np.testing.assert_allclose(hits.distance_m[chosen], expected, atol=1e-6)
    count = sum(map(len, (shapes.boxes_m, shapes.cylinders_m, shapes.crowns_m, shapes.triangles_m)))
    name = f"first surface along a ray, a city of {count} shapes"
    return higher(name, "rays/s", len(towards) / ours_s, peer, "numpy over all shapes, one ray at a time")


def fleet(folder: Path) -> Figure:
    scenario = load_scenario("fleet", [f"fleet.vehicles={VEHICLES}"])
    assert scenario.fleet is not None
    written = write_fleet(folder, scenario)
    next(written)  # the district and its map are made once, whatever the size of the fleet
    began = time.perf_counter()
    vehicles = sum(1 for _ in written)
    records = vehicles * scenario.fleet.drives_each * scenario.duration_s * scenario.fleet.rate_hz
    per_s = records / (time.perf_counter() - began)
    return higher("uploads of a simulated fleet, written", "records/s", per_s, GOAL_RECORDS_PER_S, "the goal")


def city(folder: Path) -> Figure:
    began = time.perf_counter()
    camber("simulate", "city", "--out", folder, "--quiet", timeout_s=LIMIT_S)
    made_s = time.perf_counter() - began
    name = "simulating the city with sweeps of 32 beams, survey and map included"
    return lower(name, "s", made_s, load_scenario("city").duration_s, "the drive itself")


def figures() -> list[Figure]:
    with tempfile.TemporaryDirectory() as name:
        return [tracing(), fleet(Path(name) / "fleet"), city(Path(name) / "city")]
