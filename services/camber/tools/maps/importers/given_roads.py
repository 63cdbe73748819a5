"""Where roads are, for builders that know only how high the ground is.

Sources are a release, GeoJSON lines, lanelets and files of OpenStreetMap.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lanelet2 import ROADS, read_lanelet2
from camber.formats.map_exchange.openstreetmap import SUFFIXES, OsmRoad, has_lanelets, read_roads, width_m
from camber.road_map.release import open_release
from camber.road_map.road_columns import RoadLinks, select_links
from camber.tools.maps.geojson import LineProperties, read_geojson
from camber.tools.maps.importers.checks.left_out import LeftOutLanes, left_out_lanes
from camber.tools.maps.importers.checks.level_heights import level_sigma_of
from camber.tools.maps.importers.lane_map import LaneSurvey, road_map
from camber.tools.maps.importers.lanelets import lanes_of, projector_of
from camber.tools.maps.importers.lanes import line_length_m, named_links, quantized_degrees
from camber.tools.maps.importers.osm_tags import HIGHWAYS, crossing_lines, is_road, level_of
from camber.tools.maps.importers.surfaces_along import RoadCentreLines
from camber.tools.options.number_options import number_from
from camber.tools.options.parsers import add_with_default

Bounds = tuple[float, float, float, float]
"""South, west, north, east [rad]."""

_OSM_SIGMA_M = 0.3
"""Least σ of heights; chosen: lines 6 m off (below), on ground that slopes by 5 % from the road."""
_OSM_LINK_SIGMA_M = 6.0
"""Source: M. Haklay, "How good is volunteered geographical information?", Environment and Planning B 37 (2010): roads
of OpenStreetMap are 6 m from those of Ordnance Survey on average."""


def add_road_arguments(parser: argparse.ArgumentParser) -> None:
    """Where the roads are, and how wide."""
    text = (
        "middles of the roads: folder of a release (its links), FILE.geojson (lines), FILE.osm (lanelets, or "
        "OpenStreetMap, also .osm.gz, .osm.bz2 and .pbf)"
    )
    parser.add_argument("--roads", type=Path, required=True, metavar="PATH", help=text)
    text, bounds = (
        "of a road whose line does not say it; OpenStreetMap: of each lane",
        number_from(0.5, 100.0, "m"),
    )
    add_with_default(parser, "--width-m", 3.0, text, type=bounds, metavar="W")
    text = "values of OpenStreetMap's tag `highway` that are taken"
    add_with_default(parser, "--highways", ",".join(HIGHWAYS), text)
    text = "between heights of a surface (default: the input's)"
    parser.add_argument("--spacing-m", type=number_from(0.05, 20.0, "m"), metavar="D", help=text)


def given_roads(
    args: argparse.Namespace, *, bounds_rad: Bounds | None = None
) -> tuple[RoadCentreLines, list[str]]:
    """The links and widths that `args` name, and remarks. Raises FormatError where there are none.

    Of OpenStreetMap only roads that reach into `bounds_rad` (south, west, north, east) are taken.
    """
    links, width_m, remarks = _links(args, bounds_rad)
    if not len(links):
        raise FormatError(str(args.roads), "links", "at least one road for vehicles")
    return RoadCentreLines(links, 0.5 * np.array(width_m)), remarks


def _links(args: argparse.Namespace, bounds_rad: Bounds | None) -> tuple[RoadLinks, list[float], list[str]]:
    path: Path = args.roads
    if path.is_dir():
        links = open_release(path).road_links()
        return links, [args.width_m] * len(links), []
    if path.name.endswith(SUFFIXES) and not (path.suffix == ".osm" and has_lanelets(path)):
        return _openstreetmap(args, path, bounds_rad)
    if path.suffix == ".osm":
        lanelets = read_lanelet2(path, ROADS, projector=projector_of(path))
        frame, lanes = lanes_of(lanelets, lanelets.height_m)
        # Heights only separate levels, which does not depend on the datum; without heights there are no levels.
        survey = LaneSurvey(sigma_m=1.0, link_sigma_m=0.5, seen_ns=0, level_sigma_m=level_sigma_of(args))
        links = road_map(lanes, frame, survey, str(path))[1]
        return links, [args.width_m] * len(links), []
    if path.suffix in (".geojson", ".json"):
        return _lines(args, path)
    raise FormatError(str(path), "roads", "the folder of a release, a .geojson, .osm or .pbf")


def _openstreetmap(
    args: argparse.Namespace, path: Path, bounds_rad: Bounds | None
) -> tuple[RoadLinks, list[float], list[str]]:
    if args.sigma_m < _OSM_SIGMA_M:
        expected = f"{_OSM_SIGMA_M:g} m or more for roads of OpenStreetMap, whose lines are metres off"
        raise FormatError(str(path), "--sigma-m", expected, actual=f"{args.sigma_m:g}")
    chosen = frozenset(args.highways.split(","))
    # Cut by the usual kinds whatever is chosen, so that ids are the same.
    of_file = [road for road in read_roads(path, chosen | set(HIGHWAYS)) if road.tags["highway"] in chosen]
    roads = _once([road for road in of_file if bounds_rad is None or _reaches_into(road, bounds_rad)])
    left_out = left_out_lanes(args)
    levels: list[int] = []
    kept: list[OsmRoad] = []
    for road in roads:
        try:
            levels.append(level_of(road.tags))
            kept.append(road)
        except (ValueError, OverflowError) as error:
            name = f"way {road.osm_id}"
            left_out.add(name, FormatError(str(path), name, f"a whole number as layer ({error})"))
    links = named_links(
        "link",
        [road.vertices_rad for road in kept],
        level=np.array(levels, np.int64),
        sigma_m=_OSM_LINK_SIGMA_M,
    )
    lines = [
        LineProperties(width_m=width_m(road.tags, args.width_m), tags=road.tags, has_level=False)
        for road in kept
    ]
    names = [f"way {road.osm_id}" for road in kept]
    return _without_crossed(args, path, links, lines, names=names, left_out=left_out)


def _reaches_into(road: OsmRoad, bounds_rad: Bounds) -> bool:
    """Whether the box around a road touches the bounds."""
    low, high = road.vertices_rad.min(axis=0), road.vertices_rad.max(axis=0)
    return bool((high >= bounds_rad[:2]).all() and (low <= bounds_rad[2:]).all())


def _once(roads: Sequence[OsmRoad]) -> list[OsmRoad]:
    """Roads without areas and without those that are drawn twice."""
    lines = [road for road in roads if road.tags.get("area") != "yes"]
    return list({str(quantized_degrees(road.vertices_rad)): road for road in lines}.values())


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
    chosen = [properties[k] for k in roads]
    names = [f"line {k + 1}" for k in roads]
    left_out = left_out_lanes(args)
    links, widths, losses = _without_crossed(
        args, path, select_links(links, roads), chosen, names=names, left_out=left_out
    )
    return links, widths, remarks + losses


def _without_crossed(
    args: argparse.Namespace,
    path: Path,
    links: RoadLinks,
    properties: Sequence[LineProperties],
    *,
    names: Sequence[str],
    left_out: LeftOutLanes,
) -> tuple[RoadLinks, list[float], list[str]]:
    """Links with widths, without those that cross another one on their level but do not meet it, and remarks."""
    widths = [args.width_m if each.width_m is None else each.width_m for each in properties]
    area_m2 = [width * line_length_m(line) for width, line in zip(widths, links.vertices, strict=True)]
    crossed = _crossed(links, properties, str(path))
    for k, other in crossed.items():
        expected = "a node where it crosses one on its level, or a bridge or tunnel"
        error = FormatError(str(path), names[k], expected, actual=f"crosses {names[other]}")
        left_out.add(names[k], error, area_m2[k])
    kept = [k for k in range(len(links)) if k not in crossed]
    losses = left_out.remarks(len(kept), sum(area_m2[k] for k in kept), str(path))
    return select_links(links, kept), [widths[k] for k in kept], losses


def _crossed(links: RoadLinks, properties: Sequence[LineProperties], file: str) -> dict[int, int]:
    """Lines that cross another one on their level without a node in common, and which: one of both is a bridge.

    Lines that state a level of Camber's are lanes, which cross within a junction.
    """
    tagged = [k for k, each in enumerate(properties) if not each.has_level]
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
