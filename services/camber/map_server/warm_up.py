"""Compile the choice of roads before the first question comes: the road at a made-up point is asked for, both ways.

The compiled code is kept on disk; where it is there already this takes a moment. `python -m camber.map_server.warm_up`
does it ahead, for an image.
"""

from __future__ import annotations

import numpy as np

from camber.map_server.elevation import ElevationMap
from camber.road_map.road_columns import RoadSurfaces
from camber.road_map.road_tiles import surface_tiles
from camber.schemas.pose import Road

_LATITUDE_RAD, _LONGITUDE_RAD = 0.6, 2.4


def warm_up() -> Road:
    """Ask for the road around a point on a made-up surface; returns the answer."""
    surfaces = RoadSurfaces(
        surface_id=np.array([1]),
        link_id=np.array([1]),
        level=np.array([0]),
        latitude_rad=np.array([_LATITUDE_RAD]),
        longitude_rad=np.array([_LONGITUDE_RAD]),
        yaw_rad=np.array([0.0]),
        half_length_m=np.array([10.0]),
        half_width_m=np.array([2.0]),
        sigma_m=np.array([0.03]),
        vehicles=np.array([1]),
        last_seen_ns=np.array([1_400_000_000 * 10**9]),
        heights_m=[np.full((2, 2), 50.0)],
    )
    tiles = {(tile.x, tile.y): tile for tile in surface_tiles(surfaces)}
    roads = ElevationMap(lambda x, y: tiles.get((x, y)), lambda x, y: None, datum="WGS84", map_version=1)
    # By what it was on last: what candidate links alone do not tell is told another way.
    roads.roads([_LATITUDE_RAD], [_LONGITUDE_RAD], (), 1)
    return roads.road_around(_LATITUDE_RAD, _LONGITUDE_RAD, 1.0)


if __name__ == "__main__":
    warm_up()
