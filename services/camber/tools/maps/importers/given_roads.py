"""Where roads are, for builders that know only how high the ground is: from a release, GeoJSON lines or lanelets."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lanelet2 import ROADS, read_lanelet2
from camber.road_map.release import open_release
from camber.road_map.road_columns import RoadLinks
from camber.tools.maps.geojson import read_geojson
from camber.tools.maps.importers.lane_map import LaneSurvey, road_map
from camber.tools.maps.importers.lanelets import lanes_of
from camber.tools.maps.importers.surfaces_along import RoadCentreLines
from camber.tools.options.number_options import number_from
from camber.tools.options.parsers import add_with_default


def add_road_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the roads are, and how wide."""
    text = "middles of the roads: folder of a release (its links), FILE.geojson (lines), FILE.osm (lanelets)"
    parser.add_argument("--roads", type=Path, required=True, metavar="PATH", help=text)
    text, bounds = "of a road whose line does not say it", number_from(0.5, 100.0, "m")
    add_with_default(parser, "--width-m", 3.0, text, type=bounds, metavar="W")
    text = "between heights of a surface (default: the input's)"
    parser.add_argument("--spacing-m", type=number_from(0.05, 20.0, "m"), metavar="D", help=text)


def given_roads(args: argparse.Namespace) -> RoadCentreLines:
    """The links and widths that `args` name. Raises FormatError where there are none."""
    links, width_m = _links(args.roads, args.width_m)
    if not len(links):
        raise FormatError(str(args.roads), "links", "at least one")
    return RoadCentreLines(links, 0.5 * np.array(width_m))


def _links(path: Path, width_m: float) -> tuple[RoadLinks, list[float]]:
    if path.is_dir():
        links = open_release(path).road_links()
        return links, [width_m] * len(links)
    if path.suffix == ".osm":
        lanelets = read_lanelet2(path, ROADS)
        frame, lanes = lanes_of(lanelets, lanelets.height_m)
        # Heights only separate levels, which does not depend on the datum.
        links = road_map(lanes, frame, LaneSurvey(sigma_m=1.0, link_sigma_m=0.5, seen_ns=0), str(path))[1]
        return links, [width_m] * len(links)
    if path.suffix in (".geojson", ".json"):
        _, links, widths = read_geojson(path)
        return links, [width_m if width is None else width for width in widths]
    raise FormatError(str(path), "roads", "the folder of a release, a .geojson or an .osm")
