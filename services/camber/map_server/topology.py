"""Which surface at a point is the road the vehicle is on: by links and levels, never by the height under test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from camber.map_server.tile_index import SurfaceHit

TIE_M = 1e-6
"""Centre lines this near to one another are equally near: the smaller id is taken."""


@dataclass(frozen=True, slots=True)
class Topology:
    """What is known of where the vehicle can be.

    `candidates`: links it may be on; `connected`: the link of its last surface and those that share a node with it;
    `levels`: levels of the candidates or, without candidates, of the last surface, as far as the map knows them.
    """

    candidates: frozenset[int] = frozenset()
    connected: frozenset[int] = frozenset()
    levels: frozenset[int] = frozenset()


def select_surface(hits: Sequence[SurfaceHit], topology: Topology) -> SurfaceHit | None:
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
    chosen = min(left, key=lambda hit: (round(hit.offset_m / TIE_M), hit.surface_id))
    return chosen if _agree(left, chosen) else None


def _agree(hits: Sequence[SurfaceHit], with_hit: SurfaceHit) -> bool:
    return all(abs(hit.height_m - with_hit.height_m) <= hit.sigma_m + with_hit.sigma_m for hit in hits)
