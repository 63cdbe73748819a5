"""Random places on borders of lanelets with their heights, straight from the ways of the file.

A second reading, to check the import with: it shares no function with `lanelet2`, and knows no lanes, only the lines
between neighbouring nodes.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
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


def border_places(
    data: bytes, subtypes: frozenset[str], count: int, rng: np.random.Generator
) -> list[BorderPlace]:
    """Return `count` places; empty where no border of a lanelet has latitudes, longitudes and heights."""
    root = ElementTree.fromstring(data)
    nodes = {node.get("id"): row for node in root.iterfind("node") if (row := _row(node)) is not None}
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


def _tags(element: ElementTree.Element) -> dict[str | None, str | None]:
    return {tag.get("k"): tag.get("v") for tag in element.iterfind("tag")}


def _row(node: ElementTree.Element) -> Floats | None:
    """Return latitude, longitude and height, None where one is missing."""
    try:
        row = np.array(
            [float(node.get("lat", "")), float(node.get("lon", "")), float(_tags(node).get("ele") or "")]
        )
    except ValueError:
        return None
    return row if np.isfinite(row).all() else None
