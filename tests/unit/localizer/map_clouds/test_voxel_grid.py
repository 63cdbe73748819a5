"""Thinning by voxels: the mean of each, against numpy's own grouping; and the first, as many as asked for at most."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.localizer.map_clouds.voxel_grid import first_of_voxels, thinned_evenly, voxel_count, voxel_means


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


def test_of_nothing_comes_nothing() -> None:
    assert voxel_means(np.zeros((0, 3)), 0.3).shape == (0, 3)


@pytest.mark.parametrize("far_m", [10_000.0, -10_000.0])
def test_far_from_the_origin_voxels_are_not_confused(far_m: float) -> None:
    points = cloud(5, 1_000, 5.0)
    assert len(voxel_means(points + 0.25 * round(far_m / 0.25), 0.25)) == pytest.approx(
        len(voxel_means(points, 0.25)), abs=2
    )


def dense_and_wide(n: int) -> np.ndarray:
    random = np.random.default_rng(3)
    return np.concatenate(
        [random.normal(0.0, 1.0, (n // 2, 3)), random.uniform(-30.0, 30.0, (n - n // 2, 3))]
    )


def test_the_first_point_of_each_voxel_is_what_a_dictionary_finds() -> None:
    points = dense_and_wide(5000)
    first: dict[tuple[int, ...], int] = {}
    for row, point in enumerate(points):
        first.setdefault(tuple(int(c) for c in np.floor(point / 0.7)), row)
    assert first_of_voxels(points, 0.7).tolist() == list(first.values())
    assert voxel_count(points, 0.7) == len(first)


@pytest.mark.parametrize("at_most", [1, 50, 1000, 4999])
def test_no_more_points_than_asked_for_and_each_of_them_was_there(at_most: int) -> None:
    points = dense_and_wide(5000)
    thin = thinned_evenly(points, at_most)
    assert 0 < len(thin) <= at_most
    assert {tuple(p) for p in thin} <= {tuple(p) for p in points}


def test_few_points_are_left_alone() -> None:
    points = dense_and_wide(40)
    np.testing.assert_array_equal(thinned_evenly(points, 40), points)
    assert len(thinned_evenly(np.empty((0, 3)), 10)) == 0


def test_a_dense_spot_does_not_keep_its_weight() -> None:
    points = dense_and_wide(20_000)
    thin = thinned_evenly(points, 1000)
    assert np.mean(np.linalg.norm(points, axis=1) < 3.0) > 0.45
    assert np.mean(np.linalg.norm(thin, axis=1) < 3.0) < 0.1
