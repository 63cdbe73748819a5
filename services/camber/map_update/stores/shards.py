"""Shards: the database of an observation depends on its region, so that what is fused together is stored together.

A shard is a part of the world named by a prefix of tile keys. The key of a Web-Mercator tile at zoom z has z digits 0
to 3, each a quarter of the tile before it: north-west, north-east, south-west, south-east ("quadkey"; Schwartz, "Bing
Maps Tile System", 2009). `["0", "1", "2", "3"]` are the four quarters of the world, `["0", "1", "2", "30", "31", "32",
"33"]` divides the south-eastern one again, and `[""]` is one shard for all of it.

To divide a shard, copy its database to each part before the parts receive anything: each then has the whole ledger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from camber.map_update.contribution import Contribution
from camber.road_map.tile_grid import tiles_of
from camber.schemas.road import ZOOM

WORLD = "world"
"""Name of the shard with the empty key."""


class Shards:
    """The division of the world. Raises ValueError if the keys miss a part of it or overlap."""

    def __init__(self, keys: Sequence[str]) -> None:
        self.keys = tuple(sorted(keys))
        if wrong := [key for key in keys if set(key) - set("0123") or len(key) > ZOOM]:
            raise ValueError(f"{wrong[0]!r}: expected up to {ZOOM} digits 0 to 3")
        starts = [_start(key) for key in self.keys]
        self._starts = np.array(starts, np.int64)
        ends = [_start(key) + 4 ** (ZOOM - len(key)) for key in self.keys]
        for end, start in zip([0, *ends], [*starts, 4**ZOOM], strict=True):
            if start != end:
                part = _key(min(start, end))
                what = "no shard has" if start > end else "more than one shard has"
                raise ValueError(f"{what} the tile {part}")

    def name(self, shard: int) -> str:
        """Return the name of a shard in subjects."""
        return self.keys[shard] or WORLD

    def of(self, latitude_rad: npt.ArrayLike, longitude_rad: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the shard index (n,) of n points; 0 beyond 85.05° of latitude, where there are no tiles."""
        x, y = tiles_of(latitude_rad, longitude_rad)
        key = np.zeros(x.shape, np.int64)
        for bit in range(ZOOM):
            key |= ((x >> bit & 1) | (y >> bit & 1) << 1) << (2 * bit)
        key[x < 0] = 0
        return np.searchsorted(self._starts, key, side="right") - 1

    def split(self, contributions: Sequence[Contribution]) -> list[list[tuple[int, Contribution]]]:
        """Return the parts of each contribution with their shards, ascending.

        Each part has the contribution's name, in its shard's ledger, and its rows in their order. A contribution
        without rows belongs to the first shard.
        """
        if len(self.keys) == 1 or not contributions:
            return [[(0, contribution)] for contribution in contributions]
        latitude, longitude = (
            np.concatenate([c.observations[name] for c in contributions])
            for name in ("latitude_rad", "longitude_rad")
        )
        ends = np.cumsum([len(c.observations) for c in contributions])
        of_each = np.split(self.of(latitude, longitude), ends[:-1])
        return [_parts(contribution, of) for contribution, of in zip(contributions, of_each, strict=True)]


def _parts(contribution: Contribution, of: npt.NDArray[np.intp]) -> list[tuple[int, Contribution]]:
    shards = np.unique(of).tolist() if len(of) > 1 else of.tolist() or [0]
    if len(shards) == 1:
        return [(shards[0], contribution)]
    rows = contribution.observations
    return [(shard, replace(contribution, observations=rows[of == shard])) for shard in shards]


def _start(key: str) -> int:
    """Return the first tile at ZOOM of a key."""
    number = int(key, 4) if key else 0
    return int(number * 4 ** (ZOOM - len(key)))


def _key(tile: int) -> str:
    return "".join(str(tile >> 2 * digit & 3) for digit in reversed(range(ZOOM)))
