"""The height model: where road and antenna say that a position must stand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.checks.height_model import HeightModel, RoadPoint, road_at
from camber.schemas.pose import RoadPatch
from support.judging import ROAD_M, road


def patch(**changes):
    fields = {
        "reach_m": 3.0,
        "surface_id": np.array([7, 8], "<i8"),
        "east_m": np.array([0.0, 10.0]),
        "north_m": np.array([0.0, 0.0]),
        "elevation_m": np.array([40.0, 41.0]),
        "sigma_m": np.array([0.03, 0.05]),
        "slope_east": np.array([0.0, 0.1]),
        "slope_north": np.array([0.0, -0.2]),
    }
    return RoadPatch(**fields | changes)


def test_the_antenna_must_stand_on_road_and_its_height_with_the_correction():
    assert HeightModel(antenna_m=1.8, correction_m=0.0, sigma_m=0.02).expected_m(
        RoadPoint(elevation_m=40.0, sigma_m=0.03)
    ) == pytest.approx(41.8)
    assert HeightModel(antenna_m=1.8, correction_m=-0.1, sigma_m=0.02).expected_m(
        RoadPoint(elevation_m=40.0, sigma_m=0.03)
    ) == pytest.approx(41.7)


@given(error_m=st.floats(-0.3, 0.3))
def test_the_correction_learnt_from_an_error_takes_the_difference_to_zero(error_m):
    receiver_m = 41.8 + error_m
    learnt_m = receiver_m - (1.8 + 40.0)  # (4)
    assert HeightModel(antenna_m=1.8, correction_m=learnt_m, sigma_m=0.02).expected_m(
        RoadPoint(elevation_m=40.0, sigma_m=0.03)
    ) == pytest.approx(receiver_m)


def test_its_variance_is_that_of_road_and_antenna():
    assert HeightModel(antenna_m=1.8, correction_m=0.0, sigma_m=0.02).variance_m2(
        RoadPoint(elevation_m=40.0, sigma_m=0.03)
    ) == pytest.approx(0.03**2 + 0.02**2)


def test_the_road_at_an_offset_is_that_of_its_plane():
    point = road_at(road(slope_east=0.1, slope_north=-0.05), 10.0, 4.0)
    assert point == RoadPoint(
        elevation_m=pytest.approx(ROAD_M + 0.8), sigma_m=0.03, slope_east=0.1, slope_north=-0.05, surface_id=7
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"status": "unknown", "reason": "no_surface"},
        {"elevation_m": None},
        {"sigma_m": None},
        {"slope_east": None},
        {"slope_north": None},
        {"extent_m": None},
    ],
    ids=lambda changes: ",".join(changes),
)
def test_without_a_whole_plane_there_is_no_road(changes):
    assert road_at(road(**changes), 0.0, 0.0) is None


@pytest.mark.parametrize("offset", [(20.1, 0.0), (15.0, 15.0), (math.nan, 0.0), (math.inf, 0.0)])
def test_beyond_the_extent_of_the_plane_there_is_no_road(offset):
    assert road_at(road(), *offset) is None


def test_of_a_patch_plane_and_surface_of_the_nearest_sample_count():
    point = road_at(road(patch=patch()), 9.0, 1.0)
    assert point == RoadPoint(
        elevation_m=pytest.approx(41.0 - 0.1 - 0.2),
        sigma_m=0.05,
        slope_east=0.1,
        slope_north=-0.2,
        surface_id=8,
    )


@pytest.mark.parametrize("offset_m", [(9.0, 1.0), (-8.5, -11.0), (2.0, -9.5), (-1.5, 8.0), (0.5, -0.5)])
def test_of_samples_all_around_it_is_the_nearest(offset_m):
    east_m, north_m = (axis.ravel() for axis in np.meshgrid([-10.0, 0.0, 10.0], [-10.0, 0.0, 10.0]))
    slope_east, slope_north = 0.01 * np.arange(9), -0.02 * np.arange(9)
    around = patch(
        surface_id=np.arange(9),
        east_m=east_m,
        north_m=north_m,
        elevation_m=40.0 + np.arange(9),
        sigma_m=0.01 * np.arange(9),
        slope_east=slope_east,
        slope_north=slope_north,
    )
    k = min(range(9), key=lambda k: math.dist(offset_m, (east_m[k], north_m[k])))
    elevation_m = 40.0 + k + slope_east[k] * (offset_m[0] - east_m[k])
    elevation_m += slope_north[k] * (offset_m[1] - north_m[k])
    assert road_at(road(patch=around), *offset_m) == RoadPoint(
        elevation_m=pytest.approx(elevation_m),
        sigma_m=0.01 * k,
        slope_east=slope_east[k],
        slope_north=slope_north[k],
        surface_id=k,
    )


def test_a_plane_and_a_sample_reach_as_far_as_they_say():
    assert road_at(road(), 20.0, 0.0) is not None
    assert road_at(road(patch=patch()), 0.0, 3.0) is not None


@pytest.mark.parametrize("offset", [(5.0, 0.0), (0.0, 3.1), (math.nan, 0.0), (math.inf, math.inf)])
def test_out_of_reach_of_all_samples_there_is_no_road(offset):
    assert road_at(road(patch=patch()), *offset) is None


def test_an_empty_patch_is_no_road():
    empty = {name: np.empty(0, dtype) for name, dtype in [("surface_id", "<i8")]}
    columns = ("east_m", "north_m", "elevation_m", "sigma_m", "slope_east", "slope_north")
    assert road_at(road(patch=patch(**empty, **{name: np.empty(0) for name in columns})), 0.0, 0.0) is None
