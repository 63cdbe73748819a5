"""Elevations from a map folder: the road where there is one, and the reason where there is none."""

import math

import numpy as np
import pytest

import camber
from camber.road_map.release import ReleaseError
from support import small_map


@pytest.fixture
def road_map(tmp_path):
    rising = np.array([[50.0, 50.0], [50.2, 50.2]])
    rows = [
        small_map.surface(7, heights_m=rising),
        small_map.surface(8, 0.0, 100.0, link_id=2),
        small_map.surface(9, 0.0, 100.0, link_id=3, level=1, heights_m=56.0),
    ]
    small_map.write(tmp_path / "map", rows)
    return camber.Map(tmp_path / "map")


def test_known_ambiguous_and_missing_roads_have_their_reasons(road_map):
    places = np.array([small_map.at(0.0, north_m) for north_m in (0.0, 100.0, 50.0)])
    roads = road_map.elevations(places[:, 0], places[:, 1])
    assert roads["reason"].tolist() == ["none", "levels_ambiguous", "no_surface"]
    assert roads["elevation_m"][0] == pytest.approx(50.1)
    assert roads["slope_east"][0] == pytest.approx(0.01)
    assert roads["surface_id"].tolist() == [7, -1, -1]
    assert np.isnan(roads["sigma_m"]).tolist() == [False, True, True]
    assert road_map.datum == "WGS84"


def test_one_point_may_be_two_numbers(road_map):
    latitude_rad, longitude_rad = small_map.at(5.0, 0.0)
    assert road_map.elevations(latitude_rad, longitude_rad)["elevation_m"] == pytest.approx([50.15])


def test_arrays_of_different_lengths_are_refused(road_map):
    with pytest.raises(ValueError, match="longitude"):
        road_map.elevations([0.6, 0.6], [2.3])


def test_a_folder_without_a_map_is_named(tmp_path):
    with pytest.raises(ReleaseError, match="nothing"):
        camber.Map(tmp_path / "nothing")


def test_a_place_that_is_no_number_has_no_road(road_map):
    assert road_map.elevations(math.nan, math.nan)["reason"].tolist() == ["no_surface"]
