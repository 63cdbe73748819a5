"""Lanelet2 maps in OSM XML, read and written: points with latitude, longitude and `ele`, borders, lanelets.

Source: F. Poggenhans et al., "Lanelet2: A high-definition map framework for the future of automated driving", ITSC
2018; the tags as in the project's LaneletPrimitives.md. A lanelet is a relation of type `lanelet` whose members `left`
and `right` are each one way. Ways may be drawn in either direction: the borders are turned so that the left one is on
the left of the lanelet's direction (`geometry::align` of Lanelet2). Heights are of the vertical datum that the map does
not name, so they stay as they are here. Of points without latitude and longitude, as in maps with a local projection,
the MGRS code (`mgrs_code`) and `local_x`, `local_y` in its 100 km square are taken.
"""

from __future__ import annotations

import io
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.map_exchange.mgrs import geodetic_from_mgrs

Floats = NDArray[np.float64]

MAX_BYTES = 2 << 30
ROADS = frozenset({"road", "highway", "play_street", "emergency_lane", "bus_lane", "exit", "road_shoulder"})
"""Subtypes on which vehicles drive; a lanelet without a subtype is a road."""
_LOWEST_M, _HIGHEST_M = -12_000.0, 12_000.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Lanelet:
    """One lanelet: ids of the points of its borders, in its direction, and its tags."""

    lanelet_id: int
    left: tuple[int, ...]
    right: tuple[int, ...]
    left_border_id: int
    right_border_id: int
    tags: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class LaneletMap:
    """Points (n,) and lanelets; `row_of` has the row of a point's id. Heights are as the map has them."""

    row_of: Mapping[int, int]
    latitude_rad: Floats
    longitude_rad: Floats
    height_m: Floats
    lanelets: Sequence[Lanelet]
    left_out: Mapping[str, int]
    """How many lanelets of which subtype were not asked for."""


def read_lanelet2(path: Path, subtypes: frozenset[str] = ROADS) -> LaneletMap:
    """The lanelets of a file whose subtype is among those; FormatError where something in it is not as it must be."""
    if path.stat().st_size > MAX_BYTES:
        raise FormatError(str(path), "size", f"at most {MAX_BYTES >> 30} GiB")
    return lanelet_map(path.read_bytes(), str(path), subtypes)


def lanelet_map(data: bytes, file: str, subtypes: frozenset[str] = ROADS) -> LaneletMap:
    """`read_lanelet2` of bytes."""
    nodes: dict[int, _OsmElement] = {}
    ways: dict[int, _OsmElement] = {}
    relations: dict[int, _OsmElement] = {}
    tables = {"node": nodes, "way": ways, "relation": relations}
    for element in _elements(data, file):
        if element.identity in tables[element.kind]:
            raise FormatError(file, element.name, "each id once")
        tables[element.kind][element.identity] = element
    left_out: dict[str, int] = {}
    chosen = []
    for relation in relations.values():
        if relation.tags.get("type") != "lanelet":
            continue
        subtype = relation.tags.get("subtype", "road")
        if subtype in subtypes:
            chosen.append(relation)
        else:
            left_out[subtype] = left_out.get(subtype, 0) + 1
    if not chosen:
        raise FormatError(file, "lanelets", f"at least one of subtype {', '.join(sorted(subtypes))}")
    row_of: dict[int, int] = {}
    borders = []
    for relation in chosen:
        sides = tuple(_border_of(relation, role, ways, file) for role in ("left", "right"))
        for way in sides:
            for ref in way.refs:
                if ref not in nodes:
                    raise FormatError(file, f"{way.name}, nd", "a node of this file", actual=str(ref))
                row_of.setdefault(ref, len(row_of))
        borders.append(sides)
    places = np.array([_place(nodes[ref], file) for ref in row_of]).reshape(-1, 3)
    lanelets = [
        _aligned(relation, left, right, places=places, row_of=row_of, file=file)
        for relation, (left, right) in zip(chosen, borders, strict=True)
    ]
    return LaneletMap(
        row_of=row_of,
        latitude_rad=places[:, 0],
        longitude_rad=places[:, 1],
        height_m=places[:, 2],
        lanelets=lanelets,
        left_out=left_out,
    )


def lanelet2_bytes(lanelets: LaneletMap) -> bytes:
    """A map as OSM XML that reads as the same: positions to 1e-11 degrees, heights to 1e-5 m."""
    out = io.StringIO()
    out.write("<?xml version='1.0' encoding='UTF-8'?>\n<osm version=\"0.6\" generator=\"Camber\">\n")
    latitude, longitude = np.degrees(lanelets.latitude_rad), np.degrees(lanelets.longitude_rad)
    for identity, row in lanelets.row_of.items():
        out.write(f'  <node id="{identity}" lat="{latitude[row]:.11f}" lon="{longitude[row]:.11f}">\n')
        out.write(f'    <tag k="ele" v="{lanelets.height_m[row]:.5f}"/>\n  </node>\n')
    ways: dict[int, tuple[int, ...]] = {}
    for lanelet in lanelets.lanelets:
        ways.setdefault(lanelet.left_border_id, lanelet.left)
        ways.setdefault(lanelet.right_border_id, lanelet.right)
    for identity, refs in ways.items():
        out.write(f'  <way id="{identity}">\n')
        out.writelines(f'    <nd ref="{ref}"/>\n' for ref in refs)
        out.write('    <tag k="type" v="line_thin"/>\n  </way>\n')
    for lanelet in lanelets.lanelets:
        out.write(f'  <relation id="{lanelet.lanelet_id}">\n')
        for role, way in (("left", lanelet.left_border_id), ("right", lanelet.right_border_id)):
            out.write(f'    <member type="way" ref="{way}" role="{role}"/>\n')
        tags = {"subtype": "road", **lanelet.tags, "type": "lanelet"}
        out.writelines(f"    <tag k={quoteattr(k)} v={quoteattr(v)}/>\n" for k, v in tags.items())
        out.write("  </relation>\n")
    out.write("</osm>\n")
    return out.getvalue().encode()


# -- elements --------------------------------------------------------------------------------------------------------


@dataclass(slots=True, kw_only=True)
class _OsmElement:
    kind: str
    identity: int
    attributes: Mapping[str, str]
    tags: dict[str, str]
    refs: tuple[int, ...]
    members: list[tuple[str, str, int]]

    @property
    def name(self) -> str:
        return f"{'lanelet' if self.tags.get('type') == 'lanelet' else self.kind} {self.identity}"


def _elements(data: bytes, file: str) -> Iterator[_OsmElement]:
    """Nodes, ways and relations, one after the other. Documents with entities of their own are refused."""
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise FormatError(file, "XML", "a document without a DOCTYPE")
    root = None
    try:
        for event, element in ElementTree.iterparse(io.BytesIO(data), ("start", "end")):
            if root is None:
                root = element
                if element.tag != "osm":
                    raise FormatError(file, "XML", "a document <osm>", actual=f"<{element.tag}>")
            if event == "end" and element.tag in ("node", "way", "relation"):
                if element.get("action") != "delete":
                    yield _element(element, file)
                root.clear()
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(file, "XML", f"a whole document ({error})") from None


def _element(element: ElementTree.Element, file: str) -> _OsmElement:
    identity = _id(element.get("id"), file, f"{element.tag} id")
    name = f"{element.tag} {identity}"
    tags = {tag.get("k", ""): tag.get("v", "") for tag in element.findall("tag")}
    refs = tuple(_id(nd.get("ref"), file, f"{name}, nd") for nd in element.findall("nd"))
    members = [
        (m.get("role", ""), m.get("type", ""), _id(m.get("ref"), file, f"{name}, member"))
        for m in element.findall("member")
    ]
    return _OsmElement(
        kind=element.tag,
        identity=identity,
        attributes=dict(element.attrib),
        tags=tags,
        refs=refs,
        members=members,
    )


def _id(text: str | None, file: str, field_name: str) -> int:
    try:
        identity = int(text or "")
    except ValueError:
        identity = 1 << 63
    if not -(1 << 63) < identity < 1 << 63:
        raise FormatError(file, field_name, "a whole number of 64 bits", actual=text or "")
    return identity


def _place(node: _OsmElement, file: str) -> tuple[float, float, float]:
    height_m = _number(node, "ele", node.tags.get("ele"), low=_LOWEST_M, high=_HIGHEST_M, file=file)
    lat, lon = node.attributes.get("lat"), node.attributes.get("lon")
    if not lat and not lon and "mgrs_code" in node.tags:
        x_m, y_m = (
            _number(node, name, node.tags.get(name), low=-1e5, high=2e5, file=file)
            for name in ("local_x", "local_y")
        )
        return *geodetic_from_mgrs(
            node.tags["mgrs_code"], x_m, y_m, file=file, field=f"{node.name}, mgrs_code"
        ), height_m
    latitude, longitude = (
        _number(node, "lat", lat, low=-85.0, high=85.0, file=file),
        _number(node, "lon", lon, low=-180.0, high=180.0, file=file),
    )
    return math.radians(latitude), math.radians(longitude), height_m


def _number(node: _OsmElement, name: str, text: str | None, low: float, high: float, file: str) -> float:
    try:
        number = float(text or "")
    except ValueError:
        number = math.nan
    if not low <= number <= high:
        expected = f"a number from {low:.0f} to {high:.0f}".replace("-", "−")
        raise FormatError(file, f"{node.name}, {name}", expected, actual=None if text is None else text)
    return number


def _border_of(relation: _OsmElement, role: str, ways: Mapping[int, _OsmElement], file: str) -> _OsmElement:
    refs = [ref for own, kind, ref in relation.members if own == role and kind == "way"]
    if len(refs) != 1:
        raise FormatError(file, f"{relation.name}, {role}", "one way", actual=str(len(refs)))
    if refs[0] not in ways:
        raise FormatError(file, f"{relation.name}, {role}", "a way of this file", actual=str(refs[0]))
    way = ways[refs[0]]
    if len(way.refs) < 2:
        raise FormatError(file, f"{way.name}, nd", "two nodes or more", actual=str(len(way.refs)))
    return way


# -- directions of borders -------------------------------------------------------------------------------------------


def _aligned(
    relation: _OsmElement,
    left: _OsmElement,
    right: _OsmElement,
    places: Floats,
    row_of: Mapping[int, int],
    file: str,
) -> Lanelet:
    """The lanelet with borders in its direction: what is right of the left border is the right one."""
    lines = [_plane([row_of[ref] for ref in way.refs], places, row_of[left.refs[0]]) for way in (left, right)]
    for line, way in zip(lines, (left, right), strict=True):
        if not np.hypot(*np.diff(line, axis=0).T).sum() > 1e-3:
            raise FormatError(file, f"{way.name}", "a border longer than a millimetre")
    turn_left = _side(lines[0], _middle(lines[1])) > 0.0
    turn_right = _side(lines[1], _middle(lines[0])) < 0.0
    return Lanelet(
        lanelet_id=relation.identity,
        left=left.refs[::-1] if turn_left else left.refs,
        right=right.refs[::-1] if turn_right else right.refs,
        left_border_id=left.identity,
        right_border_id=right.identity,
        tags=relation.tags,
    )


def _plane(rows: Sequence[int], places: Floats, origin: int) -> Floats:
    """East and north (n, 2) about a point, good enough to tell sides."""
    step = places[list(rows), :2] - places[origin, :2]
    return 6.4e6 * np.column_stack((step[:, 1] * math.cos(places[origin, 0]), step[:, 0]))


def _middle(line: Floats) -> Floats:
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
    return np.array([np.interp(0.5 * along[-1], along, line[:, axis]) for axis in (0, 1)])


def _side(line: Floats, point: Floats) -> float:
    """More than 0 where a point is to the left of a line, as seen from the segment that is nearest to it."""
    step = np.diff(line, axis=0)
    length_2 = np.maximum((step**2).sum(axis=1), 1e-12)
    t = np.clip(((point - line[:-1]) * step).sum(axis=1) / length_2, 0.0, 1.0)
    foot = line[:-1] + t[:, None] * step
    distance = np.hypot(*(point - foot).T)
    near = np.flatnonzero(distance <= distance.min() + 1e-6)
    # At a corner the sides of both segments count: the one that the point is more beside of.
    offset = point - line[near]
    across = (step[near, 0] * offset[:, 1] - step[near, 1] * offset[:, 0]) / np.sqrt(length_2[near])
    return float(across[np.argmax(np.abs(across))])
