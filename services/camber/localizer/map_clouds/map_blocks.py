"""The map's clouds around the vehicle, in blocks that are built once and then matched against as often as needed.

A block is a sixteenth of a tile (some 125 m at 35° of latitude) with a margin around it, so that a local map of 60 m
taken anywhere in the block finds its map. Clouds are kept thinned; the blobs they came in are not kept. Neighbouring
tiles overlap: what stands in both falls into the same cube of the grid and counts once.

Block frame: metres east and north of the block's centre, z ellipsoidal height less `base_height_m`. It touches the
ellipsoid at the base height, so that its metres are those that the sensor measures; tiles have theirs at height zero,
which on a pass at 2000 m are shorter by 1.5 cm in 50 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.geodesy.local_frame import LocalFrame
from camber.localizer.map_clouds.static_structure import static_mask
from camber.localizer.map_clouds.voxel_grid import Floats, voxel_means
from camber.localizer.matching.registration import LayerTarget
from camber.localizer.matching.shift_profile import OccupancyRaster
from camber.localizer.road.road_raster import RoadHeights
from camber.road_map.tile_grid import TILES, Tile, tile_frame, tile_of, tiles_around
from camber.schemas.road import CloudTile

CloudLayer = Literal["environment_cloud", "road_cloud"]
CLOUD_LAYERS: Final[tuple[CloudLayer, ...]] = ("environment_cloud", "road_cloud")
Bounds = tuple[tuple[float, float], ...]
"""Lower and upper height above the road (m) of each layer."""

MARGIN_M: Final = 60.0
BLOCKS_PER_TILE: Final = 4
"""Along each side."""
LAYER_MARGIN_M: Final = 0.2
"""A layer of the map reaches this far beyond its bounds: a point at the very bound finds its neighbours."""
NO_GROUND_M: Final = 0.15
"""… but a layer that begins above this does not reach below it: pavements would be most of its points."""
ROAD_VOXEL_M: Final = 0.4
_HIGHEST_STANDING_M: Final = 3.0  # crowns of trees are above
_STEP_M: Final = 0.01  # of points that are kept: six bytes each, and half a step is below a survey's noise
_MOST_STEPS: Final = 32_767
_REACH_M: Final = _MOST_STEPS * _STEP_M  # at the equator a tile reaches 306 m to each side
_SQUARE_VOXELS: Final = 200  # whole cubes, so that none is cut by the edge of a square


@dataclass(frozen=True, slots=True)
class BlockOptions:
    """How finely clouds are kept, between which heights above any road, and how many blocks.

    `ahead_m`: tiles this far from the vehicle are asked for; `forget_m`: those farther away are dropped.
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


@dataclass(slots=True, eq=False)
class Block:
    """The map around a place. `environment_m` (n, 3), `road_m` (k, 3) and `road` in the block's frame.

    `missing` names tiles that the map does not have: there may be nothing to match there, or nothing known.
    """

    frame: LocalFrame
    base_height_m: float
    environment_m: Floats
    road_m: Floats
    road: RoadHeights
    missing: tuple[str, ...]
    _layers: dict[tuple[float, float, bool], LayerTarget] = field(default_factory=dict, repr=False)
    _heights: Floats | None = field(default=None, repr=False)
    _road_target: LayerTarget | None = field(default=None, repr=False)
    _static_columns: NDArray[np.bool_] | None = field(default=None, repr=False)
    _above: OccupancyRaster | None = field(default=None, repr=False)

    def east_north(self, latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
        """A place in the block's frame."""
        return self.frame.east_north_from_geodetic(latitude_rad, longitude_rad, self.base_height_m)

    def geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Latitude and longitude of a place given in the block's frame."""
        latitude, longitude, _ = self.frame.geodetic_from_east_north(east_m, north_m, self.base_height_m)
        return latitude, longitude

    @property
    def height_above_road_m(self) -> Floats:
        """Height of the environment's points above the road below them (n,), NaN far from any road."""
        if self._heights is None:
            self._heights = self.road.height_above_road(self.environment_m)
        return self._heights

    @property
    def steady(self) -> NDArray[np.bool_]:
        """Which of the environment's points (n,) cannot have moved since the survey (`steady_columns`)."""
        if self._static_columns is None:
            self._static_columns = static_mask(self.environment_m, self.height_above_road_m)
        return self._static_columns

    @property
    def above(self) -> OccupancyRaster:
        """What stands steady, as seen from above; drawn once."""
        if self._above is None:
            low = self.height_above_road_m < _HIGHEST_STANDING_M
            self._above = OccupancyRaster.of(self.environment_m[self.steady & low])
        return self._above

    def layers(self, bounds: Bounds, *, steady: bool = True) -> tuple[LayerTarget, ...]:
        """The environment in layers of height above the road, with search structures; built once for the bounds.

        `steady`: only what cannot have moved since the survey. Where roads lie above one another, a layer holds what
        is at its height above any of them.
        """
        return tuple(self._layer(low, high, steady) for low, high in bounds)

    def build_next(self, bounds: Bounds) -> bool:
        """Build one of the search structures that are still to be built; False: all are there."""
        for low, high in bounds:
            if (low, high, True) not in self._layers:
                self._layer(low, high, True)
                return True
        if self._road_target is None:
            return len(self.road_target.points_m) > 0
        return False

    @property
    def road_target(self) -> LayerTarget:
        """The road cloud with search structures, built once; thinned further, for roads are smooth."""
        if self._road_target is None:
            self._road_target = LayerTarget.of(voxel_means(self.road_m, ROAD_VOXEL_M))
        return self._road_target

    def _layer(self, low_m: float, high_m: float, steady: bool) -> LayerTarget:
        found = self._layers.get((low_m, high_m, steady))
        if found is None:
            wanted = self._in_layer(low_m, high_m)
            found = LayerTarget.of(self.environment_m[wanted & self.steady if steady else wanted])
            self._layers[low_m, high_m, steady] = found
        return found

    def _in_layer(self, low_m: float, high_m: float) -> NDArray[np.bool_]:
        lowest_m = max(low_m - LAYER_MARGIN_M, min(low_m, NO_GROUND_M))
        return self.road.within(self.environment_m, lowest_m, high_m + LAYER_MARGIN_M)


class MapBlockStore:
    """Holds the clouds of the tiles around the vehicle and builds blocks from them."""

    def __init__(self, options: BlockOptions | None = None) -> None:
        self._options = options or BlockOptions()
        self._tiles: dict[tuple[CloudLayer, int, int], _StoredTile | None] = {}
        self._why: dict[tuple[CloudLayer, int, int], str] = {}
        self._blocks: dict[tuple[int, int], Block] = {}
        self.reason = "no block has been asked for"

    @property
    def points(self) -> int:
        """How many points of tiles are held."""
        return sum(len(tile.steps) for tile in self._tiles.values() if tile is not None)

    def tiles_held(self) -> list[tuple[CloudLayer, int, int]]:
        """Which tiles are here."""
        return [key for key, tile in self._tiles.items() if tile is not None]

    def tiles_needed(self, latitude_rad: float, longitude_rad: float) -> list[tuple[CloudLayer, int, int]]:
        """Which tiles around a place are not there yet, the vehicle's own first; forgets those far away."""
        around = tiles_around(latitude_rad, longitude_rad, self._options.ahead_m)
        number = _block_of(latitude_rad, longitude_rad)
        if number is not None:
            around += [tile for tile in _tiles_of(number) if tile not in around]
        self._forget_but(tiles_around(latitude_rad, longitude_rad, self._options.forget_m))
        own = tile_of(latitude_rad, longitude_rad)
        around.sort(key=lambda tile: tile != own)
        wanted = ((layer, x, y) for x, y in around for layer in CLOUD_LAYERS)
        return [key for key in wanted if key not in self._tiles]

    def set_tile(self, layer: CloudLayer, x: int, y: int, tile: CloudTile | None, reason: str = "") -> None:
        """Take a tile, or None with the reason where the map has none. Blocks made of an earlier one are dropped.

        Raises ValueError for a tile that is not the one it is given for.
        """
        if tile is not None and (tile.layer, tile.x, tile.y) != (layer, x, y):
            raise ValueError(f"tile {tile.layer} {tile.x} {tile.y}, expected {layer} {x} {y}")
        if tile is not None or self._tiles.get((layer, x, y)) is not None:
            self._blocks = {key: block for key, block in self._blocks.items() if (x, y) not in _tiles_of(key)}
        self._why[layer, x, y] = reason
        self._tiles[layer, x, y] = None if tile is None else _stored(tile, self._options.voxel_m)

    def forget_missing(self) -> None:
        """Ask again for tiles that there were none of: the map may have changed."""
        for key in [key for key, tile in self._tiles.items() if tile is None]:
            del self._tiles[key], self._why[key]

    def block_at(self, latitude_rad: float, longitude_rad: float) -> Block | None:
        """The block that holds a place, built when it is first asked for; None: `reason` says why there is none."""
        number = _block_of(latitude_rad, longitude_rad)
        if number is None:
            self.reason = "beyond the limit of the tiles"
            return None
        block = self._blocks.pop(number, None) or self._built(number)
        if block is not None:
            self._blocks[number] = block  # the last one used is the last one dropped
            while len(self._blocks) > self._options.blocks:
                del self._blocks[next(iter(self._blocks))]
        return block

    def build_ahead(self, latitude_rad: float, longitude_rad: float, bounds: Bounds) -> bool:
        """One step of some 0.1 s towards the block at a place where the vehicle will be soon; False: nothing to do."""
        number = _block_of(latitude_rad, longitude_rad)
        if number is None:
            return False
        known = self._blocks.get(number)
        if known is not None:
            return known.build_next(bounds)
        reason = self.reason
        built = self.block_at(latitude_rad, longitude_rad)
        self.reason = reason
        return built is not None

    def _built(self, number: tuple[int, int]) -> Block | None:
        tiles = _tiles_of(number)
        keys = [(layer, x, y) for x, y in tiles for layer in CLOUD_LAYERS]
        waiting = [key for key in keys if key not in self._tiles]
        if waiting:
            self.reason = f"{len(waiting)} of {len(keys)} tiles have not been loaded"
            return None
        missing = [key for key in keys if self._tiles[key] is None]
        whys = "; ".join(dict.fromkeys(self._why[key] for key in missing if self._why[key]))
        base_height_m = self._base_height_m(keys)
        if base_height_m is None:
            self.reason = f"the map has no clouds here ({whys})" if whys else "the map has no clouds here"
            return None
        frame, half_m = _block_frame(number, base_height_m)
        clouds = []
        for layer in CLOUD_LAYERS:
            parts = [
                _part(tile, tile_frame(x, y), frame, half_m)
                for x, y in tiles
                if (tile := self._tiles[layer, x, y]) is not None
            ]
            clouds.append(
                voxel_means(np.concatenate(parts), self._options.voxel_m) if parts else np.zeros((0, 3))
            )
        environment, road = clouds
        if not len(environment) or not len(road):
            what = "road" if len(environment) else "environment"
            self.reason = f"the map has no {what} cloud here ({whys})" if whys else f"no {what} cloud here"
            return None
        self.reason = ""
        named = tuple(f"{layer} {x} {y}" for layer, x, y in missing)
        heights = RoadHeights.of(road)
        options = self._options
        environment = environment[heights.within(environment, options.lowest_m, options.highest_m)]
        return Block(frame, base_height_m, environment, road, heights, named)

    def _base_height_m(self, keys: list[tuple[CloudLayer, int, int]]) -> float | None:
        bases = [tile.base_height_m for key in keys if (tile := self._tiles[key]) is not None]
        return bases[0] if bases else None

    def _forget_but(self, tiles: list[Tile]) -> None:
        for key in [key for key in self._tiles if key[1:] not in tiles]:
            del self._tiles[key], self._why[key]
        for number in [number for number in self._blocks if not set(_tiles_of(number)) <= set(tiles)]:
            del self._blocks[number]


def _stored(tile: CloudTile, voxel_m: float) -> _StoredTile:
    """Thinned square by square: all at once, a dense tile would need 150 MB meanwhile."""
    order, begin = _by_square(tile.quanta, tile.resolution_m, voxel_m * _SQUARE_VOXELS)
    squares = [
        _to_steps(
            voxel_means(
                np.multiply(tile.quanta[order[first:end]], tile.resolution_m, dtype=np.float64), voxel_m
            )
        )
        for first, end in pairwise(begin.tolist())
        if first < end
    ]
    points = np.concatenate(squares) if squares else np.zeros((0, 3), np.int16)
    return _StoredTile(points, tile.base_height_m)


def _to_steps(points_m: Floats) -> NDArray[np.int16]:
    steps = np.rint(points_m / _STEP_M)
    return steps[(np.abs(steps) <= _MOST_STEPS).all(axis=1)].astype(np.int16)


@compiled_without_gil
def _by_square(
    quanta: NDArray[np.int32], resolution_m: float, square_m: float
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Rows (n,) sorted by square, and where each square begins; points beyond ±`_REACH_M` are left out."""
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


def _part(tile: _StoredTile, own: LocalFrame, frame: LocalFrame, half_m: tuple[float, float]) -> Floats:
    """The points of a tile that a block reaches, in the block's frame.

    From one plane to another over a few hundred metres the map is affine within a micrometre: three places tell it.
    """
    places = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    latitude, longitude, _ = frame.geodetic_from_east_north_array(places, np.full(3, frame.height_m))
    there = own.east_north_from_geodetic_array(latitude, longitude, np.zeros(3))
    tile_from_block = np.column_stack(((there[1] - there[0]) / 100.0, (there[2] - there[0]) / 100.0))
    block_from_tile = np.linalg.inv(tile_from_block)
    up_m = tile.base_height_m - frame.height_m
    return _in_box(tile.steps, block_from_tile, there[0], up_m, half_m[0], half_m[1])


@compiled_without_gil
def _in_box(
    steps: NDArray[np.int16],
    block_from_tile: Floats,
    centre_m: Floats,
    up_m: float,
    half_east_m: float,
    half_north_m: float,
) -> Floats:
    t = block_from_tile
    inside = 0
    moved = np.empty((0, 3))
    for turn in range(2):  # first count: most of a tile is outside
        if turn:
            moved = np.empty((inside, 3))
            inside = 0
        for i in range(len(steps)):
            x, y = steps[i, 0] * _STEP_M - centre_m[0], steps[i, 1] * _STEP_M - centre_m[1]
            east, north = t[0, 0] * x + t[0, 1] * y, t[1, 0] * x + t[1, 1] * y
            if abs(east) <= half_east_m and abs(north) <= half_north_m:
                if turn:
                    moved[inside, 0], moved[inside, 1] = east, north
                    moved[inside, 2] = steps[i, 2] * _STEP_M + up_m
                inside += 1
    return moved


def _block_of(latitude_rad: float, longitude_rad: float) -> tuple[int, int] | None:
    """Number of the block that holds a place: tiles of a finer zoom."""
    tile = tile_of(latitude_rad, longitude_rad)
    if tile is None:
        return None
    column = (longitude_rad + math.pi) / (2.0 * math.pi) * TILES * BLOCKS_PER_TILE
    row = (0.5 - math.asinh(math.tan(latitude_rad)) / (2.0 * math.pi)) * TILES * BLOCKS_PER_TILE
    return math.floor(column) % (TILES * BLOCKS_PER_TILE), math.floor(row)


def _centre(number: tuple[int, int]) -> tuple[float, float, float, float]:
    """Latitude and longitude of a block's centre, and half its size to the east and to the north, with margin."""
    around = TILES * BLOCKS_PER_TILE
    north, middle, south = (
        math.atan(math.sinh(math.pi * (1.0 - 2.0 * (number[1] + share) / around)))
        for share in (0.0, 0.5, 1.0)
    )
    half_north = 0.5 * (north - south) * 6.4e6 + MARGIN_M
    half_east = math.pi / around * 6.4e6 * math.cos(min(abs(north), abs(south))) + MARGIN_M
    return middle, 2.0 * math.pi * (number[0] + 0.5) / around - math.pi, half_east, half_north


def _block_frame(number: tuple[int, int], base_height_m: float) -> tuple[LocalFrame, tuple[float, float]]:
    latitude, longitude, half_east, half_north = _centre(number)
    return LocalFrame(latitude, longitude, base_height_m), (half_east, half_north)


def _tiles_of(number: tuple[int, int]) -> list[Tile]:
    """The tiles that a block with its margin needs."""
    latitude, longitude, half_east, half_north = _centre(number)
    return tiles_around(latitude, longitude, max(half_east, half_north))
