"""Neighbours, street and region of each road surface.

Streets and regions are squares of a grid in latitude and longitude: a vehicle that drives over one surface of a street
drives over most of the others, and the surfaces of a region come from the same survey.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled_without_gil
from camber.map_update.fusion.votes import Floats, Integers
from camber.road_map.road_columns import RoadSurfaces, rows_of_ids

_EARTH_M = 6_378_137.0  # WGS 84, semi-major axis
_GAP_M = 0.5
"""Chosen: rectangles this close are neighbours; those of one road abut, those of a bend leave small gaps."""
_STEP_M = 0.5
"""Chosen: a road continues on another level where the heights of the ends differ by less; a bridge is metres higher."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SurfaceNeighbourhood:
    """Columns (n,) sorted by `surface_id`.

    Neighbours of row i are rows `neighbour[neighbour_begins[i]:neighbour_begins[i + 1]]`; `block` is the street.
    Latitude and longitude are those of a surface's middle.
    """

    surface_id: Integers
    link_id: Integers
    latitude_rad: Floats
    longitude_rad: Floats
    block: Integers
    region: Integers
    neighbour_begins: Integers
    neighbour: Integers

    def rows_of(self, surface_id: Integers) -> Integers:
        """Return the rows (k,) of surfaces; −1 for unknown ids."""
        return rows_of_ids(self.surface_id, surface_id)


class _Rectangles(NamedTuple):
    """Surfaces as rectangles, each with the mean height of its rear and front end."""

    latitude_rad: Floats
    longitude_rad: Floats
    cos: Floats
    sin: Floats
    half_length_m: Floats
    half_width_m: Floats
    level: Integers
    rear_m: Floats
    front_m: Floats


def build_neighbourhood(surfaces: RoadSurfaces, *, street_m: float, region_m: float) -> SurfaceNeighbourhood:
    """Return the neighbourhood of all surfaces of a release; squares of streets and regions have these sides."""
    order = np.argsort(surfaces.surface_id, kind="stable")
    latitude, longitude = surfaces.latitude_rad[order], surfaces.longitude_rad[order]
    rear_m, front_m = (
        np.array([surfaces.heights_m[i][end].mean() for i in order.tolist()]) for end in (0, -1)
    )
    rectangles = _Rectangles(
        latitude_rad=latitude,
        longitude_rad=longitude,
        cos=np.cos(surfaces.yaw_rad[order]),
        sin=np.sin(surfaces.yaw_rad[order]),
        half_length_m=surfaces.half_length_m[order] + 0.5 * _GAP_M,
        half_width_m=surfaces.half_width_m[order] + 0.5 * _GAP_M,
        level=surfaces.level[order],
        rear_m=rear_m,
        front_m=front_m,
    )
    begins, neighbour = _neighbours(rectangles, np.argsort(latitude, kind="stable"))
    _, block = np.unique(_squares(latitude, longitude, street_m), return_inverse=True)
    _, region = np.unique(_squares(latitude, longitude, region_m), return_inverse=True)
    return SurfaceNeighbourhood(
        surface_id=surfaces.surface_id[order],
        link_id=surfaces.link_id[order],
        latitude_rad=latitude,
        longitude_rad=longitude,
        block=block.astype(np.int64),
        region=region.astype(np.int64),
        neighbour_begins=begins,
        neighbour=neighbour,
    )


def _squares(latitude_rad: Floats, longitude_rad: Floats, side_m: float) -> Integers:
    """Return a number (n,) for the square that each point is in."""
    row = np.floor(latitude_rad * (_EARTH_M / side_m)).astype(np.int64)
    # Columns as wide as at the middle of their row, so that a row has the same columns everywhere.
    wide = np.cos((row + 0.5) * (side_m / _EARTH_M))
    column = np.floor(longitude_rad * wide * (_EARTH_M / side_m)).astype(np.int64)
    square: Integers = row * np.int64(1 << 32) + column
    return square


@compiled_without_gil
def _neighbours(r: _Rectangles, by_latitude: Integers) -> tuple[Integers, Integers]:
    """Return pairs of rectangles that meet, on one level or where a road changes its level; sweeps south to north."""
    n = len(r.level)
    radius_m = np.sqrt(r.half_length_m**2 + r.half_width_m**2)
    farthest_m = radius_m.max() if n else 0.0
    one, other = [0 for _ in range(0)], [0 for _ in range(0)]
    for i in range(n):
        a = by_latitude[i]
        for j in range(i + 1, n):
            b = by_latitude[j]
            north_m = (r.latitude_rad[b] - r.latitude_rad[a]) * _EARTH_M
            if north_m > radius_m[a] + farthest_m:
                break
            east_m = (r.longitude_rad[b] - r.longitude_rad[a]) * _EARTH_M * np.cos(r.latitude_rad[a])
            distance_m = radius_m[a] + radius_m[b]
            if north_m * north_m + east_m * east_m > distance_m * distance_m:
                continue
            if r.level[a] != r.level[b] and _height_step_m(r, a, b, east_m=east_m, north_m=north_m) > _STEP_M:
                continue
            if _overlap(r, a, b, east_m=east_m, north_m=north_m):
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
def _height_step_m(r: _Rectangles, a: int, b: int, east_m: float, north_m: float) -> float:
    """Return the height difference of those ends of two rectangles that are nearest each other."""
    nearest_m2, step_m = np.inf, np.inf
    for end_a, height_a_m in ((-r.half_length_m[a], r.rear_m[a]), (r.half_length_m[a], r.front_m[a])):
        for end_b, height_b_m in ((-r.half_length_m[b], r.rear_m[b]), (r.half_length_m[b], r.front_m[b])):
            dx = east_m + end_b * r.cos[b] - end_a * r.cos[a]
            dy = north_m + end_b * r.sin[b] - end_a * r.sin[a]
            if dx * dx + dy * dy < nearest_m2:
                nearest_m2, step_m = dx * dx + dy * dy, abs(height_b_m - height_a_m)
    return step_m


@compiled_without_gil
def _overlap(r: _Rectangles, a: int, b: int, east_m: float, north_m: float) -> bool:
    """Return whether two rectangles overlap (separating axis theorem)."""
    along = abs(r.cos[a] * r.cos[b] + r.sin[a] * r.sin[b])
    across = abs(r.cos[a] * r.sin[b] - r.sin[a] * r.cos[b])
    long_a, wide_a = r.half_length_m[a], r.half_width_m[a]
    long_b, wide_b = r.half_length_m[b], r.half_width_m[b]
    overlap: bool = (
        abs(r.cos[a] * east_m + r.sin[a] * north_m) <= long_a + long_b * along + wide_b * across
        and abs(r.cos[a] * north_m - r.sin[a] * east_m) <= wide_a + long_b * across + wide_b * along
        and abs(r.cos[b] * east_m + r.sin[b] * north_m) <= long_b + long_a * along + wide_a * across
        and abs(r.cos[b] * north_m - r.sin[b] * east_m) <= wide_b + long_a * across + wide_a * along
    )
    return overlap
