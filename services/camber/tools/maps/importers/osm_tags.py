"""Tags of OpenStreetMap on lines of GeoJSON: which of them are roads for vehicles, and on which level.

A terrain model shows the ground: what `bridge`, `tunnel` or `layer` takes off it must not get its heights. Source:
wiki.openstreetmap.org, Key:layer, Key:bridge, Key:tunnel, Key:highway. Lines that cross without a node in common are
over one another (Key:layer, "ways that cross"), whatever their tags say.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from camber.tools.maps.importers.lanes import Floats, quantized_degrees

HIGHWAYS = (
    "motorway", "motorway_link", "trunk", "trunk_link", "primary", "primary_link", "secondary", "secondary_link",
    "tertiary", "tertiary_link", "unclassified", "residential", "living_street", "service", "road", "busway",
)  # fmt: skip
"""Values of `highway` of roads for vehicles; footways, cycleways, paths, steps and tracks are not among them."""
_NO_ROADS = (
    "railway",
    "waterway",
    "aerialway",
    "route",
    "power",
    "barrier",
    "boundary",
    "natural",
    "building",
)
_PAIR = re.compile(r'"([^"]+)"=>"([^"]*)"')
_MOST_LAYER = 20  # chosen: OpenStreetMap uses −5 to 5
_CELL_RAD = 1e-5  # chosen: 64 m, longer than most segments
_MOST_CELLS = 10_000  # chosen: 6 km by 6 km, so that a damaged line does not fill the memory

Segment = tuple[int, int, Floats, Floats]
"""Line, number in it, both ends."""


def tags_of(properties: Mapping[str, Any]) -> dict[str, str]:
    """Return the tags among a feature's properties: plain, in `tags`, or in GDAL's `other_tags`."""
    tags = {key: str(value) for key, value in properties.items() if isinstance(value, str | int | float)}
    nested = properties.get("tags")
    if isinstance(nested, Mapping):
        tags |= {str(key): str(value) for key, value in nested.items()}
    other = properties.get("other_tags")
    return tags | dict(_PAIR.findall(other)) if isinstance(other, str) else tags


def is_road(tags: Mapping[str, str], highways: frozenset[str]) -> bool:
    """Return whether a line is a road of those kinds; a line without such tags is one that the user drew."""
    highway = tags.get("highway")
    return highway in highways if highway is not None else not any(key in tags for key in _NO_ROADS)


def level_of(tags: Mapping[str, str]) -> int:
    """Return the level: `layer`, but above the ground for a bridge and below it for a tunnel. ValueError."""
    text = tags.get("layer", "0")
    layer = int(float(text))
    if abs(layer) > _MOST_LAYER:
        raise ValueError(f"layer is {text!r}, expected −{_MOST_LAYER} to {_MOST_LAYER}")
    if tags.get("bridge", "no") != "no":
        return max(layer, 1)
    if tags.get("tunnel", "no") != "no" or tags.get("location") == "underground":
        return min(layer, -1)
    return layer


def crossing_lines(lines: Sequence[Floats]) -> list[tuple[int, int]]:
    """Return pairs of lines (k, 2) [rad], ascending, that cross where they have no vertex in common; a line may cross
    itself. ValueError for places that are kilometres apart in both directions."""
    pairs: set[tuple[int, int]] = set()
    for segments in _by_cell(lines).values():
        for (i, m, a, b), (j, n, c, d) in combinations(segments, 2):
            if (i, j) not in pairs and not (i == j and abs(m - n) <= 1) and _cross(a, b, c, d):
                pairs.add((min(i, j), max(i, j)))
    return sorted(pairs)


def _by_cell(lines: Sequence[Floats]) -> dict[tuple[int, int], list[Segment]]:
    """Segments by the cells that their bounding boxes touch."""
    cells: dict[tuple[int, int], list[Segment]] = {}
    for i, line in enumerate(lines):
        # To a millimetre, so that vertices in common are the same.
        places = np.array(quantized_degrees(line), np.float64)
        cell = np.floor(np.radians(places * 1e-8) / _CELL_RAD).astype(np.int64)
        for m in range(len(line) - 1):
            low, high = np.minimum(cell[m], cell[m + 1]), np.maximum(cell[m], cell[m + 1])
            if np.prod(high - low + 1) > _MOST_CELLS:
                raise ValueError("a line has places farther apart than any road's")
            segment = (i, m, places[m], places[m + 1])
            for x in range(int(low[0]), int(high[0]) + 1):
                for y in range(int(low[1]), int(high[1]) + 1):
                    cells.setdefault((x, y), []).append(segment)
    return cells


def _cross(a: Floats, b: Floats, c: Floats, d: Floats) -> bool:
    """Return whether two segments cross within both; one that only touches the other does not."""
    sides = (_side(a, b, c), _side(a, b, d), _side(c, d, a), _side(c, d, b))
    return sides[0] * sides[1] < 0.0 and sides[2] * sides[3] < 0.0


def _side(a: Floats, b: Floats, point: Floats) -> float:
    return float(np.sign((b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])))
