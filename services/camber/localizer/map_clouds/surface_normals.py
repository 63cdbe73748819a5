"""Surface normals: the plane through each point of a cloud and its neighbours, with its thickness."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.localizer.arrays import Floats, Integers

LEAST_NORMAL_VARIANCE_RAD2 = 1.0e-4
"""Chosen: no normal of a survey is better than 0.6°, 1 cm in a metre. With noiseless planes, rounding errors would look
like observability."""
_SWEEPS = 12  # of Jacobi's method; a 3 × 3 matrix is diagonal to rounding after five or six


def planes_of_neighbours(points_m: Floats, neighbours: NDArray[np.uint64]) -> tuple[Floats, Floats, Floats]:
    """Return unit normals (n, 3) of arbitrary sign, thickness (n,) [m] and the variance of the normals (n,) [rad²].

    `neighbours` (n, k), k > 3: rows of `points_m` (n, 3) about each point, itself among them. The thickness is the
    σ of the neighbours from their plane: leaves and corners are thick. The variance of a normal is that of a
    least-squares plane about its worse axis, thickness² over the scatter along the narrower extent, at most 1.
    """
    n = len(points_m)
    normals, thickness_m, variance_rad2 = np.empty((n, 3)), np.empty(n), np.empty(n)
    planes = (normals, thickness_m, variance_rad2)
    _fit(np.ascontiguousarray(points_m), neighbours.astype(np.int64), planes)
    return planes


@compiled
def _fit(points_m: Floats, neighbours: Integers, planes: tuple[Floats, Floats, Floats]) -> None:
    """Fill normals, thickness and variance of all planes."""
    normals, thickness_m, variance_rad2 = planes
    k = neighbours.shape[1]
    a, v = np.empty((3, 3)), np.empty((3, 3))
    for i in range(neighbours.shape[0]):
        mean = np.zeros(3)
        for j in range(k):
            for d in range(3):
                mean[d] += points_m[neighbours[i, j], d] / k
        a[:] = 0.0
        for j in range(k):
            for d in range(3):
                for e in range(3):
                    p = points_m[neighbours[i, j]]
                    a[d, e] += (p[d] - mean[d]) * (p[e] - mean[e])
        _diagonalise(a, v)
        least = 0
        for d in range(1, 3):
            if a[d, d] < a[least, least]:
                least = d
        # The two smaller ones of three: sorting a list takes two seconds to compile.
        low, high = min(a[0, 0], a[1, 1]), max(a[0, 0], a[1, 1])
        middle = max(low, min(high, a[2, 2]))
        for d in range(3):
            normals[i, d] = v[d, least]
        thickness2 = max(min(low, a[2, 2]), 0.0) / (k - 3)
        thickness_m[i] = math.sqrt(thickness2)
        variance_rad2[i] = (
            max(min(thickness2 / middle, 1.0), LEAST_NORMAL_VARIANCE_RAD2) if middle > 0.0 else 1.0
        )


@compiled
def _diagonalise(a: Floats, v: Floats) -> None:
    """Diagonalise by Jacobi's cyclic method, in place: `a` becomes diagonal, the columns of `v` its eigenvectors."""
    v[:] = 0.0
    for d in range(3):
        v[d, d] = 1.0
    for _ in range(_SWEEPS):
        off = a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2
        if off <= 1e-30 * (a[0, 0] ** 2 + a[1, 1] ** 2 + a[2, 2] ** 2):
            return
        for p in range(2):
            for q in range(p + 1, 3):
                if a[p, q] != 0.0:
                    _rotate(a, v, p, q)


@compiled
def _rotate(a: Floats, v: Floats, p: int, q: int) -> None:
    theta = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
    t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for d in range(3):
        a[d, p], a[d, q] = c * a[d, p] - s * a[d, q], s * a[d, p] + c * a[d, q]
    for d in range(3):
        a[p, d], a[q, d] = c * a[p, d] - s * a[q, d], s * a[p, d] + c * a[q, d]
    for d in range(3):
        v[d, p], v[d, q] = c * v[d, p] - s * v[d, q], s * v[d, p] + c * v[d, q]
