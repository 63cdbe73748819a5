"""The map of a district is that of the survey day, with the errors that were asked for and no others."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from camber.map_server.elevation_queries import ElevationMap
from camber.road_map.map_error_model import MAP_ERRORS
from camber.road_map.release import Release, read_release
from camber.road_map.tile_grid import tile_frame
from camber.schemas.road import CloudTile, Layer
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats
from camber.simulator.world.district import KINDS, District, Kind, make_district
from camber.simulator.world.survey import SurveyErrors, write_survey
from camber.simulator.world.survey_surfaces import ErrorField

TIME_NS = 1_400_000_000 * 10**9
NO_OFFSET = replace(MAP_ERRORS, common_offset_sigma_m=0.0)
EXACT = SurveyErrors(height_sigma_m=1e-9, height_errors=NO_OFFSET, clouds=False)


@lru_cache
def district(kind: Kind) -> District:
    return make_district(kind, 4, heading_rad=0.6, changed_roads={1: 0.2})


def elevation_errors(release: Release, made: District, name: str) -> Floats:
    """The map's elevation less the survey day's road, along a route, asked for by link and last surface."""
    roads = ElevationMap(release.surface_tile, release.link_tile, datum="WGS84", map_version=1)
    path = made.path(name, "survey")
    every = slice(0, None, 37)
    plane = np.column_stack((path.east_m, path.north_m))[every]
    latitude, longitude, _ = made.frame.geodetic_from_east_north_array(plane, np.zeros(len(plane)))
    errors, last = [], None
    for lat, lon, up, link in zip(latitude, longitude, path.up_m[every], path.link_id[every], strict=True):
        road = roads.road(float(lat), float(lon), [int(link)], last)
        assert road.status == "known", (road.reason, link)
        assert road.elevation_m is not None
        last = road.surface_id
        errors.append(road.elevation_m - float(up))
    return np.array(errors)


@pytest.mark.parametrize("kind", KINDS)
def test_without_errors_the_map_has_the_road_of_the_survey_day_on_every_level(
    kind: Kind, tmp_path: Path
) -> None:
    # σ of a nanometre would let no two surfaces agree that are bilinear over four metres: ask with the usual one.
    made = district(kind)
    write_survey(
        tmp_path, made, TIME_NS, SurveyErrors(height_sigma_m=0.004, height_errors=NO_OFFSET, clouds=False)
    )
    release = read_release(tmp_path)
    for name in sorted(made.layout.routes):
        if name != "default" or kind != "tunnel":
            errors = elevation_errors(release, made, name)
            assert np.abs(errors).max() < 0.04, name
            assert errors.std() < 0.008, name


def test_heights_err_by_as_much_as_was_asked_for_and_are_correlated(tmp_path: Path) -> None:
    made = district("city")
    errors = SurveyErrors(clouds=False, height_errors=NO_OFFSET)
    write_survey(tmp_path / "without", made, TIME_NS, errors)
    errors_m = elevation_errors(read_release(tmp_path / "without"), made, "all")
    assert (
        0.5 * 0.03 < np.sqrt(np.mean(errors_m**2)) < 1.6 * 0.03
    )  # a district has some ten independent stretches
    write_survey(tmp_path / "with", made, TIME_NS, replace(errors, height_errors=MAP_ERRORS))
    offset_m = elevation_errors(read_release(tmp_path / "with"), made, "all") - errors_m
    assert np.ptp(offset_m) < 0.001
    assert offset_m[0] == pytest.approx(
        MAP_ERRORS.common_offset(stream(made.seed, "survey offset")), abs=0.001
    )
    neighbours = np.corrcoef(errors_m[:-1], errors_m[1:])[0, 1]  # 3.7 m apart
    assert neighbours > 0.9


def test_the_error_field_has_its_sigma_and_correlation() -> None:
    rng = np.random.default_rng(0)
    fields = [ErrorField(0.03, MAP_ERRORS, stream(seed, "field")) for seed in range(60)]
    place = rng.uniform(-500.0, 500.0, (300, 2))
    here = np.stack([field.at(place[:, 0], place[:, 1]) for field in fields])
    assert here.std() == pytest.approx(0.03, rel=0.03)
    for away in (5.0, 20.0, 60.0, 200.0):
        there = np.stack([field.at(place[:, 0] + 0.6 * away, place[:, 1] + 0.8 * away) for field in fields])
        assert np.mean(here * there) / 0.03**2 == pytest.approx(float(MAP_ERRORS.correlation(away)), abs=0.08)


@pytest.mark.parametrize("kind", KINDS)
def test_links_are_off_but_nowhere_more_than_allowed_and_meet_at_their_nodes(
    kind: Kind, tmp_path: Path
) -> None:
    made = district(kind)
    write_survey(tmp_path, made, TIME_NS, EXACT)
    links, roads = read_release(tmp_path).road_links(), made.roads("survey")
    np.testing.assert_array_equal(links.link_id, roads.link_id)
    np.testing.assert_array_equal(links.level, roads.level)
    nodes: dict[int, list[Floats]] = {}
    furthest = []
    for row, line in enumerate(links.vertices):
        plane = made.frame.east_north_from_geodetic_array(line[:, 0], line[:, 1], np.zeros(len(line)))
        nodes.setdefault(int(links.start_node[row]), []).append(plane[0])
        nodes.setdefault(int(links.end_node[row]), []).append(plane[-1])
        fine = np.concatenate([np.linspace(a, b, 50) for a, b in itertools.pairwise(plane)])
        east, north, _ = roads.centre_line(row, np.arange(0.0, roads.length_m[row], 0.5))
        away = np.hypot(fine[:, :1] - east, fine[:, 1:] - north).min(axis=1)
        assert away.max() < 6.0 + 0.1
        furthest.append(away.max())
    assert np.median(furthest) > 2.0
    for places in nodes.values():
        assert np.ptp(np.array(places), axis=0).max() < 1e-3


def in_world(made: District, tile: CloudTile) -> Floats:
    points = tile.quanta.astype(np.float64) * tile.resolution_m
    of_tile = tile_frame(tile.x, tile.y)
    latitude, longitude, _ = of_tile.geodetic_from_east_north_array(points[:, :2], np.zeros(len(points)))
    plane = made.frame.east_north_from_geodetic_array(latitude, longitude, np.zeros(len(points)))
    return np.column_stack((plane, tile.base_height_m + points[:, 2]))


def cloud(made: District, release: Release, layer: Layer) -> Floats:
    tiles = [release.cloud_tile(layer, x, y) for x, y in release.tiles(layer)]
    return np.concatenate([in_world(made, tile) for tile in tiles if tile is not None])


def test_clouds_are_what_stands_there_on_the_survey_day(tmp_path: Path) -> None:
    made = make_district("canyon", 2, heading_rad=0.4, length_m=200.0)
    write_survey(tmp_path, made, TIME_NS, SurveyErrors(scan_spacing_m=10.0))
    release = read_release(tmp_path)
    roads = made.roads("survey")
    road, environment = (cloud(made, release, layer) for layer in ("road_cloud", "environment_cloud"))
    assert len(road) > 10_000
    up = roads.surface_m(road[:, 0], road[:, 1], np.zeros(len(road), np.int64))
    off = (road[:, 2] - up)[np.isfinite(up)]
    assert np.isfinite(up).mean() > 0.98  # some lie a centimetre beside it
    assert np.abs(np.median(off)) < 0.003
    assert np.percentile(np.abs(off), 99) < 0.02
    # Points from 12 m above the street, higher than posts and trees, to 30 m lie on the faces of buildings, to the
    # noise of the range.
    height = environment[:, 2] - roads.terrain.height_m(environment[:, 0], environment[:, 1])
    high = environment[(height > 12.0) & (height < 30.0)]
    walls = made.walls()
    away = np.full(len(high), np.inf)
    for foot, along, length, _, normal in zip(*walls, strict=True):
        step = high[:, :2] - foot[:2]
        beyond = np.maximum(np.maximum(-(step @ along), step @ along - length), 0.0)
        away = np.minimum(away, np.hypot(beyond, step @ normal))
    assert len(high) > 5_000
    assert np.percentile(away, 99) < 0.04
    assert away.max() < 0.08


def test_voxels_hold_one_point_each(tmp_path: Path) -> None:
    made = make_district("canyon", 2, length_m=120.0)
    write_survey(tmp_path, made, TIME_NS, SurveyErrors(scan_spacing_m=10.0, voxel_m=0.5))
    release = read_release(tmp_path)
    # In the world frame, in which they were thinned; points near the border of a voxel may be rounded over it.
    points = cloud(made, release, "road_cloud")
    inner = points[(np.abs(points / 0.5 - np.rint(points / 0.5)) > 0.02).all(axis=1)]
    whole = np.unique(np.rint(inner * 1000), axis=0)  # a point within 1 m of two tiles stands in both
    assert len(np.unique(np.floor(whole / 500.0), axis=0)) > 0.98 * len(whole)


def test_only_what_is_seen_from_a_route_is_scanned_where_one_is_named(tmp_path: Path) -> None:
    made = district("overpass")
    sizes = []
    for k, route in enumerate((None, "ramp")):
        write_survey(tmp_path / str(k), made, TIME_NS, SurveyErrors(scan_spacing_m=40.0), scanned_route=route)
        release = read_release(tmp_path / str(k))
        blobs = [release.blob("road_cloud", x, y) or b"" for x, y in release.tiles("road_cloud")]
        sizes.append(sum(map(len, blobs)))
    assert 0 < sizes[1] < 0.6 * sizes[0]
    with pytest.raises(KeyError):
        write_survey(tmp_path / "none", made, TIME_NS, scanned_route="nowhere")
