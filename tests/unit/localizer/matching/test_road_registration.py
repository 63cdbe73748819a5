"""Height, roll and pitch by the road."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.localizer.matching.registration import LayerTarget
from camber.localizer.matching.road_registration import fit_road
from support.plain_layers import MAP_DENSITY, pose, road, seen_from

Floats = NDArray[np.float64]


def on_a_slope(points_m: Floats, east: float, north: float) -> Floats:
    return points_m + np.outer(points_m[:, 0] * east + points_m[:, 1] * north, [0.0, 0.0, 1.0])


SLOPE = (0.10, -0.02)
ROAD = LayerTarget.of(on_a_slope(road(MAP_DENSITY, 1, 20.0), *SLOPE))
# On the slope with x uphill: nose up is negative pitch.
UPHILL_RAD = math.atan(0.10)
ROLL_DEG = math.degrees(math.atan(-0.02 * math.cos(UPHILL_RAD)))
TRUTH = pose(0.0, 0.0, 0.0, 0.0, ROLL_DEG, -math.degrees(UPHILL_RAD))
SEEN = seen_from(TRUTH, on_a_slope(road(8.0, 2, 10.0), *SLOPE))
HEIGHTS = np.zeros(len(SEEN))


def test_kerbs_and_tyres_do_not_lift_the_road() -> None:
    raised = SEEN.copy()
    raised[::4, 2] += 0.2
    fit = fit_road(raised, HEIGHTS, ROAD, TRUTH)
    assert fit.status == "converged"
    assert abs(fit.map_from_local[2, 3]) < 0.015


def test_a_narrow_strip_of_road_leaves_the_roll_open() -> None:
    strip = SEEN[np.abs(SEEN[:, 1]) < 0.05]
    fit = fit_road(strip, np.zeros(len(strip)), ROAD, TRUTH)
    assert fit.status in ("ambiguous", "lost")
    assert fit.covariance[1, 1] > 0.01**2


@pytest.mark.parametrize("heights", [np.full(len(SEEN), 1.0), HEIGHTS])
def test_without_ground_or_without_a_road_it_is_lost(heights: Floats) -> None:
    target = ROAD if heights[0] else LayerTarget.of(np.empty((0, 3)))
    fit = fit_road(SEEN, heights, target, TRUTH)
    assert fit.status == "lost"
    np.testing.assert_array_equal(fit.map_from_local, TRUTH)


def test_a_road_a_metre_lower_is_not_taken_for_this_one() -> None:
    assert fit_road(SEEN, HEIGHTS, ROAD, TRUTH @ pose(0.0, 0.0, 0.0, 1.2)).status == "lost"


def test_a_pavement_where_the_map_has_no_road_says_nothing_against_it() -> None:
    ahead, left = np.meshgrid(np.arange(-20.0, 20.0, 0.4), np.arange(25.0, 40.0, 0.4))
    verge = np.column_stack((ahead.ravel(), left.ravel() - 45.0, np.full(ahead.size, 0.12)))
    narrow = LayerTarget.of(ROAD.points_m[np.abs(ROAD.points_m[:, 1]) < 3.0])
    seen = np.concatenate((SEEN[np.abs(SEEN[:, 1]) < 3.0], seen_from(TRUTH, on_a_slope(verge, *SLOPE))))
    fit = fit_road(seen, np.zeros(len(seen)), narrow, TRUTH)
    assert fit.status == "converged"
    assert abs(fit.map_from_local[2, 3]) < 0.005
