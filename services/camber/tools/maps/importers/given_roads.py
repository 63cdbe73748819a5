"""Where roads are, for builders that know only how high the ground is: from a release, GeoJSON lines or lanelets."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lanelet2 import ROADS, read_lanelet2
from camber.road_map.release import open_release
from camber.road_map.road_columns import RoadLinks, select_links
from camber.tools.maps.geojson import LineProperties, read_geojson
from camber.tools.maps.importers.checks.left_out import left_out_lanes
from camber.tools.maps.importers.checks.level_heights import level_sigma_of
from camber.tools.maps.importers.lane_map import LaneSurvey, road_map
from camber.tools.maps.importers.lanelets import lanes_of, projector_of
from camber.tools.maps.importers.lanes import line_length_m
from camber.tools.maps.importers.osm_tags import HIGHWAYS, crossing_lines, is_road
from camber.tools.maps.importers.surfaces_along import RoadCentreLines
from camber.tools.options.number_options import number_from
from camber.tools.options.parsers import add_with_default


def add_road_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the roads are, and how wide."""
    text = "middles of the roads: folder of a release (its links), FILE.geojson (lines), FILE.osm (lanelets)"
    parser.add_argument("--roads", type=Path, required=True, metavar="PATH", help=text)
    text, bounds = "of a road whose line does not say it", number_from(0.5, 100.0, "m")
    add_with_default(parser, "--width-m", 3.0, text, type=bounds, metavar="W")
    text = "values of OpenStreetMap's tag `highway` that are taken"
    add_with_default(parser, "--highways", ",".join(HIGHWAYS), text)
    text = "between heights of a surface (default: the input's)"
    parser.add_argument("--spacing-m", type=number_from(0.05, 20.0, "m"), metavar="D", help=text)


def given_roads(args: argparse.Namespace) -> tuple[RoadCentreLines, list[str]]:
    """The links and widths that `args` name, and remarks. Raises FormatError where there are none."""
    links, width_m, remarks = _links(args)
    if not len(links):
        raise FormatError(str(args.roads), "links", "at least one road for vehicles")
    return RoadCentreLines(links, 0.5 * np.array(width_m)), remarks


def _links(args: argparse.Namespace) -> tuple[RoadLinks, list[float], list[str]]:
    path: Path = args.roads
    if path.is_dir():
        links = open_release(path).road_links()
        return links, [args.width_m] * len(links), []
    if path.suffix == ".osm":
        lanelets = read_lanelet2(path, ROADS, projector=projector_of(path))
        frame, lanes = lanes_of(lanelets, lanelets.height_m)
        # Heights only separate levels, which does not depend on the datum; without heights there are no levels.
        survey = LaneSurvey(sigma_m=1.0, link_sigma_m=0.5, seen_ns=0, level_sigma_m=level_sigma_of(args))
        links = road_map(lanes, frame, survey, str(path))[1]
        return links, [args.width_m] * len(links), []
    if path.suffix in (".geojson", ".json"):
        return _lines(args, path)
    raise FormatError(str(path), "roads", "the folder of a release, a .geojson or an .osm")


def _lines(args: argparse.Namespace, path: Path) -> tuple[RoadLinks, list[float], list[str]]:
    """Lines of roads for vehicles, without those that cross another one on their level but do not meet it."""
    _, links, properties = read_geojson(path)
    highways = frozenset(args.highways.split(","))
    roads = [k for k, each in enumerate(properties) if is_road(each.tags, highways)]
    remarks = (
        [f"{path}: {len(links) - len(roads)} lines are no roads for vehicles"]
        if len(roads) < len(links)
        else []
    )
    width_m = [args.width_m if each.width_m is None else each.width_m for each in properties]
    area_m2 = [width * line_length_m(line) for width, line in zip(width_m, links.vertices, strict=True)]
    left_out = left_out_lanes(args)
    crossed = _crossed(links, roads, properties, str(path))
    for k, other in crossed.items():
        name = f"line {k + 1}"
        expected = "a node where it crosses one on its level, or a bridge or tunnel"
        left_out.add(
            name, FormatError(str(path), name, expected, actual=f"crosses line {other + 1}"), area_m2[k]
        )
    kept = [k for k in roads if k not in crossed]
    remarks += left_out.remarks(len(kept), sum(area_m2[k] for k in kept), str(path))
    return select_links(links, kept), [width_m[k] for k in kept], remarks


def _crossed(
    links: RoadLinks, roads: Sequence[int], properties: Sequence[LineProperties], file: str
) -> dict[int, int]:
    """Lines that cross another one on their level without a node in common, and which: one of both is a bridge.

    Lines that state a level of Camber's are lanes, which cross within a junction.
    """
    tagged = [k for k in roads if not properties[k].has_level]
    crossed: dict[int, int] = {}
    for level in set(links.level[tagged].tolist()):
        on_level = [k for k in tagged if links.level[k] == level]
        try:
            pairs = crossing_lines([links.vertices[k] for k in on_level])
        except ValueError as error:
            raise FormatError(file, "coordinates", f"a road's ({error})") from None
        for i, j in pairs:
            crossed.setdefault(on_level[i], on_level[j])
            crossed.setdefault(on_level[j], on_level[i])
    return crossed
