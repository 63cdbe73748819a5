"""`camber map build opendrive`: levels, topology and heights of a made-up town are those of its formulas."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.formats.map_exchange.opendrive import OpenDrive, OpenDriveRoad
from camber.formats.map_exchange.opendrive_geometry import cubics_at, reference_line
from camber.road_map.release import Release, read_release
from camber.tools.maps.importers.lanes import named_id
from support import opendrive_maps
from support.built_maps import build_map, known_roads, link_ends, link_levels
from support.opendrive_maps import cubics, opendrive_bytes, town
from support.refusals import Refused

pyproj = pytest.importorskip("pyproj")

Floats = NDArray[np.float64]


def build(folder: Path, drive: OpenDrive, *options: str) -> int:
    (folder / "town.xodr").write_bytes(opendrive_bytes(drive))
    return build_map("opendrive", folder / "map", folder / "town.xodr", "--sigma-m", "0.02", *options)


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    folder = tmp_path_factory.mktemp("town")
    assert build(folder, town(), "--vertical-datum", "ellipsoidal") == 0
    return read_release(folder / "map")


def link(road: str, section: int, lane: int) -> int:
    return named_id("link", f"road {road}, section {section}, lane {lane}")


def off_m(
    release: Release,
    road: OpenDriveRoad,
    section: int,
    lane: int,
    s: Floats,
    t: Floats,
    *,
    above_m: float = 0.0,
) -> float:
    """How far elevations of the release are at most from the formulas, at points (s, t) of a road."""
    line, roll = reference_line(road, s), cubics_at(road.superelevation, s)
    x = line[:, 0] - np.sin(line[:, 2]) * t * np.cos(roll)
    y = line[:, 1] + np.cos(line[:, 2]) * t * np.cos(roll)
    expected = cubics_at(road.elevation, s) + t * np.sin(roll) + above_m
    longitude, latitude = pyproj.Proj(proj="utm", zone=32, datum="WGS84")(x, y, inverse=True)
    on_lane = link(road.identity, section, lane)
    result = known_roads(release, np.radians(latitude), np.radians(longitude), on_lane)
    return float(np.abs(result.elevation_m - expected).max())


def test_elevations_are_those_of_the_formulas_within_a_millimetre(release: Release) -> None:
    rng = np.random.default_rng(11)
    street, bridge, ramp, turn = town().roads
    for road, section, lane, begin, end, low, high in (
        (street, 0, -1, 0.0, 150.0, -3.5, 0.0),
        (street, 0, 1, 0.0, 150.0, 0.0, 3.5),
        (street, 1, -2, 150.0, 270.0, -6.5, -3.5),
        (bridge, 0, 1, 0.0, 120.0, 0.0, 3.5),
        (ramp, 0, -1, 0.0, 81.2, -3.5, 0.0),
        (turn, 0, -1, 0.0, 25.0, -3.5, 0.0),
    ):
        s, t = np.sort(rng.uniform(begin, end, 300)), rng.uniform(low, high, 300)
        assert off_m(release, road, section, lane, s, t) < 1e-3, road.identity


def test_the_bridge_is_on_a_level_above_the_street(release: Release) -> None:
    bridge = {link("2", 0, 1), link("2", 0, -1)}
    levels = link_levels(release)
    assert levels == {lane: int(lane in bridge) for lane in levels}
    assert bridge <= set(levels)


def test_lanes_that_go_on_to_one_another_share_a_node(release: Release) -> None:
    ends = link_ends(release)
    # To the right of the reference line traffic goes along it, to the left against it.
    assert ends[link("1", 0, -1)][1] == ends[link("1", 1, -1)][0]
    assert ends[link("1", 0, 1)][0] == ends[link("1", 1, 1)][1]
    assert ends[link("2", 0, -1)][1] == ends[link("3", 0, -1)][0]
    assert ends[link("1", 1, -1)][1] == ends[link("4", 0, -1)][0]
    assert len(ends) == 10
    assert len({node for pair in ends.values() for node in pair}) == 2 * 10 - 5


def test_traffic_on_the_left_turns_the_links(release: Release, tmp_path: Path) -> None:
    drive = town()
    left = [dataclasses.replace(road, left_hand_traffic=True) for road in drive.roads]
    assert build(tmp_path, dataclasses.replace(drive, roads=left), "--vertical-datum", "ellipsoidal") == 0
    lines = []
    for each in (release, read_release(tmp_path / "map")):
        links = each.road_links()
        lines.append(links.vertices[links.link_id.tolist().index(link("2", 0, -1))])
    np.testing.assert_allclose(lines[0], lines[1][::-1], atol=1e-10)


@pytest.mark.parametrize(
    ("georeference", "options", "output"),
    [
        (None, ("--vertical-datum", "ellipsoidal"), "header, geoReference is 'none', expected a projection"),
        ("+proj=utm +zone=32 +datum=WGS84", (), "vertical datum is 'not stated'"),
        ("+lat_0=48.1 +lon_0=11.6", ("--vertical-datum", "ellipsoidal"), "or --georeference with one ('+proj=tmerc"),
        ("+proj=utm +zone=32 +vunits=us-ft", ("--vertical-datum", "ellipsoidal"), "vunits is 'us-ft', expected m"),
        ("+proj=nonsense", ("--vertical-datum", "ellipsoidal"), "header, geoReference is '+proj=nonsense'"),
        ("EPSG:4326", ("--vertical-datum", "ellipsoidal"), "geoReference is 'EPSG:4326', expected a projection in"),
        ("EPSG:25832", ("--vertical-datum", "ellipsoidal"), "geoReference, datum is 'ETRS89', expected WGS84"),
        ("EPSG:25832+7837", (), "geoReference, datum is 'ETRS89', expected WGS84"),
        ("+proj=utm +zone=32 +datum=WGS84 +geoidgrids=egm96_15.gtx +vunits=m", (), "the grid us_nga_egm96_15.tif"),
        (
            "+proj=utm +zone=32 +datum=WGS84 +geoidgrids=egm96_15.gtx +vunits=m",
            ("--vertical-datum", "ellipsoidal"),
            "vertical datum is 'ellipsoidal', expected EPSG:5773, as the file says",
        ),
    ],
)  # fmt: skip
def test_a_place_or_height_that_is_not_known_is_refused_in_one_line(
    georeference: str | None, options: tuple[str, ...], output: str, tmp_path: Path, refused: Refused
) -> None:
    drive = dataclasses.replace(town(), georeference=georeference)
    line = refused(lambda _: build(tmp_path, drive, *options))
    assert line.startswith(f"camber map build opendrive: {tmp_path / 'town.xodr'}: ")
    assert output in line


@pytest.mark.parametrize("rows", [0, 1], ids=["no elevation", "an elevation from 20 m on"])
def test_a_road_that_nobody_measured_is_refused(
    rows: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = town()
    bare = dataclasses.replace(drive.roads[1], elevation=cubics((20.0, 525.0, 0.0, 0.0, 0.0))[:rows])
    flat = dataclasses.replace(drive, roads=[drive.roads[0], bare])
    assert build(tmp_path, flat, "--vertical-datum", "ellipsoidal") == 2
    expected = "road 2, elevationProfile, expected an elevation from the road's begin on"
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    "text",
    [
        "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9996 +x_0=500000 +y_0=0 +datum=WGS84 +units=m +vunits=m +no_defs",
        "  +proj=tmerc +lat_0=0.0000000e+0 +lon_0=9.0e+0 +k_0=0.9996 +x_0=5e5 +ellps=WGS84 +towgs84=0,0,0 +type=crs\n",
        "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9996 +x_0=500000 +y_0=0 +datum=WGS84 +geoidgrids=@null +vunits=m",
    ],
)
def test_a_transverse_mercator_projection_with_its_origin_is_read(text: str, tmp_path: Path) -> None:
    assert (
        build(tmp_path, dataclasses.replace(town(), georeference=text), "--vertical-datum", "ellipsoidal")
        == 0
    )
    latitude = read_release(tmp_path / "map").road_surfaces().latitude_rad
    assert math.degrees(float(latitude.mean())) == pytest.approx(48.13, abs=0.01)


def test_shoulders_are_as_high_above_the_road_as_the_lane_says(tmp_path: Path) -> None:
    drive = town()
    street = drive.roads[0]
    raised = dataclasses.replace(
        opendrive_maps.lane(-2, 2.0), kind="shoulder", heights=np.array([(0.0, 0.152, 0.152)])
    )
    lanes = dataclasses.replace(street.sections[0], lanes=[*street.sections[0].lanes, raised])
    street = dataclasses.replace(street, sections=[lanes, *street.sections[1:]])
    drive = dataclasses.replace(drive, roads=[street, *drive.roads[1:]])
    assert build(tmp_path, drive, "--vertical-datum", "ellipsoidal") == 0
    s = np.linspace(1.0, 149.0, 200)
    release = read_release(tmp_path / "map")
    assert off_m(release, street, 0, -2, s, np.full(200, -4.5), above_m=0.152) < 1e-3
    assert off_m(release, street, 0, -1, s, np.full(200, -3.0)) < 1e-3


def test_the_projection_may_be_named_where_the_file_does_not(tmp_path: Path) -> None:
    named = ("--georeference", "EPSG:32632", "--vertical-datum", "ellipsoidal")
    assert build(tmp_path, dataclasses.replace(town(), georeference=None), *named) == 0
    latitude = read_release(tmp_path / "map").road_surfaces().latitude_rad
    assert math.degrees(float(latitude.mean())) == pytest.approx(48.13, abs=0.01)
