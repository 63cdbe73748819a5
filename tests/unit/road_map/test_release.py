"""A release is read back as it was written, byte for byte, or it is refused with ReleaseError."""

from __future__ import annotations

import hashlib
import os
import random
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from camber.road_map.release import (
    ROOT_NAME,
    Release,
    ReleaseError,
    RoadLinks,
    RoadSurfaces,
    key_id,
    load_public_key,
    load_signing_key,
    open_release,
    read_release,
)
from camber.road_map.tile_grid import tile_corners_rad, tile_frame
from camber.schemas.codec import encode
from camber.schemas.road import Manifest, ReleaseRoot, SurfaceTile
from support.release_world import KEY, OTHER_KEY
from support.small_map import FRAME, MADE_NS, TILE, cloud, link, surface, surfaces, write


def world(seed: int = 1, *, n: int = 40) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Surfaces of all shapes and some links, scattered over several tiles."""
    rng = np.random.default_rng(seed)
    rows = [
        surface(
            100 + i,
            *rng.uniform(-700.0, 700.0, 2),
            link_id=i % 5,
            level=int(rng.integers(-1, 3)),
            yaw_rad=rng.uniform(-3.0, 3.0),
            half_length_m=rng.uniform(2.0, 30.0),
            half_width_m=rng.uniform(1.0, 5.0),
            sigma_m=rng.uniform(0.01, 0.2),
            heights_m=60.0 + rng.normal(0.0, 0.02, rng.integers(2, 6, 2)),
        )
        for i in range(n)
    ]
    lines = [link(i, (i, i + 1), rng.uniform(-700.0, 700.0, (4, 2)).tolist()) for i in range(5)]
    return rows, lines


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def same(one: RoadSurfaces | RoadLinks, other: RoadSurfaces | RoadLinks, tolerance: float) -> bool:
    pairs = [(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)]
    return all(len(a) == len(b) for a, b in pairs) and all(
        np.shape(a) == np.shape(b) and np.allclose(a, b, rtol=1e-6, atol=tolerance)
        for columns in pairs
        for a, b in zip(*columns, strict=True)
    )


def content(release: Release) -> tuple[Any, ...]:
    """All content of a release, as bytes and plain values."""
    tiles = [
        (layer, *xy, release.blob(layer, *xy))
        for layer in ("surfaces", "links", "environment_cloud", "road_cloud")
        for xy in release.tiles(layer)
    ]
    fields = ("region", "map_version", "datum", "time_ns", "surrogate")
    return tiles, *(getattr(release.manifest, name) for name in fields)


def test_surfaces_and_links_survive_a_round_trip(tmp_path: Path) -> None:
    rows, lines = world()
    write(tmp_path, rows, lines, lineage=[(101, 9), (100, 8)], surrogate="made up")
    release = read_release(tmp_path)
    assert same(release.road_surfaces(), surfaces(rows), 6e-5)
    assert np.allclose(release.road_surfaces().latitude_rad, surfaces(rows).latitude_rad, rtol=0, atol=1e-11)
    assert np.allclose(release.road_surfaces().yaw_rad, surfaces(rows).yaw_rad, rtol=0, atol=1e-9)
    assert np.allclose(release.road_links().vertices, [row["vertices"] for row in lines], rtol=0, atol=1e-11)
    assert release.manifest.surrogate == "made up"
    assert release.manifest.lineage_parent_id.tolist() == [8, 9]


def test_points_survive_a_round_trip(tmp_path: Path) -> None:
    x, y = TILE
    write(tmp_path, [surface(1)], clouds=[cloud(x, y), cloud(x, y, "environment_cloud", seed=3)])
    assert read_release(tmp_path).cloud_tile("road_cloud", x, y) == cloud(x, y)
    assert read_release(tmp_path).cloud_tile("environment_cloud", x, y) == cloud(
        x, y, "environment_cloud", seed=3
    )


def test_an_empty_map_is_a_release(tmp_path: Path) -> None:
    write(tmp_path, [])
    release = read_release(tmp_path)
    assert len(release.road_surfaces()) == 0
    assert len(release.road_links()) == 0
    assert release.surface_tile(0, 0) is None


def test_the_same_map_gives_the_same_bytes_in_any_order(tmp_path: Path) -> None:
    rows, lines = world()
    write(tmp_path / "a", rows, lines, signing_key=KEY)
    write(tmp_path / "b", rows[::-1], lines[::-1], signing_key=KEY)
    assert bytes_of(tmp_path / "a") == bytes_of(tmp_path / "b")


@pytest.mark.parametrize("seed", range(5))
def test_a_map_that_was_read_is_written_as_the_same_blobs(tmp_path: Path, seed: int) -> None:
    first = write(tmp_path / "a", *world(seed))
    read = read_release(tmp_path / "a")
    second = write(tmp_path / "b", [], surfaces=read.road_surfaces(), links=read.road_links())
    assert first == second
    assert bytes_of(tmp_path / "a") == bytes_of(tmp_path / "b")


def test_a_surface_on_the_corner_of_four_tiles_is_whole_in_each(tmp_path: Path) -> None:
    x, y = TILE
    _, west, north, _ = tile_corners_rad(x, y)
    east_m, north_m = FRAME.east_north_from_geodetic(north, west, 0.0)
    write(tmp_path, [surface(5, east_m, north_m, yaw_rad=0.4)])
    release = read_release(tmp_path)
    assert sorted(release.tiles("surfaces")) == [(x - 1, y - 1), (x - 1, y), (x, y - 1), (x, y)]
    # The ends of the rectangle's axis are the same points, from whichever tile they are computed.
    ends = []
    for xy in release.tiles("surfaces"):
        tile = release.surface_tile(*xy)
        assert tile is not None
        along = 10.0 * np.array([np.cos(tile.yaw_rad[0]), np.sin(tile.yaw_rad[0])])
        centre = np.array([tile.centre_east_m[0], tile.centre_north_m[0]])
        latitude, longitude, _ = tile_frame(*xy).geodetic_from_east_north(*(centre + along), 0.0)
        ends.append(FRAME.east_north_from_geodetic(latitude, longitude, 0.0))
    assert np.ptp(ends, axis=0).max() < 1e-4


def test_unchanged_tiles_stay_the_same_blobs(tmp_path: Path) -> None:
    rows, lines = world()
    first = write(tmp_path, rows, lines)
    before = bytes_of(tmp_path)
    assert rows[0]["surface_id"] == 100
    changed = [rows[0] | {"heights_m": rows[0]["heights_m"] + 0.1}, *rows[1:]]
    write(tmp_path, changed, lines, map_version=8, time_ns=MADE_NS + 10**9, previous=first)
    new = set(bytes_of(tmp_path)) - set(before)
    touched = [x for x in read_release(tmp_path).tiles("surfaces") if 100 in _ids(tmp_path, x)]
    assert len(new) == len(touched) + 1  # and the manifest
    assert read_release(tmp_path).manifest.previous_sha256 == first.manifest_sha256


def _ids(folder: Path, xy: tuple[int, int]) -> list[int]:
    tile = read_release(folder).surface_tile(*xy)
    assert tile is not None
    return tile.surface_id.tolist()


def test_a_signed_release_is_read_with_its_key_and_with_none(tmp_path: Path) -> None:
    root = write(tmp_path, [surface(1)], signing_key=KEY)
    assert root.key_id == key_id(KEY.public_key())
    assert read_release(tmp_path, public_key=KEY.public_key()).root == root
    assert read_release(tmp_path).root == root


@pytest.mark.parametrize(
    ("key", "changed", "message"),
    [
        (None, {}, r"root\.msgpack: signature is 'none', expected one by key"),
        (OTHER_KEY, {}, "key_id"),
        (OTHER_KEY, {"key_id": key_id(KEY.public_key())}, "signature"),
        (KEY, {"region": "elsewhere"}, "signature"),
        (KEY, {"map_version": 8}, "signature"),
        (KEY, {"manifest_sha256": "ab" * 32}, "signature"),
        (KEY, {"time_ns": MADE_NS + 1}, "signature"),
        (KEY, {"signature": np.zeros(64, np.uint8)}, "signature"),
    ],
)
def test_a_root_that_the_key_did_not_sign_is_refused(
    tmp_path: Path, key: Any, changed: dict[str, Any], message: str
) -> None:
    root = write(tmp_path, [surface(1)], signing_key=key)
    (tmp_path / ROOT_NAME).write_bytes(encode(ReleaseRoot(**root.__dict__ | changed)))
    with pytest.raises(ReleaseError, match=message):
        read_release(tmp_path, public_key=KEY.public_key())


def test_keys_are_read_from_pem_files(tmp_path: Path) -> None:
    private, public = tmp_path / "release.key", tmp_path / "release.pub"
    private.write_bytes(KEY.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    public.write_bytes(KEY.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    ids = {key_id(load_signing_key(private).public_key()), key_id(load_public_key(public))}
    assert ids == {key_id(KEY.public_key())}


def test_files_without_an_ed25519_key_are_refused(tmp_path: Path) -> None:
    other = generate_private_key(SECP256R1())
    (tmp_path / "a").write_bytes(other.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    (tmp_path / "b").write_bytes(
        other.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    )
    (tmp_path / "c").write_bytes(b"no key")
    for name in ("a", "b", "c", "missing"):
        with pytest.raises(ReleaseError, match="signing key, expected an Ed25519 key"):
            load_signing_key(tmp_path / name)
        with pytest.raises(ReleaseError, match="public key, expected an Ed25519 key"):
            load_public_key(tmp_path / name)


@pytest.mark.parametrize("seed", range(4))
def test_a_damaged_release_is_refused_or_unchanged(tmp_path: Path, seed: int) -> None:
    """Bits flipped, files cut, lengthened, emptied, exchanged: nothing but ReleaseError, and no altered data."""
    x, y = TILE
    rows, lines = world(seed, n=6)
    write(tmp_path, rows, lines, clouds=[cloud(x, y)])
    want = content(read_release(tmp_path))
    files = sorted(p for p in tmp_path.rglob("*") if p.is_file())
    rng = random.Random(seed)
    refused = []
    for _ in range(150):
        path = rng.choice(files)
        good = path.read_bytes()
        path.write_bytes(_damaged(good, rng, rng.choice(files)))
        try:
            assert content(read_release(tmp_path)) == want
        except ReleaseError as error:
            refused.append(str(error))
        path.write_bytes(good)
    assert all("\n" not in text and str(tmp_path) in text for text in refused)
    assert len(refused) > 100


def _damaged(good: bytes, rng: random.Random, other: Path) -> bytes:
    bad = bytearray(good)
    match rng.randrange(6):
        case 0:
            return bytes(bad[: rng.randrange(len(bad))])
        case 1:
            return bytes(bad) + rng.randbytes(rng.randrange(1, 9))
        case 2:
            return other.read_bytes()
        case 3:
            begin = rng.randrange(len(bad))
            bad[begin : begin + 16] = rng.randbytes(16)
        case _:
            bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
    return bytes(bad)


def test_every_bit_of_the_root_is_covered_by_the_signature(tmp_path: Path) -> None:
    root = write(tmp_path, [surface(1)], signing_key=KEY)
    path = tmp_path / ROOT_NAME
    good, want = path.read_bytes(), content(read_release(tmp_path))
    for bit in range(8 * len(good)):
        bad = bytearray(good)
        bad[bit // 8] ^= 1 << bit % 8
        path.write_bytes(bad)
        try:
            release = open_release(tmp_path, public_key=KEY.public_key())
        except ReleaseError:
            continue
        assert release.root == root  # its version and time, too
        assert content(release) == want


def test_missing_files_folders_and_pipes_are_refused(tmp_path: Path) -> None:
    write(tmp_path, [surface(1)])
    for path in [p for p in tmp_path.rglob("*") if p.is_file()]:
        good = path.read_bytes()
        path.unlink()
        with pytest.raises(ReleaseError, match="readable file"):
            read_release(tmp_path)
        path.mkdir()
        with pytest.raises(ReleaseError, match="not a plain file"):
            read_release(tmp_path)
        path.rmdir()
        os.mkfifo(path)
        with pytest.raises(ReleaseError, match="not a plain file"):
            read_release(tmp_path)
        path.unlink()
        path.write_bytes(good)
    assert read_release(tmp_path).manifest.map_version == 7
    with pytest.raises(ReleaseError, match="readable file"):
        read_release(tmp_path / "nowhere")


def test_a_damaged_blob_is_repaired_by_writing_again(tmp_path: Path) -> None:
    write(tmp_path, *world())
    good = bytes_of(tmp_path)
    for path in (tmp_path / "blobs").rglob("*"):
        if path.is_file():
            path.write_bytes(b"rot")
    write(tmp_path, *world())
    assert bytes_of(tmp_path) == good


def _forge(folder: Path, **changed: Any) -> None:
    """Put a changed surface tile into a release, with all hashes right: what a faulty writer could make."""
    release = open_release(folder)
    tile = release.surface_tile(*TILE)
    assert tile is not None
    blob = encode(SurfaceTile(**tile.__dict__ | changed))
    digest = hashlib.sha256(blob)
    manifest = release.manifest
    entry = {"sha256": np.frombuffer(digest.digest(), np.uint8)[None], "size_bytes": np.array([len(blob)])}
    head = encode(Manifest(**manifest.__dict__ | entry))
    name = hashlib.sha256(head).hexdigest()
    for sha256, data in ((digest.hexdigest(), blob), (name, head)):
        path = folder / "blobs" / sha256[:2] / sha256
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    (folder / ROOT_NAME).write_bytes(encode(ReleaseRoot(**release.root.__dict__ | {"manifest_sha256": name})))


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"x": 3}, "x, y"),
        ({"surface_id": np.array([-1])}, "surface_id of -1"),
        ({"level": np.array([21], np.int32)}, "level of 1"),
        ({"half_width_m": np.array([0.0], np.float32)}, "half_width_m of 1"),
        ({"half_length_m": np.array([1e6], np.float32)}, "half_length_m of 1"),
        ({"yaw_rad": np.array([1e300])}, "yaw_rad of 1"),
        ({"centre_east_m": np.array([1e9])}, "centre_east_m of 1"),
        ({"grid_m": np.array([0, 0, 0, 50], np.float32)}, "grid_m of 1"),
        ({"base_height_m": 99_999.0}, "grid_m"),
    ],
)
def test_a_consistent_release_of_impossible_tiles_is_refused(
    tmp_path: Path, changed: dict[str, Any], field: str
) -> None:
    write(tmp_path, [surface(1)])
    _forge(tmp_path, **changed)
    with pytest.raises(ReleaseError, match=field):
        read_release(tmp_path)


def test_a_write_that_is_interrupted_leaves_the_old_release(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, *world())
    want = content(read_release(tmp_path))
    replace, left = os.replace, [0]

    def failing(source: Any, target: Any) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise OSError("no space left")
        replace(source, target)

    monkeypatch.setattr(os, "replace", failing)
    interrupted = 0
    for n in range(100):
        left[0] = n
        try:
            write(tmp_path, *world(seed=3, n=5), map_version=8 + n)
        except OSError:
            interrupted += 1
            assert content(read_release(tmp_path)) == want
            assert not [p for p in tmp_path.rglob(".*") if p.is_file()]
        else:
            break
    assert interrupted > 3
    assert read_release(tmp_path).manifest.map_version > 7


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"surface_id": -1}, r"surfaces: surface_id\[0\], expected 0 to"),
        ({"surface_id": 1.5}, "surface_id, expected numbers"),
        ({"level": 21}, "level"),
        ({"latitude_rad": 1.5}, "latitude_rad"),
        ({"longitude_rad": 3.2}, "longitude_rad"),
        ({"half_width_m": 0.0}, "half_width_m"),
        ({"sigma_m": float("nan")}, "sigma_m, expected a column of finite numbers"),
        ({"sigma_m": -0.1}, "sigma_m"),
        ({"heights_m": np.zeros((1, 2))}, "heights_m"),
        ({"heights_m": np.full((2, 2), np.inf)}, "heights_m"),
        ({"heights_m": np.full((2, 2), 1e6)}, "heights_m"),
        ({"heights_m": np.array([[0.0, 0.0], [90.0, 90.0]])}, "slopes of at most 2"),
    ],
)
def test_impossible_surfaces_are_not_written(tmp_path: Path, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ReleaseError, match=message):
        write(tmp_path, [surface(1) | changed])
    assert bytes_of(tmp_path) == {}


def test_inconsistent_tables_are_not_written(tmp_path: Path) -> None:
    x, y = TILE
    refused: list[tuple[str, dict[str, Any]]] = [
        ("each id once", {"surface_rows": [surface(1), surface(1, 50.0)]}),
        ("a surface of this release", {"lineage": [(2, 1)]}),
        ("each tile of a layer once", {"clouds": [cloud(x, y), cloud(x, y)]}),
        ("environment_cloud or road_cloud", {"clouds": [cloud(x, y, "links")]}),
        ("region test and more than 9", {"previous": write(tmp_path / "old", [surface(1)], map_version=9)}),
        ("datum", {"datum": "no name"}),
        ("k at least 2", {"link_rows": [link(1, (1, 2), [(0.0, 0.0)])]}),
    ]
    for message, arguments in refused:
        with pytest.raises(ReleaseError, match=message):
            write(tmp_path / "new", **{"surface_rows": [surface(1)]} | arguments)
    assert bytes_of(tmp_path / "new") == {}
