"""A curve through given points that is smooth to its curvature: what a path of samples is driven along."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from camber.compiled.decorator import compiled
from camber.simulator.scene import Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CubicCurve:
    """Cubic spline of k columns over ascending distances (n,); value (n, k) and second derivative (n, k) at each.

    At either end the second derivative is that of the neighbour, so a circle keeps its curvature there.
    """

    distance_m: Floats
    value: Floats
    second: Floats

    @classmethod
    def through(cls, distance_m: Floats, value: Floats) -> Self:
        """Raises ValueError for fewer than four points, or distances that do not ascend."""
        if len(distance_m) < 4 or not bool((np.diff(distance_m) > 0.0).all()):
            raise ValueError(f"a curve needs four points at ascending distances, got {len(distance_m)}")
        second = _second_derivatives(distance_m, np.ascontiguousarray(value))
        return cls(distance_m=distance_m, value=value, second=second)

    def at(self, distance_m: Floats) -> tuple[Floats, Floats, Floats]:
        """Value, first and second derivative (m, k) at distances (m,), which are clipped to the curve."""
        s = np.clip(distance_m, self.distance_m[0], self.distance_m[-1])
        after = np.clip(np.searchsorted(self.distance_m, s, side="right"), 1, len(self.distance_m) - 1)
        before = after - 1
        h = (self.distance_m[after] - self.distance_m[before])[:, None]
        b = (s - self.distance_m[before])[:, None] / h
        a = 1.0 - b
        y0, y1, m0, m1 = self.value[before], self.value[after], self.second[before], self.second[after]
        value = a * y0 + b * y1 + ((a**3 - a) * m0 + (b**3 - b) * m1) * h**2 / 6.0
        first = (y1 - y0) / h + ((3.0 * b**2 - 1.0) * m1 - (3.0 * a**2 - 1.0) * m0) * h / 6.0
        return value, first, a * m0 + b * m1


@compiled
def _second_derivatives(x: Floats, y: Floats) -> Floats:
    """The tridiagonal system of a C2 cubic spline, solved by elimination; ends: m₀ = m₁, mₙ = mₙ₋₁."""
    n, k = y.shape
    upper = np.zeros(n)
    right = np.zeros((n, k))
    upper[0] = -1.0
    for i in range(1, n - 1):
        h0, h1 = x[i] - x[i - 1], x[i + 1] - x[i]
        pivot = 2.0 * (h0 + h1) - h0 * upper[i - 1]
        upper[i] = h1 / pivot
        for j in range(k):
            slope = (y[i + 1, j] - y[i, j]) / h1 - (y[i, j] - y[i - 1, j]) / h0
            right[i, j] = (6.0 * slope - h0 * right[i - 1, j]) / pivot
    second = np.zeros((n, k))
    for j in range(k):
        second[n - 1, j] = right[n - 2, j] / (1.0 + upper[n - 2])
        for i in range(n - 2, -1, -1):
            second[i, j] = right[i, j] - upper[i] * second[i + 1, j]
    return second
