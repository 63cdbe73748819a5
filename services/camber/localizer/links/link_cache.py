"""The links around the vehicle: fetched when it has moved, when the map has changed, when there are none."""

from __future__ import annotations

import math

from camber.localizer.links.link_matching import LinkMatcher, LinkNetwork
from camber.localizer.local_plane import LocalPlane
from camber.localizer.map_queries import Diagnostics, MapAnswers, NoAnswer
from camber.schemas.road import LinksRequest

_REFETCH_SHARE = 0.4  # of the radius: so far may the vehicle go before links are fetched anew
_FETCH_PAUSE_NS = 1_000_000_000  # between two attempts


class LinkCache:
    """A matcher over the links within `radius_m`."""

    def __init__(self, radius_m: float, answers: MapAnswers, reports: Diagnostics) -> None:
        self._radius_m = radius_m
        self._answers, self._reports = answers, reports
        self._matcher: LinkMatcher | None = None
        self._centre: tuple[float, float] | None = None
        self._version: int | None = None
        self._tried_ns = 0

    def forget(self) -> None:
        """The plane has changed: fetch anew."""
        self._centre, self._tried_ns = None, 0

    def restart(self) -> None:
        """The pose has jumped: what was known of the links driven says nothing any more."""
        if self._matcher is not None:
            self._matcher.reset()

    def note_map_version(self, map_version: int | None) -> None:
        """The elevations come from this version; links of another one are fetched anew."""
        if map_version is not None and self._version is not None and map_version != self._version:
            self._centre = None

    def around(self, plane: LocalPlane, east_m: float, north_m: float, now_ns: int) -> LinkMatcher | None:
        """The matcher over the links around a place in the plane; None where none could be had."""
        here = (east_m, north_m)
        if self._centre is None or math.dist(self._centre, here) > _REFETCH_SHARE * self._radius_m:
            self._fetch(plane, here, now_ns)
        return self._matcher if self._centre is not None else None

    def _fetch(self, plane: LocalPlane, here: tuple[float, float], now_ns: int) -> None:
        if 0 <= now_ns - self._tried_ns < _FETCH_PAUSE_NS:
            return
        self._tried_ns = now_ns
        latitude_rad, longitude_rad = plane.geodetic(*here)
        reply = self._answers.links(
            LinksRequest(
                time_ns=now_ns,
                latitude_rad=latitude_rad,
                longitude_rad=longitude_rad,
                radius_m=self._radius_m,
            )
        )
        if isinstance(reply, NoAnswer):
            self._reports.issue("no_links", reply.text)
            return
        if reply.status != "known":
            self._reports.issue("no_links", reply.reason or "unknown")
            return
        try:
            network = LinkNetwork(plane.links(reply))
        except ValueError as error:
            self._reports.issue("unusable_links", str(error))
            return
        if self._matcher is None:
            self._matcher = LinkMatcher(network)
        else:
            self._matcher.replace_network(network)
        self._centre, self._version = here, reply.map_version
