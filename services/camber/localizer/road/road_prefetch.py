"""Prefetch of the road ahead, requested along with the road at the antenna: most epochs need no query.

Positions are sampled along the arc of speed and yaw rate, and some way to both sides. Off the samples, on another
level, with other links, or after a while, the map is queried again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.horizontal_offsets import east_north_between
from camber.schemas.pose import Road
from camber.schemas.road import ElevationReply, ElevationRequest, Places, RoadsAhead

# Chosen: samples every half metre, one metre to both sides, for the next two seconds.
STEP_M = 0.5
_REACH_M = 0.4  # derived: half the diagonal of STEP_M, and a little for the fan of a curve
_HALF_WIDTH_M = 1.0
_AHEAD_S = 2.0
_MAX_AHEAD_M = 50.0
_SLOW_M_S = 1.0  # below it the yaw rate is mostly noise
_VALID_NS = 2_000_000_000
_ACROSS_M = np.arange(-_HALF_WIDTH_M, _HALF_WIDTH_M + 1e-9, STEP_M)


def places_ahead(yaw_rad: float, speed_m_s: float, yaw_rate_rad_s: float) -> Places:
    """Return positions from half a metre behind the antenna to where it is in two seconds, backwards at negative speed.

    `yaw_rad` counter-clockwise from east.
    """
    length_m = min(abs(speed_m_s) * _AHEAD_S, _MAX_AHEAD_M)
    along_m = np.arange(-STEP_M, length_m + 2.0 * STEP_M, STEP_M)
    signed_m = along_m * (-1.0 if speed_m_s < 0.0 else 1.0)
    turned_rad = yaw_rate_rad_s / np.copysign(max(abs(speed_m_s), _SLOW_M_S), speed_m_s) * signed_m
    chord_m, chord_yaw_rad = signed_m * np.sinc(0.5 * turned_rad / np.pi), yaw_rad + 0.5 * turned_rad
    normal_yaw_rad = yaw_rad + turned_rad + 0.5 * np.pi
    east_m = (chord_m * np.cos(chord_yaw_rad))[:, None] + np.outer(np.cos(normal_yaw_rad), _ACROSS_M)
    north_m = (chord_m * np.sin(chord_yaw_rad))[:, None] + np.outer(np.sin(normal_yaw_rad), _ACROSS_M)
    return Places(east_m=east_m.ravel(), north_m=north_m.ravel())


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadAhead:
    """One reply of the map, and its request."""

    request: ElevationRequest
    road: Road
    known: RoadsAhead
    east_m: NDArray[np.float64]
    north_m: NDArray[np.float64]
    row: NDArray[np.int64]
    """Of all requested positions: east, north, and the row in `known`, −1 without a road."""

    @classmethod
    def of(cls, request: ElevationRequest, reply: ElevationReply) -> RoadAhead | None:
        """Return the roads ahead of a reply; None where it has none, or names positions that were not requested."""
        known, places = reply.ahead, request.ahead
        if known is None or places is None or reply.road.status != "known" or not len(known.place):
            return None
        if int(known.place.max()) >= len(places.east_m):
            return None
        row = np.full(len(places.east_m), -1)
        row[known.place] = np.arange(len(known.place))
        return cls(
            request=request,
            road=reply.road,
            known=known,
            east_m=places.east_m,
            north_m=places.north_m,
            row=row,
        )

    def road_at(
        self, time_ns: int, position: tuple[float, float], *, link_ids: tuple[int, ...], radius_m: float
    ) -> Road | None:
        """Return the road at latitude and longitude, a plane that is valid within `radius_m`; None: query the map."""
        request, known = self.request, self.known
        if not 0 <= time_ns - request.time_ns <= _VALID_NS or link_ids != request.link_ids:
            return None
        east_m, north_m = east_north_between(request.latitude_rad, request.longitude_rad, *position)
        away_m = np.hypot(east_m - self.east_m, north_m - self.north_m)
        place = int(np.argmin(away_m))
        k = int(self.row[place])  # the nearest sample decides; no neighbour replaces an unknown one
        if not away_m[place] <= _REACH_M or k < 0 or known.level[k] != self.road.level:
            return None
        extent_m = float(known.extent_m[k]) - float(away_m[place])
        if not extent_m >= radius_m:
            return None
        slope_east, slope_north = float(known.slope_east[k]), float(known.slope_north[k])
        rise_m = slope_east * (east_m - float(self.east_m[place])) + slope_north * (
            north_m - float(self.north_m[place])
        )
        return Road(
            status="known",
            surface_id=int(known.surface_id[k]),
            level=int(known.level[k]),
            elevation_m=float(known.elevation_m[k]) + rise_m,
            sigma_m=float(known.sigma_m[k]),
            slope_east=slope_east,
            slope_north=slope_north,
            extent_m=extent_m,
            datum=self.road.datum,
            map_version=self.road.map_version,
        )
