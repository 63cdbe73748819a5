"""Which shard keeps an observation: by region, so that what is fused together is kept together.

A shard is a part of the world named by the beginning of the keys of its tiles. The key of a Web-Mercator tile at zoom z
is z digits 0 to 3, each the quarter of the tile before it: north-west, north-east, south-west, south-east ("quadkey";
Schwartz, "Bing Maps Tile System", 2009). So `["0", "1", "2", "3"]` are the four quarters of the world, `["0", "1", "2",
"30", "31", "32", "33"]` has the south-eastern one in four again, and `[""]` is one shard for all of it.

To divide a shard, copy its database to each part before the parts take anything in: each then knows what came before.
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
"""What the shard of all is called where a name may not be empty."""


class Shards:
    """The world, divided. Raises ValueError where the keys leave a part of it out or have one twice."""

    def __init__(self, keys: Sequence[str]) -> None:
        self.keys = tuple(sorted(keys))
        if wrong := [key for key in keys if set(key) - set("0123") or len(key) > ZOOM]:
            raise ValueError(f"{wrong[0]!r}: expected up to {ZOOM} digits 0 to 3")
        self._starts = np.array([_start(key) for key in self.keys], np.int64)
        ends = [
            start + 4 ** (ZOOM - len(key))
            for start, key in zip(self._starts.tolist(), self.keys, strict=True)
        ]
        for end, start in zip([0, *ends], [*self._starts.tolist(), 4**ZOOM], strict=True):
            if start != end:
                part = _key(min(start, end))
                what = "no shard has" if start > end else "more than one shard has"
                raise ValueError(f"{what} the tile {part}")

    def name(self, shard: int) -> str:
        """As it stands in subjects and names."""
        return self.keys[shard] or WORLD

    def of(self, latitude_rad: npt.ArrayLike, longitude_rad: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Index (n,) of the shard of n points; beyond 85.05° of latitude, where there are no tiles, the first."""
        x, y = tiles_of(latitude_rad, longitude_rad)
        key = np.zeros(x.shape, np.int64)
        for bit in range(ZOOM):
            key |= ((x >> bit & 1) | (y >> bit & 1) << 1) << (2 * bit)
        key[x < 0] = 0
        return np.searchsorted(self._starts, key, side="right") - 1

    def split(self, contributions: Sequence[Contribution]) -> list[list[tuple[int, Contribution]]]:
        """Of each contribution the parts and their shards, ascending; the same for the same contribution.

        Each part has the contribution's name, in a ledger of its own, and its rows in their order. One without rows is
        the first shard's.
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
    """The first tile at ZOOM that a key stands for."""
    number = int(key, 4) if key else 0
    return int(number * 4 ** (ZOOM - len(key)))


def _key(tile: int) -> str:
    return "".join(str(tile >> 2 * digit & 3) for digit in reversed(range(ZOOM)))
