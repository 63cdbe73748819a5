"""The map's clouds around the vehicle, in blocks that are built once and matched against as often as needed.

A block is a sixteenth of a tile (some 125 m at 35° of latitude) with a margin, so that a local map of 60 m taken
anywhere in the block has its map. Clouds are kept thinned; the blobs they came in are not kept. Neighbouring tiles
overlap: points of both fall into the same voxel and count once.

MapBlock frame: metres east and north of the block's centre, z ellipsoidal height less `base_height_m`. Its plane
touches the ellipsoid at the base height, so its metres are those that the sensor measures; tiles have their plane
at height zero, where 50 m are 1.5 cm shorter than on a pass at 2000 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.geodesy.local_frame import LocalFrame
from camber.localizer.arrays import Floats, Integers, Mask
from camber.localizer.map_clouds.static_structure import static_mask
from camber.localizer.map_clouds.tile_download import CloudLayer
from camber.localizer.map_clouds.voxel_grid import voxel_means
from camber.localizer.matching.registration import LayerBounds, LayerTarget
from camber.localizer.matching.shift_profile import OccupancyRaster
from camber.localizer.road.road_raster import RoadHeights
from camber.road_map.tile_grid import TILES, Tile, tile_frame, tile_of, tiles_around
from camber.schemas.road import CloudTile

CLOUD_LAYERS: Final[tuple[CloudLayer, ...]] = ("environment_cloud", "road_cloud")

MARGIN_M: Final = 60.0  # the reach of a local map, `LocalMap`
BLOCKS_PER_TILE: Final = 4  # along each side; chosen: a block is built in about half a second
LAYER_MARGIN_M: Final = 0.2
"""Chosen: a layer of the map reaches one voxel beyond its bounds, so that a point at the bound finds its neighbours."""
NO_GROUND_M: Final = 0.15
"""Chosen: but a layer that begins above this does not reach below it, where pavements would be most of its points."""
ROAD_VOXEL_M: Final = 0.4  # chosen: twice the environment's voxel, because roads are smooth
_STRUCTURE_TOP_M: Final = 3.0  # crowns of trees are above
_STEP_M: Final = 0.01  # quantum of stored points: six bytes each, and half a step is below a survey's noise
_MAX_STEPS: Final = 32_767  # of int16
_REACH_M: Final = _MAX_STEPS * _STEP_M  # at the equator a tile reaches 306 m to each side
_SQUARE_VOXELS: Final = 200  # whole voxels, so that no square cuts one
_EARTH_RADIUS_M: Final = 6.4e6  # rounded up: a block is rather too large than too small


@dataclass(frozen=True, slots=True, kw_only=True)
class MapBlockOptions:
    """Voxel of kept clouds, range of heights above any road, and number of blocks.

    `ahead_m`: tiles up to this distance are loaded; `forget_m`: those farther away are dropped.
    """

    voxel_m: float = 0.2
    lowest_m: float = -2.0
    highest_m: float = 8.0
    ahead_m: float = 200.0
    forget_m: float = 300.0
    blocks: int = 3


@dataclass(frozen=True, slots=True, eq=False)
class _StoredTile:
    """A tile's thinned points (n, 3) in steps of `_STEP_M` about its centre, heights less `base_height_m`."""

    steps: NDArray[np.int16]
    base_height_m: float


@dataclass(eq=False, kw_only=True)
class MapBlock:
    """The map around a position. `environment_m` (n, 3), `road_m` (k, 3) and `road` are in the block's frame.

    Search structures are built when first needed.
    """

    frame: LocalFrame
    base_height_m: float
    environment_m: Floats
    road_m: Floats
    road: RoadHeights

    def __post_init__(self) -> None:
        self._layers: dict[tuple[float, float, bool], LayerTarget] = {}

    def east_north(self, latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
        """Return a position in the block's frame."""
        return self.frame.east_north_from_geodetic(latitude_rad, longitude_rad, self.base_height_m)

    def geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return latitude and longitude of a position in the block's frame."""
        latitude, longitude, _ = self.frame.geodetic_from_east_north(east_m, north_m, self.base_height_m)
        return latitude, longitude

    @cached_property
    def height_above_road_m(self) -> Floats:
        """Height of the environment's points above the road below them (n,), NaN far from any road."""
        return self.road.height_above_road(self.environment_m)

    @cached_property
    def static(self) -> Mask:
        """Which of the environment's points (n,) are static structure."""
        return static_mask(self.environment_m, self.height_above_road_m)

    @cached_property
    def static_occupancy(self) -> OccupancyRaster:
        """Raster of the static structure, seen from above."""
        low = self.height_above_road_m < _STRUCTURE_TOP_M
        return OccupancyRaster.of(self.environment_m[self.static & low])

    @cached_property
    def road_target(self) -> LayerTarget:
        """The thinned road cloud with its search structures."""
        return LayerTarget.of(voxel_means(self.road_m, ROAD_VOXEL_M))

    def layers(self, bounds: LayerBounds, *, static_only: bool = True) -> tuple[LayerTarget, ...]:
        """Return the environment split into layers of height above the road, with their search structures.

        `static_only`: only the static structure. Where roads lie above one another, a layer holds what is at its height
        above any of them.
        """
        return tuple(self._layer(low, high, static_only) for low, high in bounds)

    def build_next(self, bounds: LayerBounds) -> bool:
        """Build one of the missing search structures; return False where none is missing."""
        for low, high in bounds:
            if (low, high, True) not in self._layers:
                self._layer(low, high, True)
                return True
        if "road_target" not in self.__dict__:
            return len(self.road_target.points_m) > 0
        return False

    def _layer(self, low_m: float, high_m: float, static_only: bool) -> LayerTarget:
        key = (low_m, high_m, static_only)
        if key not in self._layers:
            lowest_m = max(low_m - LAYER_MARGIN_M, min(low_m, NO_GROUND_M))
            in_layer = self.road.within(self.environment_m, lowest_m, high_m + LAYER_MARGIN_M)
            self._layers[key] = LayerTarget.of(
                self.environment_m[in_layer & self.static if static_only else in_layer]
            )
        return self._layers[key]


class MapBlockStore:
    """Stores the clouds of the tiles around the vehicle and builds blocks from them."""

    def __init__(self, options: MapBlockOptions | None = None) -> None:
        self._options = options or MapBlockOptions()
        self._tiles: dict[tuple[CloudLayer, int, int], _StoredTile | None] = {}
        self._missing_reasons: dict[tuple[CloudLayer, int, int], str] = {}
        self._blocks: dict[tuple[int, int], MapBlock] = {}
        self.reason = "no block has been asked for"

    @property
    def points(self) -> int:
        """Number of points of all stored tiles."""
        return sum(len(tile.steps) for tile in self._tiles.values() if tile is not None)

    def tiles_held(self) -> list[tuple[CloudLayer, int, int]]:
        """Return the tiles that are stored."""
        return [key for key, tile in self._tiles.items() if tile is not None]

    def tiles_needed(self, latitude_rad: float, longitude_rad: float) -> list[tuple[CloudLayer, int, int]]:
        """Return the tiles around a position that are not stored, the one of the position first."""
        around = tiles_around(latitude_rad, longitude_rad, self._options.ahead_m)
        number = _block_of(latitude_rad, longitude_rad)
        if number is not None:
            around += [tile for tile in _tiles_of(number) if tile not in around]
        here = tile_of(latitude_rad, longitude_rad)
        around.sort(key=lambda tile: tile != here)
        wanted = ((layer, x, y) for x, y in around for layer in CLOUD_LAYERS)
        return [key for key in wanted if key not in self._tiles]

    def drop_far_tiles(self, latitude_rad: float, longitude_rad: float) -> None:
        """Drop the tiles and blocks beyond `forget_m`."""
        near = tiles_around(latitude_rad, longitude_rad, self._options.forget_m)
        for key in [key for key in self._tiles if key[1:] not in near]:
            del self._tiles[key], self._missing_reasons[key]
        for number in [number for number in self._blocks if not set(_tiles_of(number)) <= set(near)]:
            del self._blocks[number]

    def set_tile(self, layer: CloudLayer, x: int, y: int, tile: CloudTile | None, reason: str = "") -> None:
        """Store a tile, or None with the reason where the map has none; drop blocks of an earlier one.

        Raises ValueError for another tile than the one named.
        """
        if tile is not None and (tile.layer, tile.x, tile.y) != (layer, x, y):
            raise ValueError(f"tile {tile.layer} {tile.x} {tile.y}, expected {layer} {x} {y}")
        if tile is not None or self._tiles.get((layer, x, y)) is not None:
            self._blocks = {key: block for key, block in self._blocks.items() if (x, y) not in _tiles_of(key)}
        self._missing_reasons[layer, x, y] = reason
        self._tiles[layer, x, y] = None if tile is None else _stored(tile, self._options.voxel_m)

    def forget_missing(self) -> None:
        """Forget which tiles the map does not have: it may have changed."""
        for key in [key for key, tile in self._tiles.items() if tile is None]:
            del self._tiles[key], self._missing_reasons[key]

    def block_at(self, latitude_rad: float, longitude_rad: float) -> MapBlock | None:
        """Return the block at a position, built when first needed; None: `reason` is set."""
        number = _block_of(latitude_rad, longitude_rad)
        if number is None:
            self.reason = "beyond the limit of the tiles"
            return None
        block = self._blocks.pop(number, None) or self._build(number)
        if block is not None:
            self._blocks[number] = block  # least recently used first
            while len(self._blocks) > self._options.blocks:
                del self._blocks[next(iter(self._blocks))]
        return block

    def build_ahead(self, latitude_rad: float, longitude_rad: float, bounds: LayerBounds) -> bool:
        """Do one step, about 0.1 s, of building the block at a position ahead; return False where nothing is to do."""
        number = _block_of(latitude_rad, longitude_rad)
        if number is None:
            return False
        block = self._blocks.get(number)
        if block is not None:
            return block.build_next(bounds)
        reason = self.reason
        built = self.block_at(latitude_rad, longitude_rad)
        self.reason = reason
        return built is not None

    def _build(self, number: tuple[int, int]) -> MapBlock | None:
        tiles = _tiles_of(number)
        keys = [(layer, x, y) for x, y in tiles for layer in CLOUD_LAYERS]
        waiting = [key for key in keys if key not in self._tiles]
        if waiting:
            self.reason = f"{len(waiting)} of {len(keys)} tiles have not been loaded"
            return None
        missing = [key for key in keys if self._tiles[key] is None]
        reasons = dict.fromkeys(self._missing_reasons[key] for key in missing if self._missing_reasons[key])
        why = f" ({'; '.join(reasons)})" if reasons else ""
        stored = [tile for key in keys if (tile := self._tiles[key]) is not None]
        if not stored:
            self.reason = f"the map has no clouds here{why}"
            return None
        base_height_m = stored[0].base_height_m
        latitude_rad, longitude_rad, *half_m = _centre(number)
        frame = LocalFrame(latitude_rad, longitude_rad, base_height_m)
        clouds = []
        for layer in CLOUD_LAYERS:
            parts = [
                _points_in_block(tile, tile_frame(x, y), frame, (half_m[0], half_m[1]))
                for x, y in tiles
                if (tile := self._tiles[layer, x, y]) is not None
            ]
            clouds.append(
                voxel_means(np.concatenate(parts), self._options.voxel_m) if parts else np.zeros((0, 3))
            )
        environment, road = clouds
        if not len(environment) or not len(road):
            what = "road" if len(environment) else "environment"
            self.reason = f"the map has no {what} cloud here{why}" if reasons else f"no {what} cloud here"
            return None
        self.reason = ""
        heights = RoadHeights.of(road)
        options = self._options
        environment = environment[heights.within(environment, options.lowest_m, options.highest_m)]
        return MapBlock(
            frame=frame,
            base_height_m=base_height_m,
            environment_m=environment,
            road_m=road,
            road=heights,
        )


def _stored(tile: CloudTile, voxel_m: float) -> _StoredTile:
    """Return the tile thinned, square by square: at once, a dense tile would need 150 MB."""
    order, begin = _by_square(tile.quanta, tile.resolution_m, voxel_m * _SQUARE_VOXELS)
    squares = [np.zeros((0, 3), np.int16)]
    for first, end in pairwise(begin.tolist()):
        if first < end:
            points_m = np.multiply(tile.quanta[order[first:end]], tile.resolution_m, dtype=np.float64)
            steps = np.rint(voxel_means(points_m, voxel_m) / _STEP_M)
            squares.append(steps[(np.abs(steps) <= _MAX_STEPS).all(axis=1)].astype(np.int16))
    return _StoredTile(np.concatenate(squares), tile.base_height_m)


@compiled_without_gil
def _by_square(
    quanta: NDArray[np.int32], resolution_m: float, square_m: float
) -> tuple[NDArray[np.int32], Integers]:
    """Return rows (n,) sorted by square, and the begin of each square; points beyond ±`_REACH_M` are left out."""
    half = int(np.ceil(_REACH_M / square_m))
    count = np.zeros(4 * half * half + 1, np.int64)
    square = np.full(len(quanta), -1, np.int32)
    for i in range(len(quanta)):
        column = int(np.floor(quanta[i, 0] * resolution_m / square_m)) + half
        row = int(np.floor(quanta[i, 1] * resolution_m / square_m)) + half
        if 0 <= column < 2 * half and 0 <= row < 2 * half:
            square[i] = row * 2 * half + column
            count[square[i] + 1] += 1
    begin = np.cumsum(count)
    at = begin[:-1].copy()
    order = np.empty(begin[-1], np.int32)
    for i in range(len(quanta)):
        if square[i] >= 0:
            order[at[square[i]]] = i
            at[square[i]] += 1
    return order, begin


def _points_in_block(
    tile: _StoredTile, tile_plane: LocalFrame, block_plane: LocalFrame, half_m: tuple[float, float]
) -> Floats:
    """Return the points of a tile that lie in a block, in the block's frame.

    Over a few hundred metres the mapping between the planes is affine within a micrometre: three points determine it.
    """
    places = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    latitude, longitude, _ = block_plane.geodetic_from_east_north_array(
        places, np.full(3, block_plane.height_m)
    )
    there = tile_plane.east_north_from_geodetic_array(latitude, longitude, np.zeros(3))
    tile_from_block = np.column_stack(((there[1] - there[0]) / 100.0, (there[2] - there[0]) / 100.0))
    block_from_tile = np.linalg.inv(tile_from_block)
    up_m = tile.base_height_m - block_plane.height_m
    return _in_box(tile.steps, block_from_tile, there[0], half_m=half_m, up_m=up_m)


@compiled_without_gil
def _in_box(
    steps: NDArray[np.int16],
    block_from_tile: Floats,
    centre_m: Floats,
    half_m: tuple[float, float],
    up_m: float,
) -> Floats:
    """Return the points within half a box of the centre, moved to the block's frame."""
    t = block_from_tile
    inside = 0
    moved = np.empty((0, 3))
    for fill in range(2):  # count first: most of a tile is outside
        if fill:
            moved = np.empty((inside, 3))
            inside = 0
        for i in range(len(steps)):
            x, y = steps[i, 0] * _STEP_M - centre_m[0], steps[i, 1] * _STEP_M - centre_m[1]
            east, north = t[0, 0] * x + t[0, 1] * y, t[1, 0] * x + t[1, 1] * y
            if abs(east) <= half_m[0] and abs(north) <= half_m[1]:
                if fill:
                    moved[inside, 0], moved[inside, 1] = east, north
                    moved[inside, 2] = steps[i, 2] * _STEP_M + up_m
                inside += 1
    return moved


def _block_of(latitude_rad: float, longitude_rad: float) -> tuple[int, int] | None:
    """Return the number of the block at a position: a tile of a finer zoom."""
    tile = tile_of(latitude_rad, longitude_rad)
    if tile is None:
        return None
    column = (longitude_rad + math.pi) / (2.0 * math.pi) * TILES * BLOCKS_PER_TILE
    row = (0.5 - math.asinh(math.tan(latitude_rad)) / (2.0 * math.pi)) * TILES * BLOCKS_PER_TILE
    return math.floor(column) % (TILES * BLOCKS_PER_TILE), math.floor(row)


def _centre(number: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return latitude and longitude of a block's centre, and half its size east and north, with margin."""
    around = TILES * BLOCKS_PER_TILE
    north, middle, south = (
        math.atan(math.sinh(math.pi * (1.0 - 2.0 * (number[1] + share) / around)))
        for share in (0.0, 0.5, 1.0)
    )
    half_north = 0.5 * (north - south) * _EARTH_RADIUS_M + MARGIN_M
    half_east = math.pi / around * _EARTH_RADIUS_M * math.cos(min(abs(north), abs(south))) + MARGIN_M
    return middle, 2.0 * math.pi * (number[0] + 0.5) / around - math.pi, half_east, half_north


def _tiles_of(number: tuple[int, int]) -> list[Tile]:
    """Return the tiles of a block with its margin."""
    latitude, longitude, half_east, half_north = _centre(number)
    return tiles_around(latitude, longitude, max(half_east, half_north))
