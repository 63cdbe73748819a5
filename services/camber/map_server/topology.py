"""Which surface at a point is the road the vehicle is on: by links and levels, never by the height under test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.map_server.tile_index import Hit, Hits, TileIndex

_TIE_M = 1e-6  # centre lines this near to one another are equally near: the smaller id is taken


@dataclass(frozen=True, slots=True)
class Topology:
    """What is known of where the vehicle can be.

    `candidates`: links it may be on; `connected`: the link of its last surface and those that share a node with it;
    `levels`: levels of the candidates or, without candidates, of the last surface, as far as the map knows them.
    """

    candidates: frozenset[int] = frozenset()
    connected: frozenset[int] = frozenset()
    levels: frozenset[int] = frozenset()


def choose(hits: Sequence[Hit], topology: Topology) -> Hit | None:
    """The surface among those at one point, or None where it is ambiguous.

    1. Surfaces of candidate links; among them, or where no candidates were given, those connected to the last surface.
    2. Where that leaves none: all, provided that nothing that is known of the topology is on another level.
    3. What is left must be on one level, or all connected to the last surface: where a road changes its level.
    4. Of that level those that contain the point (else those within the tolerance), which must agree within their σ;
       the one whose centre line is nearest.

    In 4 the heights of the map are compared with one another; no height from outside enters.
    """
    plausible = [hit for hit in hits if hit.link_id in topology.candidates]
    if plausible or not topology.candidates:
        plausible = [hit for hit in plausible or hits if hit.link_id in topology.connected] or plausible
    left = plausible or hits
    levels = {hit.level for hit in left}
    if len(levels) > 1 and any(hit.link_id not in topology.connected for hit in left):
        return None
    if not plausible and topology.levels - levels:
        return None
    left = [hit for hit in left if hit.inside] or left
    chosen = min(left, key=lambda hit: (round(hit.offset_m / _TIE_M), hit.surface_id))
    return chosen if _agree(left, chosen) else None


def _agree(hits: Sequence[Hit], with_hit: Hit) -> bool:
    return all(abs(hit.height_m - with_hit.height_m) <= hit.sigma_m + with_hit.sigma_m for hit in hits)


def choose_each(
    index: TileIndex, hits: Hits, topology: Topology
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """`choose` for each point that has hits: ascending numbers into `hits`, without the points that are ambiguous.

    And, of the first hits of points, those where all surfaces are on levels that no candidate is on: by topology the
    vehicle is not there.
    """
    if not len(hits.point):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    _, first, count = np.unique(hits.point, return_index=True, return_counts=True)
    group = np.repeat(np.arange(len(first)), count)

    def any_of(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """For each hit: is it so for any hit of its point?"""
        of_group: NDArray[np.bool_] = np.logical_or.reduceat(mask, first)[group]
        return of_group

    def those(mask: NDArray[np.bool_], otherwise: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return np.where(any_of(mask), mask, otherwise)

    link, level = index.link_id[hits.row], index.level[hits.row]
    sigma_m, surface = index.sigma_m[hits.row], index.surface_id[hits.row]
    connected = np.isin(link, list(topology.connected))
    plausible = np.isin(link, list(topology.candidates))
    everything = np.ones(len(link), bool)
    plausible = those(plausible & connected, plausible) if topology.candidates else connected
    left = those(plausible, everything)
    low = np.minimum.reduceat(np.where(left, level, np.iinfo(np.int64).max), first)[group]
    high = np.maximum.reduceat(np.where(left, level, np.iinfo(np.int64).min), first)[group]
    ambiguous = (low != high) & any_of(left & ~connected)
    for known_level in topology.levels:
        ambiguous |= ~any_of(plausible) & ~any_of(left & (level == known_level))
    elsewhere = ~any_of(plausible | np.isin(level, list(topology.levels)))
    if not (topology.candidates and topology.levels):
        elsewhere[:] = False
    left = those(left & hits.inside, left)
    tie = np.rint(hits.offset_m / _TIE_M).astype(np.int64)
    order = np.lexsort((surface, tie, ~left, group))
    best = order[np.searchsorted(group[order], np.arange(len(first)))]
    disagree = np.abs(hits.height_m - hits.height_m[best][group]) > sigma_m + sigma_m[best][group]
    ambiguous |= any_of(left & disagree)
    return np.sort(best[~ambiguous[first]]), first[elsewhere[first]]
