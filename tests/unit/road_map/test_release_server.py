"""Vehicles get the newest root, and blobs as few bytes: what they put together from it is the release."""

from __future__ import annotations

import hashlib
from pathlib import Path

from camber.map_update.fusion.correction_rows import NONE
from camber.road_map.blob_delta import decompress_blob
from camber.road_map.release import open_release
from camber.road_map.release_server import ReleaseServer
from camber.schemas.codec import decode
from camber.schemas.fleet import MapBlobReply, MapBlobRequest, MapRootReply, MapRootRequest
from camber.schemas.road import ReleaseRoot
from support.release_world import making, offsets
from support.small_map import MADE_NS, surface, write


def root_of(serving: ReleaseServer, region: str = "test", have: str | None = None) -> MapRootReply:
    return serving.root(MapRootRequest(time_ns=MADE_NS, region=region, have_sha256=have), time_ns=MADE_NS)


def fetched(serving: ReleaseServer, sha256: str, base: str | None = None) -> list[MapBlobReply]:
    replies = list[MapBlobReply]()
    while not replies or len(replies) < replies[0].parts:
        request = MapBlobRequest(time_ns=MADE_NS, sha256=sha256, base_sha256=base, part=len(replies))
        replies.append(serving.blob(request, time_ns=MADE_NS))
    return replies


def put_together(replies: list[MapBlobReply], base: bytes | None = None) -> bytes:
    return decompress_blob(b"".join(reply.payload.tobytes() for reply in replies), base)


def test_the_newest_root_is_sent_once(tmp_path: Path) -> None:
    serving = ReleaseServer(tmp_path)
    assert root_of(serving).status == "unknown"
    root = write(tmp_path, [surface(1)])
    reply = root_of(serving)
    assert decode(ReleaseRoot, reply.payload.tobytes()).message == root
    assert root_of(serving, have=root.manifest_sha256).status == "unchanged"
    assert root_of(serving, region="elsewhere").reason == "releases here are of test"
    head = serving.head(time_ns=MADE_NS)
    assert (head.map_version, head.manifest_sha256) == (root.map_version, root.manifest_sha256)


def test_a_blob_against_one_that_the_vehicle_has(tmp_path: Path) -> None:
    builder = making(tmp_path)
    builder.build(NONE, time_ns=MADE_NS)
    old = open_release(tmp_path / "out")
    builder.build(offsets(s3=0.05), time_ns=MADE_NS)
    new = open_release(tmp_path / "out")
    serving = ReleaseServer(tmp_path / "out")
    for xy in new.tiles("surfaces"):
        digest, base = new.sha256("surfaces", *xy), old.sha256("surfaces", *xy)
        assert digest is not None
        if digest != base:
            assert len(fetched(serving, digest, base)[0].payload) < 60
            whole = put_together(fetched(serving, digest, base), old.blob("surfaces", *xy))
            assert whole == new.blob("surfaces", *xy)
    no_longer_here = "0" * 64
    whole = put_together(fetched(serving, new.root.manifest_sha256, no_longer_here))
    assert hashlib.sha256(whole).hexdigest() == new.root.manifest_sha256


def test_missing_blobs_and_parts_are_unknown(tmp_path: Path) -> None:
    serving = ReleaseServer(tmp_path)
    root = write(tmp_path, [surface(1)])
    assert fetched(serving, "0" * 64)[0].status == "unknown"
    request = MapBlobRequest(time_ns=MADE_NS, sha256=root.manifest_sha256, part=1)
    assert serving.blob(request, time_ns=MADE_NS).reason == "part 1 of 1"


def test_cached_differences_are_bounded(tmp_path: Path) -> None:
    write(tmp_path, [surface(k, 400.0 * k) for k in range(8)])
    release, serving = open_release(tmp_path), ReleaseServer(tmp_path, kept_bytes=1000)
    for _ in range(2):
        for xy in release.tiles("surfaces"):
            digest = release.sha256("surfaces", *xy)
            assert digest is not None
            assert put_together(fetched(serving, digest)) == release.blob("surfaces", *xy)
