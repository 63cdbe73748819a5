"""The road under the antenna, and how the vehicle lies on it: asked of the map, or known from its last answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from camber.geodesy.horizontal_offsets import east_north_between
from camber.localizer.filter.pose_filter import PoseEstimate
from camber.localizer.map_queries import Diagnostics, MapAnswers, NoAnswer
from camber.localizer.road.road_prefetch import RoadAhead, places_ahead
from camber.schemas.pose import Road
from camber.schemas.road import ElevationRequest

_PATCH_ABOVE_M = 0.3  # a pose of larger σ gets the road around it too
_PATCH_SIGMAS = 3.7  # 99.9 % of the places where it can be
_MOST_LINKS = 16
_MOST_ASKED_ALONE = 4
_ONE_ROAD_SIGMAS = 3.0
_REMEMBERED_M = 100.0
"""A road that was driven last says so far which one is driven now."""


class _Driven(NamedTuple):
    """The last road that was known, and where; the level is the last that was certain."""

    level: int | None
    latitude_rad: float
    longitude_rad: float


class RoadBelowAntenna:
    """Remembers the last road and what lies ahead; nothing of a height comes in but the map's own.

    Where roads part or join, or change their level, several links are in question, and their surfaces lie on one
    another and agree: that is one road, whichever it turns out to be. Its elevation is known, and stays that of the
    level it was driven with; its level is not known until the links are of one level, or only surfaces of one are left
    under the antenna. Where their edges are nearer than the pose is known, only the links can tell.
    """

    def __init__(self, sigma_limit_m: float, answers: MapAnswers, reports: Diagnostics) -> None:
        self._sigma_limit_m = sigma_limit_m
        self._answers, self._reports = answers, reports
        self._ahead: RoadAhead | None = None
        self._road = Road(status="unknown", reason="no_pose")
        self._driven: _Driven | None = None

    @property
    def last(self) -> Road:
        """The road under the last pose."""
        return self._road

    def forget(self) -> None:
        """The pose has jumped: what was driven before says nothing any more."""
        self._ahead = self._driven = None

    def under(self, estimate: PoseEstimate, latitude_rad: float, longitude_rad: float) -> Road:
        """The road under the antenna at this place."""
        driven = self._driven
        if driven is not None and math.hypot(
            *east_north_between(*driven[1:], latitude_rad, longitude_rad)
        ) > (_REMEMBERED_M):
            self._driven = None
        road = self._road = self._look(estimate, latitude_rad, longitude_rad)
        if road.status == "known":
            level = road.level
            if level is None and self._driven is not None:
                level = self._driven.level
            self._driven = _Driven(level, latitude_rad, longitude_rad)
        return road

    def _look(self, estimate: PoseEstimate, latitude_rad: float, longitude_rad: float) -> Road:
        sigma_m = estimate.horizontal_sigma_m
        if sigma_m > self._sigma_limit_m:
            return Road(status="unknown", reason="pose_too_uncertain")
        candidates = estimate.link_candidates or (() if estimate.link_id is None else (estimate.link_id,))
        link_ids = tuple(int(link) for link in candidates)[:_MOST_LINKS]
        certain = sigma_m <= _PATCH_ABOVE_M
        several_levels = bool(estimate.link_candidates) and estimate.link_level is None
        if several_levels:
            self._ahead = None  # it holds one surface for each place
        if certain and self._ahead is not None and self._answers.is_there():
            place = latitude_rad, longitude_rad
            known = self._ahead.under(estimate.time_ns, *place, link_ids, _PATCH_SIGMAS * sigma_m)
            if known is not None:
                return known
        self._ahead = None
        ahead = places_ahead(estimate.yaw_rad, estimate.speed_m_s or 0.0, estimate.yaw_rate_rad_s or 0.0)
        request = ElevationRequest(
            time_ns=estimate.time_ns,
            latitude_rad=latitude_rad,
            longitude_rad=longitude_rad,
            link_ids=link_ids,
            last_surface_id=None if self._driven is None else self._road.surface_id,
            radius_m=0.0 if certain else _PATCH_SIGMAS * sigma_m,
            ahead=ahead if certain and not several_levels else None,
        )
        reply = self._answers.elevation(request)
        if isinstance(reply, NoAnswer):
            self._reports.issue("no_elevation", reply.text)
            absent = reply.failure in ("absent", "timeout")
            return Road(status="unknown", reason="map_server_absent" if absent else "map_missing")
        ambiguous = reply.road.reason == "levels_ambiguous" and bool(link_ids)
        one = self._one_road(request) if several_levels or ambiguous else None
        if several_levels and (one is None or not certain):
            return (one or reply.road).model_copy(update={"level": None})
        if one is not None or ambiguous:
            return one or reply.road
        self._ahead = RoadAhead.of(request, reply)
        return reply.road

    def _one_road(self, request: ElevationRequest) -> Road | None:
        """The road of each link in question by itself; None where they do not agree. Its level is that of them all."""
        if len(request.link_ids) > _MOST_ASKED_ALONE:
            return None
        roads: list[Road] = []
        for link in request.link_ids:
            alone = request.model_copy(update={"link_ids": (link,), "radius_m": 0.0, "ahead": None})
            reply = self._answers.elevation(alone)
            if not isinstance(reply, NoAnswer) and reply.road.status == "known":
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
    """How far other roads are above or below one at most, and whether any of them is farther than the map errs."""
    apart_m, disagree = 0.0, False
    for other in others:
        away_m = abs((other.elevation_m or 0.0) - (road.elevation_m or 0.0))
        disagree |= away_m > _ONE_ROAD_SIGMAS * math.hypot(other.sigma_m or 0.0, road.sigma_m or 0.0)
        apart_m = max(apart_m, away_m)
    return apart_m, disagree


def attitude_on(road: Road, yaw_rad: float) -> tuple[float, float]:
    """Roll and pitch [rad] of a vehicle that stands evenly on this road, pitch positive with the nose down; zero
    where the road is not known: then nobody knows better."""
    if road.slope_east is None or road.slope_north is None:
        return 0.0, 0.0
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    forward = road.slope_east * cos + road.slope_north * sin
    left = -road.slope_east * sin + road.slope_north * cos
    return math.atan(left * math.cos(math.atan(forward))), -math.atan(forward)
