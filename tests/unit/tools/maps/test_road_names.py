"""Names of roads come from the file of lines that a map was made along, by the ids that its links have."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import pytest

from camber.formats.errors import FormatError
from camber.tools.maps.geojson import read_geojson
from camber.tools.maps.importers import rasters
from camber.tools.maps.importers.given_roads import given_roads
from camber.tools.maps.road_names import road_names, road_text

OSM = """<osm version="0.6">
<node id="1" lat="35.0" lon="137.0"/><node id="2" lat="35.0" lon="137.001"/><node id="3" lat="35.001" lon="137.001"/>
<way id="7"><nd ref="1"/><nd ref="2"/><tag k="highway" v="primary"/><tag k="name" v="Elm Street"/></way>
<way id="8"><nd ref="2"/><nd ref="3"/><tag k="highway" v="primary"/><tag k="ref" v="M 4"/></way>
</osm>
"""


def line(*places: list[float], **properties: Any) -> dict[str, Any]:
    geometry = {"type": "LineString", "coordinates": list(places)}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def geojson(path: Path, *features: dict[str, Any]) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)}))
    return path


A, B, C = [137.0, 35.0], [137.001, 35.0], [137.001, 35.001]


def test_lines_of_geojson_name_the_links_that_are_made_along_them(tmp_path: Path) -> None:
    named = line(A, B, name=" Elm\n\u200bStreet "), line(B, C), line(C, A, link_id="77", ref="M 4")
    path = geojson(tmp_path / "roads.geojson", *named)
    first, second, _ = read_geojson(path)[1].link_id.tolist()
    names = road_names(path)
    assert names == {first: "Elm Street", 77: "M 4"}
    assert [road_text(each, names) for each in (first, second, None)] == ["Elm Street", f"link {second}", ""]


def test_openstreetmap_names_the_same_links_as_its_lines_in_geojson(tmp_path: Path) -> None:
    pytest.importorskip("osmium")
    (tmp_path / "town.osm").write_text(OSM)
    lines = geojson(tmp_path / "roads.geojson", line(A, B, name="Elm Street"), line(B, C, ref="M 4"))
    assert road_names(tmp_path / "town.osm") == road_names(lines)


def test_a_map_built_along_the_lines_has_the_links_that_are_named(tmp_path: Path) -> None:
    path = geojson(tmp_path / "roads.geojson", line(A, B, name="Elm Street"), line(B, C, name="Oak Street"))
    parser = argparse.ArgumentParser()
    rasters.add_arguments(parser)
    built, _ = given_roads(parser.parse_args(["a.tif", "--sigma-m", "0.1", "--roads", str(path)]))
    names = road_names(path)
    assert [names[link_id] for link_id in built.links.link_id.tolist()] == ["Elm Street", "Oak Street"]


def test_another_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="geojson"):
        road_names(tmp_path / "map.xodr")
