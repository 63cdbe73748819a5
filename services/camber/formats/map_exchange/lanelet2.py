"""Read Lanelet2 maps in OSM XML: points with latitude, longitude and `ele`, borders, lanelets.

Source: F. Poggenhans et al., "Lanelet2: A high-definition map framework for the future of automated driving", ITSC
2018; tags as in the project's LaneletPrimitives.md. A lanelet is a relation of type `lanelet` whose members `left` and
`right` are one way each. Ways may be drawn in both directions: borders are turned so that the left one is on the left
of the lanelet's direction (`geometry::align` of Lanelet2). Heights stay in the map's vertical datum, which the file
does not name. Points without latitude and longitude, as in maps with a local projection, are placed by `local_x` and
`local_y`: in the 100 km square of their `mgrs_code`, or else as the map's projector says.
"""

from __future__ import annotations

import io
import math
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError
from camber.formats.map_exchange.map_projector import FILE_NAME, MapProjector
from camber.formats.map_exchange.mgrs import geodetic_from_mgrs
from camber.formats.map_exchange.xml_doctype import refuse_doctype

Floats = NDArray[np.float64]

MAX_BYTES = 2 << 30  # chosen: larger than any published map; a wrong file is refused before it fills memory
ROADS = frozenset({"road", "highway", "play_street", "emergency_lane", "bus_lane", "exit", "road_shoulder"})
"""Subtypes on which vehicles drive; a lanelet without a subtype is a road."""
_REACH_OF_SQUARE_M = (-1e5, 2e5)  # chosen: a square of 100 km and as much around it
_REACH_OF_MAP_M = (-5e5, 5e5)  # chosen: half the width of a zone of UTM, from the origin of the map
_LOWEST_M, _HIGHEST_M = -12_000.0, 12_000.0  # chosen: beyond all land and sea floor


@dataclass(frozen=True, eq=False, kw_only=True)
class Lanelet:
    """A lanelet: point ids of its borders in its direction, ids of its borders, tags."""

    lanelet_id: int
    left: tuple[int, ...]
    right: tuple[int, ...]
    left_border_id: int
    right_border_id: int
    tags: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class LaneletMap:
    """Points (n,) and lanelets; `row_of` is the row of a point id. Heights are in the map's vertical datum."""

    row_of: Mapping[int, int]
    latitude_rad: Floats
    longitude_rad: Floats
    height_m: Floats
    lanelets: Sequence[Lanelet]
    left_out: Mapping[str, int]
    """Number of lanelets of each subtype that was not selected."""
    unreadable: Mapping[str, FormatError] = field(default_factory=dict)
    """Names of selected lanelets that could not be read, and the reasons."""


def read_lanelet2(
    path: Path,
    subtypes: frozenset[str] = ROADS,
    *,
    strict: bool = True,
    projector: MapProjector | None = None,
) -> LaneletMap:
    """Read the lanelets of some subtypes; FormatError for invalid contents. Without `strict` some may be unreadable.

    `projector`: of points that have neither latitude and longitude nor `mgrs_code`.
    """
    if path.stat().st_size > MAX_BYTES:
        raise FormatError(str(path), "size", f"at most {MAX_BYTES >> 30} GiB")
    return lanelet_map(path.read_bytes(), str(path), subtypes, strict=strict, projector=projector)


def lanelet_map(
    data: bytes,
    file: str,
    subtypes: frozenset[str] = ROADS,
    *,
    strict: bool = True,
    projector: MapProjector | None = None,
) -> LaneletMap:
    """Parse the bytes of a file; as `read_lanelet2`."""
    elements: dict[str, dict[int, _OsmElement]] = {"node": {}, "way": {}, "relation": {}}
    for element in _elements(data, file):
        if element.identity in elements[element.kind]:
            raise FormatError(file, element.name, "each id once")
        elements[element.kind][element.identity] = element
    nodes, line_strings = elements["node"], elements["way"]
    relations = [each for each in elements["relation"].values() if each.tags.get("type") == "lanelet"]
    left_out = Counter(subtype for each in relations if (subtype := _subtype(each)) not in subtypes)
    relations = [each for each in relations if _subtype(each) in subtypes]
    if not relations:
        raise FormatError(file, "lanelets", f"at least one of subtype {', '.join(sorted(subtypes))}")
    place_of: dict[int, tuple[float, float, float]] = {}
    lanelets = []
    unreadable: dict[str, FormatError] = {}
    for relation in relations:
        try:
            sides = tuple(_border_of(relation, role, line_strings, file) for role in ("left", "right"))
            places = _places(sides, nodes, file, projector)
            lanelets.append(_aligned(relation, *sides, place_of=places, file=file))
        except FormatError as error:
            if strict:
                raise
            unreadable[relation.name] = error
        else:
            place_of |= places
    places_array = np.array(list(place_of.values())).reshape(-1, 3)
    return LaneletMap(
        row_of={ref: row for row, ref in enumerate(place_of)},
        latitude_rad=places_array[:, 0],
        longitude_rad=places_array[:, 1],
        height_m=places_array[:, 2],
        lanelets=lanelets,
        left_out=left_out,
        unreadable=unreadable,
    )


def _places(
    borders: Sequence[_OsmElement],
    nodes: Mapping[int, _OsmElement],
    file: str,
    projector: MapProjector | None,
) -> dict[int, tuple[float, float, float]]:
    places = {}
    for border in borders:
        for ref in border.refs:
            if ref not in nodes:
                raise FormatError(file, f"{border.name}, nd", "a node of this file", actual=str(ref))
            places[ref] = _place(nodes[ref], file, projector)
    return places


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
    """Yield nodes, ways and relations. Documents that define entities are refused."""
    refuse_doctype(data, file)
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
    return _OsmElement(
        kind=element.tag,
        identity=identity,
        attributes=dict(element.attrib),
        tags={tag.get("k", ""): tag.get("v", "") for tag in element.findall("tag")},
        refs=tuple(_id(nd.get("ref"), file, f"{name}, nd") for nd in element.findall("nd")),
        members=[
            (m.get("role", ""), m.get("type", ""), _id(m.get("ref"), file, f"{name}, member"))
            for m in element.findall("member")
        ],
    )


def _subtype(lanelet: _OsmElement) -> str:
    return lanelet.tags.get("subtype", "road")


def _id(text: str | None, file: str, field_name: str) -> int:
    try:
        identity = int(text or "")
    except ValueError:
        identity = 1 << 63
    if not -(1 << 63) < identity < 1 << 63:
        raise FormatError(file, field_name, "an integer of 64 bits", actual=text or "")
    return identity


def _place(node: _OsmElement, file: str, projector: MapProjector | None) -> tuple[float, float, float]:
    """Return latitude, longitude [rad] and height of a node."""
    height_m = _number(node.tags.get("ele"), f"{node.name}, ele", (_LOWEST_M, _HIGHEST_M), file)
    lat, lon = node.attributes.get("lat"), node.attributes.get("lon")
    if not lat and not lon and "local_x" in node.tags:
        return *place_of_local(node.tags, node.name, file, projector), height_m
    latitude_deg = _number(lat, f"{node.name}, lat", (-85.0, 85.0), file)
    longitude_deg = _number(lon, f"{node.name}, lon", (-180.0, 180.0), file)
    return math.radians(latitude_deg), math.radians(longitude_deg), height_m


def place_of_local(
    tags: Mapping[str, str], name: str, file: str, projector: MapProjector | None
) -> tuple[float, float]:
    """Return latitude and longitude [rad] of `local_x`, `local_y` of the node `name`; FormatError."""
    reach = _REACH_OF_SQUARE_M if "mgrs_code" in tags else _REACH_OF_MAP_M
    x_m, y_m = (_number(tags.get(key), f"{name}, {key}", reach, file) for key in ("local_x", "local_y"))
    if "mgrs_code" in tags:
        return geodetic_from_mgrs(tags["mgrs_code"], x_m, y_m, file=file, field=f"{name}, mgrs_code")
    if projector is None:
        expected = f"lat and lon, mgrs_code, or {FILE_NAME} in the folder of the map"
        raise FormatError(file, name, expected, actual="local_x and local_y alone")
    height_m = _number(tags.get("ele"), f"{name}, ele", (_LOWEST_M, _HIGHEST_M), file)
    return projector.geodetic(x_m, y_m, height_m)


def _number(text: str | None, field_name: str, bounds: tuple[float, float], file: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    low, high = bounds
    if not low <= value <= high:
        expected = f"a number from {low:.0f} to {high:.0f}".replace("-", "−")
        raise FormatError(file, field_name, expected, actual=text)
    return value


def _border_of(
    relation: _OsmElement, role: str, line_strings: Mapping[int, _OsmElement], file: str
) -> _OsmElement:
    refs = [ref for of_role, kind, ref in relation.members if of_role == role and kind == "way"]
    if len(refs) != 1:
        raise FormatError(file, f"{relation.name}, {role}", "one way", actual=str(len(refs)))
    if refs[0] not in line_strings:
        raise FormatError(file, f"{relation.name}, {role}", "a way of this file", actual=str(refs[0]))
    border = line_strings[refs[0]]
    if len(border.refs) < 2:
        raise FormatError(file, f"{border.name}, nd", "two nodes or more", actual=str(len(border.refs)))
    return border


# -- directions of borders -------------------------------------------------------------------------------------------


def _aligned(
    relation: _OsmElement,
    left: _OsmElement,
    right: _OsmElement,
    *,
    place_of: Mapping[int, tuple[float, float, float]],
    file: str,
) -> Lanelet:
    """Return the lanelet with both borders turned into its direction."""
    origin = place_of[left.refs[0]]
    lines = [_plane([place_of[ref] for ref in border.refs], origin) for border in (left, right)]
    for line, border in zip(lines, (left, right), strict=True):
        if not np.hypot(*np.diff(line, axis=0).T).sum() > 1e-3:
            raise FormatError(file, border.name, "a border longer than a millimetre")
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


def _plane(places: Sequence[tuple[float, ...]], origin: tuple[float, ...]) -> Floats:
    """Return approximate east and north (n, 2) about a point, sufficient to distinguish sides."""
    step = np.array(places)[:, :2] - origin[:2]
    return 6.4e6 * np.column_stack((step[:, 1] * math.cos(origin[0]), step[:, 0]))


def _middle(line: Floats) -> Floats:
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
    return np.array([np.interp(0.5 * along[-1], along, line[:, axis]) for axis in (0, 1)])


def _side(line: Floats, point: Floats) -> float:
    """Return a positive number for a point to the left of a line, judged by the nearest segment."""
    step = np.diff(line, axis=0)
    length_2 = np.maximum((step**2).sum(axis=1), 1e-12)
    t = np.clip(((point - line[:-1]) * step).sum(axis=1) / length_2, 0.0, 1.0)
    foot = line[:-1] + t[:, None] * step
    distance = np.hypot(*(point - foot).T)
    near = np.flatnonzero(distance <= distance.min() + 1e-6)
    # At a corner both segments are nearest: the one with the larger cross-track distance decides.
    offset = point - line[near]
    across = (step[near, 0] * offset[:, 1] - step[near, 1] * offset[:, 0]) / np.sqrt(length_2[near])
    return float(across[np.argmax(np.abs(across))])
