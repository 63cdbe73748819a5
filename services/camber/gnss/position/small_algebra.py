"""Products of small vectors and matrices for compiled code, where `@` would need SciPy."""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats


@compiled
def inner(a: Floats, b: Floats) -> float:
    """a · b of two vectors (n,)."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@compiled
def product(matrix: Floats, vector: Floats) -> Floats:
    """A matrix (m, n) times a vector (n,): (m,)."""
    result = np.empty(matrix.shape[0])
    for i in range(matrix.shape[0]):
        result[i] = inner(matrix[i], vector)
    return result


@compiled
def form(vector: Floats, matrix: Floats) -> float:
    """v · M v of a vector (n,) and a matrix (n, n)."""
    return inner(vector, product(matrix, vector))
