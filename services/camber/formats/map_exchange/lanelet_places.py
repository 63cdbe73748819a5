"""Random places on borders of lanelets with their heights, straight from the ways of the file.

A second reading, to check the import with: it shares no function with `lanelet2` but for what places nodes that have no
latitude and longitude, and knows no lanes, only the lines between neighbouring nodes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class BorderPlace:
    """A place on a border: name of the lanelet, place, latitude, longitude [deg], height in the map's datum [m]."""

    name: str
    at: str
    latitude_deg: float
    longitude_deg: float
    height_m: float


LocalPlace = Callable[[Mapping[str, str]], tuple[float, float]]


def border_places(
    data: bytes,
    subtypes: frozenset[str],
    count: int,
    rng: np.random.Generator,
    *,
    place_of_local: LocalPlace,
) -> list[BorderPlace]:
    """Return `count` places; empty where no border of a lanelet has places with heights.

    `place_of_local`: latitude and longitude [rad] of a node with these tags that has only `local_x` and `local_y`.
    """
    root = ElementTree.fromstring(data)
    rows = ((node.get("id"), _row(node, place_of_local)) for node in root.iterfind("node"))
    nodes = {identity: row for identity, row in rows if row is not None}
    lines = {line.get("id"): [nd.get("ref") for nd in line.iterfind("nd")] for line in root.iterfind("way")}
    steps = []
    for relation in root.iterfind("relation"):
        tags = _tags(relation)
        if tags.get("type") != "lanelet" or tags.get("subtype", "road") not in subtypes:
            continue
        for member in relation.iterfind("member"):
            if member.get("role") in ("left", "right"):
                refs = lines.get(member.get("ref"), [])
                steps += [(relation.get("id"), a, b) for a, b in pairwise(refs)]
    steps = [step for step in steps if step[1] in nodes and step[2] in nodes]
    if not steps:
        return []
    places = []
    for k, share in zip(rng.integers(len(steps), size=count), rng.uniform(size=count), strict=True):
        lanelet, a, b = steps[k]
        latitude, longitude, height = (1.0 - share) * nodes[a] + share * nodes[b]
        at = f"between nodes {a} and {b}"
        places.append(
            BorderPlace(
                name=f"lanelet {lanelet}",
                at=at,
                latitude_deg=float(latitude),
                longitude_deg=float(longitude),
                height_m=float(height),
            )
        )
    return places


def _tags(element: ElementTree.Element) -> dict[str, str]:
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iterfind("tag")}


def _row(node: ElementTree.Element, place_of_local: LocalPlace) -> Floats | None:
    """Return latitude, longitude [deg] and height, None where one is missing."""
    tags, lat, lon = _tags(node), node.get("lat"), node.get("lon")
    try:
        if lat or lon or "local_x" not in tags:
            place_deg = float(lat or ""), float(lon or "")
        else:
            place_deg = tuple(np.degrees(place_of_local(tags)))
        row = np.array([*place_deg, float(tags.get("ele", ""))])
    except ValueError:
        return None
    return row if np.isfinite(row).all() else None
