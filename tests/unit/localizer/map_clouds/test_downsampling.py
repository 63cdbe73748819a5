"""Thinning: as many points as asked for at most, evenly, and points that were there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from camber.localizer.map_clouds.downsampling import first_of_voxels, thinned_evenly, voxel_count


def cloud(n: int) -> NDArray[np.float64]:
    random = np.random.default_rng(3)
    return np.concatenate(
        [random.normal(0.0, 1.0, (n // 2, 3)), random.uniform(-30.0, 30.0, (n - n // 2, 3))]
    )


def test_the_first_point_of_each_voxel_is_what_a_dictionary_finds() -> None:
    points = cloud(5000)
    first: dict[tuple[int, ...], int] = {}
    for row, point in enumerate(points):
        first.setdefault(tuple(int(c) for c in np.floor(point / 0.7)), row)
    assert first_of_voxels(points, 0.7).tolist() == list(first.values())
    assert voxel_count(points, 0.7) == len(first)


@pytest.mark.parametrize("at_most", [1, 50, 1000, 4999])
def test_no_more_points_than_asked_for_and_each_of_them_was_there(at_most: int) -> None:
    points = cloud(5000)
    thin = thinned_evenly(points, at_most)
    assert 0 < len(thin) <= at_most
    assert {tuple(p) for p in thin} <= {tuple(p) for p in points}


def test_few_points_are_left_alone() -> None:
    points = cloud(40)
    np.testing.assert_array_equal(thinned_evenly(points, 40), points)
    assert len(thinned_evenly(np.empty((0, 3)), 10)) == 0


def test_a_dense_spot_does_not_keep_its_weight() -> None:
    points = cloud(20_000)
    thin = thinned_evenly(points, 1000)
    assert np.mean(np.linalg.norm(points, axis=1) < 3.0) > 0.45
    assert np.mean(np.linalg.norm(thin, axis=1) < 3.0) < 0.1
