"""Cache of the links around the vehicle: fetched after some distance, after a change of the map, and while there
are none."""

from __future__ import annotations

import math

from camber.localizer.links.link_matching import LinkMatcher, LinkNetwork
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_queries import Diagnostics, MapQueries, MapQueryFailure
from camber.schemas.road import LinksRequest

_REFETCH_SHARE = 0.4  # chosen: of the radius, distance after which links are fetched again
_FETCH_PAUSE_NS = 1_000_000_000  # chosen: between two attempts


class LinkCache:
    """Provides a matcher over the links within `radius_m`."""

    def __init__(self, radius_m: float, map_queries: MapQueries, diagnostics: Diagnostics) -> None:
        self._radius_m = radius_m
        self._map_queries, self._diagnostics = map_queries, diagnostics
        self._matcher: LinkMatcher | None = None
        self._centre: tuple[float, float] | None = None
        self._version: int | None = None
        self._tried_ns = 0

    def forget(self) -> None:
        """Fetch again: the plane has changed."""
        self._centre, self._tried_ns = None, 0

    def restart(self) -> None:
        """Clear the matcher's history: the pose has jumped."""
        if self._matcher is not None:
            self._matcher.reset()

    def note_map_version(self, map_version: int | None) -> None:
        """Note the map version of the elevations; links of another one are fetched again."""
        if map_version is not None and self._version is not None and map_version != self._version:
            self._centre = None

    def matcher_at(self, plane: LocalPlane, east_m: float, north_m: float, now_ns: int) -> LinkMatcher | None:
        """Return the matcher over the links around a position in the plane; None without links."""
        here = (east_m, north_m)
        if self._centre is None or math.dist(self._centre, here) > _REFETCH_SHARE * self._radius_m:
            self._fetch(plane, here, now_ns)
        return self._matcher if self._centre is not None else None

    def _fetch(self, plane: LocalPlane, here: tuple[float, float], now_ns: int) -> None:
        if 0 <= now_ns - self._tried_ns < _FETCH_PAUSE_NS:
            return
        self._tried_ns = now_ns
        latitude_rad, longitude_rad = plane.geodetic(*here)
        reply = self._map_queries.links(
            LinksRequest(
                time_ns=now_ns,
                latitude_rad=latitude_rad,
                longitude_rad=longitude_rad,
                radius_m=self._radius_m,
            )
        )
        if isinstance(reply, MapQueryFailure) or reply.status != "known":
            text = reply.text if isinstance(reply, MapQueryFailure) else reply.reason or "unknown"
            self._diagnostics.issue("no_links", text)
            return
        try:
            network = LinkNetwork(plane.links(reply))
        except ValueError as error:
            self._diagnostics.issue("unusable_links", str(error))
            return
        if self._matcher is None:
            self._matcher = LinkMatcher(network)
        else:
            self._matcher.replace_network(network)
        self._centre, self._version = here, reply.map_version
