"""The ground of a district as a closed form: waves and hills, smooth everywhere, the same on every machine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats

_HILL_WAVES = 24  # chosen: no direction and no length without one


class Terrain(NamedTuple):
    """Ellipsoidal height of the ground over east and north of the world frame.

    `waves` (n, 4): amplitude [m], wave number east and north [rad/m], phase [rad]. `hills` (n, 5): height [m], east,
    north of the top [m], widths east and north [m]: height · exp(−(Δe/width)² − (Δn/width)²), whose steepest slope is
    0.858 height / width.
    """

    base_m: float
    waves: Floats
    hills: Floats

    def height_m(self, east_m: Floats, north_m: Floats) -> Floats:
        """Heights at places of any shape."""
        east = np.ascontiguousarray(east_m, np.float64)
        north = np.ascontiguousarray(north_m, np.float64)
        return _heights(self, east.ravel(), north.ravel()).reshape(east.shape)


@compiled
def ground_height(terrain: Terrain, e: float, n: float) -> float:
    """Height at one place."""
    height = terrain.base_m
    waves, hills = terrain.waves, terrain.hills
    for i in range(len(waves)):
        height += waves[i, 0] * math.sin(waves[i, 1] * e + waves[i, 2] * n + waves[i, 3])
    for i in range(len(hills)):
        u = (e - hills[i, 1]) / hills[i, 3]
        v = (n - hills[i, 2]) / hills[i, 4]
        height += hills[i, 0] * math.exp(-u * u - v * v)
    return height


@compiled
def _heights(terrain: Terrain, east: Floats, north: Floats) -> Floats:
    heights = np.empty(len(east))
    for i in range(len(east)):
        heights[i] = ground_height(terrain, east[i], north[i])
    return heights


def rolling_terrain(
    seed: int, *, base_m: float, slope: float, hills: Sequence[tuple[float, ...]] = ()
) -> Terrain:
    """Three waves of 500 to 1,300 m in drawn directions whose slopes add up to at most `slope`, and given hills."""
    rng = stream(seed, "terrain")
    length_m = rng.uniform(500.0, 1300.0, 3)
    direction = rng.uniform(0.0, 2.0 * math.pi, 3)
    number = 2.0 * math.pi / length_m
    towards = number * np.cos(direction), number * np.sin(direction)
    waves = np.column_stack((slope / 3.0 / number, *towards, rng.uniform(0.0, 2.0 * math.pi, 3)))
    return Terrain(base_m, waves, np.array(hills, np.float64).reshape(-1, 5))


def hilly_terrain(seed: int, *, base_m: float, slope: float) -> Terrain:
    """Hills whose slope along any direction has this root mean square: 24 waves of 100 to 1,000 m in drawn directions.

    Slopes of a wave go with the root of its length, so long hills are higher and short ones gentler: at 3.5 % each wave
    alone has a radius of crests of 2 km and more, as roads for 60 km/h are built (AASHTO, A Policy on
    Geometric Design of Highways and Streets, table 3-35: K of 11 m per per cent, 1.1 km).
    """
    rng = stream(seed, "hills")
    length_m = np.exp(rng.uniform(math.log(100.0), math.log(1000.0), _HILL_WAVES))
    direction = math.pi * (np.arange(_HILL_WAVES) + rng.random(_HILL_WAVES)) / _HILL_WAVES
    rng.shuffle(direction)
    number = 2.0 * math.pi / length_m
    steepest = np.sqrt(length_m)
    # A wave's slope along a direction is steepest · cos(angle) · cos(phase): a quarter of its square on average.
    steepest *= slope / math.sqrt(float(np.sum(steepest**2)) / 4.0)
    towards = number * np.cos(direction), number * np.sin(direction)
    waves = np.column_stack((steepest / number, *towards, rng.uniform(0.0, 2.0 * math.pi, _HILL_WAVES)))
    return Terrain(base_m, waves, np.zeros((0, 5)))
