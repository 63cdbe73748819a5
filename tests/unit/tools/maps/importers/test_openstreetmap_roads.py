"""A start from OpenStreetMap and a terrain model: roads of the ground get heights, σ says how little is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camber.road_map.release import open_release
from support.built_maps import build_map
from support.refusals import Refused

osmium = pytest.importorskip("osmium")
pyproj = pytest.importorskip("pyproj")
rasterio = pytest.importorskip("rasterio")

ZONE = "EPSG:32653"
UTM = pyproj.Proj(32653)
SIZE, CELL_M = 200, 2.0
CORNER_M = (682_000.0, 3_886_200.0)
# Metres from the north-western corner to the east and to the south.
NODES_M = {
    1: (20.0, 100.0), 2: (200.0, 100.0), 3: (380.0, 100.0), 4: (200.0, 20.0), 5: (200.0, 300.0),
    6: (20.0, 200.0), 7: (380.0, 200.0), 8: (100.0, 20.0), 9: (100.0, 300.0),
    21: (5_000.0, 100.0), 22: (5_200.0, 100.0),
}  # fmt: skip
STREETS = {
    10: ([1, 2, 3], {"highway": "residential", "width": "5"}),
    11: ([4, 2, 5], {"highway": "service", "oneway": "yes"}),
    12: ([6, 7], {"highway": "primary", "bridge": "yes", "layer": "1"}),  # over way 11
    14: ([21, 22], {"highway": "residential"}),  # outside of the raster
    15: ([8, 9], {"highway": "footway"}),
}


def ground_m(east_m: np.ndarray, south_m: np.ndarray) -> np.ndarray:
    height_m: np.ndarray = 40.0 + 0.02 * east_m - 0.01 * south_m
    return height_m


def terrain(folder: Path) -> Path:
    at = (np.arange(SIZE) + 0.5) * CELL_M
    heights_m = ground_m(at[None, :], at[:, None]).astype(np.float32)
    with rasterio.open(
        folder / "dem.tif", "w", driver="GTiff", width=SIZE, height=SIZE, count=1, dtype="float32",
        crs=pyproj.CRS(ZONE).to_3d().to_wkt(),
        transform=rasterio.Affine(CELL_M, 0.0, CORNER_M[0], 0.0, -CELL_M, CORNER_M[1]),
    ) as file:  # fmt: skip
        file.write(heights_m[None])
    return folder / "dem.tif"


def extract(path: Path, lines: dict[int, tuple[list[int], dict[str, str]]]) -> Path:
    with osmium.SimpleWriter(str(path)) as writer:
        for identity, (east_m, south_m) in NODES_M.items():
            place = UTM(CORNER_M[0] + east_m, CORNER_M[1] - south_m, inverse=True)
            writer.add_node(osmium.osm.mutable.Node(id=identity, version=1, location=place))
        for identity, (refs, tags) in lines.items():
            writer.add_way(osmium.osm.mutable.Way(id=identity, version=1, nodes=refs, tags=tags))
    return path


def build(folder: Path, roads: Path, sigma_m: float = 0.5, *more: str) -> int:
    options = ("--roads", roads, "--sigma-m", sigma_m, *more)
    return build_map("geotiff", folder / "map", *options, terrain(folder))


@pytest.mark.parametrize("name", ["town.osm", "town.osm.pbf"])
def test_streets_have_the_heights_of_the_ground_and_bridges_none(name: str, tmp_path: Path) -> None:
    assert build(tmp_path, extract(tmp_path / name, STREETS)) == 0
    release = open_release(tmp_path / "map")
    surfaces, links = release.road_surfaces(), release.road_links()
    assert sorted(links.level.tolist()) == [0, 0, 0, 0, 1]  # both streets are cut where they meet
    assert set(surfaces.link_id.tolist()) == set(links.link_id[links.level == 0].tolist())
    assert (surfaces.sigma_m >= 0.5).all()
    x_m, y_m = UTM(np.degrees(surfaces.longitude_rad), np.degrees(surfaces.latitude_rad))
    middle_m = np.array([grid.mean() for grid in surfaces.heights_m])
    np.testing.assert_allclose(middle_m, ground_m(x_m - CORNER_M[0], CORNER_M[1] - y_m), atol=0.01)
    assert set((2.0 * surfaces.half_width_m).round(1).tolist()) == {5.0, 3.0}


def test_ids_do_not_depend_on_the_kinds_that_are_chosen(tmp_path: Path) -> None:
    roads = extract(tmp_path / "town.pbf", STREETS)
    assert build(tmp_path, roads) == 0
    options = ("--roads", roads, "--sigma-m", 0.5, "--highways", "residential", terrain(tmp_path))
    assert build_map("geotiff", tmp_path / "fewer", *options) == 0
    all_links, fewer = (set(open_release(tmp_path / name).road_links().link_id) for name in ("map", "fewer"))
    assert len(fewer) == 2
    assert fewer < all_links


def test_links_of_a_crossing_share_its_node(tmp_path: Path) -> None:
    assert build(tmp_path, extract(tmp_path / "town.pbf", STREETS)) == 0
    links = open_release(tmp_path / "map").road_links()
    ends = np.concatenate((links.start_node, links.end_node))
    assert np.unique(ends, return_counts=True)[1].max() == 4


def test_a_sigma_that_lines_of_openstreetmap_cannot_have_is_refused(tmp_path: Path, refused: Refused) -> None:
    roads = extract(tmp_path / "town.pbf", STREETS)
    assert "--sigma-m is '0.1', expected 0.3 m or more" in refused(lambda _: build(tmp_path, roads, 0.1))


def test_a_crossing_without_a_node_is_left_out_and_named(tmp_path: Path, refused: Refused) -> None:
    lines = STREETS | {12: ([6, 7], {"highway": "primary"})}
    line = refused(lambda _: build(tmp_path, extract(tmp_path / "town.pbf", lines)))
    assert "expected at most 5 %" in line
    line = refused(lambda _: build(tmp_path, tmp_path / "town.pbf", 0.5, "--strict"))
    assert "way 11 is 'crosses way 12', expected a node where it crosses" in line


@pytest.mark.parametrize("layer", ["1;2", "inf", "1e400"])
def test_a_layer_that_is_no_number_is_named(layer: str, tmp_path: Path, refused: Refused) -> None:
    lines = STREETS | {12: ([6, 7], {"highway": "primary", "layer": layer})}
    roads = extract(tmp_path / "town.pbf", lines)
    assert "way 12, expected a whole number as layer" in refused(
        lambda _: build(tmp_path, roads, 0.5, "--strict")
    )


def test_an_extract_without_roads_in_the_raster_is_refused(tmp_path: Path, refused: Refused) -> None:
    roads = extract(tmp_path / "town.pbf", {14: STREETS[14]})
    assert "links, expected at least one road for vehicles" in refused(lambda _: build(tmp_path, roads))
