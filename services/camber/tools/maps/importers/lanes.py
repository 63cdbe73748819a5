"""Lanes of a road map, as its reader gives them: cross-sections from end to end, and what they are tied to."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from camber.road_map.road_columns import RoadLinks
from camber.road_map.tile_checks import MAX_ID

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
K = TypeVar("K", bound=Any)

_EARTH_M = 6.371e6  # mean radius of the earth (IUGG)


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


def quantized_degrees(line_rad: Floats) -> list[list[int]]:
    """Places (n, 2) [rad] in units of 1e-8°, a millimetre: a tool that writes the last digits anew moves no line."""
    places: list[list[int]] = np.rint(np.degrees(line_rad) * 1e8).astype(np.int64).tolist()
    return places


def named_links(
    kind: str, vertices: Sequence[Floats], *, level: Integers | None = None, sigma_m: float = 0.5
) -> RoadLinks:
    """Links along lines (k, 2) [rad] whose ids, and those of their nodes, come from their places."""
    places = [quantized_degrees(line) for line in vertices]
    return RoadLinks(
        link_id=np.array([named_id(kind, line) for line in places], np.int64),
        start_node=np.array([named_id("node", line[0]) for line in places], np.int64),
        end_node=np.array([named_id("node", line[-1]) for line in places], np.int64),
        level=np.zeros(len(places), np.int64) if level is None else level,
        sigma_m=np.full(len(places), sigma_m),
        vertices=list(vertices),
    )


def distance_along(line_m: Floats) -> Floats:
    """How far along a line (n, 2 or 3) each of its points is in the plane (n,) [m]."""
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(line_m[:, :2], axis=0).T)))


def line_length_m(line_rad: Floats) -> float:
    """Approximate length of a line (n, 2) [rad] on a sphere."""
    step = np.diff(line_rad, axis=0)
    return float(_EARTH_M * np.hypot(step[:, 0], step[:, 1] * np.cos(line_rad[:-1, 0])).sum())


class JoinedSets(Generic[K]):
    """Sets of keys that were joined; each set is known by its least key (union-find)."""

    def __init__(self) -> None:
        self._parent: dict[K, K] = {}

    def least(self, key: K) -> K:
        """Return the least key of the set that `key` is in."""
        parent = self._parent
        while parent.setdefault(key, key) != key:
            parent[key] = parent[parent[key]]
            key = parent[key]
        return key

    def join(self, a: K, b: K) -> None:
        """Make one set of the two that `a` and `b` are in."""
        first, second = sorted((self.least(a), self.least(b)))
        self._parent[second] = first

    def __iter__(self) -> Iterator[K]:
        """All keys asked for so far."""
        return iter(list(self._parent))


def mean_longitude(longitude_rad: Floats) -> float:
    """The middle of longitudes (n,) [rad], also across the antimeridian."""
    return float(np.angle(np.mean(np.exp(1j * longitude_rad))))
