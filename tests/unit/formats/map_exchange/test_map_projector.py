"""Autoware's projector file: local coordinates come out where EPSG's projections have them, wrong files are refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.lanelet2 import lanelet_map
from camber.formats.map_exchange.map_projector import read_map_projector
from camber.formats.map_exchange.mgrs import utm_zone

pyproj = pytest.importorskip("pyproj")
pytest.importorskip("ruamel.yaml")

TOKYO = "map_origin:\n  latitude: 35.6762 # [deg]\n  longitude: 139.6503\n  altitude: 0.0\n"
HEIGHT_M = 1600.0
PLACES_M = np.random.default_rng(3).uniform(-20_000.0, 20_000.0, (50, 2))


def projector_file(folder: Path, text: str) -> Path:
    path = folder / "map_projector_info.yaml"
    path.write_text(text)
    return path


def places_deg(folder: Path, text: str) -> np.ndarray:
    projector = read_map_projector(projector_file(folder, text))
    return np.degrees([projector.geodetic(*place, HEIGHT_M) for place in PLACES_M.tolist()])


def test_utm_about_an_origin_is_that_of_epsg(tmp_path: Path) -> None:
    places = places_deg(tmp_path, f"projector_type: LocalCartesianUTM\nvertical_datum: WGS84\n{TOKYO}")
    zone_54 = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32654")
    x_m, y_m = np.array(zone_54.transform(*places.T)) - np.array([zone_54.transform(35.6762, 139.6503)]).T
    np.testing.assert_allclose(np.column_stack((x_m, y_m)), PLACES_M, atol=1e-5)


def test_mgrs_is_utm_from_the_corner_of_its_square(tmp_path: Path) -> None:
    projector = read_map_projector(
        projector_file(tmp_path, "projector_type: MGRS\nvertical_datum: WGS84\nmgrs_grid: 54SUE\n")
    )
    latitude, longitude = np.degrees(projector.geodetic(81_655.0, 50_137.0, HEIGHT_M))
    x_m, y_m = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:32654").transform(latitude, longitude)
    assert (x_m % 1e5, y_m % 1e5) == pytest.approx((81_655.0, 50_137.0), abs=1e-5)


@pytest.mark.parametrize(("line", "scale"), [("", 0.9996), ("scale_factor: 1.0\n", 1.0)])
def test_transverse_mercator_has_its_meridian_at_the_origin(line: str, scale: float, tmp_path: Path) -> None:
    places = places_deg(tmp_path, f"projector_type: TransverseMercator\n{line}{TOKYO}")
    peer = pyproj.Transformer.from_crs(
        "EPSG:4326", f"+proj=tmerc +lat_0=35.6762 +lon_0=139.6503 +k={scale} +datum=WGS84"
    )
    np.testing.assert_allclose(np.column_stack(peer.transform(*places.T)), PLACES_M, atol=1e-5)


def test_local_cartesian_is_east_and_north_of_the_tangent_plane(tmp_path: Path) -> None:
    places = places_deg(tmp_path, f"projector_type: LocalCartesian\n{TOKYO}")
    peer = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        "+step +proj=topocentric +ellps=WGS84 +lat_0=35.6762 +lon_0=139.6503 +h_0=0"
    )
    latitude_deg, longitude_deg = places.T
    east_m, north_m, _ = peer.transform(longitude_deg, latitude_deg, np.full(len(places), HEIGHT_M))
    np.testing.assert_allclose(np.column_stack((east_m, north_m)), PLACES_M, atol=1e-4)


@pytest.mark.parametrize(
    ("place_deg", "zone"),
    [
        ((35.7, 139.7), 54),
        ((60.4, 5.3), 32),
        ((78.2, 15.6), 33),
        ((74.5, 19.0), 33),
        ((-34.6, -58.4), 21),
        ((0.0, 180.0), 1),
    ],
)
def test_zones_of_norway_and_svalbard_are_wider(place_deg: tuple[float, float], zone: int) -> None:
    assert utm_zone(*place_deg) == zone


@pytest.mark.parametrize(("stated", "vertical"), [("EGM2008", "EPSG:3855"), ("WGS84", None)])
def test_heights_are_settled_by_egm2008_alone(stated: str, vertical: str | None, tmp_path: Path) -> None:
    text = f"projector_type: MGRS\nvertical_datum: {stated}\nmgrs_grid: 54SUE\n"
    assert read_map_projector(projector_file(tmp_path, text)).vertical == vertical


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("", "YAML"),
        ("- a\n- b\n", "YAML"),
        ("projector_type: [\n", "YAML"),
        ("a: &a [*a, *a]\n", "projector_type"),
        ("projector_type: 3\n", "projector_type"),
        ("projector_type: Mercator\n", "projector_type"),
        ("projector_type: MGRS\nvertical_datum: NAVD88\nmgrs_grid: 54SUE\n", "vertical_datum"),
        ("projector_type: MGRS\nmgrs_grid: 99XXX\n", "mgrs_grid"),
        ("projector_type: LocalCartesianUTM\n", "map_origin"),
        ("projector_type: LocalCartesian\nmap_origin: {latitude: true, longitude: 3}\n", "latitude"),
        ("projector_type: LocalCartesian\nmap_origin: {latitude: .nan, longitude: 3}\n", "latitude"),
        (f"projector_type: TransverseMercator\nscale_factor: 0\n{TOKYO}", "scale_factor"),
        ("#" * 70_000, "size"),
        ("projector_type: !!int ''\n", "YAML"),
        ("projector_type: !!bool x\n", "YAML"),
        (
            f"projector_type: LocalCartesian\nmap_origin: {{latitude: 1{'0' * 400}, longitude: 3}}\n",
            "latitude",
        ),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(text: str, field: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError) as refused:
        read_map_projector(projector_file(tmp_path, text))
    assert refused.value.field == field
    assert "\n" not in str(refused.value)


def node(number: int, x_m: float, y_m: float) -> str:
    tags = "".join(
        f'<tag k="{key}" v="{value}"/>' for key, value in (("local_x", x_m), ("local_y", y_m), ("ele", 3.0))
    )
    return f'<node id="{number}" lat="" lon="">{tags}</node>'


LOCAL_MAP = (
    "<osm>" + node(1, 0.0, 3.0) + node(2, 30.0, 3.0) + node(3, 0.0, 0.0) + node(4, 30.0, 0.0)
    + '<way id="5"><nd ref="1"/><nd ref="2"/></way><way id="6"><nd ref="3"/><nd ref="4"/></way>'
    '<relation id="7"><member type="way" ref="5" role="left"/><member type="way" ref="6" role="right"/>'
    '<tag k="type" v="lanelet"/></relation></osm>'
).encode()  # fmt: skip


def test_a_map_of_local_coordinates_lies_where_its_projector_says(tmp_path: Path) -> None:
    projector = read_map_projector(projector_file(tmp_path, f"projector_type: LocalCartesianUTM\n{TOKYO}"))
    restored = lanelet_map(LOCAL_MAP, "a.osm", projector=projector)
    row = restored.row_of[3]
    assert math.degrees(restored.latitude_rad[row]) == pytest.approx(35.6762, abs=1e-9)
    assert math.degrees(restored.longitude_rad[row]) == pytest.approx(139.6503, abs=1e-9)


def test_a_map_of_local_coordinates_alone_names_what_is_missing() -> None:
    with pytest.raises(
        FormatError, match=r"a\.osm: node [13] is 'local_x and local_y alone', .*map_projector_info"
    ):
        lanelet_map(LOCAL_MAP, "a.osm")


def test_a_local_projector_has_no_place(tmp_path: Path) -> None:
    projector = read_map_projector(projector_file(tmp_path, "projector_type: Local\n"))
    with pytest.raises(
        FormatError, match="projector_type is 'Local', expected one that has a place on the earth"
    ):
        lanelet_map(LOCAL_MAP, "a.osm", projector=projector)
