from __future__ import annotations

import argparse
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.tools.maps.geojson import read_geojson
from camber.tools.maps.importers.given_roads import given_roads
from support import lanelet_maps

SEED = 23


def roads(path: Path) -> Any:
    return given_roads(argparse.Namespace(roads=path, width_m=3.0))


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
