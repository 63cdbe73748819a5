"""Rasters as maps: what has no datum is refused, what has no data has no surface, and σ says how rough it is."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camber.road_map.release import read_release
from camber.tools.maps.importers import rasters
from camber.tools.maps.importers.height_raster import quiet_rasterio
from support.built_maps import build_map
from support.nearest_surface import nearest_heights
from support.refusals import Refused

rasterio = pytest.importorskip("rasterio")
pyproj = pytest.importorskip("pyproj")

ZONE = "EPSG:32653"  # UTM 53 north
UTM = pyproj.Proj(32653)
KNOWN = pyproj.CRS(ZONE).to_3d()  # heights above the ellipsoid
CORNER_M = (682_000.0, 3_886_200.0)
CELL_M = 0.5
SIZE = 500
WIDTH_M = 3.0


def surface(x: Any, y: Any) -> Any:
    return 40.0 + 0.03 * (x - CORNER_M[0]) + 0.01 * (y - CORNER_M[1])


def cells() -> Any:
    at = (np.arange(SIZE) + 0.5) * CELL_M
    return surface(CORNER_M[0] + at[None, :], CORNER_M[1] - at[:, None]).astype(np.float32)


def geotiff(path: Path, heights: Any, crs: Any, *, scale: float = 1.0) -> Path:
    with quiet_rasterio(), rasterio.open(
        path, "w", driver="GTiff", width=SIZE, height=SIZE, count=1, dtype=heights.dtype, nodata=-32768,
        crs=None if crs is None else pyproj.CRS(crs).to_wkt(), tiled=True, blockxsize=128, blockysize=128,
        compress="deflate", transform=rasterio.Affine(CELL_M, 0.0, CORNER_M[0], 0.0, -CELL_M, CORNER_M[1]),
    ) as file:  # fmt: skip
        file.write(heights[None])
        file.scales = (scale,)
    return path


def line(path: Path, **properties: Any) -> Path:
    """A road 200 m to the east through the middle of the raster."""
    x = np.linspace(CORNER_M[0] + 25.0, CORNER_M[0] + 225.0, 9)
    longitude, latitude = UTM(x, np.full(9, CORNER_M[1] - 125.0), inverse=True)
    feature = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": np.column_stack((longitude, latitude)).tolist()},
        "properties": {"width_m": WIDTH_M, **properties},
    }
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return path


def build(raster: Path, roads: Path, *more: str) -> int:
    options = ("--roads", roads, "--sigma-m", "0.02", *more)
    return build_map("geotiff", raster.parent / "map", *options, raster)


def errors(folder: Path) -> tuple[Any, Any, Any]:
    """Height − truth and distance outside of the nearest surface along the middle of the road, every 0.1 m."""
    x = np.arange(CORNER_M[0] + 26.0, CORNER_M[0] + 224.0, 0.1)
    y = np.full(len(x), CORNER_M[1] - 125.0)
    longitude, latitude = np.radians(UTM(x, y, inverse=True))
    surfaces = read_release(folder).road_surfaces()
    height_m, outside_m = nearest_heights(surfaces, latitude, longitude)
    return x - CORNER_M[0], height_m - surface(x, y), outside_m


def test_a_raster_that_says_ellipsoidal_needs_no_more(tmp_path: Path) -> None:
    raster = geotiff(tmp_path / "dem.tif", cells(), KNOWN)
    assert build(raster, line(tmp_path / "road.geojson")) == 0
    _, off_m, outside_m = errors(tmp_path / "map")
    assert outside_m.max() < 0.01
    assert np.abs(off_m).max() < 0.001
    assert read_release(tmp_path / "map").road_surfaces().sigma_m == pytest.approx(0.02, abs=1e-3)


def test_a_raster_without_a_vertical_datum_is_refused_naming_the_option(
    tmp_path: Path, refused: Refused
) -> None:
    raster, roads = geotiff(tmp_path / "dem.tif", cells(), ZONE), line(tmp_path / "road.geojson")
    assert "--vertical-datum" in refused(lambda _: build(raster, roads))
    assert not (tmp_path / "map").exists()
    assert build(raster, roads, "--vertical-datum", "ellipsoidal") == 0
    assert np.abs(errors(tmp_path / "map")[1]).max() < 0.001


ELLIPSOIDAL = ("--vertical-datum", "ellipsoidal")


@pytest.mark.parametrize(
    ("crs", "options", "named"),
    [
        (f"{ZONE}+3855", (), "egm08_25"),
        (None, ELLIPSOIDAL, "CRS"),
        (f"{ZONE}+6360", ELLIPSOIDAL, "metre"),
        ("EPSG:6690", ELLIPSOIDAL, "datum"),
        ("EPSG:4978", ELLIPSOIDAL, "CRS"),
    ],
    ids=["grid missing", "no system", "feet", "another datum", "geocentric"],
)
def test_a_system_that_cannot_be_used_is_refused(
    tmp_path: Path, refused: Refused, crs: str | None, options: tuple[str, ...], named: str
) -> None:
    raster = geotiff(tmp_path / "dem.tif", cells(), crs)
    assert named in refused(lambda _: build(raster, line(tmp_path / "road.geojson"), *options))


def test_where_a_raster_has_no_data_there_is_no_surface(tmp_path: Path) -> None:
    heights = cells()
    heights[235:265, 240:260] = -32768  # 10 m along the road, all of its width
    raster = geotiff(tmp_path / "dem.tif", heights, KNOWN)
    assert build(raster, line(tmp_path / "road.geojson")) == 0
    x, off_m, outside_m = errors(tmp_path / "map")
    hole = (x > 120.5) & (x < 129.5)
    assert outside_m[hole].min() > 0.0
    assert outside_m[(x < 118.0) | (x > 132.0)].max() < 0.01
    assert np.abs(off_m[outside_m == 0.0]).max() < 0.001


def test_a_rough_raster_gives_a_larger_sigma_and_a_scaled_one_metres(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    rough = cells() + rng.normal(0.0, 0.1, (SIZE, SIZE))
    raster = geotiff(tmp_path / "dem.tif", np.round(rough * 100.0).astype(np.int32), KNOWN, scale=0.01)
    assert build(raster, line(tmp_path / "road.geojson"), "--spacing-m", "1.5") == 0
    surfaces = read_release(tmp_path / "map").road_surfaces()
    assert 0.05 < np.median(surfaces.sigma_m) < 0.15
    assert np.abs(errors(tmp_path / "map")[1]).max() < 0.5


def test_roads_of_another_level_get_nothing_from_it(tmp_path: Path, refused: Refused) -> None:
    raster = geotiff(tmp_path / "dem.tif", cells(), KNOWN)
    roads = line(tmp_path / "road.geojson", level=1)
    assert "level 0" in refused(lambda _: build(raster, roads))
    assert build(raster, roads, "--level", "1") == 0


def test_a_damaged_raster_is_one_clear_line(tmp_path: Path, refused: Refused) -> None:
    roads = line(tmp_path / "road.geojson")
    whole = geotiff(tmp_path / "dem.tif", cells(), KNOWN).read_bytes()
    broken = tmp_path / "broken.tif"
    for length in (0, 3, 100, len(whole) // 3, len(whole) // 2):
        broken.write_bytes(whole[:length])
        refused(lambda _: build(broken, roads))
    assert build(tmp_path / "none.tif", roads) == 2


def test_a_raster_of_one_height_is_refused_unless_it_is_taken_as_flat(
    tmp_path: Path, refused: Refused
) -> None:
    raster, roads = (
        geotiff(tmp_path / "dem.tif", np.zeros((SIZE, SIZE)), KNOWN),
        line(tmp_path / "road.geojson"),
    )
    assert "heights is 'level on 100 % of the roads', expected a road's" in refused(
        lambda _: build(raster, roads)
    )
    assert build(raster, roads, "--flat") == 0
    assert read_release(tmp_path / "map").road_surfaces().sigma_m == pytest.approx(10.0, abs=0.01)


def test_heights_are_compared_with_the_cells(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, refused: Refused
) -> None:
    raster, roads = geotiff(tmp_path / "dem.tif", cells(), KNOWN), line(tmp_path / "road.geojson")
    assert build(raster, roads, "--check-seed", "3") == 0
    figures = re.search(r"at (\d+) places \(seed 3\): .* most (\S+) mm", capsys.readouterr().out)
    assert figures is not None
    assert float(figures[1]) == 2000
    assert float(figures[2]) < 1.0
    true_heights = rasters.HeightRaster.heights_m
    monkeypatch.setattr(rasters.HeightRaster, "heights_m", lambda self, *at: true_heights(self, *at) + 0.07)
    (tmp_path / "map").rename(tmp_path / "first")
    assert "expected the source's within 3 σ" in refused(lambda _: build(raster, roads))


def test_a_bridge_gets_no_height_of_the_ground(tmp_path: Path, refused: Refused) -> None:
    raster = geotiff(tmp_path / "dem.tif", cells(), KNOWN)
    roads = line(tmp_path / "road.geojson", highway="primary", bridge="yes")
    assert "level 0" in refused(lambda _: build(raster, roads))
