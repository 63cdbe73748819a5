"""Surfaces and links as GeoJSON, and lines of roads of another origin.

In GeoJSON (RFC 7946) positions are WGS 84, and the third coordinate is the height above its ellipsoid: there is no
other datum to name. Ids have 62 bits and are texts: many programs keep only 53 of a JSON number. Numbers are read too.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from camber.formats.errors import FormatError
from camber.geodesy.local_frame import LocalFrame
from camber.road_map.road_columns import ReleaseError, RoadLinks, RoadSurfaces
from camber.road_map.road_tiles import surface_tiles, surfaces_from_tiles
from camber.tools.maps.importers.lanes import named_links
from camber.tools.maps.importers.osm_tags import level_of, tags_of

Feature = dict[str, Any]

_DECIMALS = 10  # of degrees: a hundredth of a millimetre
_SURFACE = (
    "surface_id", "link_id", "level", "sigma_m", "vehicles", "last_seen_ns", "half_length_m", "half_width_m",
)  # fmt: skip
_LINK = ("link_id", "start_node", "end_node", "level", "sigma_m")
_IDS = ("surface_id", "link_id", "start_node", "end_node")
_MOST_BYTES = 1 << 31  # chosen: bounds the memory of the JSON parser


def geojson_text(surfaces: RoadSurfaces, links: RoadLinks) -> str:
    """A FeatureCollection, a feature on each line: surfaces, then links, both by id."""
    features = [_surface(surfaces, int(row)) for row in np.argsort(surfaces.surface_id)]
    features += [_link(links, int(row)) for row in np.argsort(links.link_id)]
    return feature_collection(features)


@dataclass(frozen=True, slots=True, kw_only=True)
class LineProperties:
    """What a line says of its road: width [m], tags of OpenStreetMap, and whether `level` is given."""

    width_m: float | None
    tags: Mapping[str, str]
    has_level: bool


def read_geojson(path: Path) -> tuple[RoadSurfaces, RoadLinks, list[LineProperties]]:
    """Surfaces, links, and what else each link's line says.

    Raises FormatError for what is not as above, OSError if the file cannot be read.
    """
    name = str(path)
    if path.stat().st_size > _MOST_BYTES:
        raise FormatError(name, "size", f"at most {_MOST_BYTES} bytes", actual=str(path.stat().st_size))
    try:
        features = json.loads(path.read_bytes())["features"]
        surfaces = [f for f in features if f["geometry"]["type"] == "Polygon"]
        lines = [f for f in features if f["geometry"]["type"] == "LineString"]
        if len(surfaces) + len(lines) != len(features):
            raise FormatError(name, "geometry", "Polygon for a surface, LineString for a link")
        rows = [line.get("properties") or {} for line in lines]
        properties = [
            LineProperties(width_m=_number(row.get("width_m")), tags=tags_of(row), has_level=_has_level(row))
            for row in rows
        ]
        return _surfaces(surfaces), _links(lines, properties), properties
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError) as error:
        if isinstance(error, FormatError):
            raise
        why = " ".join(f"{type(error).__name__} {error}".split())[:120]
        raise FormatError(name, "GeoJSON", f"features of surfaces and links ({why})") from None


def _surface(surfaces: RoadSurfaces, row: int) -> dict[str, Any]:
    grid = surfaces.heights_m[row]
    latitude, longitude = float(surfaces.latitude_rad[row]), float(surfaces.longitude_rad[row])
    yaw, half = float(surfaces.yaw_rad[row]), (surfaces.half_length_m[row], surfaces.half_width_m[row])
    # Counter-clockwise from the rear right corner, as the format wants outer rings.
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * half
    c, s = math.cos(yaw), math.sin(yaw)
    corners = np.column_stack((c * signs[:, 0] - s * signs[:, 1], s * signs[:, 0] + c * signs[:, 1]))
    lat, lon, _ = LocalFrame(latitude, longitude, 0.0).geodetic_from_east_north_array(corners, 0.0)
    heights = [grid[0, 0], grid[-1, 0], grid[-1, -1], grid[0, -1], grid[0, 0]]
    ring = [[degrees(x), degrees(y), round(float(h), 4)] for x, y, h in zip(lon, lat, heights, strict=True)]
    properties = _properties(surfaces, _SURFACE, row) | {
        "centre": [degrees(longitude), degrees(latitude)],
        "yaw_rad": yaw,
        "heights_m": np.round(grid, 4).tolist(),
    }
    return make_feature(properties["surface_id"], "Polygon", [ring], properties)


def _link(links: RoadLinks, row: int) -> dict[str, Any]:
    line = [[degrees(longitude), degrees(latitude)] for latitude, longitude in links.vertices[row]]
    properties = _properties(links, _LINK, row)
    return make_feature(properties["link_id"], "LineString", line, properties)


def _properties(columns: RoadSurfaces | RoadLinks, names: Sequence[str], row: int) -> dict[str, Any]:
    values = {name: getattr(columns, name)[row].item() for name in names}
    return {name: str(value) if name in _IDS else value for name, value in values.items()}


def make_feature(number: str, kind: str, coordinates: list[Any], properties: Mapping[str, Any]) -> Feature:
    """A feature of GeoJSON with an id."""
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "id": number, "geometry": geometry, "properties": properties}


def feature_collection(features: Iterable[Feature]) -> str:
    """A FeatureCollection, a feature on each line."""
    body = ",\n".join(json.dumps(each, allow_nan=False, separators=(",", ":")) for each in features)
    return '{"type":"FeatureCollection","features":[\n' + body + "\n]}\n"


def degrees(angle_rad: float) -> float:
    """Degrees as a file has them."""
    return round(math.degrees(angle_rad), _DECIMALS)


def _id(value: Any) -> int:
    """An id as text or number; ValueError or TypeError for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise TypeError(f"id {value!r}, expected digits")
    return int(value)


def _surfaces(features: list[Mapping[str, Any]]) -> RoadSurfaces:
    rows = [feature["properties"] for feature in features]
    centre = np.radians(np.array([row["centre"] for row in rows], np.float64).reshape(-1, 2))
    columns: dict[str, Any] = {
        name: [_id(row[name]) if name in _IDS else row[name] for row in rows]
        for name in (*_SURFACE, "yaw_rad", "heights_m")
    }
    surfaces = RoadSurfaces(**columns, latitude_rad=centre[:, 1], longitude_rad=centre[:, 0])
    # Rounded as releases are: what came from one is what it was.
    return surfaces_from_tiles(surface_tiles(surfaces))


def _has_level(row: Mapping[str, Any]) -> bool:
    # In OpenStreetMap `level` is a floor of a building.
    return "level" in row and "highway" not in row


def _links(features: list[Mapping[str, Any]], properties: list[LineProperties]) -> RoadLinks:
    rows, vertices = [feature.get("properties") or {} for feature in features], []
    for feature in features:
        line = np.array([point[:2] for point in feature["geometry"]["coordinates"]], np.float64)
        if line.ndim != 2 or len(line) < 2 or not (np.abs(line) <= 180.0).all():
            raise ReleaseError("links", "coordinates", "two places or more, in degrees")
        vertices.append(np.radians(line[:, ::-1]))
    if not rows:
        return RoadLinks(**{field.name: [] for field in fields(RoadLinks)})  # type: ignore[arg-type]
    level = [0 if each.has_level else level_of(each.tags) for each in properties]
    links = named_links("link", vertices, level=np.array(level, np.int64))
    columns: dict[str, Any] = {}
    for name in _LINK:
        otherwise = getattr(links, name).tolist()
        columns[name] = np.array(
            [
                value if name == "level" and not each.has_level else _value(name, row.get(name, value))
                for row, each, value in zip(rows, properties, otherwise, strict=True)
            ]
        )
    return RoadLinks(**columns, vertices=vertices)


def _value(name: str, value: Any) -> Any:
    return _id(value) if name in _IDS else value


def _number(value: Any) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.5 <= value <= 100.0:
        raise ValueError(f"width_m is {value!r}, expected 0.5 to 100")
    return float(value)
