"""Compile the road selection before the first query, by queries to a synthetic surface.

The compiled code is cached on disk. `python -m camber.map_server.warm_up` fills the cache of an image.
"""

from __future__ import annotations

from camber.map_server.elevation_queries import ElevationMap
from camber.road_map.road_columns import flat_road
from camber.road_map.road_tiles import surface_tiles
from camber.schemas.pose import Road

FUNCTIONS = 8
"""Compiled functions that the warm-up calls from Python."""

_LATITUDE_RAD, _LONGITUDE_RAD = 0.6, 2.4


def warm_up() -> Road:
    """Return the road around a point on a synthetic surface; compiles both paths of the selection."""
    surfaces = flat_road(_LATITUDE_RAD, [_LONGITUDE_RAD], seen_ns=1_400_000_000 * 10**9)
    tiles = {(tile.x, tile.y): tile for tile in surface_tiles(surfaces)}
    roads = ElevationMap(lambda x, y: tiles.get((x, y)), lambda x, y: None, datum="WGS84", map_version=1)
    # With a last surface: candidate links alone do not decide, so the second path is compiled.
    roads.roads([_LATITUDE_RAD], [_LONGITUDE_RAD], (), 1)
    return roads.road_around(_LATITUDE_RAD, _LONGITUDE_RAD, 1.0)


if __name__ == "__main__":
    warm_up()
