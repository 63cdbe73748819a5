"""Road surfaces of the map as a survey finds them: rectangles of a lane and some 20 m, with heights that err.

The error is one random field over the plane for each level, so surfaces that overlap agree with one another, as those
of one survey do, and one offset for all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from camber.geodesy.local_frame import LocalFrame
from camber.road_map.map_error_model import MapErrorModel
from camber.road_map.road_columns import RoadSurfaces
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats
from camber.simulator.world.roads import HALF_WIDTH, Roads

# Chosen: surfaces as maps have them, lanes of some 20 m with heights every 4 m that follow the road's bends.
LONGEST_M = 20.0
_GRID_M = 4.0
_OVERLAP_M = 0.5
_SAGITTA_M = 0.2
_FEATURES = 400
_IDS_PER_LINK = 10_000
_FIRST_NODE_ID = 1_000_000_000


class ErrorField:
    """A Gaussian random field over the plane with a model's correlation along the road, by random Fourier features.

    Sum of cosines with drawn wave vectors (Rahimi & Recht 2007, "Random features for large-scale kernel machines").
    The spectral density of Matérn's covariance, ∝ (1 / L² + |k|²)^(−ν − 1), is that of a normal vector divided by
    L √χ² of 2ν degrees of freedom: one for the short part, three for the long one. The common offset is not in it.
    """

    def __init__(self, sigma_m: float, model: MapErrorModel, rng: np.random.Generator) -> None:
        normal, chi2 = rng.standard_normal((_FEATURES, 2)), rng.standard_normal((_FEATURES, 3)) ** 2
        is_short = (np.arange(_FEATURES) + 0.5) / _FEATURES < model.short_share
        root = np.sqrt(np.where(is_short, chi2[:, 0], chi2.sum(axis=1)))
        self._wave = normal / (np.where(is_short, model.short_m, model.long_m) * root)[:, None]
        self._phase = rng.uniform(0.0, 2.0 * math.pi, _FEATURES)
        self._size = sigma_m * math.sqrt(2.0 / _FEATURES)

    def at(self, east_m: Floats, north_m: Floats) -> Floats:
        """Errors at places of any shape."""
        angle = np.outer(east_m, self._wave[:, 0]) + np.outer(north_m, self._wave[:, 1]) + self._phase
        errors: Floats = (self._size * np.cos(angle).sum(axis=1)).reshape(east_m.shape)
        return errors


class _Rectangle(NamedTuple):
    surface_id: int
    link_id: int
    level: int
    east: float
    north: float
    yaw: float
    half_length: float
    half_width: float

    def grid(self, rows: int, columns: int) -> tuple[Floats, Floats]:
        """East and north (rows, columns): from the rear to the front, from the right to the left."""
        along = np.linspace(-self.half_length, self.half_length, rows)
        left = np.linspace(-self.half_width, self.half_width, columns)
        u, v = np.meshgrid(along, left, indexing="ij")
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.east + c * u - s * v, self.north + s * u + c * v


def surveyed_surfaces(
    roads: Roads, frame: LocalFrame, seed: int, *, sigma_m: float, model: MapErrorModel, seen_ns: int
) -> RoadSurfaces:
    """Surfaces of all links, a row for each lane, and of all junctions; `seen_ns` is when they were seen.

    Their heights err by a field of σ `sigma_m` and by the common offset of the survey.
    """
    offset_m = model.common_offset(stream(seed, "survey offset"))
    fields = {
        level: ErrorField(sigma_m, model, stream(seed, f"survey heights {level}"))
        for level in sorted(set(roads.level.tolist()) | set(roads.node_level.tolist()))
    }
    rows: list[_Rectangle] = []
    heights_m: list[Floats] = []
    for link in range(len(roads.link_id)):
        for rectangle in _lanes(roads, link):
            e, n = rectangle.grid(max(2, round(2.0 * rectangle.half_length / _GRID_M) + 1), 3)
            heights_m.append(roads.link_height_m(np.array(link), e, n) + fields[rectangle.level].at(e, n))
            rows.append(rectangle)
    for node in np.flatnonzero(roads.nodes_m[:, 2] > 0.0).tolist():
        east, north, radius, lift = roads.nodes_m[node].tolist()
        level = int(roads.node_level[node])
        link_id = _link_at(roads, node, level)
        square = (east, north, 0.0, radius, radius)
        rectangle = _Rectangle(_FIRST_NODE_ID + node, link_id, level, *square)
        cells = max(2, round(2.0 * radius / _GRID_M) + 1)
        e, n = rectangle.grid(cells, cells)
        heights_m.append(roads.terrain.height_m(e, n) + lift + fields[level].at(e, n))
        rows.append(rectangle)
    columns = np.array(rows)
    latitude, longitude, _ = frame.geodetic_from_east_north_array(columns[:, 3:5], np.zeros(len(columns)))
    # Against east at the surface's place, not at the district's origin.
    yaw = columns[:, 5] - (longitude - frame.longitude_rad) * math.sin(frame.latitude_rad)
    whole = columns[:, :3].astype(np.int64)
    return RoadSurfaces(
        surface_id=whole[:, 0],
        link_id=whole[:, 1],
        level=whole[:, 2],
        latitude_rad=latitude,
        longitude_rad=longitude,
        yaw_rad=(yaw + math.pi) % (2.0 * math.pi) - math.pi,
        half_length_m=columns[:, 6],
        half_width_m=columns[:, 7],
        sigma_m=np.full(len(columns), sigma_m),
        vehicles=np.zeros(len(columns), np.int64),
        last_seen_ns=np.full(len(columns), seen_ns),
        heights_m=[heights + offset_m for heights in heights_m],
    )


def _lanes(roads: Roads, link: int) -> Iterator[_Rectangle]:
    """Piece by piece of a link, the right lane and the left one."""
    link_id, half = int(roads.link_id[link]), float(roads.shape[link, HALF_WIDTH])
    for piece, (first, last) in enumerate(_pieces(roads, link)):
        east, north, _ = roads.centre_line(link, np.array([first, 0.5 * (first + last), last]))
        yaw = math.atan2(north[2] - north[0], east[2] - east[0])
        half_length = 0.5 * math.hypot(north[2] - north[0], east[2] - east[0]) + _OVERLAP_M
        middle_east, middle_north = 0.5 * (east[0] + east[2]), 0.5 * (north[0] + north[2])
        # The road bends away from the chord; the rectangle reaches to where it comes.
        half_width = 0.5 * half + math.hypot(east[1] - middle_east, north[1] - middle_north)
        for lane, side in enumerate((-1.0, 1.0)):
            y = side * 0.5 * half
            yield _Rectangle(
                surface_id=link_id * _IDS_PER_LINK + 2 * piece + lane,
                link_id=link_id,
                level=int(roads.level[link]),
                east=middle_east - y * math.sin(yaw),
                north=middle_north + y * math.cos(yaw),
                yaw=yaw,
                half_length=half_length,
                half_width=half_width,
            )


def _pieces(roads: Roads, link: int) -> list[tuple[float, float]]:
    """Parts of a link, s to s, at most 20 m long and so short that a bend leaves its chord by 0.2 m at most."""
    pieces = []
    for element in roads.elements[roads.element_link == link]:
        length, curvature, start = float(element[3]), abs(float(element[4])), float(element[5])
        longest = min(LONGEST_M, math.sqrt(8.0 * _SAGITTA_M / curvature)) if curvature > 0.0 else LONGEST_M
        cuts = np.linspace(start, start + length, math.ceil(length / longest - 1e-9) + 1).tolist()
        pieces += list(pairwise(cuts))
    return pieces


def _link_at(roads: Roads, node: int, level: int) -> int:
    """The id of the first link of a level at a node (row number); any, where there is none of it."""
    there = (roads.start_node == node + 1) | (roads.end_node == node + 1)
    at_level = there & (roads.level == level)
    return int(roads.link_id[np.flatnonzero(at_level if at_level.any() else there)[0]])
