"""What comes into a vehicle's store: only what is right, only what it lacks, and again from where it was cut off."""

from __future__ import annotations

import hashlib
import random
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.map_server.download_thread import DownloadIntervals, DownloadScheduler
from camber.map_server.release_download import (
    FetchRequest,
    FolderSupplier,
    ReleaseDownload,
    SupplierUnavailableError,
    VehiclePosition,
)
from camber.map_update.fusion.corrections import NONE
from camber.map_update.release.release_builder import history
from camber.road_map.release import BlobMissingError, Release, ReleaseError, open_release, read_release
from camber.road_map.store import MapStore, StoreFullError
from camber.schemas.road import CloudTile
from support.release_world import KEY, OTHER_KEY, STEP_M, Cloud, making, offsets
from support.small_map import MADE_NS, at, surface, write


class Vehicle:
    """A store, and what fetches into it."""

    def __init__(self, folder: Path, cloud: Any, *, limit_bytes: int = 1 << 30, **request: Any) -> None:
        self.store = MapStore(folder / "map.sqlite", limit_bytes=limit_bytes)
        self.cloud = cloud
        self.where = VehiclePosition()
        wished = {"region": "test", "public_key": KEY.public_key(), "around_m": None, **request}
        self.fetching = ReleaseDownload(
            self.store, FetchRequest(**wished), self.where, now_ns=lambda: MADE_NS
        )

    def bring(self, *, steps: int | None = None) -> None:
        self.fetching.ask(self.cloud)
        self.go_on(steps=steps)

    def go_on(self, *, steps: int | None = None) -> None:
        for step, _ in enumerate(self.fetching.fetch(self.cloud)):
            if steps is not None and step + 1 >= steps:
                return

    @property
    def version(self) -> int | None:
        kept = self.store.current()
        return None if kept is None else kept.map_version


def test_a_vehicle_gets_the_release_and_then_only_what_changed(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.bring()
    assert vehicle.version == 8
    first = len(vehicle.cloud.asked)
    make.build(offsets(s3=0.05), time_ns=MADE_NS + 1)
    vehicle.bring()
    assert vehicle.version == 9
    newer = vehicle.cloud.asked[first:]
    changed = open_release(tmp_path / "out").hashes() - open_release_of(make, 8)
    asked = {request.sha256 for request in newer} | {name for each in newer for name in each.more_sha256}
    assert asked == changed | {open_release(tmp_path / "out").root.manifest_sha256}
    assert all(request.base_sha256 is not None for request in newer)
    assert read_release(vehicle.store, public_key=KEY.public_key()).road_surfaces().heights_m[3][0, 0] == (
        pytest.approx(50.05)
    )
    assert not vehicle.fetching.lacks()


def open_release_of(make: Any, version: int) -> frozenset[str]:
    """The hashes of an earlier release in the folder."""
    (manifest,) = [m.manifest for m in history(make.folder) if m.manifest.map_version == version]
    return frozenset(row.tobytes().hex() for row in manifest.sha256)


def test_a_fetch_that_is_cut_goes_on_where_it_was(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    for cut in range(1, 30):
        vehicle.cloud.cut_after = cut
        try:
            vehicle.bring()
        except SupplierUnavailableError:
            vehicle = Vehicle(tmp_path, vehicle.cloud)  # the process is started anew, too
        else:
            break
    assert vehicle.version == 8
    asked = [(request.sha256, request.part) for request in vehicle.cloud.asked]
    assert len(asked) == len(set(asked))


def test_many_small_differences_come_in_one_reply_that_is_small(tmp_path: Path) -> None:
    make = making(tmp_path, 24)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.bring()
    vehicle.cloud.asked.clear()
    make.build(offsets(**{f"s{k}": 0.05 for k in range(20)}), time_ns=MADE_NS + 1)
    vehicle.bring()
    assert vehicle.version == 9
    manifest, tiles = vehicle.cloud.asked
    assert manifest.more_sha256 == ()
    assert len(tiles.more_sha256) >= 10
    assert {len(name) for name in tiles.more_base_sha256 if name is not None} == {64}
    assert read_release(vehicle.store).road_surfaces().heights_m[19][0, 0] == pytest.approx(50.05)


@pytest.mark.parametrize(
    "sizes",
    [[10**6], [-5], [2**31 - 1, 2**31 - 1], [1] * 65, [0]],
    ids=["long", "negative", "huge", "many", "none"],
)
def test_sizes_of_more_blobs_that_cannot_be_are_refused(tmp_path: Path, sizes: list[int]) -> None:
    making(tmp_path).build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.cloud.change = {"more_bytes": np.array(sizes, np.int32)}
    with pytest.raises(ReleaseError, match="sizes of more blobs"):
        vehicle.bring()
    assert vehicle.version is None
    vehicle.cloud.change = {}
    vehicle.go_on()
    assert vehicle.version == 8


def test_damaged_blobs_that_came_along_are_fetched_again_and_never_kept(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.bring()
    make.build(offsets(s1=0.05, s3=0.05, s5=0.05), time_ns=MADE_NS + 1)
    vehicle.cloud.spoil_more = lambda data: bytes(len(data))
    vehicle.bring()
    assert vehicle.version == 9
    for digest in open_release(vehicle.store).hashes():
        assert hashlib.sha256(vehicle.store.blob(digest, None)).hexdigest() == digest


def test_a_large_blob_goes_on_at_the_part_that_is_missing(tmp_path: Path) -> None:
    quanta = np.random.default_rng(1).integers(-(2**20), 2**20, (80_000, 3)).astype(np.int32)
    tile = CloudTile(
        time_ns=MADE_NS, x=1, y=2, layer="road_cloud", base_height_m=0.0, resolution_m=0.01, quanta=quanta
    )
    write(tmp_path / "out", [surface(1)], clouds=[tile], signing_key=KEY)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    for cut in range(1, 30):
        vehicle.cloud.cut_after = cut
        try:
            vehicle.bring()
            break
        except SupplierUnavailableError:
            vehicle = Vehicle(tmp_path, vehicle.cloud)
    asked = [(request.sha256, request.part) for request in vehicle.cloud.asked]
    assert len(asked) == len(set(asked))
    assert max(part for _, part in asked) >= 2
    assert vehicle.version == 7


def test_the_old_release_is_in_force_until_all_of_the_new_one_is_here(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.bring()
    make.build(offsets(s1=0.05, s3=0.05, s5=0.05), time_ns=MADE_NS + 1)
    vehicle.bring(steps=3)
    assert vehicle.version == 8
    assert len(read_release(vehicle.store).road_surfaces()) == 8
    vehicle.go_on()
    assert vehicle.version == 9


@pytest.mark.parametrize("key", [OTHER_KEY, None])
def test_a_release_signed_with_another_key_is_refused_and_nothing_of_it_is_fetched(
    tmp_path: Path, key: Any
) -> None:
    making(tmp_path / "good").build(NONE, time_ns=MADE_NS)
    making(tmp_path / "bad", key=key).build(offsets(s1=3.0), time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "good" / "out"))
    vehicle.bring()
    vehicle.cloud = Cloud(tmp_path / "bad" / "out")
    make = making(tmp_path / "bad", key=key)
    make.build(offsets(s1=3.1), time_ns=MADE_NS)
    with pytest.raises(ReleaseError, match=r"key|signature"):
        vehicle.bring()
    assert vehicle.cloud.asked == []
    assert vehicle.version == 8


@pytest.mark.parametrize(
    "spoil", [lambda d: d[: len(d) // 2], lambda d: d[:-1] + bytes([d[-1] ^ 1]), lambda d: b""]
)
def test_truncated_or_damaged_blobs_are_never_kept(tmp_path: Path, spoil: Any) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.bring()
    make.build(offsets(s3=0.05), time_ns=MADE_NS + 1)
    vehicle.cloud.spoil = spoil
    with pytest.raises(ReleaseError):
        vehicle.bring()
    assert vehicle.version == 8
    vehicle.cloud.spoil = lambda data: data
    vehicle.bring()
    assert vehicle.version == 9


def test_where_a_difference_does_not_lead_to_the_blob_the_whole_one_is_fetched(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.bring()
    make.build(offsets(s3=0.05), time_ns=MADE_NS + 1)
    vehicle.cloud.spoil = lambda data: data if data[:1] == b"z" else data[:-1]
    vehicle.bring()
    assert vehicle.version == 9
    assert {request.base_sha256 for request in vehicle.cloud.asked[-1:]} == {None}


def test_a_full_store_keeps_the_old_release(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    Vehicle(tmp_path, Cloud(tmp_path / "out")).bring()
    clouds = [
        CloudTile(
            time_ns=MADE_NS,
            x=k,
            y=2,
            layer="road_cloud",
            base_height_m=0.0,
            resolution_m=0.01,
            quanta=np.random.default_rng(k).integers(-(2**30), 2**30, (9000, 3)).astype(np.int32),
        )
        for k in range(4)
    ]
    write(tmp_path / "out", [surface(1)], map_version=20, clouds=clouds, signing_key=KEY)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"), limit_bytes=300_000)
    with pytest.raises(StoreFullError):
        vehicle.bring()
    assert vehicle.version == 8
    assert len(read_release(vehicle.store).road_surfaces()) == 8
    roomy = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    roomy.go_on()
    assert roomy.version == 20


def test_of_a_large_map_the_part_around_the_vehicle_is_kept(tmp_path: Path) -> None:
    make = making(tmp_path, 40)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"), around_m=1000.0)
    vehicle.bring()
    assert vehicle.version == 8
    release = open_release(vehicle.store)
    assert len(vehicle.store.missing(release.hashes())) == len(release.hashes())
    for place in (0, 20, 39):
        vehicle.where.point_rad = at(STEP_M * place, 0.0)
        assert vehicle.fetching.lacks()
        vehicle.go_on()
        known = known_surfaces(release)
        assert {k for k in range(40) if abs(k - place) * STEP_M < 1000.0} <= known
        assert known <= {k for k in range(40) if abs(k - place) * STEP_M < 3500.0}
        assert len(vehicle.store.missing(release.hashes())) > 0


def known_surfaces(release: Release) -> set[int]:
    found: set[int] = set()
    for xy in release.tiles("surfaces"):
        try:
            tile = release.surface_tile(*xy)
        except BlobMissingError:
            continue
        assert tile is not None
        found |= set(tile.surface_id.tolist())
    return found


def test_a_newer_release_of_a_part_knows_no_less_than_the_old_one(tmp_path: Path) -> None:
    make = making(tmp_path, 40)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"), around_m=1000.0)
    vehicle.where.point_rad = at(STEP_M * 5, 0.0)
    vehicle.bring()
    before = known_surfaces(open_release(vehicle.store))
    make.build(offsets(s5=0.1, s30=0.1), time_ns=MADE_NS + 1)
    parked = Vehicle(tmp_path, Cloud(tmp_path / "out"), around_m=1000.0)
    parked.bring()
    assert parked.version == 9
    assert known_surfaces(open_release(parked.store)) == before
    assert len(parked.cloud.asked) < 6


def test_a_folder_is_taken_in_like_the_cloud_and_an_old_one_is_left(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    folder = FolderSupplier(tmp_path / "out")
    vehicle = Vehicle(tmp_path, folder, region=None)
    vehicle.bring()
    assert vehicle.version == 8
    vehicle.cloud = FolderSupplier(tmp_path / "in")
    assert not vehicle.fetching.ask(vehicle.cloud)
    assert vehicle.version == 8


def test_without_a_region_and_without_a_map_the_cloud_cannot_be_asked(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"), region=None)
    with pytest.raises(ReleaseError, match="region, expected a setting"):
        vehicle.bring()


def test_a_damaged_blob_is_fetched_again(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.bring()
    with sqlite3.connect(tmp_path / "map.sqlite") as db:
        db.execute("UPDATE blob SET data = zeroblob(length(data)) WHERE rowid % 2 = 0 AND rowid > 1")
    vehicle.fetching.drop_damaged()
    assert vehicle.fetching.lacks()
    vehicle.go_on()
    assert len(read_release(vehicle.store).road_surfaces()) == 8


# -- when ------------------------------------------------------------------------------------------------------------


def rounds(vehicle: Vehicle, **times: float) -> DownloadScheduler:
    limits = {"ask_every_s": 600.0, "spread_s": 10.0, "retry_every_s": 60.0, **times}
    return DownloadScheduler(
        vehicle.store,
        vehicle.fetching,
        vehicle.where,
        cloud=vehicle.cloud,
        folder=None,
        times=DownloadIntervals(**limits),
        rng=random.Random(1),
    )


def run(each: DownloadScheduler, from_s: float, until_s: float) -> list[str]:
    """Steps of a second; returns the codes of what went wrong."""
    for second in np.arange(from_s, until_s):
        each.step(float(second), lambda: True, lambda: None)
    return [each.problems.get()[0] for _ in range(each.problems.qsize())]


def test_a_notice_is_followed_within_its_time_and_a_lost_one_in_the_end(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    each = rounds(vehicle)
    run(each, 0, 2)
    assert vehicle.version == 8
    make.build(offsets(s1=0.1), time_ns=MADE_NS + 1)
    run(each, 2, 100)
    assert vehicle.version == 8
    each.noticed = True
    run(each, 100, 111)
    assert vehicle.version == 9
    make.build(offsets(s1=0.2), time_ns=MADE_NS + 2)
    run(each, 111, 720)
    assert vehicle.version == 10


def test_without_a_connection_it_is_tried_less_and_less_often_and_goes_on_when_it_is_back(
    tmp_path: Path,
) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.cloud.cut_after = 1
    each = rounds(vehicle)
    codes = run(each, 0, 600)
    assert set(codes) == {"fetch_unanswered"}
    assert 10 < len(codes) < 40
    assert not each.troubled
    vehicle.cloud.cut_after = None
    run(each, 600, 661)
    assert vehicle.version == 8


def test_what_is_refused_is_said_and_tried_again_after_a_while(tmp_path: Path) -> None:
    make = making(tmp_path)
    make.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    vehicle.cloud.spoil = lambda data: data[:-1]
    each = rounds(vehicle)
    assert run(each, 0, 130) == ["release_refused"] * 3
    assert each.troubled
    vehicle.cloud.spoil = lambda data: data
    assert run(each, 130, 200) == []
    assert (vehicle.version, each.troubled) == (8, False)


def test_a_folder_without_a_release_is_named_while_there_is_no_map(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path, Cloud(tmp_path / "out"))
    each = rounds(vehicle)
    each._folder = FolderSupplier(tmp_path / "factory")
    each._guarded = lambda *_: None  # type: ignore[method-assign,assignment]
    assert run(each, 0, 5) == ["release_absent"]
    making(tmp_path / "made").build(NONE, time_ns=MADE_NS)
    (tmp_path / "made" / "out").rename(tmp_path / "factory")
    assert run(each, 5, 10) == []
    assert each._folder_stamp is not None
