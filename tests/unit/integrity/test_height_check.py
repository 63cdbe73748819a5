"""The determination: a position stands on road and antenna within the tolerance, or it does not."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.height_check import RoadPoint, determine, height_difference_m, road_at
from camber.schemas.pose import RoadPatch
from support.judging import ROAD_M, road

metres = st.floats(-50.0, 50.0)


def check(receiver_m, *, road_m=40.0, antenna_m=1.8, correction_m=0.0, tolerance_m=0.2):
    return determine(RoadPoint(road_m, 0.03), antenna_m, 0.02, correction_m, receiver_m, 0.01, tolerance_m)


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


def test_an_antenna_at_its_height_above_the_road_agrees():
    outcome = check(41.8)
    assert outcome.agrees
    assert outcome.difference_m == pytest.approx(0.0)
    assert outcome.tolerance_m == 0.2


@pytest.mark.parametrize(
    ("receiver_m", "agrees"), [(41.99, True), (42.01, False), (41.61, True), (41.59, False)]
)
def test_the_tolerance_holds_upwards_and_downwards(receiver_m, agrees):
    assert check(receiver_m).agrees is agrees


def test_the_difference_counts_from_the_receiver_up_to_the_road_model():
    assert height_difference_m(40.0, 1.8, 0.0, 41.3) == pytest.approx(0.5)


@given(error_m=st.floats(-0.3, 0.3))
def test_the_correction_learnt_from_an_error_takes_the_difference_to_zero(error_m):
    learnt_m = (41.8 + error_m) - (1.8 + 40.0)  # (4)
    assert height_difference_m(40.0, 1.8, learnt_m, 41.8 + error_m) == pytest.approx(0.0, abs=1e-9)


@given(near_m=metres, farther_m=st.floats(0.0, 50.0))
def test_a_larger_difference_is_never_trusted_more(near_m, farther_m):
    far_m = near_m + math.copysign(farther_m, near_m)
    assert check(41.8 + near_m).agrees or not check(41.8 + far_m).agrees


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["receiver_m", "road_m", "antenna_m", "correction_m"])
def test_what_is_not_a_number_disagrees(name, value):
    assert not check(**{"receiver_m": 41.8, name: value}).agrees


def test_the_sigma_is_that_of_all_three():
    assert check(41.8).sigma_m == pytest.approx(math.sqrt(0.03**2 + 0.02**2 + 0.01**2))


def test_the_road_at_an_offset_is_that_of_its_plane():
    point = road_at(road(slope_east=0.1, slope_north=-0.05), 10.0, 4.0)
    assert point == RoadPoint(pytest.approx(ROAD_M + 0.8), 0.03, 0.1, -0.05, 7)


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


def test_of_a_patch_the_nearest_sample_speaks_with_its_own_plane_and_surface():
    point = road_at(road(patch=patch()), 9.0, 1.0)
    assert point == RoadPoint(pytest.approx(41.0 - 0.1 - 0.2), 0.05, 0.1, -0.2, 8)


@pytest.mark.parametrize("offset", [(5.0, 0.0), (0.0, 3.1), (math.nan, 0.0), (math.inf, math.inf)])
def test_out_of_reach_of_all_samples_there_is_no_road(offset):
    assert road_at(road(patch=patch()), *offset) is None


def test_an_empty_patch_is_no_road():
    empty = {name: np.empty(0, dtype) for name, dtype in [("surface_id", "<i8")]}
    columns = ("east_m", "north_m", "elevation_m", "sigma_m", "slope_east", "slope_north")
    assert road_at(road(patch=patch(**empty, **{name: np.empty(0) for name in columns})), 0.0, 0.0) is None
