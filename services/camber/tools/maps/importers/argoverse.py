"""A release from a log of Argoverse 2: its lanes as links, the raster of the ground's height as their surfaces.

City coordinates are metres of the city's UTM zone from a published origin. How high a city's zero is above the
ellipsoid is not published: name it with --zero-height-m, or the heights of the release are the city's own.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.argoverse import ArgoverseLog, LaneSegment, read_log
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.road_columns import RoadLinks
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.lanes import JoinedSets, distance_along
from camber.tools.maps.importers.surfaces_along import Floats, Integers, RoadCentreLines, surfaces_along
from camber.tools.options.number_options import (
    HEIGHT,
    HEIGHT_SIGMA,
    LATITUDE,
    LONGITUDE,
    each_of,
    number_from,
)
from camber.tools.options.parsers import add_with_default

CITIES: dict[str, tuple[int, float, float]] = {
    "ATX": (14, 30.27464237939507, -97.7404457407424),
    "DTW": (17, 42.29993066912924, -83.17555750783717),
    "MIA": (17, 25.77452579915163, -80.19656914449405),
    "PAO": (10, 37.416065, -122.13571963362166),
    "PIT": (17, 40.44177902989321, -80.01294377242584),
    "WDC": (18, 38.889377, -77.0355047439081),
}
"""UTM zone (north), latitude and longitude of the origin [deg]: argoverse/av2-api, src/av2/geometry/utm.py."""
_KINDS = ("VEHICLE", "BUS")
_STEP_M = 2.0  # chosen: spacing of centre line points; lane boundaries have a point every few metres
_OTHER_LEVEL_M = 1.0  # chosen: far above the error of the raster, far below the height of a bridge

Convert = Callable[[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True, slots=True)
class CityFrame:
    """Between city coordinates (n, 2) [m] and latitude, longitude (n,) [rad]."""

    to_geodetic: Convert
    from_geodetic: Convert

    @classmethod
    def of_city(cls, city: str) -> CityFrame:
        """Raises FormatError for a city whose origin is not published."""
        if city not in CITIES:
            raise FormatError("log", "city", ", ".join(CITIES), actual=city)
        import pyproj

        zone, latitude_deg, longitude_deg = CITIES[city]
        utm = pyproj.Proj(proj="utm", zone=zone, ellps="WGS84")
        east0, north0 = utm(longitude_deg, latitude_deg)

        def to_geodetic(x_m: Floats, y_m: Floats) -> tuple[Floats, Floats]:
            longitude, latitude = utm(x_m + east0, y_m + north0, inverse=True)
            return np.deg2rad(latitude), np.deg2rad(longitude)

        def from_geodetic(latitude_rad: Floats, longitude_rad: Floats) -> tuple[Floats, Floats]:
            east, north = utm(np.rad2deg(longitude_rad), np.rad2deg(latitude_rad))
            return np.asarray(east) - east0, np.asarray(north) - north0

        return cls(to_geodetic, from_geodetic)

    @classmethod
    def at(cls, latitude_deg: float, longitude_deg: float) -> CityFrame:
        """City coordinates taken for the tangent plane at a named origin."""
        frame = LocalFrame(float(np.deg2rad(latitude_deg)), float(np.deg2rad(longitude_deg)), 0.0)

        def to_geodetic(x_m: Floats, y_m: Floats) -> tuple[Floats, Floats]:
            return frame.geodetic_from_east_north_array(np.column_stack((x_m, y_m)), 0.0)[:2]

        def from_geodetic(latitude_rad: Floats, longitude_rad: Floats) -> tuple[Floats, Floats]:
            plane = frame.east_north_from_geodetic_array(latitude_rad, longitude_rad, 0.0 * latitude_rad)
            return plane[:, 0], plane[:, 1]

        return cls(to_geodetic, from_geodetic)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only this kind needs."""
    parser.add_argument("log", type=Path, help="folder of a log: city_SE3_egovehicle.feather and map/")
    text = "ellipsoidal height of the city's zero, where it is known"
    parser.add_argument("--zero-height-m", type=HEIGHT, metavar="H", help=text)
    text = "degrees: take city coordinates for the plane there, not for those of the city in the files' names"
    origin = each_of(LATITUDE, LONGITUDE)
    parser.add_argument("--origin", action=origin, nargs=2, metavar=("LAT", "LON"), help=text)
    add_with_default(parser, "--sigma-m", 0.03, "σ of the raster's heights", type=HEIGHT_SIGMA, metavar="S")
    text = "between the surfaces' heights; else the raster's cells"
    parser.add_argument("--spacing-m", type=number_from(0.05, 20.0, "m"), metavar="D", help=text)


def build(args: argparse.Namespace) -> BuiltMap:
    """Lanes for vehicles, each with surfaces as wide as it is."""
    log = read_log(args.log)
    city = CityFrame.of_city(log.city) if args.origin is None else CityFrame.at(*args.origin)
    zero_m = 0.0 if args.zero_height_m is None else args.zero_height_m
    lanes, elsewhere = _on_the_raster(log)
    if not lanes:
        raise FormatError(str(args.log), "lanes", "one for vehicles that lies on the raster")
    roads = _roads(lanes, city)

    def ground(latitude: Floats, longitude: Floats, _: Integers) -> tuple[Floats, Floats]:
        plane_m = np.column_stack(city.from_geodetic(latitude, longitude))
        height_m = log.ground.height_between(plane_m) + zero_m
        return height_m, np.where(np.isfinite(height_m), args.sigma_m, np.nan)

    spacing_m = log.ground.cell_m if args.spacing_m is None else args.spacing_m
    surfaces = surfaces_along(roads, ground, spacing_m=spacing_m, seen_ns=args.surveyed_ns)
    remarks = [f"{elsewhere} lanes lie on another level than the raster: no surfaces"] if elsewhere else []
    surrogate = f"Argoverse 2, city {log.city}: ground raster of cells of {log.ground.cell_m:g} m"
    if args.zero_height_m is None:
        surrogate += "; heights are above the city's own zero, not the ellipsoid"
    return BuiltMap(surfaces=surfaces, links=roads.links, surrogate=surrogate, remarks=remarks)


def centre_line(lane: LaneSegment) -> tuple[Floats, float]:
    """Places (k, 3) halfway between a lane's boundaries, and half of its median width [m]."""
    length_m = max(distance_along(side)[-1] for side in (lane.left_m, lane.right_m))
    count = max(2, 1 + int(length_m / _STEP_M))
    left_m, right_m = (_points_along(side, count) for side in (lane.left_m, lane.right_m))
    width_m = np.hypot(*(left_m - right_m)[:, :2].T)
    return 0.5 * (left_m + right_m), 0.5 * float(np.median(width_m))


def _points_along(line_m: Floats, count: int) -> Floats:
    along = distance_along(line_m)
    at = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(at, along, column) for column in line_m.T])


def _on_the_raster(log: ArgoverseLog) -> tuple[list[LaneSegment], int]:
    """Lanes for vehicles whose own heights are near the raster's, and how many are not: over or under what it is of."""
    lanes = [lane for lane in log.lanes if lane.kind in _KINDS]
    off_m = []
    for lane in lanes:
        line_m, _ = centre_line(lane)
        off = np.abs(log.ground.height_between(line_m) - line_m[:, 2])
        off_m.append(float(np.median(off[np.isfinite(off)])) if np.isfinite(off).any() else 0.0)
    kept = [lane for lane, off in zip(lanes, off_m, strict=True) if off <= _OTHER_LEVEL_M]
    return kept, len(lanes) - len(kept)


def _roads(lanes: list[LaneSegment], city: CityFrame) -> RoadCentreLines:
    lines = [centre_line(lane) for lane in lanes]
    vertices = [np.column_stack(city.to_geodetic(line_m[:, 0], line_m[:, 1])) for line_m, _ in lines]
    start, end = _nodes(lanes)
    n = len(lanes)
    links = RoadLinks(
        link_id=np.array([lane.lane_id for lane in lanes]),
        start_node=start,
        end_node=end,
        level=np.zeros(n, np.int64),
        sigma_m=np.full(n, 0.3),
        vertices=vertices,
    )
    return RoadCentreLines(links, np.array([max(half_m, 0.5) for _, half_m in lines]))


def _nodes(lanes: list[LaneSegment]) -> tuple[Integers, Integers]:
    """Node ids at the start and the end of each lane; where one succeeds another they share a node.

    An end is numbered `2 · lane id` (start) or one more (end), and a node has the least number of its ends.
    """
    nodes = JoinedSets[int]()
    for lane in lanes:
        for other in lane.successors:
            nodes.join(2 * lane.lane_id + 1, 2 * other)
    start, end = (np.array([nodes.least(2 * lane.lane_id + k) for lane in lanes]) for k in (0, 1))
    return start, end
