"""Thinning by voxels: the mean of each, against numpy's own grouping."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.map_clouds.voxel_grid import voxel_means


def cloud(seed: int, n: int, spread_m: float) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, spread_m, (n, 3))


@settings(derandomize=True, max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(1, 400), spread_m=st.floats(0.01, 100.0))
def test_each_voxel_becomes_the_mean_of_its_points(seed: int, n: int, spread_m: float) -> None:
    points = cloud(seed, n, spread_m)
    _, group = np.unique(np.floor(points / 0.3), axis=0, return_inverse=True)
    group = group.ravel()
    counts = np.bincount(group)
    expected = np.column_stack([np.bincount(group, points[:, axis]) / counts for axis in range(3)])
    result = voxel_means(points, 0.3)
    assert result.shape == expected.shape
    order, other = np.lexsort(result.T), np.lexsort(expected.T)
    np.testing.assert_allclose(result[order], expected[other], atol=1e-9)


def test_they_come_in_the_order_of_first_appearance() -> None:
    points = np.array([[5.1, 0.0, 0.0], [-3.0, 0.0, 0.0], [5.2, 0.0, 0.0], [0.1, 0.0, 0.0]])
    np.testing.assert_allclose(voxel_means(points, 1.0)[:, 0], [5.15, -3.0, 0.1])


def test_points_on_a_plane_stay_on_it() -> None:
    points = cloud(4, 5_000, 5.0)
    points[:, 2] = 0.1 * points[:, 0] - 0.05 * points[:, 1]
    result = voxel_means(points, 0.5)
    assert len(result) < 2_500
    np.testing.assert_allclose(result[:, 2], 0.1 * result[:, 0] - 0.05 * result[:, 1], atol=1e-12)


def test_of_nothing_comes_nothing() -> None:
    assert voxel_means(np.zeros((0, 3)), 0.3).shape == (0, 3)


@pytest.mark.parametrize("far_m", [10_000.0, -10_000.0])
def test_far_from_the_origin_voxels_are_not_confused(far_m: float) -> None:
    points = cloud(5, 1_000, 5.0)
    assert len(voxel_means(points + 0.25 * round(far_m / 0.25), 0.25)) == pytest.approx(
        len(voxel_means(points, 0.25)), abs=2
    )
