"""`camber map build opendrive`: an OpenDRIVE map (.xodr) becomes a release.

Each lane of each lane section becomes a link, in the direction of its traffic, and rectangles along it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.opendrive import (
    JunctionConnection,
    OpenDrive,
    OpenDriveLane,
    OpenDriveRoad,
    RoadEnd,
    read_opendrive,
)
from camber.formats.map_exchange.opendrive_geometry import is_sliver, lane_points, section_span, stations
from camber.formats.map_exchange.opendrive_places import LanePlace, lane_places
from camber.formats.map_exchange.projection import GEOREFERENCE_OPTION, Projection, projection_of
from camber.formats.map_exchange.vertical_datum import VerticalDatum
from camber.geodesy.local_frame import LocalFrame
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.checks.height_check import (
    PLACES,
    SourceHeights,
    add_check_arguments,
    checked_heights,
    heights_on_lanes,
    seed_of,
)
from camber.tools.maps.importers.checks.left_out import LeftOutLanes, add_loss_arguments, left_out_lanes
from camber.tools.maps.importers.checks.level_heights import add_flat_arguments, flat_surrogate
from camber.tools.maps.importers.height_options import add_height_arguments, lane_survey, vertical_of
from camber.tools.maps.importers.lane_map import road_map
from camber.tools.maps.importers.lanes import Floats, JoinedSets, Lane, mean_longitude, named_id
from camber.tools.options.parsers import add_with_default

LANE_TYPES = (
    "driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "bidirectional", "shoulder", "stop", "bus",
    "taxi", "HOV", "slipLane",
)  # fmt: skip
_NARROWEST_M = 0.3  # chosen: no vehicle drives on a narrower lane
_USUAL_WIDTH_M = 3.5  # chosen: by which a lane that cannot be drawn counts as lost area

_GEOREFERENCE = "header, geoReference"

End = tuple[str, int, int, str]
"""Road, number of its lane section, lane, and which end of it in the direction of the road: start or end."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only an OpenDRIVE map needs."""
    parser.add_argument("file", type=Path, metavar="FILE.xodr")
    add_height_arguments(parser, of_lanes=True)
    add_loss_arguments(parser)
    add_flat_arguments(parser)
    add_check_arguments(parser)
    add_with_default(parser, "--lane-types", ",".join(LANE_TYPES), "types of lanes that are taken")
    text = "the projection, where the file does not say it"
    parser.add_argument("--georeference", metavar="PROJ", help=text)


def build(args: argparse.Namespace) -> BuiltMap:
    """Surfaces and links of the lanes."""
    file = str(args.file)
    drive = read_opendrive(args.file, strict=args.strict)
    left_out = left_out_lanes(args)
    text = args.georeference or drive.georeference
    if text is None:
        raise FormatError(file, _GEOREFERENCE, f"a projection, or {GEOREFERENCE_OPTION}", actual="none")
    projection = projection_of(text, args.datum, file, _GEOREFERENCE)
    vertical = vertical_of(args, file, projection.vertical)
    types = frozenset(args.lane_types.split(","))
    frame, lanes = lanes_of(
        drive, projection, vertical, types=types, file=file, flat=args.flat, left_out=left_out
    )
    known = lane_survey(args, vertical)
    surfaces, links, steps = road_map(lanes, frame, known, file, left_out=left_out)
    seed = seed_of(args)
    places = lane_places(args.file.read_bytes(), types, PLACES, np.random.default_rng(seed))
    source = source_heights(places, lanes, georeference=text, vertical=vertical, file=file)
    check = checked_heights(surfaces, source, seed=seed, file=file)
    return BuiltMap(
        surfaces=surfaces,
        links=links,
        surrogate=flat_surrogate(args, vertical.surrogate),
        remarks=[
            f"{file}: {len(lanes)} lanes of {len(drive.roads)} roads; heights: {vertical.how}",
            *steps,
            check,
        ],
    )


def source_heights(
    places: Sequence[LanePlace],
    lanes: Sequence[Lane],
    *,
    georeference: str,
    vertical: VerticalDatum,
    file: str,
) -> SourceHeights:
    """Places of the file on lanes that are taken, with latitudes and longitudes by PROJ and ellipsoidal heights."""
    import pyproj

    crs = pyproj.CRS(georeference)
    to_geodetic = pyproj.Proj(crs.sub_crs_list[0] if crs.is_compound else crs)

    def geodetic(places: Sequence[LanePlace]) -> tuple[Floats, Floats, Floats]:
        at = np.array([(place.x_m, place.y_m, place.z_m) for place in places]).reshape(-1, 3)
        longitude, latitude = (np.radians(angle) for angle in to_geodetic(at[:, 0], at[:, 1], inverse=True))
        return latitude, longitude, at[:, 2]

    return heights_on_lanes(places, lanes, geodetic, vertical=vertical, file=file)


def lanes_of(
    drive: OpenDrive,
    projection: Projection,
    vertical: VerticalDatum,
    *,
    types: frozenset[str],
    file: str,
    flat: bool = False,
    left_out: LeftOutLanes | None = None,
) -> tuple[LocalFrame, list[Lane]]:
    """The lanes of some types in the plane of a frame in their middle, with ellipsoidal heights.

    Invalid ones are entered in `left_out`; without it the first one is raised. `flat`: roads without an elevation
    are at height 0.
    """
    left_out = left_out or LeftOutLanes()
    for unreadable in drive.unreadable:
        for kind in unreadable.lane_kinds:
            if kind in types:
                left_out.add(f"road {unreadable.identity}, a lane of type {kind}", unreadable.error)
    pieces = [
        (road, number, lane, points)
        for road in drive.roads
        for number in range(len(road.sections))
        if not is_sliver(road, number)
        for lane, points in _lanes_of(road, number, types, file=file, flat=flat, left_out=left_out)
    ]
    if not pieces:
        left_out.remarks(0, 0.0, file)
        raise FormatError(file, "lanes", f"at least one of type {', '.join(sorted(types))}")
    plane_m = np.concatenate([points.reshape(-1, 3) for *_, points in pieces]) + np.array(drive.offset_m)
    latitude, longitude = projection.geodetic(plane_m[:, 0], plane_m[:, 1])
    height_m = vertical.ellipsoidal_m(latitude, longitude, plane_m[:, 2], file)
    frame = LocalFrame(float(np.mean(latitude)), mean_longitude(longitude), 0.0)
    plane = np.column_stack((frame.east_north_from_geodetic_array(latitude, longitude, 0.0), height_m))
    sizes = np.cumsum([points.shape[0] * points.shape[1] for *_, points in pieces])
    node_of = _nodes(drive)
    lanes = []
    for (road, number, lane, points), part in zip(pieces, np.split(plane, sizes[:-1]), strict=True):
        place = repr((drive.georeference, drive.offset_m[:2]))
        lanes.append(
            _lane(road, number, lane, points=part.reshape(points.shape), node_of=node_of, place=place)
        )
    return frame, lanes


def _lanes_of(
    road: OpenDriveRoad, number: int, types: frozenset[str], *, file: str, flat: bool, left_out: LeftOutLanes
) -> Iterator[tuple[OpenDriveLane, Floats]]:
    wanted = [lane for lane in road.sections[number].lanes if lane.kind in types]
    if not wanted:
        return
    begin, end = section_span(road, number)
    area_m2 = _USUAL_WIDTH_M * max(end - begin, 0.0)
    errors: dict[int, FormatError] = {}
    try:
        if not flat:
            _check_elevation(road, number, file)
        points = lane_points(road, number, stations(road, number, file), file, errors=errors)
    except FormatError as error:
        errors = dict.fromkeys((lane.lane_id for lane in wanted), error)
    for lane in wanted:
        if lane.lane_id in errors:
            left_out.add(_name(road, number, lane), errors[lane.lane_id], area_m2)
        elif lane.level and _is_banked(road):
            field = f"{_name(road, number, lane)}, level"
            expected = "false on a road with superelevation, crossfall or lateral shape"
            left_out.add(
                _name(road, number, lane), FormatError(file, field, expected, actual="true"), area_m2
            )
        else:
            sections = points[lane.lane_id]
            if np.hypot(*(sections[:, 0, :2] - sections[:, -1, :2]).T).max() >= _NARROWEST_M:
                yield lane, sections


def _check_elevation(road: OpenDriveRoad, number: int, file: str) -> None:
    if not len(road.elevation) or road.elevation[0, 0] > road.sections[number].s_m:
        # By the book that is a road at height 0; of a map that is to judge heights it says that nobody measured it.
        field = f"road {road.identity}, elevationProfile"
        raise FormatError(file, field, "an elevation from the road's begin on, or --flat")


def _is_banked(road: OpenDriveRoad) -> bool:
    profiles = (road.superelevation, road.crossfall_left, road.crossfall_right, road.shape)
    return any(bool((table[:, -4:] != 0.0).any()) for table in profiles)


def _name(road: OpenDriveRoad, number: int, lane: OpenDriveLane) -> str:
    return f"road {road.identity}, section {number}, lane {lane.lane_id}"


def _lane(
    road: OpenDriveRoad,
    number: int,
    lane: OpenDriveLane,
    *,
    points: Floats,
    node_of: dict[End, str],
    place: str,
) -> Lane:
    name = _name(road, number, lane)
    ends = [node_of.get(end, " ".join(map(str, end))) for end in _ends(road, number, lane.lane_id)]
    side = f"{road.identity} {number}"
    outer, inner = lane.lane_id, lane.lane_id - (1 if lane.lane_id > 0 else -1)
    right, left = (inner, outer) if lane.lane_id > 0 else (outer, inner)
    backwards = (lane.lane_id > 0) != road.left_hand_traffic
    if backwards:
        points, ends, (right, left) = points[::-1, ::-1], ends[::-1], (left, right)
    plan = (
        road.geometries, road.superelevation.tolist(), road.lane_offset.tolist(), road.sections[number].s_m,
        [(each.lane_id, each.widths.tolist(), each.borders.tolist()) for each in road.sections[number].lanes],
    )  # fmt: skip
    return Lane(
        name=name,
        plan=f"{place} {plan!r}",
        link_id=named_id("link", name),
        sections=np.ascontiguousarray(points),
        nodes=(ends[0], ends[1]),
        borders=(f"{side} {right}", f"{side} {left}"),
    )


def _ends(road: OpenDriveRoad, number: int, lane: int) -> tuple[End, End]:
    return (road.identity, number, lane, "start"), (road.identity, number, lane, "end")


def _nodes(drive: OpenDrive) -> dict[End, str]:
    """A name for each end of a lane that goes on to another, the same for all that meet there."""
    sets = JoinedSets[End]()
    for a, b in _meetings(drive):
        sets.join(a, b)
    return {end: " ".join(map(str, sets.least(end))) for end in sets}


def _meetings(drive: OpenDrive) -> Iterator[tuple[End, End]]:
    roads = {road.identity: road for road in drive.roads}
    for road in drive.roads:
        for number, section in enumerate(road.sections):
            for lane in section.lanes:
                start, end = _ends(road, number, lane.lane_id)
                if is_sliver(road, number):
                    yield start, end  # no link of it: what comes before it meets what comes after it
                if lane.predecessor is not None and number > 0:
                    yield start, _ends(road, number - 1, lane.predecessor)[1]
                elif lane.predecessor is not None:
                    yield from _to_road(start, road.predecessor, lane.predecessor, roads)
                if lane.successor is not None and number < len(road.sections) - 1:
                    yield end, _ends(road, number + 1, lane.successor)[0]
                elif lane.successor is not None:
                    yield from _to_road(end, road.successor, lane.successor, roads)
    for connection in drive.connections:
        yield from _in_junction(connection, roads)


def _to_road(
    end: End, to: RoadEnd | None, lane: int, roads: dict[str, OpenDriveRoad]
) -> Iterator[tuple[End, End]]:
    if to is not None and to.kind == "road" and to.identity in roads and to.contact is not None:
        yield end, _contact(roads[to.identity], to.contact, lane)


def _in_junction(
    connection: JunctionConnection, roads: dict[str, OpenDriveRoad]
) -> Iterator[tuple[End, End]]:
    incoming, connecting = roads.get(connection.incoming), roads.get(connection.connecting)
    if incoming is None or connecting is None:
        return
    for contact, to in (("start", incoming.predecessor), ("end", incoming.successor)):
        if to is not None and to.kind == "junction" and to.identity == connection.junction:
            for a, b in connection.lanes:
                yield _contact(incoming, contact, a), _contact(connecting, connection.contact, b)


def _contact(road: OpenDriveRoad, contact: str, lane: int) -> End:
    start, end = _ends(road, 0, lane)[0], _ends(road, len(road.sections) - 1, lane)[1]
    return start if contact == "start" else end
