from __future__ import annotations

import argparse
import dataclasses
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.tools.maps.geojson import read_geojson
from camber.tools.maps.importers import rasters
from camber.tools.maps.importers.given_roads import given_roads
from camber.tools.maps.importers.surfaces_along import RoadCentreLines
from support import lanelet_maps

SEED = 23


def roads_and_remarks(path: Path, *options: str) -> tuple[RoadCentreLines, list[str]]:
    parser = argparse.ArgumentParser()
    rasters.add_arguments(parser)
    return given_roads(parser.parse_args(["a.tif", "--sigma-m", "0.1", "--roads", str(path), *options]))


def roads(path: Path, *options: str) -> RoadCentreLines:
    return roads_and_remarks(path, *options)[0]


def geojson(path: Path, *features: dict[str, Any]) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)}))
    return path


def line(*places: list[float], **properties: Any) -> dict[str, Any]:
    geometry = {"type": "LineString", "coordinates": list(places)}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


A, B, C = [137.0, 35.0], [137.001, 35.0], [137.001, 35.001]


def test_lines_that_say_nothing_meet_where_they_end_and_are_as_wide_as_asked(tmp_path: Path) -> None:
    given = roads(geojson(tmp_path / "roads.geojson", line(A, B), line(B, C, level=1, width_m=5.0)))
    assert given.links.end_node[0] == given.links.start_node[1]
    assert given.links.start_node[0] != given.links.end_node[1]
    assert given.links.level.tolist() == [0, 1]
    assert given.half_width_m.tolist() == [1.5, 2.5]
    assert np.degrees(given.links.vertices[1]) == pytest.approx(np.array([B[::-1], C[::-1]]))


def test_of_lanelets_the_middles_are_taken(tmp_path: Path) -> None:
    town = lanelet_maps.town()
    (tmp_path / "town.osm").write_bytes(lanelet_maps.lanelet2_bytes(town))
    given = roads(tmp_path / "town.osm")
    assert len(given.links) >= len(town.lanelets) > 0
    assert (given.half_width_m == 1.5).all()


def osm_line(x0: float, y0: float, x1: float, y1: float, **tags: Any) -> dict[str, Any]:
    """A line between places in metres, about."""
    return line([137.0 + 1e-5 * x0, 35.0 + 1e-5 * y0], [137.0 + 1e-5 * x1, 35.0 + 1e-5 * y1], **tags)


@pytest.mark.parametrize(
    ("tags", "level"),
    [
        ({}, 0),
        ({"bridge": "no", "tunnel": "no", "layer": "0"}, 0),
        ({"bridge": "yes"}, 1),
        ({"bridge": "viaduct", "layer": "2"}, 2),
        ({"bridge": "yes", "layer": "0"}, 1),
        ({"tunnel": "yes"}, -1),
        ({"tunnel": "building_passage", "layer": "-3"}, -3),
        ({"layer": "1"}, 1),
        ({"layer": -2}, -2),
        ({"level": "2"}, 0),  # the floor of a building
        ({"tags": {"bridge": "yes"}}, 1),
        ({"other_tags": '"surface"=>"asphalt","bridge"=>"yes","layer"=>"1"'}, 1),
    ],
)
def test_the_level_comes_from_the_tags(tags: dict[str, Any], level: int, tmp_path: Path) -> None:
    given = roads(geojson(tmp_path / "roads.geojson", line(A, B, highway="primary", **tags)))
    assert given.links.level.tolist() == [level]


def test_a_layer_that_is_none_is_refused(tmp_path: Path) -> None:
    for layer in ("x", "99"):
        with pytest.raises(FormatError, match=r"layer|could not convert"):
            roads(geojson(tmp_path / "roads.geojson", line(A, B, highway="primary", layer=layer)))


def test_what_is_no_road_for_vehicles_is_left_out_unless_asked_for(tmp_path: Path) -> None:
    kinds = ["primary", "footway", "cycleway", "steps", "path", "track"]
    lines = [osm_line(0, 10 * k, 50, 10 * k, highway=kind) for k, kind in enumerate(kinds)]
    others = [
        osm_line(0, -10, 50, -10, railway="rail"),
        osm_line(0, -20, 50, -20, waterway="river"),
        osm_line(0, -30, 50, -30),
    ]
    path = geojson(tmp_path / "roads.geojson", *lines, *others)
    given, remarks = roads_and_remarks(path)
    assert np.degrees([line[0, 0] for line in given.links.vertices]) == pytest.approx([35.0, 35.0 - 30e-5])
    assert remarks == [f"{path}: 7 lines are no roads for vehicles"]
    assert len(roads(path, "--highways", "primary,track").links) == 3


def test_lines_that_cross_without_a_common_node_are_left_out_and_listed(tmp_path: Path) -> None:
    over = [osm_line(0, -50, 30, 50, highway="primary"), osm_line(0, 20, 30, -20, highway="residential")]
    path = geojson(tmp_path / "roads.geojson", *over, osm_line(100, 0, 600, 0, highway="primary"))
    with pytest.raises(FormatError, match=r"2 of 3 lanes.*line 1 is 'crosses line 2', expected a node where"):
        roads(path)
    given, remarks = roads_and_remarks(path, "--max-loss-percent", "70")
    assert len(given.links) == 1
    assert [text.split(":")[0] for text in remarks[1:]] == ["  line 1", "  line 2"]
    with pytest.raises(FormatError, match="line 1 is 'crosses line 2'"):
        roads(path, "--strict", "--max-loss-percent", "70")


def test_lines_that_meet_or_are_on_different_levels_do_not_cross(tmp_path: Path) -> None:
    middle = [137.0 + 15e-5, 35.0]
    meeting = [
        line([137.0, 35.0 + y], middle, [137.0 + 30e-5, 35.0 - y], highway="primary") for y in (5e-4, -5e-4)
    ]
    bridge = osm_line(0, -7, 30, 33, highway="primary", bridge="yes")
    touching = osm_line(3, 5, 3, 500, highway="service")  # ends at no node, but does not go on beyond
    lanes = [
        osm_line(-50, -10, -20, 10, level=0),
        osm_line(-50, 10, -20, -10, level=0),
    ]  # they cross within a junction
    assert len(roads(geojson(tmp_path / "roads.geojson", *meeting, bridge, *lanes)).links) == 5
    assert len(roads(geojson(tmp_path / "roads.geojson", touching, bridge)).links) == 2


def test_a_ramp_that_goes_round_over_itself_is_left_out(tmp_path: Path) -> None:
    places = [(0, 0), (30, 0), (30, 30), (15, 30), (15, -60)]
    ramp = line(*[[137.0 + 1e-5 * x, 35.0 + 1e-5 * y] for x, y in places], highway="primary_link")
    with pytest.raises(FormatError, match="line 1 is 'crosses line 1'"):
        roads(geojson(tmp_path / "roads.geojson", ramp))


def test_lanelets_without_heights_say_nothing_of_levels(tmp_path: Path) -> None:
    town = lanelet_maps.town()
    level = dataclasses.replace(town, height_m=np.full_like(town.height_m, 12.0))
    (tmp_path / "town.osm").write_bytes(lanelet_maps.lanelet2_bytes(level))
    with pytest.raises(FormatError, match="heights is 'level', expected a road's"):
        roads(tmp_path / "town.osm")
    assert len(roads(tmp_path / "town.osm", "--flat").links) == len(town.lanelets)


@pytest.mark.parametrize("name", ["roads.shp", "empty.geojson", "none.geojson"])
def test_where_there_are_no_roads_one_line_says_so(tmp_path: Path, name: str) -> None:
    geojson(tmp_path / "empty.geojson")
    (tmp_path / "roads.shp").write_bytes(b"x")
    with pytest.raises((FormatError, OSError)):
        roads(tmp_path / name)


def test_damaged_geojson_raises_nothing_else(tmp_path: Path) -> None:
    rng = random.Random(SEED)
    path = geojson(tmp_path / "roads.geojson", line(A, B, link_id=5, sigma_m=0.1), line(B, C, width_m=4.0))
    text, refused = path.read_text(), 0
    for _ in range(300):
        at, more = rng.randrange(len(text)), rng.choice(("", "{", "]", '"', "9e999", "null", "-1"))
        path.write_text(text[:at] + more + text[at + rng.choice((0, 1, 5)) :])
        try:
            read_geojson(path)
        except FormatError:
            refused += 1
    assert refused > 100
