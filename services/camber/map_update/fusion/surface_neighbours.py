"""What lies around each road surface: which others it borders on, which street and which region it is of.

Streets and regions are squares of a grid in latitude and longitude: what matters of a street is only that whoever
drives on one of its surfaces drives on most of the others, and of a region that one survey made it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.votes import Floats, Integers
from camber.road_map.road_columns import RoadSurfaces

_EARTH_M = 6_378_137.0
_GAP_M = 0.5
"""Rectangles this near each other share a border: those of one road abut, those of a bend gape a little."""
_STEP_M = 0.5
"""A road whose pieces are of two levels goes on where their ends meet in height; a bridge is metres above a street."""


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Columns (n,) in ascending order of `surface_id`; neighbours of row i are rows
    `neighbour[neighbour_begins[i]:neighbour_begins[i + 1]]`.

    `region_latitude_rad`, `region_longitude_rad` (regions,) are the middles of the regions' surfaces.
    """

    surface_id: Integers
    link_id: Integers
    sigma_m: Floats
    block: Integers
    region: Integers
    neighbour_begins: Integers
    neighbour: Integers
    region_latitude_rad: Floats
    region_longitude_rad: Floats

    def rows_of(self, surface_id: Integers) -> Integers:
        """Rows (k,) of surfaces; −1 where there is none."""
        if len(self.surface_id) == 0:
            return np.full(len(surface_id), -1)
        place = np.minimum(np.searchsorted(self.surface_id, surface_id), len(self.surface_id) - 1)
        return np.where(self.surface_id[place] == surface_id, place, -1)


def surroundings_of(surfaces: RoadSurfaces, *, street_m: float, region_m: float) -> Surroundings:
    """The surroundings of all surfaces of a release; squares of streets and of regions have these sides."""
    order = np.argsort(surfaces.surface_id, kind="stable")
    latitude, longitude = surfaces.latitude_rad[order], surfaces.longitude_rad[order]
    level = surfaces.level[order]
    rear_m, front_m = (
        np.array([surfaces.heights_m[i][end].mean() for i in order.tolist()]) for end in (0, -1)
    )
    begins, neighbour = _neighbours(
        latitude,
        longitude,
        np.cos(surfaces.yaw_rad[order]),
        np.sin(surfaces.yaw_rad[order]),
        surfaces.half_length_m[order] + 0.5 * _GAP_M,
        surfaces.half_width_m[order] + 0.5 * _GAP_M,
        level,
        rear_m,
        front_m,
        np.argsort(latitude, kind="stable"),
    )
    _, block = np.unique(_squares(latitude, longitude, street_m), return_inverse=True)
    _, region = np.unique(_squares(latitude, longitude, region_m), return_inverse=True)
    count = np.maximum(np.bincount(region), 1)
    return Surroundings(
        surfaces.surface_id[order],
        surfaces.link_id[order],
        surfaces.sigma_m[order],
        block.astype(np.int64),
        region.astype(np.int64),
        begins,
        neighbour,
        np.bincount(region, latitude) / count,
        np.bincount(region, longitude) / count,
    )


def _squares(latitude_rad: Floats, longitude_rad: Floats, side_m: float) -> Integers:
    """A number (n,) for the square that each place is in."""
    row = np.floor(latitude_rad * (_EARTH_M / side_m)).astype(np.int64)
    # Columns as wide as at the middle of their row, so that a row has the same columns everywhere.
    wide = np.cos((row + 0.5) * (side_m / _EARTH_M))
    column = np.floor(longitude_rad * wide * (_EARTH_M / side_m)).astype(np.int64)
    square: Integers = row * np.int64(1 << 32) + column
    return square


@compiled_without_gil
def _neighbours(
    latitude_rad: Floats,
    longitude_rad: Floats,
    cos: Floats,
    sin: Floats,
    half_length_m: Floats,
    half_width_m: Floats,
    level: Integers,
    rear_m: Floats,
    front_m: Floats,
    by_latitude: Integers,
) -> tuple[Integers, Integers]:
    """Pairs of rectangles that meet, on one level or where a road changes its level, by a sweep from south to north."""
    n = len(latitude_rad)
    radius_m = np.sqrt(half_length_m**2 + half_width_m**2)
    farthest_m = radius_m.max() if n else 0.0
    one, other = [0 for _ in range(0)], [0 for _ in range(0)]
    for i in range(n):
        a = by_latitude[i]
        for j in range(i + 1, n):
            b = by_latitude[j]
            north_m = (latitude_rad[b] - latitude_rad[a]) * _EARTH_M
            if north_m > radius_m[a] + farthest_m:
                break
            east_m = (longitude_rad[b] - longitude_rad[a]) * _EARTH_M * np.cos(latitude_rad[a])
            reach_m = radius_m[a] + radius_m[b]
            if north_m * north_m + east_m * east_m > reach_m * reach_m:
                continue
            if level[a] != level[b] and not _goes_on(
                east_m, north_m, cos[a], sin[a], half_length_m[a], rear_m[a], front_m[a], cos[b], sin[b],
                half_length_m[b], rear_m[b], front_m[b],
            ):  # fmt: skip
                continue
            if _meet(
                east_m, north_m, cos[a], sin[a], half_length_m[a], half_width_m[a], cos[b], sin[b],
                half_length_m[b], half_width_m[b],
            ):  # fmt: skip
                one.append(a)
                other.append(b)
    count = np.zeros(n + 1, np.int64)
    for k in range(len(one)):
        count[one[k] + 1] += 1
        count[other[k] + 1] += 1
    begins = np.cumsum(count)
    at, neighbour = begins[:-1].copy(), np.empty(2 * len(one), np.int64)
    for k in range(len(one)):
        neighbour[at[one[k]]] = other[k]
        at[one[k]] += 1
        neighbour[at[other[k]]] = one[k]
        at[other[k]] += 1
    return begins, neighbour


@compiled_without_gil
def _goes_on(
    east_m: float,
    north_m: float,
    cos_a: float,
    sin_a: float,
    long_a: float,
    rear_a_m: float,
    front_a_m: float,
    cos_b: float,
    sin_b: float,
    long_b: float,
    rear_b_m: float,
    front_b_m: float,
) -> bool:
    """Are the two ends nearest each other, of two rectangles, at one height?"""
    nearest_m2, step_m = np.inf, np.inf
    for end_a, height_a_m in ((-long_a, rear_a_m), (long_a, front_a_m)):
        for end_b, height_b_m in ((-long_b, rear_b_m), (long_b, front_b_m)):
            dx = east_m + end_b * cos_b - end_a * cos_a
            dy = north_m + end_b * sin_b - end_a * sin_a
            if dx * dx + dy * dy < nearest_m2:
                nearest_m2, step_m = dx * dx + dy * dy, abs(height_b_m - height_a_m)
    return step_m <= _STEP_M


@compiled_without_gil
def _meet(
    east_m: float,
    north_m: float,
    cos_a: float,
    sin_a: float,
    long_a: float,
    wide_a: float,
    cos_b: float,
    sin_b: float,
    long_b: float,
    wide_b: float,
) -> bool:
    """Do two rectangles overlap? Only if no side of either has them on its two sides (separating axes)."""
    along, across = abs(cos_a * cos_b + sin_a * sin_b), abs(cos_a * sin_b - sin_a * cos_b)
    return (
        abs(cos_a * east_m + sin_a * north_m) <= long_a + long_b * along + wide_b * across
        and abs(cos_a * north_m - sin_a * east_m) <= wide_a + long_b * across + wide_b * along
        and abs(cos_b * east_m + sin_b * north_m) <= long_b + long_a * along + wide_a * across
        and abs(cos_b * north_m - sin_b * east_m) <= wide_b + long_a * across + wide_a * along
    )
