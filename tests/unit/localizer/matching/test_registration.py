"""Registering a cloud: each method finds a motion that was put in, and says where there is nothing to find."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.geodesy.se3 import transform_points
from camber.localizer.matching.registration import NEIGHBOURS, CloudMethod, LayerTarget, register
from support.plain_layers import TRUTH, YARD, YARD_M, error, pose, seen_from, surfaces

Floats = NDArray[np.float64]

METHODS: list[CloudMethod] = ["point_to_point", "plane_to_plane", "vgicp"]


TARGET = LayerTarget.of(YARD_M)
SOURCE_M = seen_from(TRUTH, surfaces(YARD, 3.0, 2))


@pytest.mark.parametrize("method", METHODS)
def test_a_motion_is_recovered(method: CloudMethod) -> None:
    fit, again = (
        register(
            TARGET, SOURCE_M, pose(3.3, -2.2, 31.0), method=method, max_distance_m=1.0, max_iterations=60
        )
        for _ in range(2)
    )
    assert fit.transform.tobytes() == again.transform.tobytes()
    off_m, off_rad = error(fit.transform, TRUTH)
    assert fit.converged
    assert off_m < 0.03
    assert off_rad < 0.003
    assert fit.overlap > 0.95


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("points", [0, NEIGHBOURS - 1])
def test_too_few_points_on_one_side_leave_the_guess(method: CloudMethod, points: int) -> None:
    few = np.random.default_rng(3).uniform(-1.0, 1.0, (points, 3))
    many = np.random.default_rng(4).uniform(-1.0, 1.0, (100, 3))
    for fit in (
        register(TARGET, few, TRUTH, method=method, max_distance_m=1.0),
        register(LayerTarget.of(few), many, TRUTH, method=method, max_distance_m=1.0),
    ):
        assert not fit.converged
        assert np.array_equal(fit.transform, TRUTH)
        assert fit.mean_distance_m == np.inf
        assert fit.overlap == 0.0


@pytest.mark.parametrize("method", METHODS)
def test_a_cloud_far_from_the_map_has_no_pairs_and_does_not_converge(method: CloudMethod) -> None:
    fit = register(TARGET, SOURCE_M, pose(500.0, 0.0, 0.0), method=method, max_distance_m=1.0)
    assert not fit.converged
    assert fit.mean_distance_m == np.inf
    assert fit.overlap == 0.0


def test_mean_distance_counts_only_pairs_within_the_limit() -> None:
    """(7): the mean over the points that have a pair."""
    stray = np.concatenate([SOURCE_M, np.full((50, 3), 200.0)])
    fit = register(TARGET, stray, TRUTH, method="point_to_point", max_distance_m=0.5, max_iterations=1)
    _, nearest_m = TARGET.nearest(transform_points(fit.transform, stray))
    assert fit.mean_distance_m == pytest.approx(float(nearest_m[nearest_m <= 0.5].mean()))
    assert fit.points == len(stray)


def test_planes_of_the_map_are_fitted_to_what_lies_on_them() -> None:
    """Nearest points are those a search through all finds."""
    random = np.random.default_rng(5)
    points, asked = random.uniform(-5.0, 5.0, (300, 3)), random.uniform(-5.0, 5.0, (50, 3))
    rows, distance_m = LayerTarget.of(points).nearest(asked)
    away_m = np.linalg.norm(points[None] - asked[:, None], axis=2)
    np.testing.assert_array_equal(rows, away_m.argmin(axis=1))
    np.testing.assert_allclose(distance_m, away_m.min(axis=1))
