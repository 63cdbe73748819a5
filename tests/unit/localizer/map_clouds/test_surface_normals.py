"""Planes of neighbours: beside NumPy's eigenvectors, and what a wall, a line and a thicket are taken for."""

from __future__ import annotations

import numpy as np

from camber.localizer.map_clouds.surface_normals import planes_of_neighbours


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


def test_points_on_one_spot_are_a_plane_without_a_known_normal() -> None:
    normals, thickness_m, variance = planes_of_neighbours(
        np.ones((10, 3)), np.tile(np.arange(10, dtype=np.uint64), (10, 1))
    )
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert (thickness_m == 0.0).all()
    assert (variance == 1.0).all()
