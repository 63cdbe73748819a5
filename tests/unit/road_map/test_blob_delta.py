"""What travels is small, and what comes out is the blob again or an error, whatever happens in transit."""

from __future__ import annotations

import os
import random
from typing import Any

import numpy as np
import pytest
import zstandard

from camber.road_map.blob_delta import compress_blob, decompress_blob
from camber.road_map.release import ReleaseError
from camber.road_map.road_tiles import surface_tiles
from camber.schemas.codec import encode
from camber.schemas.road import SurfaceTile
from support.small_map import DAY_NS, MADE_NS, surface, surfaces


def a_tile(count: int = 300, seed: int = 3) -> SurfaceTile:
    rng = np.random.default_rng(seed)
    rows = [
        surface(
            10_000 + 7 * k,
            *rng.uniform(-90.0, 90.0, 2),
            yaw_rad=rng.uniform(-3.0, 3.0),
            heights_m=60.0 + np.cumsum(rng.normal(0.0, 0.05, (6, 3)), axis=0),
        )
        for k in range(count)
    ]
    return max(surface_tiles(surfaces(rows)), key=lambda tile: len(tile.surface_id))


def changed(
    tile: SurfaceTile, rows: list[int], seed: int = 4, *, bent: bool = False, **others: Any
) -> SurfaceTile:
    """The tile with other heights, σ, vehicles and times of some surfaces."""
    rng = np.random.default_rng(seed)
    columns = {name: getattr(tile, name).copy() for name in ("grid_m", "sigma_m", "vehicles", "last_seen_ns")}
    newest = MADE_NS + 30 * DAY_NS
    for row in rows:
        nodes = slice(tile.first_height[row], tile.first_height[row] + tile.rows[row] * tile.columns[row])
        steps = rng.integers(-3000, 3000, tile.rows[row] * tile.columns[row] if bent else 1)
        heights_m = np.round(tile.base_height_m + columns["grid_m"][nodes].astype(float), 4)
        columns["grid_m"][nodes] = np.round(heights_m + steps / 10_000, 4) - tile.base_height_m
        columns["sigma_m"][row] = rng.integers(20, 200) / 10_000
        columns["vehicles"][row] = rng.integers(5, 400)
        columns["last_seen_ns"][row] = newest - rng.integers(0, 9) * DAY_NS
    return SurfaceTile(**tile.__dict__ | columns | {"time_ns": newest} | others)


@pytest.mark.parametrize("bent", [False, True])
def test_changes_of_surfaces_survive_a_round_trip(bent: bool) -> None:
    old = a_tile()
    base = encode(old)
    for seed in range(5):
        rows = sorted(random.Random(seed).sample(range(len(old.rows)), 4 * seed + 1))
        new = encode(changed(old, rows, seed, bent=bent))
        small = compress_blob(new, base)
        assert small[:1] == b"s"
        assert decompress_blob(small, base) == new


def test_twenty_changed_surfaces_of_a_thousand_take_a_few_hundred_bytes() -> None:
    old = a_tile(1600)
    rows = random.Random(1).sample(range(len(old.rows)), 20)
    base, new = encode(old), encode(changed(old, rows))
    assert len(old.rows) >= 1000
    assert len(compress_blob(new, base)) < 300 < len(compress_blob(new)) / 100


def test_other_changes_are_sent_as_a_difference_of_bytes() -> None:
    old = a_tile()
    base = encode(old)
    odd = changed(old, [3], sigma_m=old.sigma_m + np.float32(1e-7))
    moved = changed(old, [3], yaw_rad=old.yaw_rad + 0.1)
    for new in (odd, moved, a_tile(200)):
        small = compress_blob(encode(new), base)
        assert small[:1] == b"p"
        assert decompress_blob(small, base) == encode(new)
        assert len(small) < len(compress_blob(encode(new)))


def test_any_bytes_survive_a_round_trip_with_and_without_a_base() -> None:
    chance = random.Random(5)
    for size in (0, 1, 1000, 300_000, 1_500_000):
        base = chance.randbytes(size)
        blob = base[: size // 2] + b"new" + base[size // 2 :]
        assert decompress_blob(compress_blob(blob), None) == blob
        assert decompress_blob(compress_blob(blob, base), base) == blob
        assert size < 1000 or len(compress_blob(blob, base)) < 200


def test_a_wrong_base_never_gives_the_blob() -> None:
    old = a_tile()
    base, new = encode(old), encode(changed(old, [1, 2]))
    for small in (compress_blob(new, base), b"p" + compress_blob(new, new[:-1])[1:]):
        try:
            other = decompress_blob(small, encode(a_tile(300, 9)))
        except ReleaseError:
            continue
        assert other != new


@pytest.mark.parametrize(
    "data", [b"", b"x", b"z", b"p", b"s", b"zabc", b"s" + zstandard.compress(b"\xff" * 12)]
)
def test_bytes_without_an_encoding_are_refused(data: bytes) -> None:
    with pytest.raises(ReleaseError):
        decompress_blob(data, encode(a_tile(20)))


def test_a_difference_without_its_base_is_refused() -> None:
    old = a_tile(20)
    with pytest.raises(ReleaseError, match="without another blob"):
        decompress_blob(compress_blob(encode(changed(old, [1])), encode(old)), None)


def test_unpacking_is_limited_to_the_size_of_the_blob() -> None:
    bomb = compress_blob(bytes(10_000_000))
    assert len(bomb) < 2000
    with pytest.raises(ReleaseError, match="at most 1000 bytes"):
        decompress_blob(bomb, None, limit=1000)


def test_damage_in_transit_gives_an_error_or_other_bytes() -> None:
    seed = int(os.environ.get("CAMBER_SEED", "11"))
    chance = random.Random(seed)
    old = a_tile(60)
    base, new = encode(old), encode(changed(old, [2, 5, 11]))
    small = compress_blob(new, base)
    outcomes = set()
    for _ in range(300):
        bad = bytearray(small)
        for _ in range(chance.randint(1, 3)):
            bad[chance.randrange(len(bad))] ^= 1 << chance.randrange(8)
        try:
            outcomes.add(decompress_blob(bytes(bad[: chance.randint(1, len(bad))]), base) == new)
        except ReleaseError:
            outcomes.add(None)
    assert None in outcomes, seed
