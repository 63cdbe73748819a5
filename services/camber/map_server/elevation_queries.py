"""Elevation, slope and uncertainty of the road under a point, or the reason why it is unknown."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camber.geodesy.local_frame import LocalFrame
from camber.map_server import batch_road_selection as codes
from camber.map_server.batch_road_selection import (
    PointColumns,
    SelectedRoads,
    empty_roads,
    select_roads,
    topologies,
)
from camber.map_server.batch_road_selection_by_links import restore_order, select_roads_by_links
from camber.map_server.point_groups import group_rows, sort_by_tile, tile_numbers
from camber.map_server.road_level_selection import Topology, select_surface
from camber.map_server.tile_index import TileIndex
from camber.road_map.tile_grid import TILES, Tile, tile_of
from camber.schemas.pose import Road, RoadPatch, RoadReason
from camber.schemas.road import LinkTile, Places, RoadsAhead, SurfaceTile

T = TypeVar("T")
M = TypeVar("M")

_LATTICE_STEP = 0.25  # chosen: spacing of a patch's 49 samples in units of its radius
_STEPS = np.arange(-1.0, 1.0 + 1e-9, _LATTICE_STEP)
_LATTICE = np.stack([axis.ravel() for axis in np.meshgrid(_STEPS, _STEPS)])
_LATTICE = _LATTICE[:, np.hypot(*_LATTICE) <= 1.0 + 1e-9]

_BLOCK = 1 << 17  # chosen: points sorted by tile at a time, within the processor's cache

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_PLANES = ("surface_id", "elevation_m", "sigma_m", "slope_east", "slope_north")
"""Columns that roads, a patch and places ahead have in common."""
REASONS: tuple[RoadReason, ...] = ("none", "no_surface", "levels_ambiguous")
"""Reasons by the numbers of `SelectedRoads.reason`."""
NO_SURFACE = Road(status="unknown", reason="no_surface")
LEVELS_AMBIGUOUS = Road(status="unknown", reason="levels_ambiguous")


class _Links:
    """Links of one tile with their nodes and levels, and the links at each node."""

    def __init__(self, tile: LinkTile) -> None:
        links = tile.link_id.tolist()
        self.level = dict(zip(links, tile.level.tolist(), strict=True))
        ends = zip(tile.start_node.tolist(), tile.end_node.tolist(), strict=True)
        self.nodes = dict(zip(links, ends, strict=True))
        self.at_node: dict[int, set[int]] = {}
        for link, nodes in self.nodes.items():
            for node in nodes:
                self.at_node.setdefault(node, set()).add(link)


class ElevationMap:
    """Elevations of one release. Tiles are loaded by two functions on first use; the latest are cached.

    The functions return None if the release has no tile; their exceptions are passed on.
    """

    def __init__(
        self,
        surfaces: Callable[[int, int], SurfaceTile | None],
        links: Callable[[int, int], LinkTile | None],
        *,
        datum: str,
        map_version: int,
        tiles_kept: int = 256,
    ) -> None:
        self.datum = datum
        self.map_version = map_version
        self._surfaces = _cached(surfaces, TileIndex, tiles_kept)
        self._links = _cached(links, _Links, tiles_kept)
        # A vehicle makes many queries with the same tile, links and last surface.
        self._topology = lru_cache(maxsize=256)(self._find_topology)
        self._links_near = lru_cache(maxsize=tiles_kept)(self._find_links_near)
        self._connected = lru_cache(maxsize=4096)(self._find_connected)

    def road(
        self,
        latitude_rad: float,
        longitude_rad: float,
        link_ids: Iterable[int] = (),
        last_surface_id: int | None = None,
    ) -> Road:
        """Return the road under a point; `link_ids` and `last_surface_id` as in ElevationRequest."""
        tile = tile_of(latitude_rad, longitude_rad)
        index = self._surfaces(tile) if tile is not None else None
        if tile is None or index is None:
            return NO_SURFACE
        hits = index.hits(*index.frame.east_north_from_geodetic(latitude_rad, longitude_rad, 0.0))
        if not hits:
            return NO_SURFACE
        hit = select_surface(hits, self._topology(tile, frozenset(link_ids), last_surface_id))
        if hit is None:
            return LEVELS_AMBIGUOUS
        return Road(
            status="known",
            surface_id=hit.surface_id,
            level=hit.level,
            elevation_m=hit.height_m,
            sigma_m=hit.sigma_m,
            slope_east=hit.slope_east,
            slope_north=hit.slope_north,
            extent_m=hit.extent_m,
            datum=self.datum,
            map_version=self.map_version,
        )

    def road_around(
        self,
        latitude_rad: float,
        longitude_rad: float,
        radius_m: float,
        link_ids: Iterable[int] = (),
        last_surface_id: int | None = None,
    ) -> Road:
        """Return `road` with a patch of samples within `radius_m`; the point itself may lie next to the road.

        The patch omits surfaces on levels without candidate links.
        """
        links = tuple(link_ids)
        road = self.road(latitude_rad, longitude_rad, links, last_surface_id)
        if radius_m <= 0.0:
            return road
        east_m, north_m = radius_m * _LATTICE[0], radius_m * _LATTICE[1]
        frame = LocalFrame(latitude_rad, longitude_rad, 0.0)
        points = frame.geodetic_from_east_north_array(
            np.column_stack((east_m, north_m)), np.zeros(len(east_m))
        )
        roads = self.roads(points[0], points[1], links, last_surface_id)
        undecided = not links and len(np.unique(roads.level)) > 1
        if undecided or (roads.ambiguous & ~roads.elsewhere).any():
            # Surfaces of several levels within the radius: the exact position would decide which is the road.
            return LEVELS_AMBIGUOUS
        if len(roads.known) == 0:
            return road
        patch = RoadPatch(
            reach_m=radius_m * _LATTICE_STEP,
            east_m=east_m[roads.known],
            north_m=north_m[roads.known],
            **{name: getattr(roads, name) for name in _PLANES},
        )
        if road.status != "known":
            road = self._nearest_plane(patch, roads)
        return road.model_copy(update={"patch": patch})

    def _nearest_plane(self, patch: RoadPatch, roads: SelectedRoads) -> Road:
        """Extrapolate the nearest plane of a patch to a point next to the road."""
        k = int(np.argmin(np.hypot(patch.east_m, patch.north_m)))
        plane = {name: getattr(patch, name)[k].item() for name in _PLANES}
        rise_m = plane["slope_east"] * patch.east_m[k].item() + plane["slope_north"] * patch.north_m[k].item()
        plane["elevation_m"] -= rise_m
        level = int(roads.level[k])
        return Road(
            status="known", level=level, extent_m=0.0, datum=self.datum, map_version=self.map_version, **plane
        )

    def roads_ahead(
        self,
        latitude_rad: float,
        longitude_rad: float,
        places: Places,
        link_ids: Iterable[int] = (),
        last_surface_id: int | None = None,
    ) -> RoadsAhead:
        """Return `roads` at places given relative to a point."""
        frame = LocalFrame(latitude_rad, longitude_rad, 0.0)
        plane_m = np.column_stack((places.east_m, places.north_m))
        points = frame.geodetic_from_east_north_array(plane_m, np.zeros(len(plane_m)))
        roads = self.roads(points[0], points[1], link_ids, last_surface_id)
        return RoadsAhead(
            place=roads.known.astype(np.int32),
            level=roads.level.astype(np.int32),
            extent_m=roads.extent_m,
            **{name: getattr(roads, name) for name in _PLANES},
        )

    def roads(
        self,
        latitude_rad: ArrayLike,
        longitude_rad: ArrayLike,
        link_ids: Iterable[int] = (),
        last_surface_id: int | None = None,
    ) -> SelectedRoads:
        """Return the roads under n points given as two arrays (n,), with the same links and last surface."""
        latitude, longitude = _columns(latitude_rad, longitude_rad)
        links = np.array([*link_ids], np.int64)
        last = np.full(len(latitude), -1 if last_surface_id is None else last_surface_id)
        return self._roads(PointColumns(latitude, longitude, np.tile(links, (len(latitude), 1)), last))

    def roads_each(
        self,
        latitude_rad: ArrayLike,
        longitude_rad: ArrayLike,
        link_ids: ArrayLike,
        last_surface_id: ArrayLike,
    ) -> SelectedRoads:
        """Return `roads` with candidate links (n, c) and last surface (n,) for each point; −1 means none."""
        latitude, longitude = _columns(latitude_rad, longitude_rad)
        links, last = (np.ascontiguousarray(ids, np.int64) for ids in (link_ids, last_surface_id))
        if links.ndim != 2 or len(links) != len(latitude) or last.shape != latitude.shape:
            count = len(latitude)
            raise ValueError(
                f"link_ids, last_surface_id: expected ({count}, c), ({count},), got {links.shape}, {last.shape}"
            )
        return self._roads(PointColumns(latitude, longitude, links, last))

    def _roads(self, points: PointColumns) -> SelectedRoads:
        """Select by candidate links alone, and by topology where these do not decide."""
        number = tile_numbers(points.latitude_rad, points.longitude_rad)
        roads, sorted_roads = empty_roads(len(number)), empty_roads(min(_BLOCK, len(number)))
        for begin in range(0, len(number), _BLOCK):
            tiles, rows, start, sorted_place = sort_by_tile(number[begin : begin + _BLOCK])
            rows += begin
            for tile, first, end in zip(tiles.tolist(), start[:-1].tolist(), start[1:].tolist(), strict=True):
                index = self._index(tile)
                if index is None:
                    sorted_roads.reason[first:end], sorted_roads.elsewhere[first:end] = (
                        codes.NO_SURFACE,
                        False,
                    )
                else:
                    select_roads_by_links(
                        index.table, points, rows[first:end], roads=sorted_roads, begin=first
                    )
            restore_order(sorted_place, sorted_roads, roads, begin)
        undecided = np.flatnonzero(roads.reason == codes.UNDECIDED)
        if len(undecided):
            self._by_topology(undecided, number, points, roads)
        return roads.of_known()

    def _by_topology(
        self, rows: Integers, number: Integers, points: PointColumns, roads: SelectedRoads
    ) -> None:
        """Select undecided points by topology, determined once for each tile, last surface and set of links."""
        keys = np.column_stack((number[rows], points.last[rows], points.links[rows]))
        group, first = group_rows(keys)
        known = []
        for tile, surface, *links in keys[first].tolist():
            candidates = frozenset(link for link in links if link >= 0)
            known.append(self._topology(divmod(tile, TILES), candidates, None if surface < 0 else surface))
        table_of_topologies = topologies(known)
        by_tile = np.argsort(keys[:, 0], kind="stable")
        tiles, start = np.unique(keys[by_tile, 0], return_index=True)
        for tile, members in zip(tiles.tolist(), np.split(by_tile, start[1:]), strict=True):
            index = self._index(tile)
            assert index is not None, "a tile without surfaces is decided"
            topology = group[members]
            select_roads(
                index.table, points, rows[members], topology=topology, known=table_of_topologies, roads=roads
            )

    def _index(self, tile: int) -> TileIndex | None:
        return self._surfaces(divmod(tile, TILES)) if tile >= 0 else None

    def _find_topology(self, tile: Tile, candidates: frozenset[int], last_surface_id: int | None) -> Topology:
        connected: frozenset[int] = frozenset()
        levels: frozenset[int] = frozenset()
        if last_surface_id is not None:
            connected, levels = self._find_last(tile, last_surface_id)
        if candidates:
            near = self._links_near(tile)
            levels = frozenset(
                links.level[link] for links in near for link in candidates if link in links.level
            )
        return Topology(candidates=candidates, connected=connected, levels=levels)

    def _find_last(self, tile: Tile, surface_id: int) -> tuple[frozenset[int], frozenset[int]]:
        """Return the links connected to a surface, and its level; nothing unless it is in the tile or a neighbour."""
        for around in _neighbours(tile):
            index = self._surfaces(around)
            link_and_level = None if index is None else index.link_and_level(surface_id)
            if link_and_level is not None:
                link, level = link_and_level
                return self._connected(tile, link), frozenset({level})
        return frozenset(), frozenset()

    def _find_connected(self, tile: Tile, link: int) -> frozenset[int]:
        """Return a link and those near the tile that share a node with it."""
        near = self._links_near(tile)
        nodes = {node for links in near for node in links.nodes.get(link, ())}
        return frozenset({link}.union(*(links.at_node.get(node, ()) for links in near for node in nodes)))

    def _find_links_near(self, tile: Tile) -> tuple[_Links, ...]:
        return tuple(links for around in _neighbours(tile) if (links := self._links(around)) is not None)


@lru_cache(maxsize=4096)
def _neighbours(tile: Tile) -> tuple[Tile, ...]:
    """Return a tile and the eight around it, itself first."""
    x, y = tile
    steps = [(0, 0)] + [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    return tuple(((x + i) % TILES, y + j) for i, j in steps if 0 <= y + j < TILES)


def _columns(latitude_rad: ArrayLike, longitude_rad: ArrayLike) -> tuple[Floats, Floats]:
    latitude = np.ascontiguousarray(latitude_rad, np.float64)
    longitude = np.ascontiguousarray(longitude_rad, np.float64)
    if latitude.ndim != 1 or latitude.shape != longitude.shape:
        shapes = f"{np.shape(latitude_rad)}, {np.shape(longitude_rad)}"
        raise ValueError(f"latitude_rad, longitude_rad: expected (n,), got {shapes}")
    return latitude, longitude


def _cached(
    load: Callable[[int, int], T | None], make: Callable[[T], M], count: int
) -> Callable[[Tile], M | None]:
    """Cache `make(load(tile))` for the last `count` tiles; a load that raised is repeated."""

    @lru_cache(maxsize=count)
    def get(tile: Tile) -> M | None:
        loaded = load(*tile)
        return None if loaded is None else make(loaded)

    return get
