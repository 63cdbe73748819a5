"""Roads of OpenStreetMap: cut where they meet, the same from XML and PBF, wrong files refused in one line."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.openstreetmap import OsmRoad, has_lanelets, read_roads, width_m
from support.lanelet_maps import lanelet2_bytes, town

osmium = pytest.importorskip("osmium")

NODES_DEG = {1: (48.0, 11.0), 2: (48.0, 11.001), 3: (48.0, 11.002), 4: (48.001, 11.001), 5: (48.002, 11.001)}
LINES = {
    10: ([1, 2, 3], {"highway": "residential", "lanes": "2"}),
    11: ([2, 4, 5], {"highway": "service", "oneway": "yes"}),
    12: ([4, 3], {"highway": "footway"}),
    13: ([5, 3], {"waterway": "river"}),
}


def osm_file(
    path: Path, lines: dict[int, tuple[list[int], dict[str, str]]] = LINES, without: int = 0
) -> Path:
    """Written by osmium, in the format that the name of the file says."""
    with osmium.SimpleWriter(str(path)) as writer:
        for identity, (latitude, longitude) in NODES_DEG.items():
            if identity != without:
                writer.add_node(
                    osmium.osm.mutable.Node(id=identity, version=1, location=(longitude, latitude))
                )
        for identity, (refs, tags) in lines.items():
            writer.add_way(osmium.osm.mutable.Way(id=identity, version=1, nodes=refs, tags=tags))
    return path


def lines_deg(roads: list[OsmRoad]) -> list[list[tuple[float, float]]]:
    return [[tuple(place) for place in np.degrees(road.vertices_rad).round(7).tolist()] for road in roads]


HIGHWAYS = frozenset({"residential", "service"})


@pytest.mark.parametrize("name", ["a.osm", "a.osm.gz", "a.osm.bz2", "a.osm.pbf", "a.pbf"])
def test_roads_are_cut_where_they_meet(name: str, tmp_path: Path) -> None:
    roads = read_roads(osm_file(tmp_path / name), HIGHWAYS)
    at = NODES_DEG
    assert lines_deg(roads) == [[at[1], at[2]], [at[2], at[3]], [at[2], at[4], at[5]]]
    assert [road.osm_id for road in roads] == [10, 10, 11]
    assert roads[0].tags == {"highway": "residential", "lanes": "2"}


def test_a_road_ends_where_an_extract_has_no_node(tmp_path: Path) -> None:
    roads = read_roads(
        osm_file(tmp_path / "a.pbf", {10: ([1, 2, 3, 4, 5], {"highway": "service"})}, without=3), HIGHWAYS
    )
    at = NODES_DEG
    assert lines_deg(roads) == [[at[1], at[2]], [at[4], at[5]]]


def test_a_file_with_what_an_editor_has_deleted_is_refused(tmp_path: Path) -> None:
    text = osm_file(tmp_path / "a.osm").read_text()
    assert text.count('<way id="10"') == 1
    (tmp_path / "a.osm").write_text(text.replace('<way id="10"', '<way id="10" action="delete"'))
    with pytest.raises(FormatError, match="action is 'delete', expected a file without elements"):
        read_roads(tmp_path / "a.osm", HIGHWAYS)


def test_a_loop_is_one_road(tmp_path: Path) -> None:
    (road,) = read_roads(osm_file(tmp_path / "a.pbf", {10: ([1, 2, 4, 1], {"highway": "service"})}), HIGHWAYS)
    assert len(road.vertices_rad) == 4


@pytest.mark.parametrize(
    ("tags", "expected_m"),
    [
        ({}, 6.0),
        ({"oneway": "yes"}, 3.0),
        ({"oneway": "-1", "lanes": "2"}, 6.0),
        ({"lanes": "4"}, 12.0),
        ({"lanes": "1.5"}, 6.0),
        ({"lanes": "1.5", "oneway": "yes"}, 3.0),
        ({"lanes": "²"}, 6.0),
        ({"lanes": "9" * 5000}, 6.0),
        ({"lanes": "20"}, 60.0),
        ({"lanes": "0"}, 6.0),
        ({"width": "9" * 5000 + "'"}, 6.0),
        ({"lanes": "99"}, 6.0),
        ({"width": "7.5", "lanes": "4"}, 7.5),
        ({"width": "7,5 m"}, 7.5),
        ({"width": "16'6\""}, 5.029),
        ({"width": "narrow"}, 6.0),
        ({"width": "0.1"}, 6.0),
        ({"width": "1e300"}, 6.0),
    ],
)
def test_the_width_is_stated_or_that_of_the_lanes(tags: dict[str, str], expected_m: float) -> None:
    assert width_m(tags, 3.0) == pytest.approx(expected_m, abs=1e-3)


@pytest.mark.parametrize("name", ["a.osm", "a.osm.gz", "a.pbf"])
def test_a_cut_file_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    path = osm_file(tmp_path / name)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(
        FormatError, match=r"^\S+: OpenStreetMap, expected a whole .osm or .pbf \("
    ) as refused:
        read_roads(path, HIGHWAYS)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "data", [b"", b"<gpx/>", b"<!DOCTYPE osm [<!ENTITY a 'b'>]><osm>&a;</osm>", b"\x00" * 200]
)
@pytest.mark.parametrize("name", ["a.osm", "a.pbf"])
def test_what_is_no_file_of_openstreetmap_is_refused(name: str, data: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(FormatError):
        read_roads(tmp_path / name, HIGHWAYS)


def test_random_damage_gives_roads_or_one_line(tmp_path: Path) -> None:
    seed = 20261129
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    for name in ("a.osm", "a.pbf"):
        sound = osm_file(tmp_path / name).read_bytes()
        for _ in range(200):
            data = bytearray(sound)
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
            (tmp_path / name).write_bytes(data)
            with suppress(FormatError):
                roads = read_roads(tmp_path / name, HIGHWAYS)
                assert all(
                    np.isfinite(road.vertices_rad).all() and len(road.vertices_rad) > 1 for road in roads
                )
        (tmp_path / name).unlink()


def test_a_lanelet2_map_is_no_file_of_openstreetmap(tmp_path: Path) -> None:
    (tmp_path / "lanelets.osm").write_bytes(lanelet2_bytes(town()))
    assert has_lanelets(tmp_path / "lanelets.osm")
    assert not has_lanelets(osm_file(tmp_path / "a.osm"))
