"""A release's links as viewers draw them: one GeoJSON of lines, for recordings and Foxglove."""

from __future__ import annotations

import json
from itertools import accumulate

import numpy as np

from camber.formats.foxglove.drawings import Drawing
from camber.formats.foxglove.protobuf import encode
from camber.road_map.road_columns import RoadLinks

TOPIC = "/map/roads"
_MOST_POINTS = 50_000
"""Chosen: 1.5 MB, and what a viewer's map panel draws at once; a larger map is cut, which `left_out` says."""
_STYLE = {"color": "#808080", "weight": 2}


def draw_roads(links: RoadLinks) -> Drawing:
    """Return the links' lines, those of the lowest ids where there are too many."""
    rows = np.argsort(links.link_id)
    sizes = accumulate(len(links.vertices[row]) for row in rows)
    kept = [row for row, size in zip(rows, sizes, strict=True) if size <= _MOST_POINTS]
    features = [
        {
            "type": "Feature",
            "properties": {
                "link_id": str(links.link_id[row]),  # viewers keep 53 bits of a number
                "level": int(links.level[row]),
                "style": _STYLE,
            },
            "geometry": {
                "type": "LineString",
                "coordinates": np.degrees(links.vertices[row][:, ::-1]).round(7).tolist(),
            },
        }
        for row in kept
    ]
    roads = {"type": "FeatureCollection", "features": features, "left_out": len(rows) - len(kept)}
    geojson = json.dumps(roads, separators=(",", ":"))
    return Drawing(TOPIC, "GeoJSON", encode("GeoJSON", {"geojson": geojson}))
