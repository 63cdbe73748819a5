"""Select the road surface at a point by links and levels, never by the height under test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from camber.map_server.tile_index import SurfaceHit

TIE_M = 1e-6
"""Resolution of the distance to centre lines: among equally near ones the smaller id is taken; chosen: rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Topology:
    """Links and levels on which the vehicle may be.

    `candidates`: links it may be on; `connected`: the link of its last surface and those that share a node with it;
    `levels`: known levels of the candidates or, without candidates, of the last surface.
    """

    candidates: frozenset[int] = frozenset()
    connected: frozenset[int] = frozenset()
    levels: frozenset[int] = frozenset()


def select_surface(hits: Sequence[SurfaceHit], topology: Topology) -> SurfaceHit | None:
    """Return the surface among those at one point, or None if ambiguous.

    1. Surfaces of candidate links; among them, or without candidates, those connected to the last surface.
    2. If none is left: all, provided that no level known by topology differs from theirs.
    3. The surfaces left must be on one level, or all connected to the last surface: a road that changes its level.
    4. Of these the ones that contain the point, else those within the tolerance. They must agree within their σ; the
       one with the nearest centre line is selected.

    Step 4 compares heights of the map with one another; no measured height enters.
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
