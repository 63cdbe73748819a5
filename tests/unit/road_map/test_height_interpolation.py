"""Heights by surface id are those that the map server gives for the same surfaces, from the same map in tiles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from camber.geodesy.local_frame import LocalFrame
from camber.map_server.tile_index import TileIndex
from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.road_tiles import surface_tiles, surfaces_from_tiles
from support.small_map import FRAME, at, surface, surfaces

CURVED = surface(5, yaw_rad=0.3, heights_m=[[50.0, 50.2], [50.5, 50.4], [51.0, 51.6]])


def one(row: int, east_m: float, north_m: float) -> tuple[float, float]:
    heights = SurfaceHeights(surfaces([CURVED]))
    latitude, longitude = at(east_m, north_m)
    height_m, outside_m = heights.heights_m([row], [latitude], [longitude])
    return float(height_m[0]), float(outside_m[0])


def test_rows_by_id_in_any_order_and_none_for_an_unknown_one() -> None:
    heights = SurfaceHeights(surfaces([surface(9), surface(2**62), surface(4)]))
    assert heights.rows_of([4, 9, 5, 2**62, 0, -7]).tolist() == [2, 0, -1, 1, -1, -1]
    assert SurfaceHeights(surfaces([])).rows_of([4]).tolist() == [-1]


@pytest.mark.parametrize("seed", range(5))
def test_heights_are_those_of_the_map_server_within_a_tenth_of_a_millimetre(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame = LocalFrame(rng.uniform(-1.4, 1.4), rng.uniform(-math.pi, math.pi), 0.0)
    base_m = rng.uniform(-300.0, 3000.0)
    rows = [
        surface(
            i,
            *rng.uniform(-600.0, 600.0, 2),
            yaw_rad=rng.uniform(-math.pi, math.pi),
            half_length_m=rng.uniform(3.0, 60.0),
            half_width_m=rng.uniform(1.5, 6.0),
            heights_m=base_m + rng.uniform(-50.0, 50.0) + rng.normal(0.0, 0.05, rng.integers(2, 6, 2)),
            frame=frame,
        )
        for i in range(60)
    ]
    made = surface_tiles(surfaces(rows))
    heights = SurfaceHeights(surfaces_from_tiles(made))
    tiles = [TileIndex(tile) for tile in made]
    compared = 0
    for row in rows:
        here = LocalFrame(row["latitude_rad"], row["longitude_rad"], 0.0)
        cos, sin = math.cos(row["yaw_rad"]), math.sin(row["yaw_rad"])
        u, v = rng.uniform(-1.0, 1.0, (2, 8)) * [[row["half_length_m"] + 0.3], [row["half_width_m"] + 0.3]]
        points = here.geodetic_from_east_north_array(
            np.column_stack((cos * u - sin * v, sin * u + cos * v)), 0.0
        )
        number = heights.rows_of(np.full(8, row["surface_id"]))
        height_m, outside_m = heights.heights_m(number, points[0], points[1])
        beyond = np.maximum(np.abs((u, v)) - [[row["half_length_m"]], [row["half_width_m"]]], 0.0)
        assert np.allclose(outside_m, np.hypot(*beyond), atol=1e-4)
        for i in range(8):
            for tile in tiles:
                hits = tile.hits(*tile.frame.east_north_from_geodetic(points[0][i], points[1][i], 0.0))
                for hit in hits:
                    if hit.surface_id == row["surface_id"]:
                        assert height_m[i] == pytest.approx(hit.height_m, abs=1e-4)
                        compared += 1
    assert compared > 300


def test_outside_its_rectangle_a_surface_is_extrapolated_with_its_distance() -> None:
    turn = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
    height_m, outside_m = one(0, *(turn @ (13.0, 6.0)))
    assert outside_m == pytest.approx(5.0, abs=1e-6)  # 3 m ahead of it and 4 m to its left
    # 51.6 m at the corner; ahead the left edge rises by 0.12, to the left the front edge by 0.15.
    assert height_m == pytest.approx(51.6 + 3.0 * 0.12 + 4.0 * 0.15, abs=1e-6)
    assert one(0, 0.0, 0.0)[1] == 0.0


def test_an_unknown_surface_or_point_has_no_height() -> None:
    for height_m, outside_m in [one(-1, 0.0, 0.0), one(0, 2e5, 0.0)]:
        assert math.isnan(height_m)
        assert outside_m == math.inf
    heights = SurfaceHeights(surfaces([CURVED]))
    _, outside_m = heights.heights_m([0, 0], [math.nan, at(0.0, 0.0)[0]], [at(0.0, 0.0)[1], math.inf])
    assert outside_m.tolist() == [math.inf, math.inf]
    # On the other side of the earth, in line with its centre.
    _, outside_m = heights.heights_m([0], [-FRAME.latitude_rad], [FRAME.longitude_rad - math.pi])
    assert outside_m.tolist() == [math.inf]


def test_columns_of_different_lengths_are_refused() -> None:
    heights = SurfaceHeights(surfaces([CURVED]))
    with pytest.raises(ValueError, match=r"expected three of \(n,\), got \(1,\), \(2,\), \(1,\)"):
        heights.heights_m([0], [0.0, 0.0], [0.0])
    for row in (1, -2):
        with pytest.raises(ValueError, match=f"expected −1 to 0, got {row} to {row}"):
            heights.heights_m([row], [0.0], [0.0])
    assert [len(column) for column in heights.heights_m([], [], [])] == [0, 0]
