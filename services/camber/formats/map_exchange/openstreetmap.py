"""Read the roads of OpenStreetMap files (.osm, .osm.gz, .osm.bz2, .pbf), cut where they meet.

Source: wiki.openstreetmap.org, Elements, Key:highway, Key:width, Key:lanes. A file is read twice: ways first, then the
nodes of those that are roads, so that memory grows with the roads and not with the file.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.errors import FormatError

Floats = NDArray[np.float64]

SUFFIXES = (".osm", ".osm.gz", ".osm.bz2", ".pbf")
_LANELET = re.compile(rb"""k\s*=\s*["']type["']\s+v\s*=\s*["']lanelet["']""")
_DELETED = re.compile(rb"""\saction\s*=\s*["']delete["']""")
_PIECE_BYTES = 1 << 20  # chosen: memory of the search
_OVERLAP_BYTES = 64  # chosen: longer than what is searched for
_METRES = re.compile(r"\s*(\d+(?:[.,]\d+)?)\s*m?\s*$")
_FEET = re.compile(r"\s*(\d{1,4})\s*'\s*(?:(\d{1,4})\s*\")?\s*$")
_FOOT_M, _INCH_M = 0.3048, 0.0254
_LARGEST_ID = (
    1 << 36
)  # chosen: five times the largest of 2026; 8 GB of bits, of which only pages in use are made
_WIDEST_M = 100.0  # chosen: above any carriageway; a larger `width` is an error of the map
_LANES = re.compile(r"\s*(1?[1-9]|10|20)\s*$")
"""Chosen: up to 20 likewise."""


@dataclass(frozen=True, eq=False, kw_only=True)
class OsmRoad:
    """Part of a way between places where roads meet: id of the way, tags, vertices (k, 2) latitude, longitude [rad]."""

    osm_id: int
    tags: Mapping[str, str]
    vertices_rad: Floats


def has_lanelets(path: Path) -> bool:
    """Return whether an .osm file is a Lanelet2 map."""
    return _contains(path, _LANELET)


def _contains(path: Path, pattern: re.Pattern[bytes]) -> bool:
    end = b""
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            if pattern.search(end + piece):
                return True
            end = piece[-_OVERLAP_BYTES:]
    return False


def read_roads(path: Path, highways: frozenset[str]) -> list[OsmRoad]:
    """Return the roads whose `highway` is among `highways`, in the order of the file.

    A way ends where it meets another one, and where the file has none of its nodes, as at the border of an extract.
    FormatError for what is no file of OpenStreetMap, OSError if it cannot be read.
    """
    import osmium

    file = str(path)
    if path.suffix == ".osm" and _contains(path, _DELETED):
        expected = "a file without elements that an editor marks as deleted, such as an extract"
        raise FormatError(file, "action", expected, actual="delete")
    path.stat()
    # All that libosmium raises for damaged files.
    damage = (RuntimeError, ValueError, IndexError, OverflowError, osmium.InvalidLocationError)
    try:
        lines = list(_lines(path, highways))
        places = _places(path, {ref for _, _, refs in lines for ref in refs})
    except damage as error:
        reason = " ".join(str(error).split())[:120]
        raise FormatError(file, "OpenStreetMap", f"a whole .osm or .pbf ({reason})") from None
    meets = Counter(ref for _, _, refs in lines for ref in refs)
    return [
        OsmRoad(osm_id=osm_id, tags=tags, vertices_rad=np.array([places[ref] for ref in part]))
        for osm_id, tags, refs in lines
        for part in _parts(refs, places, meets)
    ]


def width_m(tags: Mapping[str, str], lane_m: float) -> float:
    """Return the width of a road [m]: `width`, or `lane_m` for each of its lanes.

    Without `lanes`, or with one that is no whole number, there is one for `oneway`, else two.
    """
    stated = _stated_width_m(tags.get("width", ""))
    if stated is not None and 0.5 <= stated <= _WIDEST_M:
        return stated
    oneway = tags.get("oneway") in ("yes", "1", "-1", "true")
    stated_lanes = _LANES.match(tags.get("lanes", ""))
    count = int(stated_lanes[1]) if stated_lanes is not None else 1 if oneway else 2
    return min(lane_m * count, _WIDEST_M)


def _stated_width_m(text: str) -> float | None:
    metres, feet = _METRES.match(text), _FEET.match(text)
    if metres is not None:
        return float(metres[1].replace(",", "."))
    return None if feet is None else int(feet[1]) * _FOOT_M + int(feet[2] or 0) * _INCH_M


def _lines(path: Path, highways: frozenset[str]) -> Iterator[tuple[int, dict[str, str], list[int]]]:
    import osmium

    roads = osmium.filter.TagFilter(*(("highway", kind) for kind in sorted(highways)))
    lines: Any = osmium.FileProcessor(str(path), osmium.osm.WAY).with_filter(roads)
    for line in lines:
        refs = [node.ref for node in line.nodes]
        yield (
            line.id,
            {tag.k: tag.v for tag in line.tags},
            [r for k, r in enumerate(refs) if k == 0 or r != refs[k - 1]],
        )


def _places(path: Path, refs: Set[int]) -> dict[int, tuple[float, float]]:
    import osmium

    nodes: Any = osmium.FileProcessor(str(path), osmium.osm.NODE)
    # An array of bits as long as the largest id: not for ids of editors, below zero, and damaged ones.
    if all(0 < ref < _LARGEST_ID for ref in refs):
        nodes = nodes.with_filter(osmium.filter.IdFilter(refs))
    return {
        node.id: (math.radians(node.lat), math.radians(node.lon))
        for node in nodes
        if node.id in refs and node.location.valid()
    }


def _parts(
    refs: list[int], places: Mapping[int, tuple[float, float]], meets: Mapping[int, int]
) -> Iterator[list[int]]:
    """Yield the parts of a way, of two nodes or more, between nodes of several roads and missing ones."""
    part: list[int] = []
    for ref in refs:
        if ref not in places:
            if len(part) > 1:
                yield part
            part = []
            continue
        part.append(ref)
        if meets[ref] > 1 and len(part) > 1:
            yield part
            part = [ref]
    if len(part) > 1:
        yield part
