"""The height of the road below, against roads of closed form; roads above one another are never mixed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from camber.localizer.road.road_planes import CELL_M, OUTWARDS_M
from camber.localizer.road.road_raster import RoadHeights

Floats = NDArray[np.float64]
Height = Callable[[Floats, Floats], Floats]
PER_SQUARE_METRE = 20


def strip(
    height: Height, *, along_east: bool, half_length_m: float = 60.0, half_width_m: float = 4.0, seed: int = 1
) -> Floats:
    """Points of a straight road through the origin, with the range noise of a survey."""
    rng = np.random.default_rng(seed)
    n = int(4.0 * half_length_m * half_width_m * PER_SQUARE_METRE)
    along, across = rng.uniform(-half_length_m, half_length_m, n), rng.uniform(-half_width_m, half_width_m, n)
    east, north = (along, across) if along_east else (across, along)
    return np.column_stack((east, north, height(east, north) + 0.01 * rng.standard_normal(n)))


def low(east: Floats, north: Floats) -> Floats:
    return 0.02 * east + 0.02 * north


def high(east: Floats, north: Floats) -> Floats:
    return 6.0 - 0.03 * north + 0.0 * east


@pytest.fixture(scope="module")
def crossing() -> RoadHeights:
    return RoadHeights.of(np.vstack((strip(low, along_east=True), strip(high, along_east=False, seed=2))))


@settings(derandomize=True, max_examples=15, deadline=None)
@given(
    east=st.floats(-0.12, 0.12),
    north=st.floats(-0.12, 0.12),
    bend=st.floats(-0.002, 0.002),
    seed=st.integers(0, 99),
)
def test_height_and_slope_are_those_of_the_road(east: float, north: float, bend: float, seed: int) -> None:
    def height(e: Floats, n: Floats) -> Floats:
        return 40.0 + east * e + north * n + bend * e * e

    roads = RoadHeights.of(strip(height, along_east=True, half_length_m=20.0, seed=seed))
    for e, n in np.random.default_rng(seed).uniform((-17.0, -3.0), (17.0, 3.0), (20, 2)).tolist():
        truth = 40.0 + east * e + north * n + bend * e * e
        result = roads.elevation(e, n, truth + 1.0)
        assert result.height_m == pytest.approx(truth, abs=0.012)
        assert result.slope_east == pytest.approx(east + 2.0 * bend * e, abs=0.015)
        assert result.slope_north == pytest.approx(north, abs=0.015)
        assert abs(result.height_m - truth) < 4.0 * result.sigma_m
        assert result.distance_m < CELL_M


def test_where_roads_cross_each_keeps_its_height(crossing: RoadHeights) -> None:
    for e, n in np.random.default_rng(3).uniform(-3.5, 3.5, (50, 2)).tolist():
        here = np.array(e), np.array(n)
        lower, upper = (crossing.elevation(e, n, near) for near in (1.0, 5.0))
        assert lower.height_m == pytest.approx(float(low(*here)), abs=0.012)
        assert upper.height_m == pytest.approx(float(high(*here)), abs=0.012)
        assert (lower.slope_east, lower.slope_north) == pytest.approx((0.02, 0.02), abs=0.01)
        assert (upper.slope_east, upper.slope_north) == pytest.approx((0.0, -0.03), abs=0.01)


@settings(derandomize=True, max_examples=100, deadline=None)
@given(east=st.floats(-80.0, 80.0), north=st.floats(-80.0, 80.0), near=st.floats(-3.0, 9.0))
def test_no_height_lies_between_two_roads(
    crossing: RoadHeights, east: float, north: float, near: float
) -> None:
    result = crossing.elevation(east, north, near)
    if result is not None:
        # Below: from −60 to 60 m by 2 %, and across; above: by 3 %.
        assert -1.4 <= result.height_m <= 1.4 or 4.1 <= result.height_m <= 7.9


@pytest.mark.parametrize(
    ("height", "place", "reach_m"),
    [(low, (-50.0, 0.0, -1.0), (55.0, 3.5)), (high, (0.0, 40.0, 4.8), (3.5, 55.0))],
)
def test_every_point_is_above_the_road_driven_on(
    crossing: RoadHeights, height: Height, place: tuple[float, float, float], reach_m: tuple[float, float]
) -> None:
    east_m, north_m = reach_m
    points = np.random.default_rng(4).uniform((-east_m, -north_m, -1.0), (east_m, north_m, 9.0), (500, 3))
    truth = points[:, 2] - height(points[:, 0], points[:, 1])
    np.testing.assert_allclose(crossing.surface_through(*place).height_above(points), truth, atol=0.02)


def test_a_ramp_leads_from_one_road_to_the_other_and_stays_apart_where_it_joins() -> None:
    """A ramp of 10 % leaves beside a level road, with a wall between them that grows to 4 m."""

    def ramp(east: Floats, north: Floats) -> Floats:
        return np.maximum(0.1 * east, 0.0) + 0.0 * north

    level = strip(lambda e, n: 0.0 * e, along_east=True, half_length_m=40.0, half_width_m=3.0)
    outside = strip(ramp, along_east=True, half_length_m=40.0, half_width_m=1.5, seed=2)
    outside[:, 1] += 4.5
    roads = RoadHeights.of(np.concatenate((level, outside)))
    for east in (-20.0, 5.0, 12.0, 25.0, 38.0):
        result = roads.elevation(east, 0.0, 0.2)
        up = roads.elevation(east, 4.5, max(0.1 * east, 0.0))
        assert result.height_m == pytest.approx(0.0, abs=0.02)
        assert up.height_m == pytest.approx(max(0.1 * east, 0.0), abs=0.03)
    # At the wall itself each keeps its own height to within the fit of the last cell.
    inside, outer = roads.elevation(35.0, 2.8, 0.0), roads.elevation(35.0, 3.3, 3.5)
    assert (inside.height_m, outer.height_m) == (pytest.approx(0.0, abs=0.05), pytest.approx(3.5, abs=0.1))
    # Driven onto, the ramp is what continues.
    surface = roads.surface_through(-30.0, 4.5, 0.0)
    np.testing.assert_allclose(surface.height_above(np.array([[35.0, 5.0, 5.0]])), 1.5, atol=0.1)


def test_a_gap_in_the_cloud_is_bridged() -> None:
    road = strip(lambda e, n: 0.05 * e, along_east=True)
    road = road[(road[:, 0] < 5.0) | (road[:, 0] > 12.0)]
    surface = RoadHeights.of(road).surface_through(-50.0, 0.0, -2.5)
    points = np.array([[-40.0, 0.0, 0.0], [50.0, 1.0, 0.0]])
    np.testing.assert_allclose(surface.height_above(points), -0.05 * points[:, 0], atol=0.02)


def test_off_the_road_its_height_is_continued_level_with_a_growing_sigma() -> None:
    roads = RoadHeights.of(strip(lambda e, n: 0.02 * n, along_east=True))
    at = [roads.elevation(0.0, north, 0.0) for north in (0.0, 10.0, 20.0, 30.0)]
    assert all(result is not None for result in at)
    heights = [result.height_m for result in at if result is not None]
    sigmas = [result.sigma_m for result in at if result is not None]
    assert heights[1:] == pytest.approx([0.1, 0.1, 0.1], abs=0.03)
    assert sigmas == sorted(sigmas)
    assert sigmas[2] > 0.3


def test_beyond_the_reach_nothing_is_known() -> None:
    roads = RoadHeights.of(strip(low, along_east=True))
    for east, north in ((0.0, OUTWARDS_M + 6.0), (500.0, 0.0), (0.0, -500.0)):
        assert roads.elevation(east, north, 0.0) is None
        assert roads.surface_through(east, north, 0.0) is None
        points = np.array([[east, north, 1.0]])
        assert np.isnan(roads.height_above_road(points)).all()
        assert not roads.within(points, -100.0, 100.0).any()


def test_without_a_road_nothing_is_known() -> None:
    roads = RoadHeights.of(np.zeros((0, 3)))
    assert roads.elevation(0.0, 0.0, 0.0) is None
    assert roads.surface_through(0.0, 0.0, 0.0) is None
    assert np.isnan(roads.height_above_road(np.zeros((3, 3)))).all()


def test_a_height_far_from_every_road_starts_no_surface(crossing: RoadHeights) -> None:
    assert crossing.surface_through(0.0, 0.0, 3.0) is None


def test_height_above_the_road_below(crossing: RoadHeights) -> None:
    points = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, 5.8], [0.0, 0.0, 8.0], [0.0, 0.0, -0.5]])
    np.testing.assert_allclose(crossing.height_above_road(points), [3.0, -0.2, 2.0, -0.5], atol=0.02)


def test_a_layer_is_above_any_of_the_roads(crossing: RoadHeights) -> None:
    points = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 6.5], [0.0, 0.0, 3.5], [50.0, 0.0, 6.5]])
    assert crossing.within(points, 0.2, 1.0).tolist() == [True, True, False, False]


def test_a_surface_is_built_once_while_the_vehicle_is_on_it() -> None:
    roads = RoadHeights.of(strip(low, along_east=True))
    first = roads.surface_through(-20.0, 0.0, -0.4)
    assert roads.surface_through(20.0, 1.0, 0.4) is first
