"""Parts of a blob fit into replies and make the blob again."""

from __future__ import annotations

import hashlib

import pytest

from camber.map_server.release_queries import tile_part
from camber.road_map.release_files import PART_BYTES
from camber.schemas.codec import encode
from camber.schemas.road import TileReply, TileRequest
from support.small_map import MADE_NS


def part(blob: bytes, number: int = 0, have: str | None = None) -> TileReply:
    request = TileRequest(time_ns=MADE_NS, x=1, y=2, layer="links", have_sha256=have, part=number)
    return tile_part(blob, hashlib.sha256(blob).hexdigest(), request, time_ns=MADE_NS)


@pytest.mark.parametrize("size", [1, PART_BYTES - 1, PART_BYTES, PART_BYTES + 1, 3 * PART_BYTES + 7])
def test_parts_fit_into_replies_and_make_up_the_blob(size: int) -> None:
    blob = bytes(i * i % 251 for i in range(size))
    replies = [part(blob, i) for i in range(part(blob).parts)]
    assert b"".join(reply.payload.tobytes() for reply in replies) == blob
    assert {reply.sha256 for reply in replies} == {hashlib.sha256(blob).hexdigest()}
    assert max(len(encode(reply)) for reply in replies) <= 256_000


def test_a_client_with_the_blob_gets_unchanged() -> None:
    digest = hashlib.sha256(b"abc").hexdigest()
    reply = part(b"abc", have=digest)
    assert (reply.status, reply.sha256, reply.parts, reply.payload.size) == ("unchanged", digest, 0, 0)


def test_a_client_with_another_blob_gets_this_one() -> None:
    assert part(b"abc", have="0" * 64).payload.tobytes() == b"abc"


def test_there_is_no_part_beyond_the_last() -> None:
    reply = part(b"abc", 1)
    assert (reply.status, reply.reason, reply.payload.size) == ("unknown", "part 1 of 1", 0)
