"""Validity of a tile's contents beyond its message's schema, and the slopes of its surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.schemas.road import CloudTile, LinkTile, SurfaceTile

MAX_ID = 2**62  # chosen: two bits below the range of int64
MAX_LEVEL = 20  # chosen: more decks than any road interchange has
LOWEST_M, HIGHEST_M = -19_000.0, 99_000.0
"""Range of the schema less what extrapolation beyond an edge may add."""
MAX_SLOPE = 2.0  # chosen: no road is steeper, the steepest streets have 0.35
_MAX_REACH_M = 100_000.0  # chosen: distance of geometry from its tile's centre, far beyond any tile

_Check = tuple[str, str, NDArray[np.bool_]]


def tile_defect(tile: SurfaceTile | LinkTile | CloudTile) -> tuple[str, str] | None:
    """Return the field and its expected value of the first invalid entry of a tile; None for a valid tile."""
    if isinstance(tile, SurfaceTile):
        return _surface_defect(tile)
    return _link_defect(tile) if isinstance(tile, LinkTile) else None


def surface_slopes(tile: SurfaceTile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the steepest slope and the largest difference of slopes of each surface's grid.

    Both are bounds from the edges of the grid's cells, where a bilinear cell has its extreme slopes.
    """
    steepest, spread = np.zeros(len(tile.rows)), np.zeros(len(tile.rows))
    shapes = np.column_stack((tile.rows, tile.columns)).astype(np.int64)
    for n, m in np.unique(shapes, axis=0):
        rows = np.flatnonzero((tile.rows == n) & (tile.columns == m))
        at = tile.first_height[rows, None].astype(np.int64) + np.arange(n * m)
        grid_m = tile.grid_m[at].astype(np.float64).reshape(len(rows), n, m)
        length_m = 2.0 * tile.half_length_m[rows].astype(np.float64)[:, None, None]
        width_m = 2.0 * tile.half_width_m[rows].astype(np.float64)[:, None, None]
        along = np.diff(grid_m, axis=1) * (n - 1) / length_m
        across = np.diff(grid_m, axis=2) * (m - 1) / width_m
        steepest[rows] = np.hypot(np.abs(along).max((1, 2)), np.abs(across).max((1, 2)))
        spread[rows] = np.hypot(np.ptp(along, (1, 2)), np.ptp(across, (1, 2)))
    return steepest, spread


def _surface_defect(tile: SurfaceTile) -> tuple[str, str] | None:
    defect = _first_defect(
        tile.surface_id,
        [
            ("surface_id", "0 to 2⁶²", (tile.surface_id >= 0) & (tile.surface_id <= MAX_ID)),
            ("link_id", "0 to 2⁶²", (tile.link_id >= 0) & (tile.link_id <= MAX_ID)),
            ("level", "-20 to 20", np.abs(tile.level.astype(np.int64)) <= MAX_LEVEL),
            ("centre_east_m", "at most 100 km", np.abs(tile.centre_east_m) <= _MAX_REACH_M),
            ("centre_north_m", "at most 100 km", np.abs(tile.centre_north_m) <= _MAX_REACH_M),
            ("yaw_rad", "-8 to 8", np.abs(tile.yaw_rad) <= 8.0),
            ("half_length_m", "more than 0, at most 100 km", _is_length(tile.half_length_m)),
            ("half_width_m", "more than 0, at most 100 km", _is_length(tile.half_width_m)),
        ],
    )
    if defect is not None:
        return defect
    if len(np.unique(tile.surface_id)) != len(tile.surface_id):
        return "surface_id", "each id once"
    heights_m = tile.base_height_m + tile.grid_m.astype(np.float64)
    if not ((heights_m >= LOWEST_M) & (heights_m <= HIGHEST_M)).all():
        return "grid_m", "heights of −19,000 to 99,000 m"
    slopes = ("grid_m", f"slopes of at most {MAX_SLOPE:.0f}", surface_slopes(tile)[0] <= MAX_SLOPE)
    return _first_defect(tile.surface_id, [slopes])


def _is_length(half_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    right: NDArray[np.bool_] = (half_m > 0.0) & (half_m <= _MAX_REACH_M)
    return right


def _link_defect(tile: LinkTile) -> tuple[str, str] | None:
    near = (np.abs(tile.east_m) <= _MAX_REACH_M) & (np.abs(tile.north_m) <= _MAX_REACH_M)
    if not near.all():
        return f"vertex {np.argmin(near)}", "at most 100 km from the tile"
    if len(np.unique(tile.link_id)) != len(tile.link_id):
        return "link_id", "each id once"
    return _first_defect(
        tile.link_id,
        [
            ("link_id", "0 to 2⁶²", (tile.link_id >= 0) & (tile.link_id <= MAX_ID)),
            ("level", "-20 to 20", np.abs(tile.level.astype(np.int64)) <= MAX_LEVEL),
            ("first_vertex", "two vertices or more", np.diff(tile.first_vertex) >= 2),
        ],
    )


def _first_defect(ids: NDArray[np.int64], checks: list[_Check]) -> tuple[str, str] | None:
    for field, expected, right in checks:
        if not right.all():
            return f"{field} of {ids[np.argmin(right)]}", expected
    return None
