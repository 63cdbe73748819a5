"""The map straight from a release gives what the map server's process gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from camber.map_server.service import MapServerService
from camber.map_server.settings import MapServerSettings
from camber.road_map.release import ReleaseError
from camber.road_map.tile_grid import tile_of
from camber.runtime.bus import Bus
from camber.schemas.base import Message
from camber.schemas.codec import encode
from camber.schemas.road import ElevationRequest, Layer, LinksRequest, Places, TileRequest
from camber.tools.localize.local_map_queries import LocalMapQueries, release_for
from support.fake_bus import FakeBus
from support.small_map import DAY_NS, FRAME, MADE_NS, at, link, surface, write

NOW_NS = MADE_NS + DAY_NS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A road below another one that crosses it, and what leads to both."""
    path = tmp_path_factory.mktemp("map")
    lines = [
        link(1, (1, 2), [(-200.0, 0.0), (200.0, 0.0)]),
        link(2, (3, 4), [(0.0, -200.0), (0.0, 200.0)], level=1),
    ]
    roads = [
        surface(5, half_length_m=200.0),
        surface(6, link_id=2, level=1, yaw_rad=np.pi / 2, half_length_m=200.0, heights_m=57.0),
    ]
    write(path, roads, lines)
    return path


def questions() -> list[tuple[str, Message]]:
    rng = np.random.default_rng(5)
    asked: list[tuple[str, Message]] = []
    for east_m, north_m in rng.uniform(-60.0, 60.0, (40, 2)) * (1.0, 0.05):
        place = dict(zip(("latitude_rad", "longitude_rad"), at(east_m, north_m), strict=True))
        around = Places(east_m=rng.uniform(-9, 9, 5), north_m=rng.uniform(-9, 9, 5))
        topology: dict[str, Any] = {"link_ids": (int(rng.integers(1, 3)),), "ahead": around}
        for more in (topology, {"last_surface_id": 5}, {"radius_m": 4.0}):
            asked.append(("elevation", ElevationRequest(time_ns=NOW_NS, **place, **more)))
        asked.append(("links", LinksRequest(time_ns=NOW_NS, **place, radius_m=150.0)))
    x, y = cast(tuple[int, int], tile_of(FRAME.latitude_rad, FRAME.longitude_rad))
    layers: tuple[Layer, ...] = ("surfaces", "links", "road_cloud")
    asked += [
        ("tile", TileRequest(time_ns=NOW_NS, x=x, y=y, layer=layer, part=part))
        for layer in layers
        for part in (0, 1)
    ]
    return asked


def test_every_answer_is_that_of_the_map_server(folder: Path) -> None:
    bus = FakeBus(NOW_NS)
    service = MapServerService(MapServerSettings(release=folder), cast(Bus, bus))
    at_hand = LocalMapQueries(release_for(folder, "WGS84"))
    assert at_hand.is_available()
    output: set[str] = set()
    for name, request in questions():
        (theirs,) = service.answers()[name]([request])
        mine = getattr(at_hand, name)(request)
        assert encode(mine) == encode(cast(Message, theirs))
        road = getattr(mine, "road", None)
        output.add(road.status if road is not None else mine.status)
    assert output == {"known", "unknown"}
    assert bus.issues == []


def test_a_map_of_another_datum_is_refused(folder: Path) -> None:
    with pytest.raises(ReleaseError, match=r"datum is 'WGS84', expected JGD2011 as of the drive"):
        release_for(folder, "JGD2011")


def test_a_damaged_map_is_refused_before_anything_is_asked(folder: Path, tmp_path: Path) -> None:
    write(tmp_path, [surface(5)])
    blobs = sorted((tmp_path / "blobs").rglob("*"), key=lambda path: path.stat().st_size)
    largest = [path for path in blobs if path.is_file()][-1]
    data = bytearray(largest.read_bytes())
    data[len(data) // 2] ^= 1
    largest.write_bytes(bytes(data))
    with pytest.raises(ReleaseError):
        release_for(tmp_path, "WGS84")
    with pytest.raises(ReleaseError):
        release_for(tmp_path / "nowhere", "WGS84")
