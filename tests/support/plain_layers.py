"""A yard of flat walls and posts, a corridor and a road, as clouds: what scan matching is tried on without a recording.

Points stand at random on the surfaces, so those of the map and of a local map are never the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.se3 import invert, map_from_vehicle, transform_points
from camber.localizer.matching.layered_matching import MatchOptions
from camber.localizer.matching.registration import LayerTarget

Floats = NDArray[np.float64]

HEIGHT_M = 3.5
NOISE_M = 0.01
MAP_DENSITY = 25.0
LOCAL_DENSITY = 10.0
"""Points for a square metre."""

YARD = [
    ((-20.0, -12.0), (20.0, -12.0)),
    ((20.0, -12.0), (20.0, 5.0)),
    ((20.0, 5.0), (8.0, 15.0)),
    ((8.0, 15.0), (-20.0, 15.0)),
    ((-20.0, 15.0), (-20.0, -12.0)),
    ((3.0, 4.0), (5.0, 4.0)),
    ((5.0, 4.0), (5.0, 6.0)),
    ((-9.0, -6.0), (-8.0, -4.0)),
]
CORRIDOR = [((-60.0, -4.0), (60.0, -4.0)), ((-60.0, 4.0), (60.0, 4.0))]


def surfaces(
    walls: list[tuple[tuple[float, float], tuple[float, float]]],
    density: float,
    seed: int | tuple[int, ...] | np.random.Generator,
    low_m: float = 0.0,
    high_m: float = HEIGHT_M,
) -> Floats:
    """Points (n, 3) on upright walls, with noise across them."""
    random, parts = np.random.default_rng(seed), []
    for (x0, y0), (x1, y1) in walls:
        length = float(np.hypot(x1 - x0, y1 - y0))
        n = int(density * length * (high_m - low_m))
        along = random.uniform(0.0, 1.0, n)
        across = random.normal(0.0, NOISE_M, n)
        x = x0 + along * (x1 - x0) - across * (y1 - y0) / length
        y = y0 + along * (y1 - y0) + across * (x1 - x0) / length
        parts.append(np.stack([x, y, random.uniform(low_m, high_m, n)], axis=1))
    return np.concatenate(parts)


def road(density: float, seed: int, half_m: float = 15.0) -> Floats:
    """Points (n, 3) of a level square of road."""
    random = np.random.default_rng(seed)
    n = int(density * 4.0 * half_m**2)
    points_m = random.uniform(-half_m, half_m, (n, 3))
    points_m[:, 2] = random.normal(0.0, NOISE_M, n)
    return points_m


def pose(
    east_m: float,
    north_m: float,
    yaw_deg: float,
    up_m: float = 0.0,
    roll_deg: float = 0.0,
    pitch_deg: float = 0.0,
) -> Floats:
    """map_from_local (4, 4)"""
    roll, pitch, yaw = np.radians([roll_deg, pitch_deg, yaw_deg])
    return map_from_vehicle(east_m, north_m, up_m, float(roll), float(pitch), float(yaw))


def seen_from(map_from_local: Floats, points_m: Floats) -> Floats:
    """Points of the map's frame as a vehicle at `map_from_local` sees them."""
    return transform_points(invert(map_from_local), points_m)


def targets(points_m: Floats, options: MatchOptions | None = None) -> list[LayerTarget]:
    """The layers of a map on level ground at height zero, with a margin of 0.2 m."""
    bounds = (options or MatchOptions()).bounds_m
    h = points_m[:, 2]
    return [LayerTarget.of(points_m[(h >= low - 0.2) & (h < high + 0.2)]) for low, high in bounds]


def error(result: Floats, truth: Floats) -> tuple[float, float]:
    """Horizontal distance [m] and turn [rad] between two poses."""
    apart = invert(truth) @ result
    return float(np.hypot(apart[0, 3], apart[1, 3])), abs(float(np.arctan2(apart[1, 0], apart[0, 0])))


TRUTH = pose(3.0, -2.0, 30.0)
YARD_M = surfaces(YARD, MAP_DENSITY, 1)
YARD_SEEN_M = seen_from(TRUTH, surfaces(YARD, LOCAL_DENSITY, 2))
