"""What comes into a vehicle's store: only what is right, only what it lacks, and again from where it was cut off."""

from __future__ import annotations

import hashlib
import random
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.map_server.download_thread import DownloadThread
from camber.map_server.release_download import FolderSupplier, ReleaseDownload, SupplierUnavailableError
from camber.map_update.fusion.correction_rows import NONE
from camber.map_update.release.release_builder import ReleaseBuilder, history
from camber.road_map.release import BlobMissingError, Release, ReleaseError, open_release, read_release
from camber.road_map.store import MapStore, StoreFullError
from support.release_world import KEY, OTHER_KEY, STEP_M, Cloud, making, offsets
from support.small_map import MADE_NS, at, cloud, surface, write

FIVES = offsets(s1=0.05, s3=0.05, s5=0.05)


class Vehicle:
    """A store, and what downloads into it."""

    def __init__(
        self, folder: Path, cloud: Any = None, *, limit_bytes: int = 1 << 30, **options: Any
    ) -> None:
        self.store = MapStore(folder / "map.sqlite", limit_bytes=limit_bytes)
        self.cloud = cloud or Cloud(folder / "out")
        options = {"region": "test", "public_key": KEY.public_key(), "around_m": None, **options}
        self.download = ReleaseDownload(self.store, now_ns=lambda: MADE_NS, **options)

    def ask_and_fetch(self, *, steps: int | None = None) -> None:
        self.download.ask(self.cloud)
        self.fetch(steps=steps)

    def fetch(self, *, steps: int | None = None) -> None:
        for step, _ in enumerate(self.download.fetch(self.cloud)):
            if steps is not None and step + 1 >= steps:
                return

    def surfaces(self) -> int:
        return len(read_release(self.store).road_surfaces())

    @property
    def version(self) -> int | None:
        kept = self.store.current()
        return None if kept is None else kept.map_version


@pytest.fixture
def builder(tmp_path: Path) -> ReleaseBuilder:
    """Has built release 8 of eight surfaces in `out`."""
    builder = making(tmp_path)
    builder.build(NONE, time_ns=MADE_NS)
    return builder


@pytest.fixture
def vehicle(tmp_path: Path, builder: ReleaseBuilder) -> Vehicle:
    """Has downloaded release 8."""
    vehicle = Vehicle(tmp_path)
    vehicle.ask_and_fetch()
    assert vehicle.version == 8
    vehicle.cloud.asked.clear()
    return vehicle


def fetched_in_cuts(folder: Path) -> list[tuple[str, int]]:
    """Download with a connection that is cut after each blob or part; returns blobs and parts as requested."""
    vehicle = Vehicle(folder)
    for cut in range(1, 30):
        vehicle.cloud.cut_after = cut
        try:
            vehicle.ask_and_fetch()
            break
        except SupplierUnavailableError:
            vehicle = Vehicle(folder, vehicle.cloud)  # the process is started anew, too
    asked = [(request.sha256, request.part) for request in vehicle.cloud.asked]
    assert vehicle.version is not None
    assert len(asked) == len(set(asked))
    return asked


def test_a_vehicle_gets_the_release_and_then_only_what_changed(
    tmp_path: Path, builder: ReleaseBuilder, vehicle: Vehicle
) -> None:
    builder.build(offsets(s3=0.05), time_ns=MADE_NS + 1)
    vehicle.ask_and_fetch()
    assert vehicle.version == 9
    newer = vehicle.cloud.asked
    (before,) = [m.manifest for m in history(builder.folder) if m.manifest.map_version == 8]
    changed = open_release(tmp_path / "out").hashes() - {row.tobytes().hex() for row in before.sha256}
    asked = {request.sha256 for request in newer} | {name for each in newer for name in each.more_sha256}
    assert asked == changed | {open_release(tmp_path / "out").root.manifest_sha256}
    assert all(request.base_sha256 is not None for request in newer)
    surfaces = read_release(vehicle.store, public_key=KEY.public_key()).road_surfaces()
    assert surfaces.heights_m[3][0, 0] == pytest.approx(50.05)


def test_a_download_that_is_cut_continues_where_it_was(tmp_path: Path, builder: ReleaseBuilder) -> None:
    assert len(fetched_in_cuts(tmp_path)) > 1


def test_a_large_blob_continues_at_the_part_that_is_missing(tmp_path: Path) -> None:
    write(tmp_path / "out", [surface(1)], clouds=[cloud(1, points=80_000, limit=2**20)], signing_key=KEY)
    assert max(part for _, part in fetched_in_cuts(tmp_path)) >= 2


def test_many_small_differences_come_in_one_reply_that_is_small(tmp_path: Path) -> None:
    builder = making(tmp_path, 24)
    builder.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path)
    vehicle.ask_and_fetch()
    vehicle.cloud.asked.clear()
    builder.build(offsets(**{f"s{k}": 0.05 for k in range(20)}), time_ns=MADE_NS + 1)
    vehicle.ask_and_fetch()
    assert vehicle.version == 9
    manifest, tiles = vehicle.cloud.asked
    assert manifest.more_sha256 == ()
    assert len(tiles.more_sha256) >= 10
    assert {len(name) for name in tiles.more_base_sha256 if name is not None} == {64}
    assert read_release(vehicle.store).road_surfaces().heights_m[19][0, 0] == pytest.approx(50.05)


@pytest.mark.parametrize("sizes", [[10**6], [-5], [2**31 - 1, 2**31 - 1], [1] * 65, [0]])
def test_impossible_sizes_of_more_blobs_are_refused(
    tmp_path: Path, builder: ReleaseBuilder, sizes: list[int]
) -> None:
    vehicle = Vehicle(tmp_path)
    vehicle.cloud.change = {"more_bytes": np.array(sizes, np.int32)}
    with pytest.raises(ReleaseError, match="sizes of more blobs"):
        vehicle.ask_and_fetch()
    assert vehicle.version is None
    vehicle.cloud.change = {}
    vehicle.fetch()
    assert vehicle.version == 8


def test_damaged_blobs_that_came_along_are_fetched_again_and_never_kept(
    builder: ReleaseBuilder, vehicle: Vehicle
) -> None:
    builder.build(FIVES, time_ns=MADE_NS + 1)
    vehicle.cloud.spoil_more = lambda data: bytes(len(data))
    vehicle.ask_and_fetch()
    assert vehicle.version == 9
    for digest in open_release(vehicle.store).hashes():
        assert hashlib.sha256(vehicle.store.blob(digest, None)).hexdigest() == digest


def test_the_old_release_is_in_force_until_all_of_the_new_one_is_here(
    builder: ReleaseBuilder, vehicle: Vehicle
) -> None:
    builder.build(FIVES, time_ns=MADE_NS + 1)
    vehicle.ask_and_fetch(steps=3)
    assert (vehicle.version, vehicle.surfaces()) == (8, 8)
    vehicle.fetch()
    assert vehicle.version == 9


@pytest.mark.parametrize("key", [OTHER_KEY, None])
def test_a_release_signed_with_another_key_is_refused_and_nothing_of_it_is_fetched(
    tmp_path: Path, vehicle: Vehicle, key: Any
) -> None:
    forger = making(tmp_path / "bad", key=key)
    for offset_m in (3.0, 3.1):
        forger.build(offsets(s1=offset_m), time_ns=MADE_NS)
    vehicle.cloud = Cloud(tmp_path / "bad" / "out")
    with pytest.raises(ReleaseError, match=r"key|signature"):
        vehicle.ask_and_fetch()
    assert vehicle.cloud.asked == []
    assert vehicle.version == 8


@pytest.mark.parametrize(
    "spoil", [lambda d: d[: len(d) // 2], lambda d: d[:-1] + bytes([d[-1] ^ 1]), lambda d: b""]
)
def test_truncated_or_damaged_blobs_are_never_kept(
    builder: ReleaseBuilder, vehicle: Vehicle, spoil: Any
) -> None:
    builder.build(offsets(s3=0.05), time_ns=MADE_NS + 1)
    vehicle.cloud.spoil = spoil
    with pytest.raises(ReleaseError):
        vehicle.ask_and_fetch()
    assert vehicle.version == 8
    vehicle.cloud.spoil = lambda data: data
    vehicle.ask_and_fetch()
    assert vehicle.version == 9


def test_where_a_difference_does_not_lead_to_the_blob_the_whole_one_is_fetched(
    builder: ReleaseBuilder, vehicle: Vehicle
) -> None:
    builder.build(offsets(s3=0.05), time_ns=MADE_NS + 1)
    vehicle.cloud.spoil = lambda data: data if data[:1] == b"z" else data[:-1]
    vehicle.ask_and_fetch()
    assert vehicle.version == 9
    assert vehicle.cloud.asked[-1].base_sha256 is None


def test_a_full_store_keeps_the_old_release(tmp_path: Path, vehicle: Vehicle) -> None:
    clouds = [cloud(k, points=9000, limit=2**30, seed=k) for k in range(4)]
    write(tmp_path / "out", [surface(1)], map_version=20, clouds=clouds, signing_key=KEY)
    small = Vehicle(tmp_path, limit_bytes=300_000)
    with pytest.raises(StoreFullError):
        small.ask_and_fetch()
    assert (small.version, small.surfaces()) == (8, 8)
    vehicle.fetch()
    assert vehicle.version == 20


def test_of_a_large_map_the_part_around_the_vehicle_is_kept(tmp_path: Path) -> None:
    making(tmp_path, 40).build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, around_m=1000.0)
    vehicle.ask_and_fetch()
    assert vehicle.version == 8
    release = open_release(vehicle.store)
    assert len(vehicle.store.missing(release.hashes())) == len(release.hashes())
    for place in (0, 20, 39):
        vehicle.download.position_rad = at(STEP_M * place, 0.0)
        vehicle.fetch()
        known = known_surfaces(release)
        assert {k for k in range(40) if abs(k - place) * STEP_M < 1000.0} <= known
        assert known <= {k for k in range(40) if abs(k - place) * STEP_M < 3500.0}
        assert len(vehicle.store.missing(release.hashes())) > 0


def known_surfaces(release: Release) -> set[int]:
    known: set[int] = set()
    for xy in release.tiles("surfaces"):
        try:
            tile = release.surface_tile(*xy)
        except BlobMissingError:
            continue
        assert tile is not None
        known |= set(tile.surface_id.tolist())
    return known


def test_a_newer_release_of_a_part_has_no_less_than_the_old_one(tmp_path: Path) -> None:
    builder = making(tmp_path, 40)
    builder.build(NONE, time_ns=MADE_NS)
    vehicle = Vehicle(tmp_path, around_m=1000.0)
    vehicle.download.position_rad = at(STEP_M * 5, 0.0)
    vehicle.ask_and_fetch()
    before = known_surfaces(open_release(vehicle.store))
    builder.build(offsets(s5=0.1, s30=0.1), time_ns=MADE_NS + 1)
    parked = Vehicle(tmp_path, around_m=1000.0)
    parked.ask_and_fetch()
    assert parked.version == 9
    assert known_surfaces(open_release(parked.store)) == before
    assert len(parked.cloud.asked) < 6


def test_a_folder_supplies_like_the_cloud_and_an_old_one_is_ignored(
    tmp_path: Path, builder: ReleaseBuilder
) -> None:
    vehicle = Vehicle(tmp_path, FolderSupplier(tmp_path / "out"), region=None)
    vehicle.ask_and_fetch()
    assert vehicle.version == 8
    assert not vehicle.download.ask(FolderSupplier(tmp_path / "in"))
    assert vehicle.version == 8


def test_without_a_region_and_without_a_map_the_cloud_cannot_be_asked(tmp_path: Path) -> None:
    with pytest.raises(ReleaseError, match="region, expected a setting"):
        Vehicle(tmp_path, region=None).ask_and_fetch()


def test_a_damaged_blob_is_fetched_again(tmp_path: Path, vehicle: Vehicle) -> None:
    with sqlite3.connect(tmp_path / "map.sqlite") as db:
        db.execute("UPDATE blob SET data = zeroblob(length(data)) WHERE rowid % 2 = 0 AND rowid > 1")
    vehicle.download.drop_damaged()
    assert vehicle.store.missing(open_release(vehicle.store).hashes())
    vehicle.fetch()
    assert vehicle.surfaces() == 8


def thread_of(vehicle: Vehicle, folder: FolderSupplier | None = None) -> DownloadThread:
    intervals = {"ask_every_s": 600.0, "spread_s": 10.0, "retry_every_s": 60.0}
    return DownloadThread(
        vehicle.download,
        cloud=vehicle.cloud,
        folder=folder,
        monotonic_s=lambda: 0.0,
        rng=random.Random(1),
        **intervals,
    )


def run(thread: DownloadThread, from_s: float, until_s: float) -> list[str]:
    """Steps of a second; returns the codes of the problems."""
    for second in np.arange(from_s, until_s):
        thread.step(float(second))
    return [code for code, _ in thread.take_problems()]


def test_a_notice_is_followed_within_its_time_and_a_lost_one_in_the_end(
    tmp_path: Path, builder: ReleaseBuilder
) -> None:
    vehicle = Vehicle(tmp_path)
    thread = thread_of(vehicle)
    run(thread, 0, 2)
    assert vehicle.version == 8
    assert thread.take_change()
    builder.build(offsets(s1=0.1), time_ns=MADE_NS + 1)
    run(thread, 2, 100)
    assert vehicle.version == 8
    assert not thread.take_change()
    thread.notice()
    run(thread, 100, 111)
    assert vehicle.version == 9
    builder.build(offsets(s1=0.2), time_ns=MADE_NS + 2)
    run(thread, 111, 720)
    assert vehicle.version == 10


def test_without_a_connection_queries_become_rarer_and_continue_when_it_is_back(
    tmp_path: Path, builder: ReleaseBuilder
) -> None:
    vehicle = Vehicle(tmp_path)
    vehicle.cloud.cut_after = 1
    thread = thread_of(vehicle)
    codes = run(thread, 0, 600)
    assert set(codes) == {"fetch_unanswered"}
    assert 10 < len(codes) < 40
    assert not thread.troubled
    vehicle.cloud.cut_after = None
    run(thread, 600, 661)
    assert vehicle.version == 8


def test_a_refusal_is_reported_and_the_download_retried_later(
    tmp_path: Path, builder: ReleaseBuilder
) -> None:
    vehicle = Vehicle(tmp_path)
    vehicle.cloud.spoil = lambda data: data[:-1]
    thread = thread_of(vehicle)
    assert run(thread, 0, 130) == ["release_refused"] * 3
    assert thread.troubled
    vehicle.cloud.spoil = lambda data: data
    assert run(thread, 130, 200) == []
    assert (vehicle.version, thread.troubled) == (8, False)


def test_a_folder_without_a_release_is_named_while_there_is_no_map(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path)
    vehicle.cloud.cut_after = 0
    thread = thread_of(vehicle, FolderSupplier(tmp_path / "factory"))
    codes = run(thread, 0, 5)
    assert codes.count("release_absent") == 1
    making(tmp_path / "made").build(NONE, time_ns=MADE_NS)
    (tmp_path / "made" / "out").rename(tmp_path / "factory")
    assert "release_absent" not in run(thread, 5, 10)
    assert vehicle.version == 8
