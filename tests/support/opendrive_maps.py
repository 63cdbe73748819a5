"""An OpenDRIVE map made up: a street with spirals and superelevation, a bridge over it, a ramp and a junction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from numpy.typing import NDArray

from camber.formats.map_exchange.opendrive import (
    SHAPES,
    JunctionConnection,
    LaneSection,
    OpenDrive,
    OpenDriveLane,
    OpenDriveRoad,
    PlanViewGeometry,
    RoadEnd,
)
from camber.formats.map_exchange.opendrive_geometry import reference_line

Floats = NDArray[np.float64]

GEOREFERENCE = "+proj=utm +zone=32 +datum=WGS84 +units=m +no_defs"
EAST_M, NORTH_M = 691_000.0, 5_334_000.0
NO_ROWS = np.zeros((0, 5))
RADIUS_M = 60.0


def cubics(*rows: tuple[float, ...]) -> Floats:
    return np.array(rows, np.float64).reshape(-1, 5)


def lane(
    lane_id: int, width_m: float = 3.5, before: int | None = None, after: int | None = None
) -> OpenDriveLane:
    return OpenDriveLane(
        lane_id=lane_id,
        kind="driving",
        widths=cubics((0.0, width_m, 0.0, 0.0, 0.0)),
        borders=NO_ROWS,
        predecessor=before,
        successor=after,
    )


def road(
    identity: str, geometries: list[PlanViewGeometry], sections: list[LaneSection], **more: object
) -> OpenDriveRoad:
    names = ("elevation", "superelevation", "crossfall_left", "crossfall_right", "lane_offset")
    profiles: dict[str, object] = dict.fromkeys(names, NO_ROWS)
    length_m = geometries[-1].s_m + geometries[-1].length_m
    values = profiles | {"shape": np.zeros((0, 6))} | more
    return OpenDriveRoad(
        identity=identity, length_m=length_m, geometries=geometries, sections=sections, **values
    )  # type: ignore[arg-type]


def geometry(
    start: Sequence[float], length_m: float, shape: str = "line", numbers: tuple[float, ...] = ()
) -> PlanViewGeometry:
    """A reference line from a place on: x, y, heading."""
    x_m, y_m, heading_rad = map(float, start)
    return PlanViewGeometry(
        s_m=0.0, x_m=x_m, y_m=y_m, heading_rad=heading_rad, length_m=length_m, shape=shape, numbers=numbers,
        normalised=shape == "paramPoly3",
    )  # fmt: skip


def street_geometries() -> list[PlanViewGeometry]:
    """100 m straight, a clothoid of 40 m to the left, 60 m of arc, a clothoid out of it, 30 m straight."""
    k = 1.0 / RADIUS_M
    parts: list[tuple[str, float, tuple[float, ...]]] = [
        ("line", 100.0, ()), ("spiral", 40.0, (0.0, k)), ("arc", 60.0, (k,)),
        ("spiral", 40.0, (k, 0.0)), ("line", 30.0, ()),
    ]  # fmt: skip
    geometries: list[PlanViewGeometry] = []
    start, s_m = np.array([EAST_M, NORTH_M, 0.2]), 0.0
    for shape, length_m, numbers in parts:
        part = geometry(start, length_m, shape, numbers)
        geometries.append(replace(part, s_m=s_m))
        start = reference_line(road("", [part], []), np.array([length_m]))[0]
        s_m += length_m
    return geometries


def town() -> OpenDrive:
    """Street 1 (its second section has a lane more), bridge 2 over it, ramp 3 after 2, junction 9 behind 1."""
    street = street_geometries()
    street_road = road(
        "1",
        street,
        [
            LaneSection(0.0, [lane(1, after=1), lane(-1, after=-1)]),
            LaneSection(150.0, [lane(1, before=1), lane(-1, before=-1), lane(-2, 3.0)]),
        ],
        elevation=cubics((0.0, 520.0, 0.02, 0.0, 0.0), (120.0, 522.4, 0.02, -2e-4, 4e-7)),
        superelevation=cubics(
            (100.0, 0.0, 0.0015, 0.0, 0.0), (140.0, 0.06, 0.0, 0.0, 0.0),
            (200.0, 0.06, -0.0015, 0.0, 0.0), (240.0, 0.0, 0.0, 0.0, 0.0),
        ),
        successor=RoadEnd(kind="junction", identity="9"),
    )  # fmt: skip
    middle = reference_line(street_road, np.array([50.0]))[0]
    across = middle[2] + 0.5 * math.pi
    start = middle[0] - 60.0 * math.cos(across), middle[1] - 60.0 * math.sin(across), across
    bridge = road(
        "2",
        [geometry(start, 120.0)],
        [LaneSection(0.0, [lane(1, before=None, after=1), lane(-1, after=-1)])],
        elevation=cubics((0.0, 525.0, 0.08, -0.08 / 120.0, 0.0)),
        successor=RoadEnd(kind="road", identity="3", contact="start"),
    )
    end = reference_line(bridge, np.array([120.0]))[0]
    bend = (0.0, 80.0, 0.0, 0.0, 0.0, 0.0, 20.0, -10.0)
    ramp = road(
        "3",
        [geometry(end, 81.2, "paramPoly3", bend)],
        [LaneSection(0.0, [lane(1, before=1), lane(-1, before=-1)])],
        elevation=cubics((0.0, 525.0, -0.05, 0.0, 0.0)),
        predecessor=RoadEnd(kind="road", identity="2", contact="end"),
    )
    last = reference_line(street_road, np.array([street_road.length_m]))[0]
    turn = road(
        "4",
        [geometry(last, 25.0, "arc", (-0.05,))],
        [LaneSection(0.0, [lane(-1, before=-1)])],
        elevation=cubics((0.0, *_rise(street_road), 0.0, 0.0)),
        predecessor=RoadEnd(kind="road", identity="1", contact="end"),
    )
    return OpenDrive(
        georeference=GEOREFERENCE,
        offset_m=(0.0, 0.0, 0.0),
        roads=[street_road, bridge, ramp, turn],
        connections=[
            JunctionConnection(junction="9", incoming="1", connecting="4", contact="start", lanes=[(-1, -1)])
        ],
    )


def _rise(road: OpenDriveRoad) -> tuple[float, float]:
    """Height and slope at the end of a road."""
    s, a, b, c, d = road.elevation[-1].tolist()
    ds = road.length_m - s
    return a + ds * (b + ds * (c + ds * d)), b + ds * (2.0 * c + 3.0 * d * ds)


def opendrive_bytes(drive: OpenDrive) -> bytes:
    """A map as OpenDRIVE 1.7 that is read as the same, to the last digit."""
    root = Element("OpenDRIVE")
    header = SubElement(root, "header", revMajor="1", revMinor="7")
    if drive.georeference is not None:
        SubElement(header, "geoReference").text = drive.georeference
    if any(drive.offset_m):
        SubElement(header, "offset", _numbers(("x", "y", "z", "hdg"), (*drive.offset_m, 0.0)))
    for each in drive.roads:
        _write_road(root, each)
    for name in dict.fromkeys(connection.junction for connection in drive.connections):
        junction = SubElement(root, "junction", id=name, name=name)
        of_junction = [connection for connection in drive.connections if connection.junction == name]
        for k, connection in enumerate(of_junction):
            ends = {"incomingRoad": connection.incoming, "connectingRoad": connection.connecting}
            element = SubElement(junction, "connection", id=str(k), **ends, contactPoint=connection.contact)
            for first, second in connection.lanes:
                SubElement(element, "laneLink", {"from": str(first), "to": str(second)})
    return tostring(root, "UTF-8")


def _write_road(root: Element, each: OpenDriveRoad) -> None:
    rule = "LHT" if each.left_hand_traffic else "RHT"
    length = repr(float(each.length_m))
    element = SubElement(root, "road", id=each.identity, length=length, junction="-1", rule=rule)
    link = SubElement(element, "link")
    for tag, end in (("predecessor", each.predecessor), ("successor", each.successor)):
        if end is not None:
            contact = {} if end.contact is None else {"contactPoint": end.contact}
            SubElement(link, tag, elementType=end.kind, elementId=end.identity, **contact)
    plan_view = SubElement(element, "planView")
    for part in each.geometries:
        start = (part.s_m, part.x_m, part.y_m, part.heading_rad, part.length_m)
        geometry = SubElement(plan_view, "geometry", _numbers(("s", "x", "y", "hdg", "length"), start))
        shape = SubElement(geometry, part.shape, _numbers(SHAPES[part.shape], part.numbers))
        if part.shape == "paramPoly3":
            shape.set("pRange", "normalized" if part.normalised else "arcLength")
    _write_cubics(SubElement(element, "elevationProfile"), "elevation", each.elevation)
    lateral = SubElement(element, "lateralProfile")
    _write_cubics(lateral, "superelevation", each.superelevation)
    _write_cubics(lateral, "crossfall", each.crossfall_left, side="left")
    _write_cubics(lateral, "crossfall", each.crossfall_right, side="right")
    for row in each.shape.tolist():
        SubElement(lateral, "shape", _numbers(("s", "t", "a", "b", "c", "d"), row))
    lanes = SubElement(element, "lanes")
    _write_cubics(lanes, "laneOffset", each.lane_offset)
    for section in each.sections:
        section_element = SubElement(lanes, "laneSection", _numbers(("s",), (section.s_m,)))
        for side, sign in (("left", 1), ("right", -1)):
            of_side = [other_lane for other_lane in section.lanes if other_lane.lane_id * sign > 0]
            if of_side:
                side_element = SubElement(section_element, side)
                for one in sorted(of_side, key=lambda other_lane: -other_lane.lane_id):
                    _write_lane(side_element, one)


def _write_lane(parent: Element, one: OpenDriveLane) -> None:
    level = "true" if one.level else "false"
    element = SubElement(parent, "lane", id=str(one.lane_id), type=one.kind, level=level)
    link = SubElement(element, "link")
    for tag, other in (("predecessor", one.predecessor), ("successor", one.successor)):
        if other is not None:
            SubElement(link, tag, id=str(other))
    _write_cubics(element, "width", one.widths, "sOffset")
    _write_cubics(element, "border", one.borders, "sOffset")
    for row in one.heights.tolist():
        SubElement(element, "height", _numbers(("sOffset", "inner", "outer"), row))


def _write_cubics(parent: Element, tag: str, table: Floats, at: str = "s", **more: str) -> None:
    for row in table.tolist():
        SubElement(parent, tag, more | _numbers((at, "a", "b", "c", "d"), row))


def _numbers(keys: Sequence[str], numbers: Sequence[float]) -> dict[str, str]:
    return {key: repr(float(number)) for key, number in zip(keys, numbers, strict=True)}
