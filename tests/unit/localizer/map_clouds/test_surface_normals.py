"""Planes of neighbours: beside NumPy's eigenvectors, and what a wall, a line and a thicket are taken for."""

from __future__ import annotations

import numpy as np

from camber.localizer.map_clouds.surface_normals import planes_of_neighbours
from camber.localizer.matching.registration import LayerTarget


def test_normals_and_thickness_are_those_of_an_eigenvalue_decomposition() -> None:
    random = np.random.default_rng(1)
    points = random.normal(0.0, [3.0, 1.0, 0.2], (400, 3))
    neighbours = random.integers(0, 400, (400, 10)).astype(np.uint64)
    normals, thickness_m, variance = planes_of_neighbours(points, neighbours)
    centred = points[neighbours] - points[neighbours].mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))
    np.testing.assert_allclose(np.abs(np.sum(normals * vectors[:, :, 0], axis=1)), 1.0, atol=1e-9)
    np.testing.assert_allclose(thickness_m, np.sqrt(values[:, 0] / 7.0), atol=1e-12)
    np.testing.assert_allclose(variance, np.minimum(values[:, 0] / 7.0 / values[:, 1], 1.0), atol=1e-12)


def test_a_wall_is_thin_with_a_sure_normal_and_a_thicket_neither() -> None:
    random = np.random.default_rng(2)
    wall = random.uniform(-2.0, 2.0, (2000, 3)) * np.array([1.0, 0.0, 1.0])
    wall[:, 1] = random.normal(0.0, 0.01, 2000)
    thicket = random.uniform(-1.0, 1.0, (2000, 3))
    of_wall, of_thicket = LayerTarget.of(wall), LayerTarget.of(thicket)
    assert np.median(of_wall.thickness_m) < 0.02
    assert np.median(np.abs(of_wall.normals[:, 1])) > 0.99
    assert np.median(of_wall.normal_variance_rad2) < 0.1 * np.median(of_thicket.normal_variance_rad2)
    assert np.median(of_thicket.thickness_m) > 0.05


def test_points_on_one_spot_are_a_plane_without_a_known_normal() -> None:
    normals, thickness_m, variance = planes_of_neighbours(
        np.ones((10, 3)), np.tile(np.arange(10, dtype=np.uint64), (10, 1))
    )
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert (thickness_m == 0.0).all()
    assert (variance == 1.0).all()
