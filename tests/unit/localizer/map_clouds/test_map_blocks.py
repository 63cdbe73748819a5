"""Clouds of tiles become blocks: whole, each point once, in metres about the block's centre, and built once."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.geodesy.local_frame import LocalFrame
from camber.localizer.map_clouds.map_blocks import (
    CLOUD_LAYERS,
    MARGIN_M,
    NO_GROUND_M,
    MapBlock,
    MapBlockOptions,
    MapBlockStore,
)
from camber.localizer.map_clouds.tile_download import CloudLayer
from camber.road_map.tile_grid import Tile, tile_frame, tile_of
from camber.schemas.road import CloudTile

Floats = NDArray[np.float64]
HOME = tile_of(math.radians(35.17), math.radians(136.9))
assert HOME is not None
X, Y = HOME
BOUNDS = ((0.2, 1.0), (1.0, 2.0), (2.0, 3.0))
RESOLUTION_M = 0.005


def corner() -> tuple[float, float]:
    """Where four tiles meet."""
    n = 2.0**16
    return math.atan(math.sinh(math.pi * (1.0 - 2.0 * Y / n))), 2.0 * math.pi * X / n - math.pi


CORNER = corner()
PLACE = LocalFrame(*CORNER, 0.0)
BASE_M = 47.0


def street() -> dict[CloudLayer, Floats]:
    """A road along east through the corner and poles beside it, east, north about it and ellipsoidal height."""
    rng, half = np.random.default_rng(1), 120.0
    n = int(2.0 * half * 8.0 * 20.0)
    east, north = rng.uniform(-half, half, n), rng.uniform(-4.0, 4.0, n)
    road = np.column_stack((east, north, BASE_M + 0.05 * east))
    along, up = (
        axis.ravel() for axis in np.meshgrid(np.arange(-half, half, 10.0), np.arange(60) * 0.2, indexing="ij")
    )
    poles = np.column_stack((along, np.full(len(along), 6.0), up))
    poles[:, 2] += BASE_M + 0.05 * poles[:, 0]
    return {"road_cloud": road, "environment_cloud": poles}


STREET = street()


def tile(layer: CloudLayer, x: int, y: int, points_m: Floats) -> CloudTile | None:
    """The points that stand in a tile, its margin of a metre included."""
    latitude, longitude, _ = PLACE.geodetic_from_east_north_array(points_m[:, :2], np.zeros(len(points_m)))
    of_tile = tile_frame(x, y).east_north_from_geodetic_array(latitude, longitude, np.zeros(len(points_m)))
    frame = tile_frame(x, y)
    centre = PLACE.east_north_from_geodetic(frame.latitude_rad, frame.longitude_rad, 0.0)
    inside = (np.abs(points_m[:, :2] - centre) <= np.abs(centre) + 1.0).all(axis=1)
    if not inside.any():
        return None
    about = np.column_stack((of_tile[inside], points_m[inside, 2] - 45.0))
    return CloudTile(
        time_ns=1_400_000_000 * 10**9,
        x=x,
        y=y,
        layer=layer,
        base_height_m=45.0,
        resolution_m=RESOLUTION_M,
        quanta=np.rint(about / RESOLUTION_M).astype(np.int32),
    )


def load(
    blocks: MapBlockStore,
    is_there: Callable[[CloudLayer, int], bool] = lambda layer, x: True,
    reason: str = "no such tile",
) -> MapBlockStore:
    """Set the tiles needed about the corner that are there, by layer and x."""
    for layer, x, y in blocks.tiles_needed(*CORNER):
        there = tile(layer, x, y, STREET[layer]) if is_there(layer, x) else None
        blocks.set_tile(layer, x, y, there, reason)
    return blocks


def loaded(options: MapBlockOptions | None = None) -> MapBlockStore:
    return load(MapBlockStore(options))


def at(east_m: float, north_m: float) -> tuple[float, float]:
    latitude, longitude, _ = PLACE.geodetic_from_east_north(east_m, north_m, 0.0)
    return latitude, longitude


@pytest.fixture(scope="module")
def block() -> MapBlock:
    blocks = loaded()
    result = blocks.block_at(*at(5.0, -5.0))
    assert result is not None, blocks.reason
    return result


def test_around_a_corner_four_tiles_are_needed_the_nearest_one_first() -> None:
    blocks = MapBlockStore()
    place = at(5.0, -5.0)
    needed = blocks.tiles_needed(*place)
    tiles: list[Tile] = [(x, y) for _, x, y in needed]
    assert set(tiles) == {(X, Y), (X - 1, Y), (X, Y - 1), (X - 1, Y - 1)}
    assert [layer for layer, x, y in needed if (x, y) == (X, Y)] == list(CLOUD_LAYERS)
    assert tiles[0] == tile_of(*place)


def test_while_tiles_are_missing_there_is_no_block_and_it_is_reported() -> None:
    blocks = MapBlockStore()
    assert blocks.block_at(*CORNER) is None
    assert "not been loaded" in blocks.reason
    load(blocks)
    assert blocks.block_at(*CORNER) is not None
    assert blocks.reason == ""


def test_a_block_holds_all_points_in_reach_each_once(block: MapBlock) -> None:
    """Also those that stand in two tiles, and across the border; no neighbour is lost at it."""
    poles = STREET["environment_cloud"]
    latitude, longitude, _ = PLACE.geodetic_from_east_north_array(poles[:, :2], np.zeros(len(poles)))
    expected = block.frame.east_north_from_geodetic_array(
        latitude, longitude, np.full(len(poles), block.base_height_m)
    )
    truth = np.column_stack((expected, poles[:, 2] - block.base_height_m))
    above = poles[:, 2] - BASE_M - 0.05 * poles[:, 0]
    near = (np.abs(truth[:, :2]) < 62.0 + MARGIN_M - 10.0).all(axis=1) & (above < 7.9)
    assert 100 < near.sum() < len(truth)
    gap = np.abs(truth[near][:, None] - block.environment_m[None]).max(axis=2).min(axis=1)
    assert gap.max() < 0.2
    back = np.abs(block.environment_m[:, None] - truth[None]).max(axis=2).min(axis=1)
    assert back.max() < 0.2
    cells = np.floor(block.environment_m / 0.2).astype(int)
    assert len(np.unique(cells, axis=0)) > 0.9 * len(cells)


def test_its_heights_are_above_the_road(block: MapBlock) -> None:
    poles = STREET["environment_cloud"]
    heights = block.height_above_road_m
    assert np.isfinite(heights).all()
    assert heights.min() == pytest.approx(0.0, abs=0.1)
    assert heights.max() == pytest.approx(MapBlockOptions().highest_m, abs=0.2)
    assert len(heights) < len(poles)


def test_its_road_is_the_road(block: MapBlock) -> None:
    for east in (-50.0, 0.0, 40.0):
        e, n = block.east_north(*at(east, 1.0))
        result = block.road.elevation(e, n, 0.0)
        assert result.height_m + block.base_height_m == pytest.approx(BASE_M + 0.05 * east, abs=0.02)
        assert result.slope_east == pytest.approx(0.05, abs=0.005)


def test_metres_are_those_of_the_sensor_also_on_a_mountain() -> None:
    """Tiles are at height zero; at 3000 m a sensor measures 2.3 cm more over 50 m."""
    blocks = MapBlockStore()
    for layer, x, y in blocks.tiles_needed(*CORNER):
        low = tile(layer, x, y, STREET[layer])
        high = None if low is None else low.model_copy(update={"base_height_m": low.base_height_m + 3000.0})
        blocks.set_tile(layer, x, y, high)
    result = blocks.block_at(*at(5.0, -5.0))
    ends = [result.east_north(*at(east, 6.0)) for east in (-50.0, 50.0)]
    assert math.dist(*ends) == pytest.approx(100.0 * (1.0 + 3045.0 / 6.36e6), abs=2e-3)
    pole = result.environment_m[np.abs(result.environment_m[:, 0] - ends[1][0]) < 0.15]
    assert pole[:, 0].mean() == pytest.approx(ends[1][0], abs=5e-3)


def test_layers_reach_a_little_beyond_their_bounds_but_not_to_the_ground(block: MapBlock) -> None:
    targets = block.layers(BOUNDS)
    assert all(one is other for one, other in zip(block.layers(BOUNDS), targets, strict=True))
    road = block.road
    low, middle, high = (road.height_above_road(target.points_m) for target in targets)
    assert low.min() >= NO_GROUND_M - 0.03
    assert (low.max(), middle.min(), middle.max()) == pytest.approx((1.2, 0.8, 2.2), abs=0.1)
    assert (high.min(), high.max()) == pytest.approx((1.8, 3.2), abs=0.1)


def test_a_layer_that_begins_at_the_road_reaches_below_it(block: MapBlock) -> None:
    (low,) = block.layers(((0.0, 1.0),))
    assert block.road.height_above_road(low.points_m).min() < 0.1


def test_a_block_is_built_once_while_it_is_in_use() -> None:
    blocks = loaded()
    first = blocks.block_at(*at(5.0, -5.0))
    assert blocks.block_at(*at(60.0, -60.0)) is first
    other = blocks.block_at(*at(-5.0, -5.0))
    assert other is not first
    assert blocks.block_at(*at(5.0, -5.0)) is first


def test_no_tile_is_asked_for_twice_while_it_is_near() -> None:
    blocks = loaded()
    for east in range(-90, 91, 10):
        assert blocks.tiles_needed(*at(float(east), 5.0)) == []


def test_only_the_last_few_blocks_are_kept() -> None:
    blocks = loaded(MapBlockOptions(blocks=2))
    first = blocks.block_at(*at(5.0, -5.0))
    blocks.block_at(*at(-5.0, -5.0))
    blocks.block_at(*at(-5.0, 5.0))
    again = blocks.block_at(*at(5.0, -5.0))
    assert again is not first
    assert again.environment_m.tobytes() == first.environment_m.tobytes()


def test_tiles_far_away_are_forgotten() -> None:
    blocks = loaded()
    held = blocks.points
    assert held > 0
    blocks.drop_far_tiles(*at(3000.0, 0.0))
    assert blocks.points == 0
    assert load(blocks).points == held


def test_where_the_map_has_nothing_the_reason_is_reported() -> None:
    blocks = load(MapBlockStore(), lambda layer, x: False, reason="datum_mismatch")
    assert blocks.block_at(*CORNER) is None
    assert "datum_mismatch" in blocks.reason
    assert blocks.tiles_needed(*CORNER) == []
    blocks.forget_missing()
    assert len(blocks.tiles_needed(*CORNER)) == 8


def test_an_environment_without_a_road_is_no_block() -> None:
    blocks = load(MapBlockStore(), lambda layer, x: layer == "environment_cloud")
    assert blocks.block_at(*CORNER) is None
    assert "road" in blocks.reason


def test_a_new_tile_replaces_the_old_one_and_its_blocks() -> None:
    blocks = loaded()
    first = blocks.block_at(*at(5.0, -5.0))
    moved = {layer: points + np.array([0.0, 0.0, 1.0]) for layer, points in STREET.items()}
    for layer in CLOUD_LAYERS:
        blocks.set_tile(layer, X, Y, tile(layer, X, Y, moved[layer]))
    again = blocks.block_at(*at(5.0, -5.0))
    assert again is not first
    e, n = again.east_north(*at(30.0, -2.0))
    result = again.road.elevation(e, n, 5.0)
    assert result.height_m + again.base_height_m == pytest.approx(BASE_M + 1.5 + 1.0, abs=0.03)


def test_a_tile_that_was_missing_and_comes_with_a_new_map_makes_blocks_anew() -> None:
    blocks = load(MapBlockStore(), lambda layer, x: x == X)
    first = blocks.block_at(*at(5.0, -5.0))
    blocks.forget_missing()
    load(blocks)
    again = blocks.block_at(*at(5.0, -5.0))
    assert len(again.environment_m) > len(first.environment_m)


def test_the_block_ahead_is_built_step_by_step() -> None:
    blocks = MapBlockStore()
    ahead = at(-5.0, -5.0)
    assert not blocks.build_ahead(*ahead, BOUNDS)
    load(blocks)
    here = blocks.block_at(*at(5.0, -5.0))
    steps = 0
    while blocks.build_ahead(*ahead, BOUNDS):
        steps += 1
        assert blocks.reason == ""
        assert blocks.block_at(*at(5.0, -5.0)) is here
    assert steps == 1 + len(BOUNDS) + 1
    result = blocks.block_at(*ahead)
    assert not result.build_next(BOUNDS)


@pytest.mark.parametrize("latitude_deg", [0.1, 35.2, -47.3, 70.0])
def test_the_tiles_of_the_vehicles_block_are_always_among_those_needed(latitude_deg: float) -> None:
    """Blocks are larger near the equator."""
    rng = np.random.default_rng(7)
    middle = np.array([math.radians(latitude_deg), 1.0])
    for latitude, longitude in (middle + rng.uniform(-0.004, 0.004, (30, 2))).tolist():
        blocks = MapBlockStore()
        for layer, x, y in blocks.tiles_needed(latitude, longitude):
            blocks.set_tile(layer, x, y, None)
        assert blocks.block_at(latitude, longitude) is None
        assert blocks.reason == "the map has no clouds here"


def test_a_tile_given_for_another_is_refused() -> None:
    there = tile("road_cloud", X, Y, STREET["road_cloud"])
    with pytest.raises(ValueError, match="expected"):
        MapBlockStore().set_tile("road_cloud", X + 1, Y, there)


def test_beyond_the_tiles_there_is_no_block() -> None:
    blocks = MapBlockStore()
    assert blocks.block_at(1.55, 0.0) is None
    assert blocks.reason
    assert blocks.tiles_needed(1.55, 0.0) == []


def test_points_of_a_tile_that_reach_nowhere_are_dropped() -> None:
    quanta = np.array([[0, 0, 0], [200_000_000, 0, 0], [0, 0, 2_000_000_000]], np.int32)
    there = tile("road_cloud", X, Y, STREET["road_cloud"])
    odd = there.model_copy(update={"resolution_m": 1.0, "quanta": quanta})
    blocks = MapBlockStore()
    blocks.set_tile("road_cloud", X, Y, odd)
    assert blocks.points == 1
