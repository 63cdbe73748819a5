"""A vehicle's store: versions go one way, a blob is whole or not there, a full or damaged file harms nothing else."""

from __future__ import annotations

import os
import random
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from camber.road_map.release import BlobMissingError, ReleaseError, open_release, read_release
from camber.road_map.release_files import ROOT_NAME
from camber.road_map.release_watch import ReleaseWatch
from camber.road_map.store import MapStore, StoreFullError
from support.release_world import KEY, OTHER_KEY
from support.small_map import surface, write


@pytest.fixture
def store(tmp_path: Path) -> MapStore:
    return MapStore(tmp_path / "map.sqlite")


def stored(store: MapStore, folder: Path, *, in_force: bool = True, leave_out: int = 0) -> int:
    """Take all of a folder's release into the store; returns its version."""
    release = open_release(folder)
    data = (folder / ROOT_NAME).read_bytes()
    assert store.accept(data, file="root", region=None, public_key=None)
    store.put(release.root.manifest_sha256, release.source.blob(release.root.manifest_sha256, None))
    for digest in sorted(release.hashes())[leave_out:]:
        store.put(digest, release.source.blob(digest, None))
    if in_force:
        store.put_in_force(release.root.map_version)
    return release.root.map_version


def root(folder: Path, version: int, *, region: str = "test", key: Ed25519PrivateKey | None = KEY) -> bytes:
    rows = [surface(1, heights_m=10.0 * version)]
    write(folder / "other", rows, map_version=version, region=region, signing_key=key)
    return (folder / "other" / ROOT_NAME).read_bytes()


def test_a_release_is_read_from_the_store_as_from_its_folder(tmp_path: Path) -> None:
    write(tmp_path / "map", [surface(k, 300.0 * k) for k in range(5)], signing_key=KEY)
    store = MapStore(tmp_path / "map.sqlite")
    assert store.stamp() is None
    stored(store, tmp_path / "map")
    copy, original = read_release(store, public_key=KEY.public_key()), read_release(tmp_path / "map")
    assert copy.manifest == original.manifest
    for xy in original.tiles("surfaces"):
        assert copy.blob("surfaces", *xy) == original.blob("surfaces", *xy)


def test_the_active_release_outlives_the_process_and_is_watched_by_another(tmp_path: Path) -> None:
    store, other = MapStore(tmp_path / "map.sqlite"), MapStore(tmp_path / "map.sqlite")
    watch = ReleaseWatch(other)
    for version in (7, 8, 9):
        write(tmp_path / "map", [surface(1, heights_m=version)], map_version=version)
        stored(store, tmp_path / "map")
        watch.look()
        assert watch.verify(1)
        assert watch.current is not None
        assert watch.current.root.map_version == version
    store.close()
    again = MapStore(tmp_path / "map.sqlite")
    kept = [again.current(), again.previous()]
    assert [each.map_version if each else None for each in kept] == [9, 8]


def test_a_tile_that_was_not_fetched_is_missing_and_not_empty(tmp_path: Path) -> None:
    write(tmp_path / "map", [surface(k, 600.0 * k) for k in range(4)])
    store = MapStore(tmp_path / "map.sqlite")
    stored(store, tmp_path / "map", leave_out=1)
    release = open_release(store)
    missing = [
        xy for xy in release.tiles("surfaces") if store.missing([release.sha256("surfaces", *xy) or ""])
    ]
    assert len(missing) == 1
    with pytest.raises(BlobMissingError):
        release.surface_tile(*missing[0])
    assert release.surface_tile(1, 1) is None


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("other key", "expected key "),
        ("unsigned", "signature is 'none', expected one by key"),
        ("other region", "region is 'elsewhere', expected test"),
        ("older", "map_version is '7', expected 8 or more, which has been here already"),
        ("another of this version", "expected the manifest of version 8 that was accepted before"),
        ("bytes", "ReleaseRoot"),
    ],
)
def test_an_unacceptable_root_is_refused_and_named(
    tmp_path: Path, store: MapStore, name: str, expected: str
) -> None:
    write(tmp_path / "map", [surface(1)], map_version=8, signing_key=KEY)
    stored(store, tmp_path / "map")
    data = {
        "other key": root(tmp_path, 9, key=OTHER_KEY),
        "unsigned": root(tmp_path, 9, key=None),
        "other region": root(tmp_path, 9, region="elsewhere"),
        "older": root(tmp_path, 7),
        "another of this version": root(tmp_path, 8),
        "bytes": b"nothing of the kind",
    }[name]
    with pytest.raises(ReleaseError) as refusal:
        store.accept(data, file="cloud", region=None, public_key=KEY.public_key())
    assert str(refusal.value).startswith("cloud: ")
    assert expected in str(refusal.value)
    assert (store.coming(), store.highest()) == (None, 8)


def test_only_the_operator_goes_back_and_the_release_left_does_not_return(
    tmp_path: Path, store: MapStore
) -> None:
    roots = {}
    for version in (7, 8):
        write(tmp_path / "map", [surface(1, heights_m=version)], map_version=version)
        roots[version] = (tmp_path / "map" / ROOT_NAME).read_bytes()
        stored(store, tmp_path / "map")
    assert store.go_back().map_version == 7
    assert open_release(store).root.map_version == 7
    assert not store.accept(roots[8], file="cloud", region=None, public_key=None)
    assert store.coming() is None
    with pytest.raises(ReleaseError, match="one before"):
        store.go_back()
    assert store.accept(root(tmp_path, 9), file="cloud", region=None, public_key=None)
    states = [(kept.map_version, kept.state) for kept in store.releases()]
    assert states == [(9, "coming"), (8, "left"), (7, "here")]


def test_the_operator_can_allow_lower_versions(tmp_path: Path, store: MapStore) -> None:
    write(tmp_path / "map", [surface(1)], map_version=80)
    stored(store, tmp_path / "map")
    with pytest.raises(ReleaseError, match="80 or more"):
        store.accept(root(tmp_path, 3), file="cloud", region=None, public_key=None)
    store.allow_from(1)
    assert store.accept(root(tmp_path, 3), file="cloud", region=None, public_key=None)


def test_blobs_that_no_kept_release_needs_are_deleted(tmp_path: Path, store: MapStore) -> None:
    for version in (1, 2, 3, 4):
        write(tmp_path / "map", [surface(1, heights_m=version), surface(2, 900.0)], map_version=version)
        stored(store, tmp_path / "map")
    everything = sqlite3.connect(tmp_path / "map.sqlite").execute("SELECT count(*) FROM blob").fetchone()[0]
    assert store.collect(in_use=[2]) == 2  # a manifest and a tile
    assert [kept.map_version for kept in store.releases()] == [4, 3, 2]
    assert store.collect() == 2
    left = sqlite3.connect(tmp_path / "map.sqlite").execute("SELECT count(*) FROM blob").fetchone()[0]
    assert left == everything - 4
    assert len(read_release(store).road_surfaces()) == 2
    store.go_back()
    assert read_release(store).road_surfaces().heights_m[0][0, 0] == 3.0


def test_a_full_store_refuses_and_keeps_its_content(tmp_path: Path) -> None:
    store = MapStore(tmp_path / "map.sqlite", limit_bytes=400_000)
    write(tmp_path / "map", [surface(1)])
    stored(store, tmp_path / "map")

    def fill() -> None:
        for seed in range(100):
            store.put_part("0" * 64, None, seed, np.random.default_rng(seed).bytes(20_000))

    with pytest.raises(StoreFullError, match="free space"):
        fill()
    assert len(read_release(store).road_surfaces()) == 1
    store.drop("0" * 64)
    store.put_part("1" * 64, None, 0, bytes(10_000))


def test_parts_are_those_of_one_base_and_without_gaps(tmp_path: Path, store: MapStore) -> None:
    for number in (0, 1, 3):
        store.put_part("a" * 64, "b" * 64, number, bytes([number]))
    assert store.parts("a" * 64, "b" * 64) == [b"\0", b"\1"]
    assert store.parts("a" * 64, None) == []


def test_a_damaged_file_is_renamed_and_a_new_one_started(tmp_path: Path) -> None:
    path = tmp_path / "map.sqlite"
    path.write_bytes(b"this was a map" * 1000)
    store = MapStore(path)
    assert store.notice is not None
    assert store.stamp() is None
    assert path.with_name("map.sqlite.corrupt").exists()


def test_a_blob_changed_on_the_disk_is_never_returned(tmp_path: Path, store: MapStore) -> None:
    write(tmp_path / "map", [surface(1)])
    stored(store, tmp_path / "map")
    release = open_release(store)
    digest = release.sha256("surfaces", *release.tiles("surfaces")[0])
    assert digest is not None
    with sqlite3.connect(tmp_path / "map.sqlite") as db:
        db.execute("UPDATE blob SET data = zeroblob(length(data)) WHERE sha256 = ?", (digest,))
    with pytest.raises(ReleaseError, match="SHA-256"):
        store.blob(digest, None)
    with pytest.raises(ReleaseError, match="SHA-256"):
        store.put(digest, b"other bytes")


def test_a_store_of_a_later_program_is_not_changed(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "map.sqlite") as db:
        db.execute("PRAGMA user_version = 99")
    with pytest.raises(ReleaseError, match="later version"):
        MapStore(tmp_path / "map.sqlite")


def contents_or_problem(path: Path) -> list[object] | str:
    """What a store says of its releases, or the file that its ReleaseError names."""
    try:
        with closing(MapStore(path)) as store:
            return [store.current(), store.previous(), store.highest(), store.root()]
    except ReleaseError as error:
        return path.name if path.name in str(error) else str(error)


def test_any_changed_byte_is_named_and_never_another_release(tmp_path: Path, store: MapStore) -> None:
    for version in (7, 8):
        write(tmp_path / "map", [surface(1, heights_m=version)], map_version=version)
        stored(store, tmp_path / "map")
    states = [store.current(), store.previous(), store.highest(), store.root()]
    store.close()
    path = tmp_path / "map.sqlite"
    data = path.read_bytes()
    print("seed 24")
    rng = random.Random(24)
    for k in range(200):
        at = rng.randrange(len(data)) if k % 2 else rng.randrange(100)
        damaged = bytearray(data)
        damaged[at] ^= rng.randrange(1, 256)
        path.write_bytes(damaged if k % 10 else data[:at])
        for log in ("-wal", "-shm"):
            path.with_name(path.name + log).unlink(missing_ok=True)
        assert contents_or_problem(path) in (states, "map.sqlite")


def test_facts_that_another_program_has_changed_are_damage(tmp_path: Path, store: MapStore) -> None:
    write(tmp_path / "map", [surface(1)], map_version=7)
    stored(store, tmp_path / "map")
    store.close()
    with sqlite3.connect(tmp_path / "map.sqlite") as db:
        db.execute("UPDATE fact SET value = 3 WHERE name = 'highest'")
    again = MapStore(tmp_path / "map.sqlite")
    assert again.notice is not None
    assert again.highest() is None


def test_a_store_of_before_there_was_a_checksum_is_read_once_and_given_one(
    tmp_path: Path, store: MapStore
) -> None:
    write(tmp_path / "map", [surface(1)], map_version=7)
    stored(store, tmp_path / "map")
    store.close()
    with sqlite3.connect(tmp_path / "map.sqlite") as db:
        db.execute("DELETE FROM fact WHERE name = 'checksum'")
        db.execute("PRAGMA user_version = 1")
    for _ in range(2):
        again = MapStore(tmp_path / "map.sqlite")
        assert (again.highest(), again.notice) == (7, None)
        again.close()


def test_a_pipe_in_the_place_of_a_store_is_one_line_and_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "map.sqlite")
    for read_only in (False, True):
        with pytest.raises(ReleaseError, match="not a plain file"):
            MapStore(tmp_path / "map.sqlite", read_only=read_only)
