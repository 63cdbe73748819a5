"""Points are counted to the tiles that `tile_of` says, also at their edges, and lie side by side by tile."""

import math

import numpy as np
import pytest

from camber.map_server.point_groups import sort_by_tile, tile_numbers
from camber.road_map.tile_grid import TILES, tile_of

SEED = 91


@pytest.mark.parametrize("reach_rad", [1e-5, 3e-3, 1.0])
@pytest.mark.parametrize("about_rad", [0.0, 0.61, -1.48])
def test_tile_numbers_equal_those_of_single_points(about_rad: float, reach_rad: float) -> None:
    rng = np.random.default_rng(SEED)
    latitude = about_rad + rng.uniform(-reach_rad, reach_rad, 3000)
    longitude = rng.uniform(-math.pi, math.pi, 3000)
    # Northern edges of tiles, and the numbers next to them.
    y = np.floor((0.5 - np.arcsinh(np.tan(latitude[:300])) / (2.0 * math.pi)) * TILES)
    edge = np.arctan(np.sinh((0.5 - y / TILES) * 2.0 * math.pi))
    latitude[:900] = np.concatenate((edge, np.nextafter(edge, 2.0), np.nextafter(edge, -2.0)))
    latitude[-3:], longitude[-2:] = [math.nan, 0.5, 1.5], [math.inf, 0.0]
    numbers = tile_numbers(latitude, longitude).tolist()
    for number, *point in zip(numbers[:-3], latitude.tolist(), longitude.tolist(), strict=False):
        tile = tile_of(*point)
        assert number == (-1 if tile is None else tile[0] * TILES + tile[1])
    assert numbers[-3:] == [-1, -1, -1]


@pytest.mark.parametrize("count", [0, 1, 7, 5000])
def test_points_are_sorted_by_tile_in_their_order(count: int) -> None:
    number = np.random.default_rng(SEED).integers(-1, 40, count) * 12345
    tiles, points, start, sorted_place = sort_by_tile(number)
    assert sorted(tiles.tolist()) == sorted(set(number.tolist()))
    for tile, first, end in zip(tiles.tolist(), start[:-1], start[1:], strict=True):
        assert points[first:end].tolist() == np.flatnonzero(number == tile).tolist()
    assert points[sorted_place].tolist() == list(range(count))
