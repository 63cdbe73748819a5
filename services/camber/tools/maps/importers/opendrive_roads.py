"""`camber map build opendrive`: an OpenDRIVE map (.xodr) becomes a release.

Each lane of each lane section becomes a link, in the direction of its traffic, and rectangles along it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
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
from camber.formats.map_exchange.opendrive_geometry import lane_points, stations
from camber.formats.map_exchange.projection import Projection, projection_of
from camber.formats.map_exchange.vertical_datum import VerticalDatum
from camber.geodesy.local_frame import LocalFrame
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.height_options import add_height_arguments, lane_survey, vertical_of
from camber.tools.maps.importers.lane_map import road_map
from camber.tools.maps.importers.lanes import Floats, JoinedSets, Lane, mean_longitude, named_id
from camber.tools.options.parsers import add_with_default

LANE_TYPES = (
    "driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "bidirectional", "shoulder", "stop", "bus",
    "taxi", "HOV", "slipLane",
)  # fmt: skip
_NARROWEST_M = 0.3  # chosen: no vehicle drives on a narrower lane

End = tuple[str, int, int, str]
"""Road, number of its lane section, lane, and which end of it in the direction of the road: start or end."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only an OpenDRIVE map needs."""
    parser.add_argument("file", type=Path, metavar="FILE.xodr")
    add_height_arguments(parser, of_lanes=True)
    add_with_default(parser, "--lane-types", ",".join(LANE_TYPES), "types of lanes that are taken")
    text = "the projection, where the file does not say it"
    parser.add_argument("--georeference", metavar="PROJ", help=text)


def build(args: argparse.Namespace) -> BuiltMap:
    """Surfaces and links of the lanes."""
    file = str(args.file)
    drive = read_opendrive(args.file)
    text = args.georeference or drive.georeference
    if text is None:
        expected = "a projection, or --georeference with one"
        raise FormatError(file, "header, geoReference", expected, actual="none")
    projection = projection_of(text, args.datum, file, "header, geoReference")
    vertical = vertical_of(args, file, projection.vertical)
    types = frozenset(args.lane_types.split(","))
    frame, lanes = lanes_of(drive, projection, vertical, types=types, file=file)
    known = lane_survey(args, vertical)
    surfaces, links, steps = road_map(lanes, frame, known, file)
    return BuiltMap(
        surfaces=surfaces,
        links=links,
        surrogate=vertical.surrogate,
        remarks=[f"{file}: {len(lanes)} lanes of {len(drive.roads)} roads; heights: {vertical.how}", *steps],
    )


def lanes_of(
    drive: OpenDrive, projection: Projection, vertical: VerticalDatum, *, types: frozenset[str], file: str
) -> tuple[LocalFrame, list[Lane]]:
    """The lanes of some types in the plane of a frame in their middle, with ellipsoidal heights."""
    pieces = [
        (road, number, lane, points)
        for road in drive.roads
        for number in range(len(road.sections))
        for lane, points in _lanes_of(road, number, types, file)
    ]
    if not pieces:
        raise FormatError(file, "lanes", f"at least one of type {', '.join(sorted(types))}")
    flat = np.concatenate([points.reshape(-1, 3) for *_, points in pieces]) + np.array(drive.offset_m)
    latitude, longitude = projection.geodetic(flat[:, 0], flat[:, 1])
    height_m = vertical.ellipsoidal_m(latitude, longitude, flat[:, 2], file)
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
    road: OpenDriveRoad, number: int, types: frozenset[str], file: str
) -> Iterator[tuple[OpenDriveLane, Floats]]:
    wanted = [lane for lane in road.sections[number].lanes if lane.kind in types]
    if not wanted:
        return
    if not len(road.elevation) or road.elevation[0, 0] > road.sections[number].s_m:
        # By the book that is a road at height 0; of a map that is to judge heights it says that nobody measured it.
        field = f"road {road.identity}, elevationProfile"
        raise FormatError(file, field, "an elevation from the road's begin on")
    points = lane_points(road, number, stations(road, number, file), file)
    for lane in wanted:
        sections = points[lane.lane_id]
        if np.hypot(*(sections[:, 0, :2] - sections[:, -1, :2]).T).max() >= _NARROWEST_M:
            yield lane, sections


def _lane(
    road: OpenDriveRoad,
    number: int,
    lane: OpenDriveLane,
    *,
    points: Floats,
    node_of: dict[End, str],
    place: str,
) -> Lane:
    name = f"road {road.identity}, section {number}, lane {lane.lane_id}"
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
