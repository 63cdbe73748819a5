"""`camber map build geojson`: surfaces and links as `camber map export --to geojson` writes them.

In GeoJSON (RFC 7946) positions are WGS 84, and the third coordinate is the height above its ellipsoid: there is no
other datum to name.

    surface   Polygon, its corners with their heights; properties hold all columns of RoadSurfaces
    link      LineString; properties hold all columns of RoadLinks

Ids have 62 bits and are texts: many programs keep only 53 of a JSON number. Numbers are read too.

What is written is read again as it was. Lines of another origin need no properties: ids come from their places, and
levels, where `level` is not given, from the tags `bridge`, `tunnel` and `layer` of OpenStreetMap.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from camber.formats.errors import FormatError
from camber.tools.maps.geojson import read_geojson
from camber.tools.maps.importers.built_map import BuiltMap
from camber.tools.maps.importers.checks.height_check import (
    PLACES,
    SourceHeights,
    add_check_arguments,
    checked_heights,
    seed_of,
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only GeoJSON needs."""
    parser.add_argument("file", type=Path, metavar="FILE.geojson")
    add_check_arguments(parser)


def build(args: argparse.Namespace) -> BuiltMap:
    """Everything in the file; each surface must be on one of its links."""
    surfaces, links, _ = read_geojson(args.file)
    stray = set(surfaces.link_id.tolist()) - set(links.link_id.tolist())
    if stray:
        raise FormatError(str(args.file), "link_id", "a link of the file", actual=str(min(stray)))
    seed = seed_of(args)
    corners = corner_heights(args.file, np.random.default_rng(seed))
    check = checked_heights(surfaces, corners, seed=seed, file=str(args.file))
    return BuiltMap(surfaces=surfaces, links=links, remarks=[check])


def corner_heights(path: Path, rng: np.random.Generator) -> SourceHeights:
    """Heights that random corners of polygons have as third coordinate, which the surfaces are not made from."""
    features = json.loads(path.read_bytes())["features"]
    polygons = [each for each in features if each["geometry"]["type"] == "Polygon"]
    try:
        corners = [
            (place, polygon["properties"])
            for polygon in polygons
            for place in polygon["geometry"]["coordinates"][0][:-1]
            if len(place) > 2
        ]
        drawn = [corners[k] for k in rng.integers(len(corners), size=PLACES)] if corners else []
        places = np.array([place[:3] for place, _ in drawn], np.float64).reshape(-1, 3)
    except (KeyError, TypeError, ValueError, IndexError):
        expected = "rings of places in degrees, with heights in metres"
        raise FormatError(str(path), "coordinates of polygons", expected) from None
    return SourceHeights(
        latitude_rad=np.radians(places[:, 1]),
        longitude_rad=np.radians(places[:, 0]),
        height_m=places[:, 2],
        links=[[int(properties["link_id"])] for _, properties in drawn],
        names=[f"a corner of surface {properties['surface_id']}" for _, properties in drawn],
    )
