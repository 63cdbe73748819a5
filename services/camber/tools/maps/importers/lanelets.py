"""`camber map build lanelet2`: a Lanelet2 map (.osm, with `ele`) becomes a release.

Each lanelet on which vehicles drive becomes a link and rectangles along it whose heights lie between its borders.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camber.formats.map_exchange.lanelet2 import ROADS, Lanelet, LaneletMap, place_of_local, read_lanelet2
from camber.formats.map_exchange.lanelet_places import BorderPlace, border_places
from camber.formats.map_exchange.map_projector import FILE_NAME, MapProjector, read_map_projector
from camber.formats.map_exchange.vertical_datum import VerticalDatum
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.tile_checks import MAX_ID
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.checks.height_check import (
    PLACES,
    SourceHeights,
    add_check_arguments,
    checked_heights,
    heights_on_lanes,
    seed_of,
)
from camber.tools.maps.importers.checks.left_out import add_loss_arguments, left_out_lanes
from camber.tools.maps.importers.checks.level_heights import add_flat_arguments, flat_surrogate
from camber.tools.maps.importers.height_options import add_height_arguments, lane_survey, vertical_of
from camber.tools.maps.importers.lane_map import road_map
from camber.tools.maps.importers.lanes import Floats, Integers, Lane, distance_along, mean_longitude, named_id
from camber.tools.options.parsers import add_with_default


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only a Lanelet2 map needs."""
    parser.add_argument("file", type=Path, metavar="FILE.osm")
    text = f"how local_x and local_y are projected (default: {FILE_NAME} in the folder of the map, if it is there)"
    parser.add_argument("--projector", type=Path, metavar="FILE", help=text)
    add_height_arguments(parser, of_lanes=True)
    add_loss_arguments(parser)
    add_flat_arguments(parser)
    add_check_arguments(parser)
    add_with_default(parser, "--subtypes", ",".join(sorted(ROADS)), "of lanelets that are taken")


def build(args: argparse.Namespace) -> BuiltMap:
    """Surfaces and links of the lanelets."""
    file = str(args.file)
    left_out = left_out_lanes(args)
    subtypes = frozenset(args.subtypes.split(","))
    projector = projector_of(args.file, args.projector)
    source = read_lanelet2(args.file, subtypes, strict=args.strict, projector=projector)
    for name, error in source.unreadable.items():
        left_out.add(name, error)
    if not source.lanelets:
        left_out.remarks(0, 0.0, file)
    vertical = vertical_of(args, file, None if projector is None else projector.vertical)
    height_m = vertical.ellipsoidal_m(source.latitude_rad, source.longitude_rad, source.height_m, file)
    frame, lanes = lanes_of(source, height_m)
    surfaces, links, steps = road_map(lanes, frame, lane_survey(args, vertical), file, left_out=left_out)
    remarks = [f"{file}: {len(links)} links of lanelets; heights: {vertical.how}"]
    remarks += [
        f"{file}: {count} lanelets of subtype {name} not taken" for name, count in source.left_out.items()
    ]
    seed = seed_of(args)
    places = border_places(
        args.file.read_bytes(),
        subtypes,
        PLACES,
        np.random.default_rng(seed),
        place_of_local=lambda tags: place_of_local(tags, "node", file, projector),
    )
    check = checked_heights(surfaces, source_heights(places, lanes, vertical, file), seed=seed, file=file)
    return BuiltMap(
        surfaces=surfaces,
        links=links,
        surrogate=flat_surrogate(args, vertical.surrogate),
        remarks=[*remarks, *steps, check],
    )


def projector_of(map_path: Path, named: Path | None = None) -> MapProjector | None:
    """Return the projector of the `named` file, or of that which Autoware expects beside the map; None for neither."""
    path = named or map_path.with_name(FILE_NAME)
    return read_map_projector(path) if named is not None or path.is_file() else None


def source_heights(
    places: Sequence[BorderPlace], lanes: Sequence[Lane], vertical: VerticalDatum, file: str
) -> SourceHeights:
    """Places of the file on borders of lanelets that are taken, with ellipsoidal heights."""

    def geodetic(places: Sequence[BorderPlace]) -> tuple[Floats, Floats, Floats]:
        at = [(place.latitude_deg, place.longitude_deg, place.height_m) for place in places]
        latitude_deg, longitude_deg, height_m = np.array(at).reshape(-1, 3).T
        return np.radians(latitude_deg), np.radians(longitude_deg), height_m

    return heights_on_lanes(places, lanes, geodetic, vertical=vertical, file=file)


def lanes_of(lanelets: LaneletMap, height_m: Floats) -> tuple[LocalFrame, list[Lane]]:
    """The lanelets in the plane of a frame in their middle, with ellipsoidal heights (n,) of the map's points."""
    frame = LocalFrame(float(np.mean(lanelets.latitude_rad)), mean_longitude(lanelets.longitude_rad), 0.0)
    plane_m = frame.east_north_from_geodetic_array(lanelets.latitude_rad, lanelets.longitude_rad, 0.0)
    points = np.column_stack((plane_m, height_m))
    # To a millimetre: a tool that writes the last digits anew has not moved a lane.
    places = np.rint(np.degrees(np.column_stack((lanelets.latitude_rad, lanelets.longitude_rad))) * 1e8)
    return frame, [_lane(each, lanelets, points, places.astype(np.int64)) for each in lanelets.lanelets]


def _lane(lanelet: Lanelet, lanelets: LaneletMap, points: Floats, places: Integers) -> Lane:
    right, left = ([lanelets.row_of[ref] for ref in refs] for refs in (lanelet.right, lanelet.left))
    name = f"lanelet {lanelet.lanelet_id}"
    level = lanelet.tags.get("layer", lanelet.tags.get("level", ""))
    return Lane(
        name=name,
        plan=f"{places[right].tolist()} {places[left].tolist()}",
        link_id=lanelet.lanelet_id if 0 <= lanelet.lanelet_id <= MAX_ID else named_id("link", name),
        sections=_sections(points[right], points[left]),
        nodes=(f"{lanelet.left[0]} {lanelet.right[0]}", f"{lanelet.left[-1]} {lanelet.right[-1]}"),
        borders=(str(lanelet.right_border_id), str(lanelet.left_border_id)),
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
    along = distance_along(border)
    share: Floats = along / along[-1]
    return share
