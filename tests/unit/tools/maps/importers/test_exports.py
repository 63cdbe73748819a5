"""Releases given away and taken in again: GeoTIFF, GeoJSON, PCD cells."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from camber.cli import main
from camber.formats.map_exchange.pcd import read_pcd
from camber.road_map.cloud_tiles import cloud_tiles
from camber.road_map.release import Release, read_release
from camber.road_map.road_columns import RoadLinks, RoadSurfaces
from camber.schemas.road import CloudTile
from camber.tools.maps.importers.surfaces_along import Floats, Integers, RoadCentreLines, surfaces_along
from support.built_maps import build_map
from support.nearest_surface import nearest_heights
from support.refusals import Refused
from support.small_map import FRAME, link, links, write

NOW_NS = 1_400_000_000 * 10**9
BRIDGE_M = 6.0
LINES_M = (((-60.0, 0.0), (60.0, 8.0)), ((5.0, -40.0), (5.0, 40.0)))
"""From where to where the road goes, and the bridge over it."""


def hill(east_m: Floats, north_m: Floats) -> Floats:
    height: Floats = 50.0 + 0.05 * east_m - 0.02 * north_m + 0.0003 * east_m**2
    return height


def road_and_bridge() -> tuple[RoadSurfaces, RoadLinks]:
    """A road to the east, another over it to the north."""
    road, bridge = (link(3 + 2 * k, (1 + 2 * k, 2 + 2 * k), LINES_M[k], level=k) for k in (0, 1))
    road_links = links([road, bridge | {"sigma_m": 0.25}])

    def ground(latitude: Floats, longitude: Floats, row: Integers) -> tuple[Floats, Floats]:
        plane = FRAME.east_north_from_geodetic_array(latitude, longitude, 0.0 * latitude)
        return hill(*plane.T) + BRIDGE_M * row, np.full(len(row), 0.03)

    roads = RoadCentreLines(road_links, np.array([2.0, 2.0]))
    return surfaces_along(roads, ground, spacing_m=1.0, seen_ns=NOW_NS - 10**9, vehicles=4), road_links


def written(folder: Path, clouds: Sequence[CloudTile] = ()) -> Path:
    surfaces, road_links = road_and_bridge()
    write(folder, [], time_ns=NOW_NS, surfaces=surfaces, links=road_links, clouds=clouds)
    return folder


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("release")
    rng = np.random.default_rng(5)
    plane = rng.uniform((-60.0, -30.0), (60.0, 30.0), (3000, 2))
    clouds = [
        *cloud_tiles(np.column_stack((plane, hill(*plane.T))), FRAME, "road_cloud", NOW_NS),
        *cloud_tiles(np.column_stack((plane, hill(*plane.T) + 9.0)), FRAME, "environment_cloud", NOW_NS),
    ]
    return written(folder, clouds)


def exported(release: Path, to: str, out: Path, *more: str) -> Path:
    assert main(["map", "export", str(release), "--to", to, "--out", str(out), *more]) == 0
    return out


def along(level: int) -> Floats:
    """Places (n, 2) along the middle of a road, not at its very ends."""
    return np.linspace(*LINES_M[level], 204)[2:-2]


def heights(map_release: Release, places_m: Floats, level: int) -> Floats:
    surfaces = map_release.road_surfaces()
    latitude, longitude, _ = FRAME.geodetic_from_east_north_array(places_m, 0.0)
    return nearest_heights(surfaces, latitude, longitude, near_m=0.01, level=level)[0]


def test_geojson_comes_back_as_it_went_to_the_last_byte_of_its_tiles(release: Path, tmp_path: Path) -> None:
    path = exported(release, "geojson", tmp_path / "map.geojson")
    assert build_map("geojson", tmp_path / "again", path) == 0
    before, after = read_release(release), read_release(tmp_path / "again")
    for layer in ("surfaces", "links"):
        assert before.tiles(layer) == after.tiles(layer)
        assert [before.sha256(layer, *xy) for xy in before.tiles(layer)] == [
            after.sha256(layer, *xy) for xy in after.tiles(layer)
        ]


def test_heights_of_geojson_are_compared_with_its_corners(
    release: Path, tmp_path: Path, refused: Refused, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported(release, "geojson", tmp_path / "map.geojson")
    assert build_map("geojson", tmp_path / "again", path, "--check-seed", 3) == 0
    assert "against the source at 2000 places (seed 3)" in capsys.readouterr().out
    roads = json.loads(path.read_text())
    surface = next(f for f in roads["features"] if f["geometry"]["type"] == "Polygon")
    surface["properties"]["heights_m"] = (np.array(surface["properties"]["heights_m"]) + 0.3).tolist()
    path.write_text(json.dumps(roads))
    line = refused(lambda _: build_map("geojson", tmp_path / "moved", path))
    # At a corner that two surfaces of a link share, the one that differs more counts.
    assert "height at a corner of surface" in line
    assert "is '0.300 m, " in line


@pytest.mark.parametrize("ring", [[["a", "b", "c"]] * 5, [1.0, 2.0], None])
def test_a_polygon_that_is_no_ring_is_one_line(
    ring: object, release: Path, tmp_path: Path, refused: Refused
) -> None:
    path = exported(release, "geojson", tmp_path / "map.geojson")
    roads = json.loads(path.read_text())
    for feature in roads["features"]:
        if feature["geometry"]["type"] == "Polygon":
            feature["geometry"]["coordinates"] = [ring]
    path.write_text(json.dumps(roads))
    line = refused(lambda _: build_map("geojson", tmp_path / "again", path))
    assert "coordinates of polygons, expected rings" in line


def test_ids_of_geojson_are_texts_and_numbers_are_read_too(release: Path, tmp_path: Path) -> None:
    path = exported(release, "geojson", tmp_path / "map.geojson")
    roads = json.loads(path.read_text())
    for feature in roads["features"]:
        values = feature["properties"]
        for name in {"surface_id", "link_id", "start_node", "end_node"} & values.keys():
            assert isinstance(values[name], str), name
            values[name] = int(values[name])
    numbers = tmp_path / "numbers.geojson"
    numbers.write_text(json.dumps(roads))
    assert build_map("geojson", tmp_path / "again", numbers) == 0
    again = read_release(tmp_path / "again").road_surfaces()
    assert again.surface_id.tolist() == read_release(release).road_surfaces().surface_id.tolist()


def test_geojson_says_where_surfaces_are_to_who_knows_nothing_of_camber(
    release: Path, tmp_path: Path
) -> None:
    features = json.loads(exported(release, "geojson", tmp_path / "map.geojson").read_text())["features"]
    polygons = [f for f in features if f["geometry"]["type"] == "Polygon"]
    lines = [f for f in features if f["geometry"]["type"] == "LineString"]
    assert len(lines) == 2
    assert len(polygons) == len(read_release(release).road_surfaces())
    for polygon in polygons:
        (ring,) = polygon["geometry"]["coordinates"]
        assert ring[0] == ring[-1]
        corners = np.array(ring)
        x, y = corners[:, 0], corners[:, 1]
        assert np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0.0  # counter-clockwise
        plane = FRAME.east_north_from_geodetic_array(np.radians(y), np.radians(x), 0.0 * x)
        lift = BRIDGE_M * polygon["properties"]["level"]
        assert np.abs(corners[:, 2] - hill(*plane.T) - lift).max() < 0.002


def test_a_geotiff_of_each_level_comes_back_within_a_millimetre(release: Path, tmp_path: Path) -> None:
    folder = exported(release, "geotiff", tmp_path / "tif", "--cell-m", "0.25")
    assert sorted(path.name for path in folder.iterdir()) == ["level_0.tif", "level_1.tif"]
    for level in (0, 1):
        out = tmp_path / f"again{level}"
        options = ("--roads", release, "--width-m", 3, "--sigma-m", 0.03, "--spacing-m", 0.5)
        tif = folder / f"level_{level}.tif"
        assert build_map("geotiff", out, tif, *options, "--level", level) == 0
        again = read_release(out)
        assert set(again.road_surfaces().link_id.tolist()) == {3 if level == 0 else 5}
        assert len(again.road_links()) == 2
        places_m = along(level)
        read_m = heights(again, places_m, level)
        assert np.isfinite(read_m).all()
        assert np.abs(read_m - heights(read_release(release), places_m, level)).max() < 0.001


def test_autoware_s_cells_hold_each_point_once_where_the_projector_says(
    release: Path, tmp_path: Path
) -> None:
    import pyproj

    folder = exported(release, "pcd", tmp_path / "autoware", "--cell-m", "25")
    metadata = (folder / "pointcloud_map_metadata.yaml").read_text().splitlines()
    assert metadata[:2] == ["x_resolution: 25.0", "y_resolution: 25.0"]
    projector = dict(
        line.strip().split(": ")
        for line in (folder / "map_projector_info.yaml").read_text().splitlines()
        if ": " in line
    )
    assert projector["projector_type"] == "LocalCartesianUTM"
    utm = pyproj.Proj(proj="utm", zone=53, ellps="WGS84")
    east0, north0 = utm(float(projector["longitude"]), float(projector["latitude"]))
    count = 0
    for line in metadata[2:]:
        name, corner = line.split(": ")
        low = np.array(json.loads(corner), np.float64)
        points = read_pcd(folder / "pointcloud_map" / name).points_m.astype(np.float64)
        assert ((points[:, :2] >= low - 1e-3) & (points[:, :2] <= low + 25.0 + 1e-3)).all()
        longitude, latitude = np.radians(utm(points[:, 0] + east0, points[:, 1] + north0, inverse=True))
        plane = FRAME.east_north_from_geodetic_array(latitude, longitude, 0.0 * latitude)
        off = points[:, 2] - hill(*plane.T)
        assert (np.minimum(np.abs(off), np.abs(off - 9.0)) < 0.01).all()
        count += len(points)
    assert 5990 <= count <= 6000  # see _points: on a border some are in neither tile


def test_what_cannot_be_exported_is_one_clear_line(tmp_path: Path, refused: Refused) -> None:
    bare = written(tmp_path / "bare")
    for folder, options in ((bare, ("--to", "pcd")), (tmp_path / "none", ("--to", "geojson"))):
        refused(main, "map", "export", folder, "--out", tmp_path / "x", *options)
