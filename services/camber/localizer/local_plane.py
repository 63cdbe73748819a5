"""The local tangent plane in which the localizer computes: east and north [m] from an origin near the vehicle."""

from __future__ import annotations

import math

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.localizer.links.link_matching import RoadLink
from camber.schemas.road import LinksReply

MOVE_AFTER_M = 2000.0
"""Derived: at this distance from the origin north is off by 0.01° at 35° latitude; beyond it the origin moves."""

_EARTH_RADIUS_M = 6.371e6  # mean radius, IUGG


class LocalPlane:
    """A local tangent plane on the ellipsoid, without heights."""

    def __init__(self, latitude_rad: float, longitude_rad: float) -> None:
        self._frame = LocalFrame(latitude_rad, longitude_rad, 0.0)

    def east_north(self, latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
        """Return plane coordinates [m] of a position."""
        return self._frame.east_north_from_geodetic(latitude_rad, longitude_rad, 0.0)

    def geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Return latitude and longitude of plane coordinates."""
        latitude_rad, longitude_rad, _ = self._frame.geodetic_from_east_north(east_m, north_m, 0.0)
        return latitude_rad, longitude_rad

    def is_too_far(self, east_m: float, north_m: float) -> bool:
        """Whether plane coordinates are too far from the origin."""
        return math.hypot(east_m, north_m) > MOVE_AFTER_M

    def covers(self, latitude_rad: float, longitude_rad: float) -> bool:
        """Whether a position is near enough. Its coordinates do not show it: those of the antipode are zero."""
        here = self._frame
        half_chord = math.hypot(
            math.sin(0.5 * (latitude_rad - here.latitude_rad)),
            math.sin(0.5 * (longitude_rad - here.longitude_rad))
            * math.sqrt(math.cos(latitude_rad) * math.cos(here.latitude_rad)),
        )
        return 2.0 * _EARTH_RADIUS_M * half_chord < MOVE_AFTER_M

    def links(self, reply: LinksReply) -> list[RoadLink]:
        """Return the links of a reply in this plane."""
        vertices_m = self._frame.east_north_from_geodetic_array(
            reply.latitude_rad, reply.longitude_rad, np.zeros(len(reply.latitude_rad))
        )
        return [
            RoadLink(
                link_id=int(reply.link_id[i]),
                start_node=int(reply.start_node[i]),
                end_node=int(reply.end_node[i]),
                vertices_m=vertices_m[reply.first_vertex[i] : reply.first_vertex[i + 1]],
                level=int(reply.level[i]),
                sigma_m=float(reply.sigma_m[i]),
            )
            for i in range(len(reply.link_id))
        ]
