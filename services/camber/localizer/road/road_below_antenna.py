"""The road below the antenna, and the vehicle's attitude on it: by a query to the map, or by the last reply."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from camber.geodesy.horizontal_offsets import east_north_between
from camber.localizer.filter.planar_pose import rotated
from camber.localizer.filter.pose_estimate import PoseEstimate
from camber.localizer.map_queries import Diagnostics, MapQueries, MapQueryFailure
from camber.localizer.road.road_prefetch import RoadAhead, places_ahead
from camber.schemas.pose import Road
from camber.schemas.road import ElevationRequest

_PATCH_ABOVE_M = 0.3  # decision 0003: a pose of larger σ gets a patch of the road around it
_PATCH_SIGMAS = 3.7  # 99.9 % of a normal distribution in two dimensions
# Chosen: the most links of a query, the most that are queried one by one, and 99.7 % of a normal error.
_MAX_LINKS = 16
_MAX_SINGLE_QUERIES = 4
_SAME_ROAD_SIGMAS = 3.0
_REMEMBERED_M = 100.0
"""Chosen: distance over which the last road identifies the one that is driven now."""


class _LastRoad(NamedTuple):
    """The last known road and its position; the level is the last certain one."""

    level: int | None
    latitude_rad: float
    longitude_rad: float


class RoadBelowAntenna:
    """Keeps the last road and the roads ahead; no height is used but the map's.

    Where roads part or join, or change their level, several links are candidates, and their surfaces overlap and
    agree: that is one road. Its elevation is known, and stays that of the level it was driven with; its level is
    unknown until the links have one level, or only surfaces of one are below the antenna. Where their edges are
    nearer than the pose's σ, only the links decide.
    """

    def __init__(self, sigma_limit_m: float, map_queries: MapQueries, diagnostics: Diagnostics) -> None:
        self._sigma_limit_m = sigma_limit_m
        self._map_queries, self._diagnostics = map_queries, diagnostics
        self._ahead: RoadAhead | None = None
        self.last = Road(status="unknown", reason="no_pose")
        self._driven: _LastRoad | None = None

    def forget(self) -> None:
        """Forget the last road: the pose has jumped."""
        self._ahead = self._driven = None

    def update(self, estimate: PoseEstimate, latitude_rad: float, longitude_rad: float) -> Road:
        """Return the road below the antenna at this position."""
        driven = self._driven
        if driven is not None:
            away_m = math.hypot(*east_north_between(*driven[1:], latitude_rad, longitude_rad))
            self._driven = driven if away_m <= _REMEMBERED_M else None
        road = self.last = self._query(estimate, latitude_rad, longitude_rad)
        if road.status == "known":
            level = road.level
            if level is None and self._driven is not None:
                level = self._driven.level
            self._driven = _LastRoad(level, latitude_rad, longitude_rad)
        return road

    def _query(self, estimate: PoseEstimate, latitude_rad: float, longitude_rad: float) -> Road:
        sigma_m = estimate.horizontal_sigma_m
        if sigma_m > self._sigma_limit_m:
            return Road(status="unknown", reason="pose_too_uncertain")
        link = estimate.link
        candidates = link.candidates or (() if link.link_id is None else (link.link_id,))
        link_ids = tuple(int(link_id) for link_id in candidates)[:_MAX_LINKS]
        certain = sigma_m <= _PATCH_ABOVE_M
        several_levels = bool(link.candidates) and link.level is None
        if several_levels:
            self._ahead = None  # it holds one surface for each place
        if certain and self._ahead is not None and self._map_queries.is_available():
            place = latitude_rad, longitude_rad
            known = self._ahead.road_at(
                estimate.time_ns, place, link_ids=link_ids, radius_m=_PATCH_SIGMAS * sigma_m
            )
            if known is not None:
                return known
        self._ahead = None
        ahead = places_ahead(estimate.yaw_rad, estimate.speed_m_s or 0.0, estimate.yaw_rate_rad_s or 0.0)
        request = ElevationRequest(
            time_ns=estimate.time_ns,
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            link_ids=link_ids,
            last_surface_id=None if self._driven is None else self.last.surface_id,
            radius_m=0.0 if certain else _PATCH_SIGMAS * sigma_m,
            ahead=ahead if certain and not several_levels else None,
        )
        reply = self._map_queries.elevation(request)
        if isinstance(reply, MapQueryFailure):
            self._diagnostics.issue("no_elevation", reply.text)
            absent = reply.failure in ("absent", "timeout")
            return Road(status="unknown", reason="map_server_absent" if absent else "map_missing")
        ambiguous = reply.road.reason == "levels_ambiguous" and bool(link_ids)
        one = self._one_road(request) if several_levels or ambiguous else None
        if several_levels and (one is None or not certain):
            unlevelled: Road = (one or reply.road).model_copy(update={"level": None})
            return unlevelled
        if one is not None or ambiguous:
            return one or reply.road
        self._ahead = RoadAhead.of(request, reply)
        return reply.road

    def _one_road(self, request: ElevationRequest) -> Road | None:
        """Query the road of each candidate link; return it where they agree, with the level that they share."""
        if len(request.link_ids) > _MAX_SINGLE_QUERIES:
            return None
        roads: list[Road] = []
        for link in request.link_ids:
            alone = request.model_copy(update={"link_ids": (link,), "radius_m": 0.0, "ahead": None})
            reply = self._map_queries.elevation(alone)
            if not isinstance(reply, MapQueryFailure) and reply.road.status == "known":
                roads.append(reply.road)
        if not roads:
            return None
        level = None if self._driven is None else self._driven.level
        road = next((road for road in roads if road.level == level), roads[0])
        apart_m, disagree = _apart(road, roads)
        if disagree:
            return None
        alike = len({road.level for road in roads}) == 1
        sigma_m = max(road.sigma_m or 0.0, apart_m)
        return road.model_copy(update={"sigma_m": sigma_m, "level": road.level if alike else None})


def _apart(road: Road, others: Sequence[Road]) -> tuple[float, bool]:
    """Return the largest height difference of other roads from one, and whether any exceeds the map's error."""
    apart_m, disagree = 0.0, False
    for other in others:
        away_m = abs((other.elevation_m or 0.0) - (road.elevation_m or 0.0))
        disagree |= away_m > _SAME_ROAD_SIGMAS * math.hypot(other.sigma_m or 0.0, road.sigma_m or 0.0)
        apart_m = max(apart_m, away_m)
    return apart_m, disagree


def attitude_on_road(road: Road, yaw_rad: float) -> tuple[float, float]:
    """Return roll and pitch [rad] of a vehicle on this road, pitch positive with the nose down; zero without a road."""
    if road.slope_east is None or road.slope_north is None:
        return 0.0, 0.0
    forward, left = rotated(-yaw_rad, road.slope_east, road.slope_north)
    return math.atan(left * math.cos(math.atan(forward))), -math.atan(forward)
