"""The plane in which the localizer computes: east and north metres about an origin near the vehicle."""

from __future__ import annotations

import math

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.localizer.links.link_matching import Link
from camber.schemas.road import LinksReply

MOVE_AFTER_M = 2000.0
"""The plane is laid anew beyond this distance: at 2 km its north is off by 0.01° at 35° latitude."""

_EARTH_RADIUS_M = 6.371e6


class LocalPlane:
    """A plane about a point; heights do not enter it."""

    def __init__(self, latitude_rad: float, longitude_rad: float) -> None:
        self._frame = LocalFrame(latitude_rad, longitude_rad, 0.0)

    def east_north(self, latitude_rad: float, longitude_rad: float) -> tuple[float, float]:
        """Plane coordinates (m) of a point."""
        return self._frame.east_north_from_geodetic(latitude_rad, longitude_rad, 0.0)

    def geodetic(self, east_m: float, north_m: float) -> tuple[float, float]:
        """Latitude and longitude of plane coordinates."""
        latitude_rad, longitude_rad, _ = self._frame.geodetic_from_east_north(east_m, north_m, 0.0)
        return latitude_rad, longitude_rad

    def too_far(self, east_m: float, north_m: float) -> bool:
        """Is it time for another plane?"""
        return math.hypot(east_m, north_m) > MOVE_AFTER_M

    def reaches(self, latitude_rad: float, longitude_rad: float) -> bool:
        """Is a point near enough to compute in this plane? Its coordinates do not say: the antipode's are zero."""
        here = self._frame
        half_chord = math.hypot(
            math.sin(0.5 * (latitude_rad - here.latitude_rad)),
            math.sin(0.5 * (longitude_rad - here.longitude_rad))
            * math.sqrt(math.cos(latitude_rad) * math.cos(here.latitude_rad)),
        )
        return 2.0 * _EARTH_RADIUS_M * half_chord < MOVE_AFTER_M

    def links(self, reply: LinksReply) -> list[Link]:
        """The links of a reply in this plane."""
        plane = self._frame.east_north_from_geodetic_array(
            reply.latitude_rad, reply.longitude_rad, np.zeros(len(reply.latitude_rad))
        )
        return [
            Link(
                int(reply.link_id[i]),
                int(reply.start_node[i]),
                int(reply.end_node[i]),
                plane[reply.first_vertex[i] : reply.first_vertex[i + 1]],
                int(reply.level[i]),
                float(reply.sigma_m[i]),
            )
            for i in range(len(reply.link_id))
        ]
