"""`camber map build geojson`: surfaces and links as `camber map export --to geojson` writes them.

The heights are above the ellipsoid, as GeoJSON (RFC 7946) has them: there is no other datum to name.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from camber.formats.errors import FormatError
from camber.tools.maps.geojson import read_geojson
from camber.tools.maps.importers.built_map import BuiltMap


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What only GeoJSON needs."""
    parser.add_argument("file", type=Path, metavar="FILE.geojson")


def build(args: argparse.Namespace) -> BuiltMap:
    """Everything in the file; each surface must be on one of its links."""
    surfaces, links, _ = read_geojson(args.file)
    stray = set(surfaces.link_id.tolist()) - set(links.link_id.tolist())
    if stray:
        raise FormatError(str(args.file), "link_id", "a link of the file", actual=str(min(stray)))
    return BuiltMap(surfaces=surfaces, links=links)
