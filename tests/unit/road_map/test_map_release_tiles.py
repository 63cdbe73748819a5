"""Tiles are numbered as everybody numbers them, and a box finds every tile that it touches."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.geodesy.local_frame import LocalFrame
from camber.road_map.tile_grid import (
    LIMIT_LATITUDE_RAD,
    TILES,
    tile_corners_rad,
    tile_frame,
    tile_of,
    tiles_around,
    tiles_of,
    tiles_of_boxes,
)

LATITUDES = st.floats(-1.48, 1.48)
LONGITUDES = st.floats(-math.pi, math.pi)


def test_tile_numbers_are_those_of_the_slippy_map() -> None:
    # By the formula of the OpenStreetMap wiki ("Slippy map tilenames") in degrees: another form of the same.
    for latitude, longitude in (
        (35.17, 136.9),
        (-33.86, 151.21),
        (51.5, -0.12),
        (0.0001, 0.0001),
        (78.2, 15.6),
    ):
        phi = math.radians(latitude)
        x = int((longitude + 180.0) / 360.0 * 65536)
        y = int((1.0 - math.log(math.tan(phi) + 1.0 / math.cos(phi)) / math.pi) / 2.0 * 65536)
        assert tile_of(math.radians(latitude), math.radians(longitude)) == (x, y)


def test_there_are_no_tiles_at_the_poles() -> None:
    for latitude in (LIMIT_LATITUDE_RAD, -LIMIT_LATITUDE_RAD, math.pi / 2, math.nan):
        assert tile_of(latitude, 0.0) is None
        assert tiles_around(latitude, 0.0, 100.0) == []
    x, y = tiles_of([1.57, 0.5], [0.0, 0.0])
    assert (x[0], y[0], (x[1], y[1])) == (-1, -1, tile_of(0.5, 0.0))


def test_the_antimeridian_is_one_line() -> None:
    assert tile_of(0.1, math.pi) == tile_of(0.1, -math.pi)
    assert {x for x, _ in tiles_around(0.1, math.pi, 10.0)} == {0, TILES - 1}


@settings(max_examples=100, deadline=None, derandomize=True)
@given(LATITUDES, LONGITUDES)
def test_a_point_lies_within_its_tile_alone_and_among_many(latitude_rad: float, longitude_rad: float) -> None:
    tile = tile_of(latitude_rad, longitude_rad)
    assert tile is not None
    south, west, north, east = tile_corners_rad(*tile)
    assert south - 1e-12 <= latitude_rad <= north + 1e-12
    assert west - 1e-12 <= longitude_rad <= east + 1e-12 or longitude_rad > math.pi - 1e-12
    assert south < tile_frame(*tile).latitude_rad < north
    x, y = tiles_of([latitude_rad], [longitude_rad])
    # On a border itself the two may round apart by one tile; what is near a border stands in both.
    assert abs(tile[0] - int(x[0])) in (0, 1, TILES - 1)
    assert abs(tile[1] - int(y[0])) <= 1


@settings(max_examples=100, deadline=None, derandomize=True)
@given(LATITUDES, LONGITUDES, st.floats(0.1, 2000.0), st.floats(0.1, 2000.0), st.integers(0, 2**32))
def test_a_box_finds_every_tile_that_it_touches(
    latitude_rad: float, longitude_rad: float, half_east_m: float, half_north_m: float, seed: int
) -> None:
    box, x, y = tiles_of_boxes(
        *(np.array([v]) for v in (latitude_rad, longitude_rad, half_east_m, half_north_m))
    )
    tiles = set(zip(x.tolist(), y.tolist(), strict=True))
    assert len(tiles) == len(box)
    points_m = np.random.default_rng(seed).uniform(-1.0, 1.0, (50, 2)) * (half_east_m, half_north_m)
    points_m[:4] = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)]) * (half_east_m, half_north_m)
    frame = LocalFrame(latitude_rad, longitude_rad, 0.0)
    latitude, longitude, _ = frame.geodetic_from_east_north_array(points_m, 0.0)
    inside = {tile_of(*point) for point in zip(latitude.tolist(), longitude.tolist(), strict=True)}
    assert inside <= tiles


def test_many_boxes_are_each_as_if_alone() -> None:
    rng = np.random.default_rng(4)
    columns = [rng.uniform(*limits, 30) for limits in ((-1.4, 1.4), (-3.1, 3.1), (1, 900), (1, 900))]
    box, x, y = tiles_of_boxes(*columns)
    for i in range(30):
        _, x_alone, y_alone = tiles_of_boxes(*(column[i : i + 1] for column in columns))
        assert x[box == i].tolist() == x_alone.tolist()
        assert y[box == i].tolist() == y_alone.tolist()


def test_a_tile_in_japan_is_about_half_a_kilometre_wide() -> None:
    south, west, north, east = tile_corners_rad(57691, 25900)
    assert (east - west) * 6.378e6 * math.cos(south) == pytest.approx(500.0, rel=0.05)
    assert (north - south) * 6.36e6 == pytest.approx(500.0, rel=0.05)
