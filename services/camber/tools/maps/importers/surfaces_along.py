"""Road surfaces along lines, from whatever says how high the ground is: a raster, a cloud, a track.

A line is cut into pieces of at most 20 m whose chord leaves it by 0.2 m at most. Each becomes a rectangle about its
chord with a grid of heights, or several smaller ones: where the ground is not known there is no surface, nor where
it rises like a wall. What is too short or too narrow then to drive on is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.local_frame import LocalFrame
from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.road_map.tile_grid import tile_frame, tile_of
from camber.tools.maps.importers.lanes import distance_along, named_id, quantized_degrees

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]

Ground = Callable[[Floats, Floats, Integers], tuple[Floats, Floats]]
"""Of places (n,), latitude and longitude [rad], and the rows (n,) of their links: ellipsoidal heights and their σ [m],
NaN where the ground is not known there."""

# Chosen: docs/maps.md, rasters; pieces that follow a road within 0.2 m and overlap slightly, without gaps.
_LONGEST_M = 20.0
_SAGITTA_M = 0.2
_OVERLAP_M = 0.5
_STEP_M = 0.5
_SHORTEST_M = 1.0

_NARROWEST_M = 0.5  # chosen: no vehicle drives on a narrower surface
_WORTH_SPLITTING = 0.75
"""Rows are shared out between shorter rectangles where together they are narrower than this share of the widest."""
_STEEPEST = 1.0
"""Between neighbouring heights; what is steeper is a wall, an edge or an error, and no road."""
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True, eq=False)
class RoadCentreLines:
    """Links whose vertices are the middles of roads, and how wide each road is to either side (n,)."""

    links: RoadLinks
    half_width_m: Floats


def surfaces_along(
    roads: RoadCentreLines, ground: Ground, *, spacing_m: float, seen_ns: int, vehicles: int = 0
) -> RoadSurfaces:
    """Surfaces of all links, heights every `spacing_m`.

    σ: that of the heights, and with it how far the ground is off the grid between its nodes (root mean square): what
    the grid cannot follow.
    """
    links = roads.links
    pieces = [piece for row in range(len(links)) for piece in _pieces(roads, row, spacing_m)]
    at_nodes = _sample_ground(ground, pieces, [piece.nodes() for piece in pieces])
    between = _sample_ground(ground, pieces, [piece.between() for piece in pieces])
    rows = [
        row | {"vehicles": vehicles, "last_seen_ns": seen_ns}
        for piece, (height_m, sigma_m), (between_m, _) in zip(pieces, at_nodes, between, strict=True)
        for row in _known_parts(piece, links, height_m=height_m, sigma_m=sigma_m, between_m=between_m)
    ]
    columns: dict[str, Any] = {each.name: [row[each.name] for row in rows] for each in fields(RoadSurfaces)}
    return RoadSurfaces(**columns)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _RoadPiece:
    """A rectangle in a plane, the `number`th of the link `row`; nodes at `along_m` (n,) and `across_m` (m,)."""

    row: int
    number: int
    frame: LocalFrame
    centre_m: Floats
    yaw_rad: float
    along_m: Floats
    across_m: Floats

    def nodes(self) -> Floats:
        """Points (n · m, 2) in the plane, row-major."""
        return self.points(self.along_m, self.across_m)

    def between(self) -> Floats:
        """A point in each cell between the nodes ((n − 1) · (m − 1), 2), at `shares` of it."""
        along_m, across_m = (
            edges[:-1] + share * np.diff(edges)
            for edges, share in zip((self.along_m, self.across_m), self.shares(), strict=True)
        )
        return self.points(along_m, across_m)

    def shares(self) -> tuple[Floats, Floats]:
        """Along (n − 1,) and across (m − 1,): another in each cell, so that nothing periodic hides from them."""
        along, across = np.arange(len(self.along_m) - 1), np.arange(len(self.across_m) - 1)
        return np.mod(0.5 + _GOLDEN * along, 1.0), np.mod(0.5 + _GOLDEN * across, 1.0)

    def points(self, along_m: Floats, across_m: Floats) -> Floats:
        """Of all pairs of these."""
        u, v = (grid.ravel() for grid in np.meshgrid(along_m, across_m, indexing="ij"))
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        points: Floats = self.centre_m + np.column_stack((c * u - s * v, s * u + c * v))
        return points

    def place(self, along_m: float, across_m: float) -> tuple[float, float, float]:
        """Latitude and longitude of a point, and the rectangle's yaw against east there [rad]."""
        point = self.points(np.array([along_m]), np.array([across_m]))
        latitude, longitude, _ = self.frame.geodetic_from_east_north_array(point, 0.0)
        step = (longitude[0] - self.frame.longitude_rad + math.pi) % (2.0 * math.pi) - math.pi
        return (
            float(latitude[0]),
            float(longitude[0]),
            self.yaw_rad - step * math.sin(self.frame.latitude_rad),
        )


def _pieces(roads: RoadCentreLines, row: int, spacing_m: float) -> Iterator[_RoadPiece]:
    vertices, half_width_m = roads.links.vertices[row], float(roads.half_width_m[row])
    tile = tile_of(float(vertices[0, 0]), float(vertices[0, 1]))
    assert tile is not None  # RoadLinks holds no others
    frame = tile_frame(*tile)
    plane_m = frame.east_north_from_geodetic_array(vertices[:, 0], vertices[:, 1], np.zeros(len(vertices)))
    line_m = resampled(plane_m, _STEP_M)
    columns = max(2, math.ceil(2.0 * half_width_m / spacing_m - 1e-6) + 1)
    for number, (first, last) in enumerate(_chords(line_m)):
        a, b = line_m[first], line_m[last]
        half_length_m = 0.5 * math.hypot(*(b - a)) + _OVERLAP_M
        rows = max(2, math.ceil(2.0 * half_length_m / spacing_m - 1e-6) + 1)
        yield _RoadPiece(
            row=row,
            number=number,
            frame=frame,
            centre_m=0.5 * (a + b),
            yaw_rad=math.atan2(b[1] - a[1], b[0] - a[0]),
            along_m=np.linspace(-half_length_m, half_length_m, rows),
            across_m=np.linspace(-half_width_m, half_width_m, columns),
        )


def resampled(line_m: Floats, step_m: float) -> Floats:
    """A line (k, 2) as points at equal distances of at most `step_m` along it; empty where it has no length."""
    along_m = distance_along(line_m)
    if along_m[-1] <= 0.0:
        return np.zeros((0, 2))
    at_m = np.linspace(0.0, along_m[-1], math.ceil(along_m[-1] / step_m) + 1)
    return np.column_stack([np.interp(at_m, along_m, line_m[:, axis]) for axis in (0, 1)])


def _chords(line_m: Floats) -> Iterator[tuple[int, int]]:
    """First and last point of each piece."""
    longest = round(_LONGEST_M / _STEP_M)
    first = 0
    while first < len(line_m) - 1:
        last = min(first + longest, len(line_m) - 1)
        # A rest that is too short to stand alone is shared.
        if first + longest < len(line_m) - 1 < first + 2 * longest:
            last = (first + len(line_m)) // 2
        while last > first + 1 and _bow_m(line_m[first : last + 1]) > _SAGITTA_M:
            last = first + max(1, (last - first) * 3 // 4)
        yield first, last
        first = last


def _bow_m(line_m: Floats) -> float:
    """How far a line leaves its chord; the whole length where it comes back to its beginning."""
    chord = line_m[-1] - line_m[0]
    length = math.hypot(*chord)
    if length < 1e-6:
        return math.inf
    off = line_m - line_m[0]
    return float(np.abs(off[:, 0] * chord[1] - off[:, 1] * chord[0]).max() / length)


def _sample_ground(
    ground: Ground, pieces: list[_RoadPiece], points_m: list[Floats]
) -> list[tuple[Floats, Floats]]:
    """Heights and σ of the points of each piece, asked for at once."""
    if not pieces:
        return []
    counts = [len(points) for points in points_m]
    latitude, longitude = np.empty(sum(counts)), np.empty(sum(counts))
    at = 0
    for piece, points in zip(pieces, points_m, strict=True):
        part = slice(at, at := at + len(points))
        latitude[part], longitude[part], _ = piece.frame.geodetic_from_east_north_array(points, 0.0)
    height_m, sigma_m = ground(latitude, longitude, np.repeat([piece.row for piece in pieces], counts))
    cuts = np.cumsum(counts)[:-1]
    return list(zip(np.split(height_m, cuts), np.split(sigma_m, cuts), strict=True))


def _known_parts(
    piece: _RoadPiece, links: RoadLinks, *, height_m: Floats, sigma_m: Floats, between_m: Floats
) -> Iterator[dict[str, Any]]:
    """Rows of RoadSurfaces where the ground is known. An id is that of a part of a line, whatever its height is."""
    n, m = len(piece.along_m), len(piece.across_m)
    height_m, sigma_m = height_m.reshape(n, m), sigma_m.reshape(n, m)
    u, v = piece.shares()[0][:, None], piece.shares()[1]
    bilinear_m = (1.0 - u) * ((1.0 - v) * height_m[:-1, :-1] + v * height_m[:-1, 1:])
    bilinear_m += u * ((1.0 - v) * height_m[1:, :-1] + v * height_m[1:, 1:])
    off_m2 = (between_m.reshape(n - 1, m - 1) - bilinear_m) ** 2
    known = np.isfinite(height_m) & np.isfinite(sigma_m) & ~_walls(piece, height_m)
    link_id, line = int(links.link_id[piece.row]), quantized_degrees(links.vertices[piece.row])
    for first, last, left, right in _known_blocks(piece, known):
        along_m, across_m = piece.along_m[first:last], piece.across_m[left:right]
        off = off_m2[first : last - 1, left : right - 1]
        off = off[np.isfinite(off)]
        roughness_m2 = float(np.mean(off)) if len(off) else 0.0
        inner = slice(first, last), slice(left, right)
        centre_m = 0.5 * float(along_m[0] + along_m[-1]), 0.5 * float(across_m[0] + across_m[-1])
        half_length_m = 0.5 * float(along_m[-1] - along_m[0])
        begin_m = centre_m[0] - half_length_m - float(piece.along_m[0])
        latitude_rad, longitude_rad, yaw_rad = piece.place(*centre_m)
        place = (link_id, line, piece.number, int(begin_m + 1e-6))
        yield {
            "surface_id": named_id("surface", *place),
            "link_id": link_id,
            "level": int(links.level[piece.row]),
            "latitude_rad": latitude_rad,
            "longitude_rad": longitude_rad,
            "yaw_rad": yaw_rad,
            "half_length_m": half_length_m,
            "half_width_m": 0.5 * float(across_m[-1] - across_m[0]),
            "sigma_m": math.sqrt(float(np.mean(sigma_m[inner] ** 2)) + roughness_m2),
            "heights_m": height_m[inner].copy(),
        }


def _walls(piece: _RoadPiece, height_m: Floats) -> Mask:
    """Nodes (n, m) from which it is too steep to a neighbour."""
    walls = np.zeros(height_m.shape, bool)
    along = np.abs(np.diff(height_m, axis=0)) > _STEEPEST * np.diff(piece.along_m)[:, None]
    across = np.abs(np.diff(height_m, axis=1)) > _STEEPEST * np.diff(piece.across_m)
    walls[1:] |= along
    walls[:-1] |= along
    walls[:, 1:] |= across
    walls[:, :-1] |= across
    return walls


def _known_blocks(piece: _RoadPiece, known: Mask) -> Iterator[tuple[int, int, int, int]]:
    """First and last + 1 of rows and of columns, about the middle, within which every height is known."""
    spans = [_about_the_middle(row) for row in known]
    there = np.array([right - left >= 2 for left, right in spans])
    stack = _runs(there)[::-1]
    while stack:
        first, last = stack.pop()
        left = max(span[0] for span in spans[first:last])
        right = min(span[1] for span in spans[first:last])
        widest = max(span[1] - span[0] for span in spans[first:last])
        long_m = float(piece.along_m[last - 1] - piece.along_m[first])
        if right - left < _WORTH_SPLITTING * widest and last - first >= 4 and long_m >= 2.0 * _SHORTEST_M:
            middle = (first + last) // 2
            # The row in the middle belongs to both, so that nothing is open between them.
            stack += [(middle, last), (first, middle + 1)]
            continue
        wide_m = float(piece.across_m[right - 1] - piece.across_m[left]) if right - left >= 2 else 0.0
        if last - first >= 2 and long_m >= _SHORTEST_M and wide_m >= _NARROWEST_M:
            yield first, last, left, right


def _about_the_middle(known: Mask) -> tuple[int, int]:
    """First and last + 1 of those about the middle that are known one after another."""
    middle = (len(known) - 1) // 2
    for first, last in _runs(known):
        if first <= middle < last or first <= len(known) // 2 < last:
            return first, last
    return 0, 0


def _runs(known: Mask) -> list[tuple[int, int]]:
    """First and last + 1 of what is known one after another."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], known.astype(np.int8), [0]))))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
