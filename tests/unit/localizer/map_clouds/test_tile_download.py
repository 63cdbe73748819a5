"""Loading a tile part by part: it arrives whole and right, or the reason is reported."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.map_clouds.tile_download import TileFetch
from camber.map_server.release_queries import tile_part, unknown_tile
from camber.road_map.release_files import PART_BYTES
from camber.schemas.codec import encode
from camber.schemas.road import CloudTile, TileReply, TileRequest

NOW_NS = 1_400_000_000 * 10**9
Server = Callable[[TileRequest], TileReply | None]


def tile_blob(points: int = 100_000, seed: int = 1, *, x: int = 57_000, y: int = 25_000) -> bytes:
    quanta = np.random.default_rng(seed).integers(-50_000, 50_000, (points, 3), dtype=np.int32)
    return encode(
        CloudTile(
            time_ns=NOW_NS,
            x=x,
            y=y,
            layer="road_cloud",
            base_height_m=40.0,
            resolution_m=0.005,
            quanta=quanta,
        )
    )


def digest(blob: bytes) -> str:
    return hashlib.sha256(blob).hexdigest()


def serving(blob: bytes, name: str | None = None) -> Server:
    return lambda request: tile_part(blob, name or digest(blob), request, time_ns=NOW_NS)


def run(fetch: TileFetch, server: Server, steps: int = 200) -> int:
    """How many steps it took."""
    for step in range(steps):
        for request in fetch.requests(NOW_NS):
            fetch.receive(request.part, server(request))
        if fetch.state != "loading":
            return step + 1
    return steps


def new_fetch(**options: object) -> TileFetch:
    return TileFetch("road_cloud", 57_000, 25_000, **options)  # type: ignore[arg-type]


def test_a_tile_arrives_whole_a_few_parts_a_step() -> None:
    blob = tile_blob()
    fetch, parts = new_fetch(parts_per_step=2), -(-len(blob) // PART_BYTES)
    steps = run(fetch, serving(blob))
    assert parts == 5
    assert (fetch.state, fetch.reason, fetch.sha256) == ("loaded", "", digest(blob))
    assert steps == 1 + 2
    assert len(fetch.tile.quanta) == 100_000
    assert fetch.requests(NOW_NS) == []


def test_an_unchanged_tile_is_not_loaded_again() -> None:
    blob = tile_blob()
    fetch = new_fetch(have_sha256=digest(blob))
    assert run(fetch, serving(blob)) == 1
    assert (fetch.state, fetch.tile, fetch.sha256) == ("unchanged", None, digest(blob))


def test_a_changed_tile_is_loaded() -> None:
    fetch = new_fetch(have_sha256=digest(tile_blob(seed=2)))
    run(fetch, serving(tile_blob()))
    assert fetch.state == "loaded"


def test_where_the_map_changes_meanwhile_it_begins_again() -> None:
    old, new = tile_blob(seed=1), tile_blob(seed=2)
    asked: list[int] = []

    def changing(request: TileRequest) -> TileReply | None:
        asked.append(request.part)
        return serving(old if len(asked) <= 3 else new)(request)

    fetch = new_fetch()
    run(fetch, changing)
    assert fetch.state == "loaded"
    assert fetch.sha256 == digest(new)
    assert fetch.tile is not None
    assert encode(fetch.tile) == new
    assert asked.count(0) == 2


def test_a_map_that_never_stays_the_same_is_given_up() -> None:
    blobs = [tile_blob(seed=seed) for seed in range(2)]
    asked: list[int] = []

    def changing(request: TileRequest) -> TileReply | None:
        asked.append(request.part)
        return serving(blobs[len(asked) % 2])(request)

    fetch = new_fetch()
    run(fetch, changing)
    assert (fetch.state, fetch.reason) == ("unknown", "the tile changes faster than it can be loaded")
    assert len(asked) < 25


def test_unanswered_parts_are_asked_for_again() -> None:
    blob = tile_blob()
    asked: list[int] = []

    def failing(request: TileRequest) -> TileReply | None:
        asked.append(request.part)
        return None if len(asked) % 3 == 0 else serving(blob)(request)

    fetch = new_fetch()
    run(fetch, failing)
    assert fetch.state == "loaded"
    assert fetch.sha256 == digest(blob)


def test_a_server_that_never_answers_is_given_up() -> None:
    fetch = new_fetch()
    run(fetch, lambda _: None)
    assert (fetch.state, fetch.reason) == ("unknown", "the map server does not answer")


@pytest.mark.parametrize("reason", ["datum_mismatch", "map_missing", "the release has no such tile"])
def test_why_there_is_no_tile_is_passed_on(reason: str) -> None:
    fetch = new_fetch()
    run(fetch, lambda _: unknown_tile(reason, time_ns=NOW_NS))
    assert (fetch.state, fetch.reason, fetch.tile) == ("unknown", reason, None)


@pytest.mark.parametrize(
    ("server", "reason"),
    [
        (serving(tile_blob(), name="0" * 64), "hash"),
        (serving(b"nothing of the kind" * 1000), "."),
        (serving(tile_blob(x=57_001)), "57001"),
    ],
    ids=["another hash", "no tile", "another tile"],
)
def test_other_bytes_than_the_tiles_are_refused(server: Server, reason: str) -> None:
    fetch = new_fetch()
    run(fetch, server)
    assert (fetch.state, fetch.tile) == ("unknown", None)
    assert re.search(reason, fetch.reason)


def test_unchanged_without_having_anything_is_refused() -> None:
    fetch, blob = new_fetch(), tile_blob()
    had = serving(blob)
    run(fetch, lambda request: had(request.model_copy(update={"have_sha256": digest(blob)})))
    assert fetch.state == "unknown"


@settings(derandomize=True, max_examples=60, deadline=None)
@given(data=st.data())
def test_any_replies_give_the_right_tile_or_none(data: st.DataObject) -> None:
    """Replies of wrong parts, hashes and numbers, in any order: never a wrong tile, and never more than a bound."""
    blob = tile_blob(points=30_000)
    fetch = new_fetch()
    for _ in range(60):
        for request in fetch.requests(NOW_NS):
            reply = serving(blob)(request)
            fault = data.draw(st.sampled_from(["none"] * 12 + ["lost", "parts", "hash", "bytes", "cut"]))
            if fault == "parts":
                reply = reply.model_copy(update={"parts": data.draw(st.integers(0, 5000))})
            elif fault == "hash":
                reply = reply.model_copy(update={"sha256": data.draw(st.sampled_from([None, "0" * 64]))})
            elif fault in ("bytes", "cut"):
                payload = reply.payload.copy()
                payload[len(payload) // 2 :] ^= 0x55
                reply = reply.model_copy(update={"payload": payload if fault == "bytes" else payload[:100]})
            fetch.receive(request.part, None if fault == "lost" else reply)
    if fetch.state == "loaded":
        assert fetch.tile is not None
        assert encode(fetch.tile) == blob
    else:
        assert fetch.tile is None
        assert fetch.reason or fetch.state == "loading"
