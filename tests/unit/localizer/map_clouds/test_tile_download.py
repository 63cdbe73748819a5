"""Loading a tile part by part: it arrives whole and right, or the reason is reported."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.map_clouds.tile_download import MAX_BYTES, TileFetch
from camber.map_server.release_queries import tile_part, unknown_tile
from camber.road_map.release_files import PART_BYTES
from camber.schemas.codec import encode
from camber.schemas.road import CloudTile, TileReply, TileRequest

NOW_NS = 1_400_000_000 * 10**9
NOTHING = np.zeros(0, np.uint8)
Server = Callable[[TileRequest], TileReply]


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


def run(server: Server, have_sha256: str | None = None) -> tuple[TileFetch, list[int]]:
    """The download at its end, and the parts that were asked for."""
    fetch, asked = TileFetch("road_cloud", 57_000, 25_000, have_sha256=have_sha256), list[int]()
    while fetch.state == "loading" and len(asked) < 300:
        request = fetch.request(NOW_NS)
        asked.append(request.part)
        fetch.receive(server(request))
    return fetch, asked


def switching(*servers: Server) -> Server:
    """Each reply by the next server, the last one for the rest."""
    left = list(servers)
    return lambda request: (left.pop(0) if len(left) > 1 else left[0])(request)


@pytest.mark.parametrize("have_sha256", [None, "0" * 64])
def test_a_tile_arrives_whole_part_by_part(have_sha256: str | None) -> None:
    blob = tile_blob()
    fetch, asked = run(serving(blob), have_sha256)
    assert (fetch.state, fetch.reason, fetch.sha256) == ("loaded", "", digest(blob))
    assert asked == list(range(-(-len(blob) // PART_BYTES))) == [0, 1, 2, 3, 4]
    assert encode(fetch.tile) == blob


def test_an_unchanged_tile_is_not_loaded_again() -> None:
    blob = tile_blob()
    fetch, asked = run(serving(blob), digest(blob))
    assert (fetch.state, fetch.tile, fetch.sha256, asked) == ("unchanged", None, digest(blob), [0])


def test_where_the_map_changes_meanwhile_it_begins_again() -> None:
    old, new = tile_blob(seed=1), tile_blob(seed=2)
    fetch, asked = run(switching(*[serving(old)] * 3, serving(new)))
    assert (fetch.state, asked) == ("loaded", [0, 1, 2, 3, 0, 1, 2, 3, 4])
    assert encode(fetch.tile) == new


def test_a_map_that_never_stays_the_same_is_given_up() -> None:
    fetch, asked = run(switching(*[serving(tile_blob(seed=seed)) for seed in range(2)] * 100))
    assert (fetch.state, fetch.reason) == ("unknown", "the tile changes faster than it can be loaded")
    assert len(asked) < 25


@pytest.mark.parametrize(
    ("server", "reason"),
    [
        (lambda _: unknown_tile("datum_mismatch", time_ns=NOW_NS), "^datum_mismatch$"),
        (serving(tile_blob(), name="0" * 64), "hash"),
        (serving(b"nothing of the kind" * 1000), "."),
        (serving(tile_blob(x=57_001)), "57001"),
        (serving(bytes(MAX_BYTES + 1), name="0" * 64), "more than"),
        (
            lambda _: TileReply(time_ns=NOW_NS, status="unchanged", sha256="0" * 64, payload=NOTHING),
            "unchanged",
        ),
    ],
    ids=["none", "another hash", "no tile", "another tile", "too large", "unchanged, of nothing"],
)
def test_no_tile_and_other_bytes_than_the_tiles_are_reported(server: Server, reason: str) -> None:
    fetch, _ = run(server)
    assert (fetch.state, fetch.tile) == ("unknown", None)
    assert re.search(reason, fetch.reason)


@settings(derandomize=True, max_examples=60, deadline=None)
@given(data=st.data())
def test_any_replies_give_the_right_tile_or_none(data: st.DataObject) -> None:
    """Replies of wrong parts, hashes and numbers, in any order: never a wrong tile."""
    blob = tile_blob(points=30_000)
    right = serving(blob)

    def faulty(request: TileRequest) -> TileReply:
        reply = right(request)
        fault = data.draw(st.sampled_from(["none"] * 12 + ["part", "parts", "hash", "bytes", "cut"]))
        if fault == "part":
            return right(request.model_copy(update={"part": data.draw(st.integers(0, 1))}))
        if fault == "parts":
            return reply.model_copy(update={"parts": data.draw(st.integers(0, 5000))})
        if fault == "hash":
            return reply.model_copy(update={"sha256": data.draw(st.sampled_from([None, "0" * 64]))})
        payload = reply.payload.copy()
        payload[len(payload) // 2 :] ^= 0x55 * (fault == "bytes")
        return reply.model_copy(update={"payload": payload[:100] if fault == "cut" else payload})

    fetch, _ = run(faulty)
    if fetch.state == "loaded":
        assert encode(fetch.tile) == blob
    else:
        assert fetch.tile is None
        assert fetch.reason
