from __future__ import annotations

import math

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.road_map.cloud_tiles import RESOLUTION_M, cloud_tiles, first_of_voxels
from camber.road_map.tile_grid import tile_frame, tile_of

FRAME = LocalFrame(math.radians(35.1), math.radians(137.0), 0.0)


def test_every_point_is_in_its_tile_and_near_a_border_in_both() -> None:
    rng = np.random.default_rng(3)
    points_m = np.column_stack((rng.uniform(-700.0, 700.0, (5000, 2)), rng.uniform(40.0, 60.0, 5000)))
    tiles = cloud_tiles(points_m, FRAME, "road_cloud", 10**18)
    assert len(tiles) > 4
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(points_m[:, :2], 0.0)
    tile_of_point = [tile_of(*place) for place in zip(latitude.tolist(), longitude.tolist(), strict=True)]
    by_tile = {(tile.x, tile.y): tile for tile in tiles}
    assert set(tile_of_point) <= set(by_tile)
    for place, (tile_xy, height_m) in enumerate(zip(tile_of_point, points_m[:, 2].tolist(), strict=True)):
        assert tile_xy is not None
        tile = by_tile[tile_xy]
        plane = tile_frame(*tile_xy).east_north_from_geodetic(latitude[place], longitude[place], 0.0)
        about = tile.quanta * tile.resolution_m + [0.0, 0.0, tile.base_height_m]
        away = np.abs(about - [*plane, height_m]).max(axis=1)
        assert away.min() < 0.51 * RESOLUTION_M + 1e-4
    assert sum(len(tile.quanta) for tile in tiles) > len(points_m)
    assert cloud_tiles(points_m[:0], FRAME, "road_cloud", 10**18) == []


def test_the_first_point_of_each_voxel_is_kept() -> None:
    points_m = np.array([[0.02, 0.0, 0.0], [0.31, 0.0, 0.0], [0.05, 0.08, 0.09], [-0.01, 0.0, 0.0]])
    assert first_of_voxels(points_m, 0.1).tolist() == [0, 1, 3]
