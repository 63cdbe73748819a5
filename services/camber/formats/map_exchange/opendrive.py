"""OpenDRIVE maps (.xodr): what stands in the XML, as plain values; read and written.

Source: ASAM OpenDRIVE 1.8.0, and 1.4H for `poly3` and `crossfall`, which later editions dropped. Read are: header with
geoReference and offset; of roads the plan view (line, arc, spiral, poly3, paramPoly3), elevation, superelevation,
crossfall, lateral shape, lane offset, lane sections with widths or borders, links; of junctions the connections.
`camber.formats.map_exchange.opendrive_geometry` computes with it.
"""

from __future__ import annotations

import io
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError

Floats = NDArray[np.float64]
Element = ElementTree.Element

MAX_BYTES = 1 << 30
MOST_ROAD_M = 100_000.0
_MOST = 1e9
_CUBIC = ("a", "b", "c", "d")
_PARAMETRIC = ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV")


@dataclass(frozen=True, kw_only=True)
class PlanViewGeometry:
    """One part of a reference line: where it begins, and its shape.

    `shape` is line, arc (curvature), spiral (curvature at begin and end), poly3 (a, b, c, d) or paramPoly3 (eight
    coefficients; `normalised`: its parameter goes from 0 to 1, else it is the length along).
    """

    s_m: float
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    shape: str
    numbers: tuple[float, ...] = ()
    normalised: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenDriveLane:
    """A lane of a section: cubics (n, 5) of its width or its outer border, by the distance from the section's begin."""

    lane_id: int
    kind: str
    widths: Floats
    borders: Floats
    predecessor: int | None = None
    successor: int | None = None


@dataclass(frozen=True)
class LaneSection:
    """Lanes from `s_m` on, without the middle one, which has no width."""

    s_m: float
    lanes: Sequence[OpenDriveLane]


@dataclass(frozen=True, kw_only=True)
class RoadEnd:
    """What a road goes on to: kind road (with the end where they meet, start or end) or junction."""

    kind: str
    identity: str
    contact: str | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenDriveRoad:
    """One road. Profiles are cubics (n, 5): s, a, b, c, d with a + b·ds + c·ds² + d·ds³ from s on."""

    identity: str
    length_m: float
    geometries: Sequence[PlanViewGeometry]
    sections: Sequence[LaneSection]
    elevation: Floats
    superelevation: Floats
    crossfall_left: Floats
    crossfall_right: Floats
    shape: Floats
    """(n, 6): s, t, a, b, c, d: heights over t, straight from one s to the next."""
    lane_offset: Floats
    left_hand_traffic: bool = False
    predecessor: RoadEnd | None = None
    successor: RoadEnd | None = None


@dataclass(frozen=True, kw_only=True)
class JunctionConnection:
    """In a junction: lanes (from, to) of an incoming road and of the connecting road at that of its ends.

    In a direct junction, which has no roads of its own, the road behind it stands for the connecting road.
    """

    junction: str
    incoming: str
    connecting: str
    contact: str
    lanes: Sequence[tuple[int, int]]


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenDrive:
    """A map. Without a geoReference its place on earth is not known. The offset (x, y, z) is added to coordinates."""

    georeference: str | None
    offset_m: tuple[float, float, float]
    roads: Sequence[OpenDriveRoad]
    connections: Sequence[JunctionConnection] = ()


def read_opendrive(path: Path) -> OpenDrive:
    """The map in a file; FormatError where something in it is not as it must be."""
    if path.stat().st_size > MAX_BYTES:
        raise FormatError(str(path), "size", f"at most {MAX_BYTES >> 30} GiB")
    return opendrive_map(path.read_bytes(), str(path))


def opendrive_map(data: bytes, file: str) -> OpenDrive:
    """`read_opendrive` of bytes."""
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise FormatError(file, "XML", "a document without a DOCTYPE")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FormatError(file, "XML", f"a whole document ({error})") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[
            2
        ]  # editions differ in their namespaces, not in their names
    if root.tag != "OpenDRIVE":
        raise FormatError(file, "XML", "a document <OpenDRIVE>", actual=f"<{root.tag}>")
    roads = [_road(element, file) for element in root.findall("road")]
    if not roads:
        raise FormatError(file, "road", "at least one")
    names = [road.identity for road in roads]
    if len(set(names)) != len(names):
        raise FormatError(file, "road id", "each once")
    connections = [
        _connection(junction.get("id", ""), element, file)
        for junction in root.findall("junction")
        for element in junction.findall("connection")
        if _connected(element) is not None and element.get("incomingRoad") is not None
    ]
    header = root.find("header")
    georeference = None if header is None else (header.findtext("geoReference") or "").strip() or None
    offset = None if header is None else header.find("offset")
    if offset is not None and abs(_number(offset, "hdg", file, "header, offset", default=0.0)) > 0.0:
        raise FormatError(file, "header, offset, hdg", "0", actual=offset.get("hdg"))
    x, y, z = (
        0.0 if offset is None else _number(offset, name, file, "header, offset", default=0.0)
        for name in ("x", "y", "z")
    )
    return OpenDrive(georeference=georeference, offset_m=(x, y, z), roads=roads, connections=connections)


# -- read ------------------------------------------------------------------------------------------------------------


def _road(element: Element, file: str) -> OpenDriveRoad:
    identity = element.get("id", "")
    name = f"road {identity}"
    length_m = _number(element, "length", file, name)
    if not 0.0 < length_m <= MOST_ROAD_M:
        raise FormatError(
            file, f"{name}, length", f"more than 0, at most {MOST_ROAD_M:.0f}", actual=element.get("length")
        )
    geometries = [_geometry(part, file, name) for part in element.findall("planView/geometry")]
    if not geometries or any(a.s_m >= b.s_m for a, b in pairwise(geometries)):
        raise FormatError(file, f"{name}, planView", "geometries with s ascending")
    sections = [_section(part, file, name) for part in element.findall("lanes/laneSection")]
    if not sections or any(a.s_m >= b.s_m for a, b in pairwise(sections)):
        raise FormatError(file, f"{name}, lanes", "laneSections with s ascending")
    crossfalls = element.findall("lateralProfile/crossfall")
    left, right = (
        [part for part in crossfalls if part.get("side", "both") in (side, "both")]
        for side in ("left", "right")
    )
    where = f"{name}, lateralProfile"
    shape = [
        [_number(part, key, file, f"{where}, shape") for key in ("s", "t", *_CUBIC)]
        for part in element.findall("lateralProfile/shape")
    ]
    return OpenDriveRoad(
        identity=identity,
        length_m=length_m,
        geometries=geometries,
        sections=sections,
        elevation=_cubics(element.findall("elevationProfile/elevation"), "s", file, f"{name}, elevation"),
        superelevation=_cubics(
            element.findall("lateralProfile/superelevation"), "s", file, f"{where}, superelevation"
        ),
        crossfall_left=_cubics(left, "s", file, f"{where}, crossfall"),
        crossfall_right=_cubics(right, "s", file, f"{where}, crossfall"),
        shape=np.array(sorted(shape)).reshape(-1, 6),
        lane_offset=_cubics(element.findall("lanes/laneOffset"), "s", file, f"{name}, laneOffset"),
        left_hand_traffic=element.get("rule") == "LHT",
        predecessor=_end(element.find("link/predecessor")),
        successor=_end(element.find("link/successor")),
    )


def _geometry(element: Element, file: str, road: str) -> PlanViewGeometry:
    name = f"{road}, geometry at s {element.get('s', '')[:20]}"
    s, x, y, heading, length = (_number(element, key, file, name) for key in ("s", "x", "y", "hdg", "length"))
    if not 0.0 <= length <= MOST_ROAD_M or s < 0.0:
        raise FormatError(file, f"{name}, length", f"0 to {MOST_ROAD_M:.0f}", actual=element.get("length"))
    keys = {
        "line": (),
        "arc": ("curvature",),
        "spiral": ("curvStart", "curvEnd"),
        "poly3": _CUBIC,
        "paramPoly3": _PARAMETRIC,
    }
    shapes = [child for child in element if child.tag in keys]
    if len(shapes) != 1:
        raise FormatError(
            file, name, f"one of {', '.join(keys)}", actual=",".join(child.tag for child in element)
        )
    tag = shapes[0].tag
    numbers = tuple(_number(shapes[0], key, file, f"{name}, {tag}") for key in keys[tag])
    if tag in ("arc", "spiral") and max(map(abs, numbers)) > 10.0:
        raise FormatError(
            file, f"{name}, {tag}", "curvatures of at most 10 per metre", actual=str(max(numbers, key=abs))
        )
    normalised = tag == "paramPoly3" and shapes[0].get("pRange", "normalized") == "normalized"
    return PlanViewGeometry(
        s_m=s,
        x_m=x,
        y_m=y,
        heading_rad=heading,
        length_m=length,
        shape=tag,
        numbers=numbers,
        normalised=normalised,
    )


def _section(element: Element, file: str, road: str) -> LaneSection:
    s_m = _number(element, "s", file, f"{road}, laneSection")
    name = f"{road}, laneSection at s {s_m:g}"
    lanes = [
        _lane(part, file, name) for side in ("left", "right") for part in element.findall(f"{side}/lane")
    ]
    ids = sorted(lane.lane_id for lane in lanes)
    right, left = sum(i < 0 for i in ids), sum(i > 0 for i in ids)
    if ids != [*range(-right, 0), *range(1, left + 1)]:
        raise FormatError(
            file, f"{name}, lane id", "1, 2, … on the left, −1, −2, … on the right", actual=str(ids)
        )
    return LaneSection(s_m, lanes)


def _lane(element: Element, file: str, section: str) -> OpenDriveLane:
    lane_id = _whole(element, "id", file, f"{section}, lane")
    name = f"{section}, lane {lane_id}"
    raised = element.findall("height") if element.get("type") == "driving" else []
    if any(
        _number(part, key, file, f"{name}, height") != 0.0 for part in raised for key in ("inner", "outer")
    ):
        raise FormatError(file, f"{name}, height", "none of a driving lane")
    links = [element.find(f"link/{key}") for key in ("predecessor", "successor")]
    before, after = (None if link is None else _whole(link, "id", file, f"{name}, link") for link in links)
    widths = _cubics(element.findall("width"), "sOffset", file, f"{name}, width")
    borders = _cubics(element.findall("border"), "sOffset", file, f"{name}, border")
    return OpenDriveLane(
        lane_id=lane_id,
        kind=element.get("type", ""),
        widths=widths,
        borders=borders,
        predecessor=before,
        successor=after,
    )


def _end(element: Element | None) -> RoadEnd | None:
    if element is None:
        return None
    return RoadEnd(
        kind=element.get("elementType", "road"),
        identity=element.get("elementId", ""),
        contact=element.get("contactPoint"),
    )


def _connection(junction: str, element: Element, file: str) -> JunctionConnection:
    name = f"junction {junction}, connection {element.get('id', '')}"
    contact = element.get("contactPoint", "")
    if contact not in ("start", "end"):
        raise FormatError(file, f"{name}, contactPoint", "start or end", actual=contact)
    lanes = [
        (_whole(link, "from", file, f"{name}, laneLink"), _whole(link, "to", file, f"{name}, laneLink"))
        for link in element.findall("laneLink")
    ]
    return JunctionConnection(
        junction=junction,
        incoming=element.get("incomingRoad", ""),
        connecting=_connected(element) or "",
        contact=contact,
        lanes=lanes,
    )


def _connected(element: Element) -> str | None:
    """The road that a connection leads to: one within the junction, or in a direct junction the one behind it."""
    return element.get("connectingRoad") or element.get("linkedRoad")


def _cubics(elements: Sequence[Element], at: str, file: str, name: str) -> Floats:
    rows = [[_number(part, key, file, name) for key in (at, *_CUBIC)] for part in elements]
    table = np.array(rows).reshape(-1, 5)
    if (np.diff(table[:, 0]) < 0.0).any():
        raise FormatError(file, f"{name}, {at}", "values ascending")
    return table


def _number(element: Element, key: str, file: str, name: str, default: float | None = None) -> float:
    text = element.get(key)
    if text is None and default is not None:
        return default
    try:
        number = float(text or "")
    except ValueError:
        number = math.nan
    if not abs(number) <= _MOST:
        raise FormatError(file, f"{name}, {key}", "a number of at most a milliard", actual=text)
    return number


def _whole(element: Element, key: str, file: str, name: str) -> int:
    text = element.get(key, "")
    try:
        number = int(text)
    except ValueError:
        number = 1 << 32
    if abs(number) > 1000:
        raise FormatError(file, f"{name}, {key}", "a whole number of at most 1000", actual=text)
    return number


# -- write -----------------------------------------------------------------------------------------------------------


def opendrive_bytes(drive: OpenDrive) -> bytes:
    """A map as OpenDRIVE 1.7 that reads as the same, to the last digit."""
    out = io.StringIO()
    out.write('<?xml version="1.0" encoding="UTF-8"?>\n<OpenDRIVE>\n<header revMajor="1" revMinor="7">\n')
    if drive.georeference is not None:
        out.write(f"<geoReference>{escape(drive.georeference)}</geoReference>\n")
    if any(drive.offset_m):
        x, y, z = map(repr, map(float, drive.offset_m))
        out.write(f'<offset x="{x}" y="{y}" z="{z}" hdg="0.0"/>\n')
    out.write("</header>\n")
    for road in drive.roads:
        _write_road(out, road)
    for junction in dict.fromkeys(connection.junction for connection in drive.connections):
        own = [connection for connection in drive.connections if connection.junction == junction]
        out.write(f"<junction id={quoteattr(junction)} name={quoteattr(junction)}>\n")
        for k, connection in enumerate(own):
            out.write(
                f'<connection id="{k}" incomingRoad={quoteattr(connection.incoming)} '
                f'connectingRoad={quoteattr(connection.connecting)} contactPoint="{connection.contact}">\n'
            )
            out.writelines(f'<laneLink from="{a}" to="{b}"/>\n' for a, b in connection.lanes)
            out.write("</connection>\n")
        out.write("</junction>\n")
    out.write("</OpenDRIVE>\n")
    return out.getvalue().encode()


def _write_road(out: io.StringIO, road: OpenDriveRoad) -> None:
    rule = "LHT" if road.left_hand_traffic else "RHT"
    out.write(
        f'<road id={quoteattr(road.identity)} length="{float(road.length_m)!r}" junction="-1" rule="{rule}">\n<link>\n'
    )
    for tag, end in (("predecessor", road.predecessor), ("successor", road.successor)):
        if end is not None:
            contact = "" if end.contact is None else f' contactPoint="{end.contact}"'
            out.write(f'<{tag} elementType="{end.kind}" elementId={quoteattr(end.identity)}{contact}/>\n')
    out.write("</link>\n<planView>\n")
    for part in road.geometries:
        place = (part.s_m, part.x_m, part.y_m, part.heading_rad, part.length_m)
        out.write(
            f"<geometry {_attributes(('s', 'x', 'y', 'hdg', 'length'), place)}>{_shape(part)}</geometry>\n"
        )
    out.write("</planView>\n<elevationProfile>\n")
    _write_cubics(out, "elevation", "s", road.elevation)
    out.write("</elevationProfile>\n<lateralProfile>\n")
    _write_cubics(out, "superelevation", "s", road.superelevation)
    _write_cubics(out, 'crossfall side="left"', "s", road.crossfall_left)
    _write_cubics(out, 'crossfall side="right"', "s", road.crossfall_right)
    for row in road.shape.tolist():
        out.write(f"<shape {_attributes(('s', 't', *_CUBIC), row)}/>\n")
    out.write("</lateralProfile>\n<lanes>\n")
    _write_cubics(out, "laneOffset", "s", road.lane_offset)
    for section in road.sections:
        _write_section(out, section)
    out.write("</lanes>\n</road>\n")


def _shape(part: PlanViewGeometry) -> str:
    keys = {
        "arc": ("curvature",),
        "spiral": ("curvStart", "curvEnd"),
        "poly3": _CUBIC,
        "paramPoly3": _PARAMETRIC,
    }
    extra = (
        f' pRange="{"normalized" if part.normalised else "arcLength"}"' if part.shape == "paramPoly3" else ""
    )
    return f"<{part.shape} {_attributes(keys.get(part.shape, ()), part.numbers)}{extra}/>"


def _write_section(out: io.StringIO, section: LaneSection) -> None:
    out.write(f'<laneSection s="{float(section.s_m)!r}">\n')
    sides = {
        "left": [lane for lane in section.lanes if lane.lane_id > 0],
        "right": [lane for lane in section.lanes if lane.lane_id < 0],
    }
    for side, lanes in (("left", sides["left"]), ("center", None), ("right", sides["right"])):
        if lanes is None:
            out.write('<center><lane id="0" type="none" level="false"/></center>\n')
        elif lanes:
            out.write(f"<{side}>\n")
            for lane in sorted(lanes, key=lambda lane: -lane.lane_id):
                _write_lane(out, lane)
            out.write(f"</{side}>\n")
    out.write("</laneSection>\n")


def _write_lane(out: io.StringIO, lane: OpenDriveLane) -> None:
    out.write(f'<lane id="{lane.lane_id}" type={quoteattr(lane.kind)} level="false">\n<link>')
    for tag, other in (("predecessor", lane.predecessor), ("successor", lane.successor)):
        if other is not None:
            out.write(f'<{tag} id="{other}"/>')
    out.write("</link>\n")
    _write_cubics(out, "width", "sOffset", lane.widths)
    _write_cubics(out, "border", "sOffset", lane.borders)
    out.write("</lane>\n")


def _write_cubics(out: io.StringIO, tag: str, at: str, table: Floats) -> None:
    out.writelines(f"<{tag} {_attributes((at, *_CUBIC), row)}/>\n" for row in table.tolist())


def _attributes(keys: Sequence[str], numbers: Sequence[float]) -> str:
    return " ".join(f'{key}="{float(number)!r}"' for key, number in zip(keys, numbers, strict=True))
