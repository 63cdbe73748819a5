"""Tiles come from the map server once while they are in use, and again only where the map has changed."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from camber.localizer.map_clouds.map_blocks import MapBlockOptions
from camber.localizer.map_clouds.tile_scheduling import CloudTileLoader
from camber.localizer.map_queries import MapQueryFailure
from camber.localizer.warm_up import NoDiagnostics, SyntheticMap, synthetic_street
from camber.road_map.tile_grid import tile_frame
from camber.schemas.road import TileReply, TileRequest

FRAME = tile_frame(57686, 25920)
HERE = (FRAME.latitude_rad, FRAME.longitude_rad)
NS = 1_000_000_000
START_NS = 1_400_000_000 * NS


class CountingMap(SyntheticMap):
    def __init__(self) -> None:
        super().__init__(*synthetic_street())
        self.asked: Counter[tuple[str, int, int]] = Counter()
        self.there, self.silent = True, False
        self.seen: list[TileRequest] = []

    def tile(self, request: TileRequest) -> TileReply | MapQueryFailure:  # type: ignore[override]
        self.asked[request.layer, request.x, request.y] += 1
        self.seen.append(request)
        if self.silent:
            return MapQueryFailure("timeout", "by the test")
        reply = super().tile(request)
        if request.have_sha256 is not None and request.have_sha256 == reply.sha256:
            return reply.model_copy(update={"status": "unchanged", "payload": np.zeros(0, np.uint8)})
        return reply

    def is_available(self) -> bool:
        return self.there


def supply(answers: Any) -> CloudTileLoader:
    return CloudTileLoader(MapBlockOptions(), answers, NoDiagnostics())


def test_a_tile_is_loaded_once_while_it_is_in_use() -> None:
    answers = CountingMap()
    clouds = supply(answers)
    blocks = [clouds.block_at(*HERE, START_NS + second * NS) for second in range(20)]
    assert blocks[-1] is not None
    assert all(block is blocks[-1] for block in blocks[-10:])
    assert answers.asked["road_cloud", 57686, 25920] == 1
    assert answers.asked["environment_cloud", 57686, 25920] == 1


def test_of_a_new_version_only_what_has_changed_is_loaded_again() -> None:
    answers = CountingMap()
    clouds = supply(answers)
    clouds.note_map_version(1)
    before = clouds.block_at(*HERE, START_NS + NS)
    clouds.note_map_version(2)
    assert clouds.block_at(*HERE, START_NS + 2 * NS) is before
    again = [request for request in answers.seen if request.have_sha256 is not None]
    assert {request.layer for request in again} == {"road_cloud", "environment_cloud"}
    assert answers.asked["road_cloud", 57686, 25920] == 2
    clouds.block_at(*HERE, START_NS + 3 * NS)
    assert answers.asked["road_cloud", 57686, 25920] == 2


def test_a_query_without_reply_is_repeated_after_a_pause() -> None:
    answers = CountingMap()
    answers.silent = True
    clouds = supply(answers)
    for tenth in range(10):
        assert clouds.block_at(*HERE, START_NS + tenth * NS // 10) is None
    assert sum(answers.asked.values()) == 1
    assert "not been loaded" in clouds.reason
    answers.silent = False
    assert clouds.block_at(*HERE, START_NS + 2 * NS) is not None


def test_an_absent_map_server_is_not_queried_and_loaded_tiles_stay_in_use() -> None:
    answers = CountingMap()
    clouds = supply(answers)
    block = clouds.block_at(*HERE, START_NS + NS)
    asked = sum(answers.asked.values())
    answers.there = False
    clouds.note_map_version(1)
    clouds.note_map_version(2)
    assert clouds.block_at(*HERE, START_NS + 2 * NS) is block
    assert sum(answers.asked.values()) == asked


def test_without_clouds_the_reason_is_given_and_the_query_repeated_later() -> None:
    answers = CountingMap()
    clouds = supply(answers)
    far = (HERE[0] + 0.01, HERE[1])
    assert clouds.block_at(*far, START_NS + NS) is None
    assert "no clouds" in clouds.reason
    asked = sum(answers.asked.values())
    assert clouds.block_at(*far, START_NS + 2 * NS) is None
    assert sum(answers.asked.values()) == asked
    assert clouds.block_at(*far, START_NS + 40 * NS) is None
    assert sum(answers.asked.values()) > asked
