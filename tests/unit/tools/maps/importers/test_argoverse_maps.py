"""Logs of Argoverse 2 as releases: what the map server then says of the road is what the log's raster says."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from camber.formats.errors import FormatError
from camber.formats.map_exchange.argoverse import Floats, LaneSegment, read_log
from camber.road_map.release import read_release
from camber.tools.maps.importers.argoverse import CityFrame, _nodes, centre_line
from support.built_maps import build_map, elevation_map
from support.refusals import Refused

NAMES = ("7fab2350", "3bffdcff")
WITHIN_M = 0.015
POSES_APART = 20  # of 200 in a second; all of them give the same figures to 2 mm


def elevations(folder: Path, city: str, places_m: Floats) -> Floats:
    """Of the road under places (n, 3), as map_server answers, surface after surface."""
    asked = elevation_map(read_release(folder))
    latitude, longitude = CityFrame.of_city(city).to_geodetic(places_m[:, 0], places_m[:, 1])
    result, last = np.full(len(places_m), np.nan), None
    for k, (lat, lon) in enumerate(zip(latitude.tolist(), longitude.tolist(), strict=True)):
        road = asked.road(lat, lon, last_surface_id=last)
        if road.elevation_m is not None:
            result[k], last = road.elevation_m, road.surface_id
    return result


@pytest.mark.parametrize("name", NAMES)
def test_under_each_pose_the_map_says_what_the_raster_says(data: Path, tmp_path: Path, name: str) -> None:
    folder = data / "av2" / name
    assert build_map("argoverse", tmp_path / "map", folder) == 0
    log = read_log(folder)
    places_m = log.city_from_egovehicle[::POSES_APART, :3, 3]
    height_m = elevations(tmp_path / "map", log.city, places_m)
    off_m = np.abs(height_m - log.ground.height_between(places_m))
    cell_m = np.abs(height_m - log.ground.height(places_m))
    lane_m = np.abs(log.ground.height_between(places_m) - log.ground.height(places_m))
    above_m = places_m[:, 2] - height_m
    print(f"{name}: off the raster p95 {np.percentile(off_m, 95):.4f}, its cells {np.percentile(cell_m, 95):.4f} "
          f"(raster itself {np.percentile(lane_m, 95):.4f}), origin above {above_m.mean():.4f} ± {above_m.std():.4f} "
          f"(median {np.median(above_m):.4f})")  # fmt: skip
    assert np.isfinite(height_m).all()
    assert np.percentile(off_m, 95) <= WITHIN_M
    # The raster's own steps of up to 6 cm, which a bilinear surface goes over within a cell.
    assert np.percentile(cell_m, 95) <= np.percentile(lane_m, 95) + 0.5 * WITHIN_M
    assert 0.30 <= above_m.mean() <= 0.32


def test_a_city_s_metres_are_those_of_its_zone() -> None:
    frame = CityFrame.of_city("PIT")
    x, y = np.array([0.0, 1000.0, 0.0, 5000.0]), np.array([0.0, 0.0, 1000.0, 2400.0])
    latitude, longitude = frame.to_geodetic(x, y)
    assert np.degrees([latitude[0], longitude[0]]) == pytest.approx([40.44177902989321, -80.01294377242584])
    back = np.column_stack(frame.from_geodetic(latitude, longitude))
    assert np.abs(back - np.column_stack((x, y))).max() < 1e-6


def test_with_an_origin_the_city_is_a_plane_there() -> None:
    frame = CityFrame.at(35.0, 137.0)
    latitude, longitude = frame.to_geodetic(np.array([0.0, 300.0]), np.array([0.0, -400.0]))
    assert np.degrees([latitude[0], longitude[0]]) == pytest.approx([35.0, 137.0])
    x, y = frame.from_geodetic(latitude, longitude)
    assert np.abs(np.column_stack((x, y)) - [[0.0, 0.0], [300.0, -400.0]]).max() < 1e-6


def test_a_city_whose_origin_is_not_published_is_refused() -> None:
    with pytest.raises(FormatError, match="PIT"):
        CityFrame.of_city("XYZ")


def test_a_log_whose_files_are_damaged_is_one_clear_line(
    data: Path, tmp_path: Path, refused: Refused
) -> None:
    copy = tmp_path / "log"
    shutil.copytree(data / "av2" / "3bffdcff", copy, copy_function=shutil.copyfile)
    files = ("city_SE3_egovehicle.feather", "*_ground_height_surface____PIT.npy", "*Sim2_city.json")
    for name in (*files, "log_map_*.json"):
        (path,) = copy.rglob(name)
        whole = path.read_bytes()
        for length in (5, len(whole) // 2):
            path.write_bytes(whole[:length])
            refused(lambda _: build_map("argoverse", tmp_path / "map", copy))
        path.unlink()
        refused(lambda _: build_map("argoverse", tmp_path / "map", copy))
        path.write_bytes(whole)


def lane(lane_id: int, *successors: int) -> LaneSegment:
    left = np.array([[0.0, 2.0, 5.0], [10.0, 2.0, 6.0]])
    right = np.array([[0.0, -2.0, 5.0], [4.0, -2.0, 5.0], [10.0, -2.0, 6.0]])
    return LaneSegment(lane_id=lane_id, kind="VEHICLE", left_m=left, right_m=right, successors=successors)


def test_lanes_that_follow_one_another_meet_in_a_node() -> None:
    start, end = _nodes([lane(10, 11, 12), lane(11, 99), lane(12), lane(20, 12)])
    assert end[0] == start[1] == start[2] == end[3]
    assert len({*start.tolist(), *end.tolist()}) == 5


def test_the_middle_of_a_lane_is_halfway_between_its_sides() -> None:
    line_m, half_m = centre_line(lane(1))
    assert half_m == pytest.approx(2.0, abs=0.01)
    assert np.abs(line_m[:, 1]).max() < 1e-9
    assert line_m[[0, -1], 0].tolist() == [0.0, 10.0]
