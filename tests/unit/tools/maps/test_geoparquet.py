"""Releases as GeoParquet, read by DuckDB: it finds the release's own numbers."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pytest

from camber.cli import main
from camber.road_map.release import Release, ReleaseError, open_release, read_release
from camber.tools.maps.geojson import geojson_text
from camber.tools.maps.geoparquet import export_geoparquet
from support.refusals import Refused
from support.small_disk import small_disk
from support.small_map import link, surface, write

SEED = 11
SURFACES = 200
REACH_M = 900.0  # chosen: nine tiles and more
LARGEST_ID = 2**62


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Surfaces and links over many tiles, with ids that no double holds, and grids of many shapes."""
    rng = np.random.default_rng(SEED)
    places = rng.uniform(-REACH_M, REACH_M, (SURFACES, 2))
    rows = [
        surface(
            LARGEST_ID - 3 * k,
            *place,
            link_id=LARGEST_ID - 7 * (k % 40),
            level=int(rng.integers(-2, 3)),
            yaw_rad=float(rng.uniform(-3.0, 3.0)),
            half_length_m=float(rng.uniform(1.0, 30.0)),
            sigma_m=float(rng.uniform(0.01, 0.5)),
            heights_m=50.0 + rng.uniform(-0.2, 0.2, rng.integers(2, 5, 2)),
        )
        for k, place in enumerate(places.tolist())
    ]
    lines = rng.uniform(-REACH_M, REACH_M, (40, 5, 2))
    links = [link(LARGEST_ID - 7 * k, (k, k + 1), line[: 2 + k % 4]) for k, line in enumerate(lines)]
    path = tmp_path_factory.mktemp("release")
    write(path, rows, links)
    return path


@pytest.fixture(scope="module")
def release(folder: Path) -> Release:
    return read_release(folder)


@pytest.fixture(scope="module")
def out(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("out") / "parquet"
    assert main(["map", "export", str(folder), "--to", "geoparquet", "--out", str(path)]) == 0
    return path


def answer(out: Path, table: str, query: str) -> list[Any]:
    """Rows of a query over a table."""
    return duckdb.sql(f"SELECT {query} FROM '{out / table}.parquet'").fetchall()


def test_surfaces_are_in_many_tiles_but_once_in_the_file(out: Path, release: Release) -> None:
    stored = [release.surface_tile(*xy) for xy in release.tiles("surfaces")]
    assert sum(len(tile.surface_id) for tile in stored if tile is not None) > SURFACES
    surfaces = release.road_surfaces()
    assert answer(out, "surfaces", "count(*), count(DISTINCT surface_id)") == [(SURFACES, SURFACES)]
    ids = answer(out, "surfaces", "surface_id, link_id")
    assert sorted(ids) == list(zip(surfaces.surface_id.tolist(), surfaces.link_id.tolist(), strict=True))


def test_sums_and_bounds_of_duckdb_are_those_of_the_release(out: Path, release: Release) -> None:
    surfaces, links = release.road_surfaces(), release.road_links()
    names = ("latitude_rad", "longitude_rad", "yaw_rad", "half_length_m", "half_width_m", "sigma_m")
    sums = answer(out, "surfaces", ", ".join(f"sum({name}::DOUBLE)" for name in names))[0]
    assert sums == pytest.approx([getattr(surfaces, name).sum() for name in names], rel=1e-12)
    whole = ("surface_id", "link_id", "level", "vehicles", "last_seen_ns")
    exact = answer(out, "surfaces", ", ".join(f"sum({name})" for name in whole))[0]
    assert list(exact) == [sum(getattr(surfaces, name).tolist()) for name in whole]
    heights = [height for grid in surfaces.heights_m for height in grid.ravel().tolist()]
    total = answer(out, "surfaces", "sum(list_sum(flatten(heights_m))), sum(len(flatten(heights_m)))")[0]
    assert total == (pytest.approx(sum(heights), rel=1e-12), len(heights))
    whole = ("link_id", "start_node", "end_node", "level")
    exact = answer(out, "links", ", ".join(["count(*)", *(f"sum({name})" for name in whole)]))[0]
    assert list(exact) == [len(links), *(sum(getattr(links, name).tolist()) for name in whole)]
    vertices = np.degrees(np.concatenate(list(links.vertices)))
    bounds = answer(out, "links", "min(bbox.ymin), min(bbox.xmin), max(bbox.ymax), max(bbox.xmax)")[0]
    assert bounds == pytest.approx([*vertices.min(axis=0), *vertices.max(axis=0)], abs=1e-12)


def test_geometry_is_that_of_geojson(out: Path, release: Release) -> None:
    features = json.loads(geojson_text(release.road_surfaces(), release.road_links()))["features"]
    for table, kind, number in (("surfaces", "Polygon", "surface_id"), ("links", "LineString", "link_id")):
        texts = dict(answer(out, table, f"{number}::VARCHAR, ST_AsText(geometry)"))
        expected = {f["id"]: f["geometry"]["coordinates"] for f in features if f["geometry"]["type"] == kind}
        assert texts.keys() == expected.keys()
        for identity, text in texts.items():
            numbers = [place.split() for place in text[text.rindex("(") + 1 :].rstrip(")").split(", ")]
            places = expected[identity][0] if kind == "Polygon" else expected[identity]
            difference = np.abs(np.array(numbers, float) - places)
            assert (difference < [1e-9, 1e-9, 1e-4][: len(places[0])]).all()


def test_bounds_of_each_row_hold_its_polygon(out: Path) -> None:
    rows = answer(out, "surfaces", "bbox, ST_AsText(geometry)")
    for bounds, text in rows:
        corners = np.array([place.split() for place in text[12:].rstrip(")").split(", ")], float)
        for axis, column in zip("xyz", corners.T, strict=True):
            assert (bounds[f"{axis}min"], bounds[f"{axis}max"]) == (column.min(), column.max())


def test_grids_come_back_row_by_row(out: Path, release: Release) -> None:
    surfaces = release.road_surfaces()
    grids = dict(answer(out, "surfaces", "surface_id, heights_m"))
    for number, grid in zip(surfaces.surface_id.tolist(), surfaces.heights_m, strict=True):
        assert grids[number] == grid.tolist()


def test_metadata_are_those_of_geoparquet_1_1(out: Path) -> None:
    for table, kind, axes in (("surfaces", "Polygon Z", 3), ("links", "LineString", 2)):
        query = f"SELECT decode(value) FROM parquet_kv_metadata('{out / table}.parquet') WHERE decode(key) = 'geo'"
        ((text,),) = duckdb.sql(query).fetchall()
        metadata = json.loads(text)
        assert (metadata["version"], metadata["primary_column"]) == ("1.1.0", "geometry")
        geometry = metadata["columns"]["geometry"]
        assert (geometry["encoding"], geometry["geometry_types"], geometry["epoch"]) == (
            "WKB",
            [kind],
            2024.5,
        )
        assert (geometry["crs"]["type"], geometry["crs"]["name"]) == ("GeographicCRS", "WGS 84")
        assert len(geometry["crs"]["coordinate_system"]["axis"]) == axes
        covering = geometry["covering"]["bbox"]
        assert covering == {
            f"{a}{end}": ["bbox", f"{a}{end}"] for end in ("min", "max") for a in "xyz"[:axes]
        }


def test_an_empty_map_has_tables_without_rows(tmp_path: Path) -> None:
    write(tmp_path / "map", [])
    out = tmp_path / "out"
    assert main(["map", "export", str(tmp_path / "map"), "--to", "geoparquet", "--out", str(out)]) == 0
    assert [answer(out, table, "count(*)") for table in ("surfaces", "links")] == [[(0,)], [(0,)]]


def test_a_tile_that_cannot_be_read_leaves_no_file(folder: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "map"
    shutil.copytree(folder, damaged)
    release = open_release(damaged)
    digest = release.sha256("surfaces", *release.tiles("surfaces")[2]) or ""
    (damaged / "blobs" / digest[:2] / digest).unlink()
    with pytest.raises(ReleaseError, match=digest):
        export_geoparquet(release, "map", tmp_path / "out", None)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_full_disk_is_one_clear_line(folder: Path, tmp_path: Path, refused: Refused) -> None:
    with small_disk(tmp_path / "disk", 16_384):
        out = tmp_path / "disk" / "out"
        line = refused(main, "map", "export", folder, "--to", "geoparquet", "--out", out)
        assert line.endswith("No space left on device")
        assert list(out.iterdir()) == []
