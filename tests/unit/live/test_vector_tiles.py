"""Vector tiles against a decoder of their own."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest

from camber.live.map_tiles import MapTiles, ReleaseSource, degrees_of
from camber.live.vector_tiles import EXTENT, TileLayer, encode_tile
from camber.replay.short_drive import write_short_drive
from camber.road_map.release import open_release
from camber.road_map.tile_grid import tile_frame
from camber.schemas.road import ZOOM, CloudTile, Layer
from support.vector_tile_reader import decoded


def layer_of(
    kind: Literal["LineString", "Polygon"], features: dict[int, list[tuple[int, int]]], **properties: Any
) -> TileLayer:
    return TileLayer(
        name=kind,
        kind=kind,
        numbers=np.array([*features]),
        points=np.array([point for points in features.values() for point in points]),
        first=np.cumsum([0, *map(len, features.values())]),
        properties={name: np.array(column) for name, column in properties.items()},
    )


def test_what_is_encoded_is_decoded_again() -> None:
    ring = [(10, 20), (300, 20), (300, -7), (10, -7)]
    other = [(x + 1, y + 70_000) for x, y in ring[:3]]
    roads = layer_of("Polygon", {2**40: ring, 5: other}, sigma=[0.5, 0.25], level=[-3, 2])
    lines = layer_of("LineString", {1: [(0, 0), (0, 0), (5000, 8191)], 0: [(9, 9), (8, 9), (8, 9), (-8, -9)]})
    tile = decoded(encode_tile([roads, lines]))
    assert tile["Polygon"] == [
        (2**40, ring, {"sigma": 0.5, "level": -3}),
        (5, other, {"sigma": 0.25, "level": 2}),
    ]
    assert tile["LineString"] == [(1, [(0, 0), (5000, 8191)], {}), (0, [(9, 9), (8, 9), (-8, -9)], {})]


def test_what_has_no_size_is_left_out() -> None:
    flat, still = [(3, 3), (3, 3), (4, 4), (4, 4)], [(3, 3), (3, 3)]
    assert encode_tile([layer_of("Polygon", {1: flat}), layer_of("LineString", {1: still})]) == b""
    lines = layer_of("LineString", {1: still, 2: [(3, 3), (3, 4)], 3: still}, level=[7, 8, 9])
    assert decoded(encode_tile([lines])) == {"LineString": [(2, [(3, 3), (3, 4)], {"level": 8})]}


@pytest.fixture(scope="module")
def tiles(tmp_path_factory: pytest.TempPathFactory) -> MapTiles:
    manifest = write_short_drive(tmp_path_factory.mktemp("drive"))
    return MapTiles(ReleaseSource(open_release(manifest.parent / "map")))


def test_roads_are_where_the_release_has_them(tiles: MapTiles) -> None:
    (x, y), *_ = tiles.source.tiles() or []
    surfaces = tiles.source.surface_tile(x, y)
    assert surfaces is not None
    features = {
        number: (ring, properties) for number, ring, properties in decoded(tiles.tile(ZOOM, x, y))["surfaces"]
    }
    assert features.keys() == set(surfaces.surface_id.tolist())
    for row, number in enumerate(surfaces.surface_id.tolist()):
        ring, properties = features[number]
        middle = np.mean(ring, axis=0) / EXTENT
        longitude, latitude = degrees_of(x + middle[0], y + middle[1])
        place = tile_frame(x, y).east_north_from_geodetic_array(
            *np.radians([[latitude], [longitude]]), np.zeros(1)
        )
        expected = (surfaces.centre_east_m[row], surfaces.centre_north_m[row])
        np.testing.assert_allclose(place[0], expected, atol=0.1)  # a unit of the tile is 6 cm
        assert properties["sigma"] == pytest.approx(float(surfaces.sigma_m[row]), abs=6e-4)
        assert properties["level"] == surfaces.level[row]


def test_smaller_zooms_have_links_then_squares(tiles: MapTiles) -> None:
    (x, y), *_ = tiles.source.tiles() or []
    layers = {
        zoom: set(decoded(tiles.tile(zoom, x >> (ZOOM - zoom), y >> (ZOOM - zoom))))
        for zoom in (15, 14, 12, 9)
    }
    assert layers == {15: {"links", "surfaces"}, 14: {"links"}, 12: {"links"}, 9: {"squares"}}
    assert tiles.tile(ZOOM, 0, 0) == b""
    assert tiles.tile(3, 0, 0) == tiles.tile(20, 0, 0) == b""


def test_bounds_hold_all_tiles(tiles: MapTiles) -> None:
    facts = tiles.source.describe()
    west, south, east, north = facts["bounds"]
    for x, y in tiles.source.tiles() or []:
        longitude, latitude = degrees_of(x + 0.5, y + 0.5)
        assert west < longitude < east
        assert south < latitude < north
    assert facts["surrogate"]


class _Cloud(ReleaseSource):
    """A release with points of its own."""

    def __init__(self, points: int) -> None:
        x, y = self.place = (57686, 25920)
        quanta = np.array([[0, 0, 10], [1000, 0, 20], [0, -1000, 35]] * points, np.int32)
        self._cloud = CloudTile(
            time_ns=1_400_000_000 * 10**9,
            x=x,
            y=y,
            layer="environment_cloud",
            base_height_m=40.0,
            resolution_m=0.1,
            quanta=quanta,
        )

    def cloud_tile(self, layer: Layer, x: int, y: int) -> CloudTile | None:
        return self._cloud if (layer, (x, y)) == ("environment_cloud", self.place) else None


def test_points_are_shares_of_their_tile() -> None:
    source = _Cloud(1)
    points = np.frombuffer(MapTiles(source).points(*source.place), "<f4").reshape(-1, 3)
    share = 100.0 / (2.0 * np.pi * 6378137.0 * np.cos(np.radians(35.5)) / (1 << ZOOM))
    np.testing.assert_allclose(points[0], [0.5, 0.5, 0.0], atol=1e-3)
    np.testing.assert_allclose(points[1], [0.5 + share, 0.5, 1.0], atol=3e-3)
    np.testing.assert_allclose(points[2], [0.5, 0.5 + share, 2.5], atol=3e-3)
    assert MapTiles(source).points(0, 0) == b""


def test_of_many_points_some_are_sent() -> None:
    source = _Cloud(300_000)
    assert 200_000 * 12 < len(MapTiles(source).points(*source.place)) <= 400_000 * 12
