"""Read OpenDRIVE maps (.xodr) as plain values; `opendrive_geometry` computes with them.

Source: ASAM OpenDRIVE 1.8.0, and 1.4H for `poly3` and `crossfall`, which later editions dropped. Read are: header with
geoReference and offset; of roads the plan view (line, arc, spiral, poly3, paramPoly3), elevation, superelevation,
crossfall, lateral shape, lane offset, lane sections with widths or borders and heights, links; of junctions the
connections.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.map_exchange.xml_doctype import refuse_doctype

Floats = NDArray[np.float64]

# Chosen: bounds that no real map reaches, so that a damaged file is refused before it fills the memory.
MAX_BYTES = 1 << 30
MAX_ROAD_M = 100_000.0
_MAX_NUMBER = 1e9
_MAX_CURVATURE_PER_M = 10.0
_CUBIC = ("a", "b", "c", "d")
SHAPES: dict[str, tuple[str, ...]] = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": _CUBIC,
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
}
"""Elements of a planView geometry and their attributes (ASAM OpenDRIVE 1.8.0, chapter 9)."""


@dataclass(frozen=True, kw_only=True)
class PlanViewGeometry:
    """One part of a reference line: its start and its shape.

    `shape` is a key of SHAPES and `numbers` its attributes; `normalised`: the parameter of a paramPoly3 goes from 0 to
    1, else it is the arc length.
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
    """A lane of a section: cubics (n, 5) of width or outer border, over the distance from the section's start.

    `heights` (n, 3): from which distance on the lane is how much above the road at its inner and its outer border [m].
    `level`: superelevation and crossfall do not apply to it. `error`: why it could not be read; then all else is empty.
    """

    lane_id: int
    kind: str
    widths: Floats
    borders: Floats
    heights: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    level: bool = False
    predecessor: int | None = None
    successor: int | None = None
    error: FormatError | None = None


@dataclass(frozen=True)
class LaneSection:
    """Lanes from `s_m` on, without the centre lane, which has no width."""

    s_m: float
    lanes: Sequence[OpenDriveLane]


@dataclass(frozen=True, kw_only=True)
class RoadEnd:
    """Predecessor or successor of a road: a road (with the end where they meet, start or end) or a junction."""

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
    """(n, 6): s, t, a, b, c, d: heights over t, linear between values of s."""
    lane_offset: Floats
    left_hand_traffic: bool = False
    predecessor: RoadEnd | None = None
    successor: RoadEnd | None = None


@dataclass(frozen=True, kw_only=True)
class JunctionConnection:
    """Connection in a junction: lanes (from, to) of an incoming road and of the connecting road at its end `contact`.

    In a direct junction, which contains no roads, the linked road takes the place of the connecting road.
    """

    junction: str
    incoming: str
    connecting: str
    contact: str
    lanes: Sequence[tuple[int, int]]


@dataclass(frozen=True, eq=False, kw_only=True)
class UnreadableRoad:
    """A road that could not be read: the types of its lanes, one for each lane of each section, and the reason."""

    identity: str
    lane_kinds: Sequence[str]
    error: FormatError


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenDrive:
    """A map. Without a geoReference its position on earth is unknown. The offset (x, y, z) is added to coordinates."""

    georeference: str | None
    offset_m: tuple[float, float, float]
    roads: Sequence[OpenDriveRoad]
    connections: Sequence[JunctionConnection] = ()
    unreadable: Sequence[UnreadableRoad] = ()


def read_opendrive(path: Path, *, strict: bool = True) -> OpenDrive:
    """Read a map; FormatError for invalid contents. Without `strict` lanes and roads may be unreadable."""
    if path.stat().st_size > MAX_BYTES:
        raise FormatError(str(path), "size", f"at most {MAX_BYTES >> 30} GiB")
    return opendrive_map(path.read_bytes(), str(path), strict=strict)


def opendrive_map(data: bytes, file: str, *, strict: bool = True) -> OpenDrive:
    """Parse the bytes of a file; as `read_opendrive`."""
    refuse_doctype(data, file)
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FormatError(file, "XML", f"a whole document ({error})") from None
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # namespaces differ between editions, names do not
    if root.tag != "OpenDRIVE":
        raise FormatError(file, "XML", "a document <OpenDRIVE>", actual=f"<{root.tag}>")
    roads: list[OpenDriveRoad] = []
    unreadable: list[UnreadableRoad] = []
    for element in root.findall("road"):
        node = _XmlElement(element, file, f"road {element.get('id', '')}")
        try:
            roads.append(_road(node, strict))
        except FormatError as error:
            if strict:
                raise
            kinds = [
                lane.get("type", "")
                for side in ("left", "right")
                for lane in element.iterfind(f".//{side}/lane")
            ]
            unreadable.append(UnreadableRoad(identity=node.get("id"), lane_kinds=kinds, error=error))
    if not roads:
        raise unreadable[0].error if unreadable else FormatError(file, "road", "at least one")
    if len({road.identity for road in roads}) != len(roads):
        raise FormatError(file, "road id", "each once")
    connections = [
        _connection(junction.get("id", ""), element, file)
        for junction in root.findall("junction")
        for element in junction.findall("connection")
        if _connecting_road(element) and element.get("incomingRoad") is not None
    ]
    offset = _XmlElement(root.find("header/offset"), file, "header, offset")
    if abs(offset.number("hdg", default=0.0)) > 0.0:
        raise offset.error("hdg", "0", actual=offset.get("hdg"))
    x, y, z = (offset.number(name, default=0.0) for name in ("x", "y", "z"))
    georeference = (root.findtext("header/geoReference") or "").strip() or None
    return OpenDrive(
        georeference=georeference,
        offset_m=(x, y, z),
        roads=roads,
        connections=connections,
        unreadable=unreadable,
    )


class _XmlElement:
    """An XML element, or None for a missing one, with its file and name for error texts."""

    def __init__(self, element: ElementTree.Element | None, file: str, name: str) -> None:
        self.element = ElementTree.Element("missing") if element is None else element
        self.file = file
        self.name = name

    def get(self, key: str) -> str:
        return self.element.get(key, "")

    def nodes(self, path: str, name: str = "") -> list[_XmlElement]:
        """Return the elements at a path; `name` is appended to the name of this one."""
        full_name = f"{self.name}, {name}" if name else self.name
        return [_XmlElement(element, self.file, full_name) for element in self.element.findall(path)]

    def error(self, field: str, expected: str, actual: str | None = None) -> FormatError:
        return FormatError(
            self.file, f"{self.name}, {field}" if field else self.name, expected, actual=actual
        )

    def number(self, key: str, default: float | None = None) -> float:
        text = self.element.get(key)
        if text is None and default is not None:
            return default
        try:
            number = float(text or "")
        except ValueError:
            number = math.nan
        if not abs(number) <= _MAX_NUMBER:
            raise self.error(key, "a number of at most 1e9", actual=text)
        return number

    def integer(self, key: str) -> int:
        try:
            number = int(self.get(key))
        except ValueError:
            number = 1 << 32
        if abs(number) > 1000:
            raise self.error(key, "an integer of at most 1000", actual=self.get(key))
        return number

    def cubics(self, path: str, name: str = "", at: str = "s") -> Floats:
        """Return the cubics (n, 5) at a path: where each begins and its coefficients."""
        return _cubics(self.nodes(path, name or path.rpartition("/")[2]), at)


def _cubics(nodes: Sequence[_XmlElement], at: str = "s") -> Floats:
    table = np.array([[node.number(key) for key in (at, *_CUBIC)] for node in nodes]).reshape(-1, 5)
    if (np.diff(table[:, 0]) < 0.0).any():
        raise nodes[0].error(at, "values ascending")
    return table


def _road(node: _XmlElement, strict: bool) -> OpenDriveRoad:
    length_m = node.number("length")
    if not 0.0 < length_m <= MAX_ROAD_M:
        raise node.error("length", f"more than 0, at most {MAX_ROAD_M:.0f}", actual=node.get("length"))
    geometries = [_geometry(part) for part in node.nodes("planView/geometry")]
    if not geometries or any(a.s_m >= b.s_m for a, b in pairwise(geometries)):
        raise node.error("planView", "geometries with s ascending")
    sections = [_section(part, strict) for part in node.nodes("lanes/laneSection", "laneSection")]
    if not sections or any(a.s_m > b.s_m for a, b in pairwise(sections)):
        raise node.error("lanes", "laneSections with s ascending")
    crossfalls = node.nodes("lateralProfile/crossfall", "lateralProfile, crossfall")
    left, right = (
        [part for part in crossfalls if part.element.get("side", "both") in (side, "both")]
        for side in ("left", "right")
    )
    shapes = node.nodes("lateralProfile/shape", "lateralProfile, shape")
    shape = [[part.number(key) for key in ("s", "t", *_CUBIC)] for part in shapes]
    return OpenDriveRoad(
        identity=node.get("id"),
        length_m=length_m,
        geometries=geometries,
        sections=sections,
        elevation=node.cubics("elevationProfile/elevation"),
        superelevation=node.cubics("lateralProfile/superelevation", "lateralProfile, superelevation"),
        crossfall_left=_cubics(left),
        crossfall_right=_cubics(right),
        shape=np.array(sorted(shape)).reshape(-1, 6),
        lane_offset=node.cubics("lanes/laneOffset"),
        left_hand_traffic=node.get("rule") == "LHT",
        predecessor=_road_end(node.element.find("link/predecessor")),
        successor=_road_end(node.element.find("link/successor")),
    )


def _geometry(node: _XmlElement) -> PlanViewGeometry:
    node = _XmlElement(node.element, node.file, f"{node.name}, geometry at s {node.get('s')[:20]}")
    s, x, y, heading, length = (node.number(key) for key in ("s", "x", "y", "hdg", "length"))
    if not 0.0 <= length <= MAX_ROAD_M or s < 0.0:
        raise node.error("length", f"0 to {MAX_ROAD_M:.0f}", actual=node.get("length"))
    shapes = [child for child in node.element if child.tag in SHAPES]
    if len(shapes) != 1:
        tags = ",".join(child.tag for child in node.element)
        raise node.error("", f"one of {', '.join(SHAPES)}", actual=tags)
    tag = shapes[0].tag
    shape = _XmlElement(shapes[0], node.file, f"{node.name}, {tag}")
    numbers = tuple(shape.number(key) for key in SHAPES[tag])
    if tag in ("arc", "spiral") and max(map(abs, numbers)) > _MAX_CURVATURE_PER_M:
        raise shape.error("", "curvatures of at most 10 per metre", actual=str(max(numbers, key=abs)))
    return PlanViewGeometry(
        s_m=s,
        x_m=x,
        y_m=y,
        heading_rad=heading,
        length_m=length,
        shape=tag,
        numbers=numbers,
        normalised=tag == "paramPoly3" and shapes[0].get("pRange", "normalized") == "normalized",
    )


def _section(node: _XmlElement, strict: bool) -> LaneSection:
    s_m = node.number("s")
    node = _XmlElement(node.element, node.file, f"{node.name} at s {s_m:g}")
    lanes = [_lane(part, strict) for side in ("left", "right") for part in node.nodes(f"{side}/lane", "lane")]
    ids = sorted(lane.lane_id for lane in lanes)
    right, left = sum(i < 0 for i in ids), sum(i > 0 for i in ids)
    if ids != [*range(-right, 0), *range(1, left + 1)]:
        raise node.error("lane id", "1, 2, … on the left, −1, −2, … on the right", actual=str(ids))
    return LaneSection(s_m, lanes)


def _lane(node: _XmlElement, strict: bool) -> OpenDriveLane:
    lane_id = node.integer("id")
    node = _XmlElement(node.element, node.file, f"{node.name} {lane_id}")
    try:
        return _readable_lane(node, lane_id)
    except FormatError as error:
        if strict:
            raise
        nothing = np.zeros((0, 5))
        return OpenDriveLane(
            lane_id=lane_id, kind=node.get("type"), widths=nothing, borders=nothing, error=error
        )


def _readable_lane(node: _XmlElement, lane_id: int) -> OpenDriveLane:
    heights = node.nodes("height", "height")
    height = np.array([[part.number(key) for key in ("sOffset", "inner", "outer")] for part in heights])
    if (np.diff(height.reshape(-1, 3)[:, 0]) < 0.0).any():
        raise heights[0].error("sOffset", "values ascending")
    links = [node.nodes(f"link/{key}", "link") for key in ("predecessor", "successor")]
    predecessor, successor = (link[0].integer("id") if link else None for link in links)
    return OpenDriveLane(
        lane_id=lane_id,
        kind=node.get("type"),
        widths=node.cubics("width", at="sOffset"),
        borders=node.cubics("border", at="sOffset"),
        heights=height.reshape(-1, 3),
        level=node.get("level") in ("true", "1"),
        predecessor=predecessor,
        successor=successor,
    )


def _road_end(element: ElementTree.Element | None) -> RoadEnd | None:
    if element is None:
        return None
    kind, identity = element.get("elementType", "road"), element.get("elementId", "")
    return RoadEnd(kind=kind, identity=identity, contact=element.get("contactPoint"))


def _connection(junction: str, element: ElementTree.Element, file: str) -> JunctionConnection:
    node = _XmlElement(element, file, f"junction {junction}, connection {element.get('id', '')}")
    contact = node.get("contactPoint")
    if contact not in ("start", "end"):
        raise node.error("contactPoint", "start or end", actual=contact)
    lanes = [(link.integer("from"), link.integer("to")) for link in node.nodes("laneLink", "laneLink")]
    return JunctionConnection(
        junction=junction,
        incoming=node.get("incomingRoad"),
        connecting=_connecting_road(element),
        contact=contact,
        lanes=lanes,
    )


def _connecting_road(element: ElementTree.Element) -> str:
    """Return the road of a connection: within the junction, or beyond a direct junction."""
    return element.get("connectingRoad") or element.get("linkedRoad") or ""
