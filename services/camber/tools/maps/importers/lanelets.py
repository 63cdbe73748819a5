"""`camber map build lanelet2`: a Lanelet2 map (.osm, with `ele`) becomes a release.

Each lanelet on which vehicles drive becomes a link and rectangles along it whose heights lie between its borders.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from camber.formats.map_exchange.lanelet2 import ROADS, Lanelet, LaneletMap, read_lanelet2
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.tile_checks import MAX_ID
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.height_options import add_height_arguments, sigma_of, vertical_of
from camber.tools.maps.importers.lane_map import LaneSurvey, lineage, road_map
from camber.tools.maps.importers.lanes import Floats, Integers, Lane, named_id
from camber.tools.options.number_options import number_from


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only a Lanelet2 map needs."""
    parser.add_argument("file", type=Path, metavar="FILE.osm")
    add_height_arguments(parser)
    parser.add_argument(
        "--link-sigma-m",
        type=number_from(0.001, 100.0, "m"),
        default=0.5,
        metavar="S",
        help="σ of the lanes across (default: %(default)s)",
    )
    parser.add_argument(
        "--subtypes",
        default=",".join(sorted(ROADS)),
        help="of lanelets that are taken (default: %(default)s)",
    )


def build(args: argparse.Namespace) -> BuiltMap:
    """Surfaces and links of the lanelets."""
    file = str(args.file)
    found = read_lanelet2(args.file, frozenset(args.subtypes.split(",")))
    vertical = vertical_of(args, file)
    height_m = vertical.ellipsoidal_m(found.latitude_rad, found.longitude_rad, found.height_m, file)
    frame, lanes = lanes_of(found, height_m)
    known = LaneSurvey(
        sigma_m=sigma_of(args, vertical), link_sigma_m=args.link_sigma_m, seen_ns=args.surveyed_ns
    )
    surfaces, links, steps = road_map(lanes, frame, known, file)
    remarks = [
        f"{file}: {count} lanelets of subtype {name} left out" for name, count in found.left_out.items()
    ]
    return BuiltMap(
        surfaces=surfaces,
        links=links,
        lineage=lineage(surfaces, args.previous_release),
        surrogate=vertical.surrogate,
        remarks=[f"{file}: {len(lanes)} lanelets; heights: {vertical.how}", *remarks, *steps],
    )


def lanes_of(lanelets: LaneletMap, height_m: Floats) -> tuple[LocalFrame, list[Lane]]:
    """The lanelets in the plane of a frame in their middle, with ellipsoidal heights (n,) of the map's points."""
    frame = LocalFrame(float(np.mean(lanelets.latitude_rad)), _middle_longitude(lanelets.longitude_rad), 0.0)
    plane_m = frame.east_north_from_geodetic_array(lanelets.latitude_rad, lanelets.longitude_rad, 0.0)
    points = np.column_stack((plane_m, height_m))
    # To a millimetre: a tool that writes the last digits anew has not moved a lane.
    places = np.rint(np.degrees(np.column_stack((lanelets.latitude_rad, lanelets.longitude_rad))) * 1e8)
    return frame, [_lane(own, lanelets, points, places.astype(np.int64)) for own in lanelets.lanelets]


def _middle_longitude(longitude_rad: Floats) -> float:
    return float(np.angle(np.mean(np.exp(1j * longitude_rad))))


def _lane(own: Lanelet, lanelets: LaneletMap, points: Floats, places: Integers) -> Lane:
    right, left = ([lanelets.row_of[ref] for ref in refs] for refs in (own.right, own.left))
    name = f"lanelet {own.lanelet_id}"
    level = own.tags.get("layer", own.tags.get("level", ""))
    return Lane(
        name=name,
        plan=f"{places[right].tolist()} {places[left].tolist()}",
        link_id=own.lanelet_id if 0 <= own.lanelet_id <= MAX_ID else named_id("link", name),
        sections=_sections(points[right], points[left]),
        nodes=(f"{own.left[0]} {own.right[0]}", f"{own.left[-1]} {own.right[-1]}"),
        borders=(str(own.right_border_id), str(own.left_border_id)),
        level=int(level) if level.lstrip("-").isdecimal() and abs(int(level)) <= 20 else None,
    )


def _sections(right: Floats, left: Floats) -> Floats:
    """Cross-sections (n, 2, 3) at all points of both borders, each opposite the point as far along its own border."""
    along = [_share(border) for border in (right, left)]
    at = np.unique(np.concatenate(along))
    at = at[np.concatenate(([True], np.diff(at) > 1e-9))]
    sides = [
        np.column_stack([np.interp(at, share, border[:, axis]) for axis in range(3)])
        for share, border in zip(along, (right, left), strict=True)
    ]
    return np.stack(sides, axis=1)


def _share(border: Floats) -> Floats:
    """How far along a border each of its points is, 0 to 1."""
    along: Floats = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(border[:, :2], axis=0).T))))
    along /= along[-1]
    return along
