"""Lanes of a road map, as its reader gives them: cross-sections from end to end, and what they are tied to."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.road_map.tile_checks import MAX_ID

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Lane:
    """One lane in the plane of a frame.

    `sections` (n, k, 3): n ≥ 2 cross-sections along the lane, each of k ≥ 2 points from the right border to the left
    one; east, north [m] in the plane and ellipsoidal height [m]; straight between points. `name` is for people and the
    same in every edition of the map, `plan` says all that the lane's shape in the plane comes from, without heights:
    lanes of equal name and plan are cut alike. `nodes`: names of its two ends, shared with the lanes it goes on to.
    `borders`: names of its right and left border, shared with the lanes beside it. `level`: where the map says it.
    """

    name: str
    plan: str
    link_id: int
    sections: Floats
    nodes: tuple[str, str]
    borders: tuple[str, str]
    level: int | None = None

    @property
    def centre_m(self) -> Floats:
        """Middles of the cross-sections (n, 2)."""
        middle: Floats = 0.5 * (self.sections[:, 0, :2] + self.sections[:, -1, :2])
        return middle


def named_id(*parts: object) -> int:
    """An id that a name gives, the same on every machine: 62 bits of SHA-256. Of ten million names two share an id
    with a probability of 1e-5; RoadSurfaces and RoadLinks refuse such a map."""
    digest = hashlib.sha256("\n".join(map(str, parts)).encode()).digest()
    return int.from_bytes(digest[:8], "big") % MAX_ID
