"""Protection levels: the smallest L that the error exceeds with no more than a chosen probability.

The error of a position is a mixture of normal distributions: it is right, or wrong in one way or another, each with
its weight, mean m and covariance. Let a, b be the eigenvalues of a horizontal covariance. Whitened, the error about its
mean has a direction φ that is uniform and a length that is Rayleigh's. In the direction n it leaves the circle of
radius L ≥ |m| after r = √(L² − |m|² + (m·n)²) − m·n, hence

    P(|N(m, C)| > L) = mean over φ of exp(−r² / (2 s)),    s = a cos² φ + b sin² φ,    n = (√a cos φ, √b sin φ) / √s

exactly; the mean over evenly spaced φ converges faster than any power. b = 0 is the normal distribution on a line (with
m = 0 the form of J. W. Craig, MILCOM 1991): heights are horizontal errors to the east alone. Nearer than its mean a
part counts in full.

numpy only. Shapes: n positions, k parts of the mixture; weights (n, k). An input that is not finite, a covariance that
is none, or no risk left to spend gives an infinite level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_NODES = 24
_COS = np.cos((np.arange(_NODES) + 0.5) * (2.0 * math.pi / _NODES))
_SIN = np.sin((np.arange(_NODES) + 0.5) * (2.0 * math.pi / _NODES))
_MEAN = np.full(_NODES, 1.0 / _NODES)
_GRIDS, _GRID = 3, np.linspace(0.0, 1.0, 9)
_SMALLEST_M2 = 1e-30  # in place of no variance at all
_ROWS = 1_000  # at a time: what grid and nodes take in memory
_ROUNDING = 1e-9
_MARGIN = 2e-4  # of the risk: what the nodes are wrong by, of errors without a mean


@dataclass(frozen=True, slots=True, eq=False)
class Tails:
    """What is needed of n mixtures to tell P(|error| > L).

    Weights, means along and across the major axis, larger and smaller variance, all (n, k).
    """

    weight: Floats
    along_m: Floats
    across_m: Floats
    larger_m2: Floats
    smaller_m2: Floats

    def __getitem__(self, rows: NDArray[np.intp]) -> Tails:
        return Tails(*(column[rows] for column in self.columns))

    @property
    def columns(self) -> tuple[Floats, ...]:
        """All of them, in the order of the fields."""
        return self.weight, self.along_m, self.across_m, self.larger_m2, self.smaller_m2

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which rows (n,) are finite throughout, and all of whose covariances are some."""
        sound = (self.smaller_m2 >= -_ROUNDING * self.larger_m2) & (self.larger_m2 < np.inf)
        for column in self.columns[:3]:
            sound &= np.isfinite(column)
        return np.asarray(sound.all(axis=1))

    def _nodes(self) -> tuple[Floats, Floats, Floats, Floats]:
        """At the nodes −1 / (2 s), m·n and its square (n, 1, k, nodes), and |m|² (n, 1, k)."""
        x = np.sqrt(self.larger_m2)[..., None] * _COS
        y = np.sqrt(np.maximum(self.smaller_m2, 0.0))[..., None] * _SIN
        square = np.maximum(x * x + y * y, _SMALLEST_M2)
        outwards = (self.along_m[..., None] * x + self.across_m[..., None] * y) / np.sqrt(square)
        length2 = self.along_m**2 + self.across_m**2
        return (-0.5 / square)[:, None], outwards[:, None], (outwards * outwards)[:, None], length2[:, None]

    def _beyond(self, level_m: Floats, nodes: tuple[Floats, Floats, Floats, Floats]) -> Floats:
        """P(|error| > L) (n, g), or never less, for g levels each (n, g)."""
        rate, outwards, outwards2, length2 = nodes
        room = (level_m * level_m)[:, :, None] - length2
        # In place: an array of its own for each step takes longer than the step.
        each = np.maximum(room, 0.0)[..., None] + outwards2
        np.sqrt(each, out=each)
        each -= outwards
        each *= each
        each *= rate
        np.exp(each, out=each)
        mean = (each.reshape(-1, _NODES) @ _MEAN).reshape(room.shape)
        tail = np.where(room >= 0.0, mean, 1.0)
        return np.asarray((tail @ self.weight[:, :, None])[..., 0])

    def levels_m(self, risk: Floats) -> Floats:
        """Of rows that are known, risks above 0: by a grid, finer ones about the root, secants of ln P there."""
        nodes, risk = self._nodes(), (1.0 - _MARGIN) * risk
        # Each part's tail is at most Rayleigh's of its larger variance: here each has its even share of the risk.
        parts = self.weight * (self.weight.shape[1] / risk)[:, None]
        share = np.log(np.maximum(parts, 1.0))
        reach = np.hypot(self.along_m, self.across_m) + np.sqrt(2.0 * share * self.larger_m2)
        low, high = np.zeros(len(risk)), np.where(parts > 1.0, reach, 0.0).max(axis=1)
        row = np.arange(len(risk)) * _GRID.size
        for _ in range(_GRIDS):
            grid = low[:, None] + (high - low)[:, None] * _GRID
            beyond = self._beyond(grid, nodes)
            enough = beyond <= risk[:, None]
            enough[:, -1] = True  # by construction: rounding must not deny it
            first = row + enough.argmax(axis=1)
            before = np.maximum(first - 1, row)
            low, high = grid.take(before), grid.take(first)
        # Secants of ln P, aimed a ten-thousandth below: the first through both ends of the cell, the second through the
        # lower end and where the first one led. Where ln P is bent downwards the first falls short and the second goes
        # beyond; where upwards both go beyond. Where it jumps neither need lead anywhere: only what was seen to keep to
        # the risk is taken.
        log_low, at, p_at = np.log(beyond.take(before)), high, beyond.take(first)
        above = log_low - (np.log(risk) - 1e-4)
        for _ in range(2):
            fall = log_low - np.log(np.maximum(p_at, 1e-300))
            share = np.minimum(np.maximum(above / np.maximum(fall, 1e-12), 0.0), _GRID.size)
            at = np.minimum(np.maximum(low + (at - low) * share, low), high)
            p_at = self._beyond(at[:, None], nodes)[:, 0]
            high = np.where(p_at <= risk, at, high)
        return np.asarray(high)


def levels_m(tails: Tails, risk: Floats) -> Floats:
    """The smallest L (n,) with P(|error| > L) ≤ risk (n,); ∞ where there is none.

    P, the mean over the nodes, is at most the risk less two ten-thousandths, which is more than the nodes are wrong by;
    but at a level that lies just beyond a part's mean, where P falls steeply or jumps, they are by up to 3 %. L is too
    large by no more than three ten-thousandths of the risk make, or, beside such a jump, by a thousandth of the
    farthest part's reach.
    """
    possible = np.flatnonzero(tails.known & (risk > 0.0))
    if 0 < len(possible) == len(risk) <= _ROWS:
        return tails.levels_m(risk)
    levels = np.full(len(risk), np.inf)
    for at in range(0, len(possible), _ROWS):
        rows = possible[at : at + _ROWS]
        levels[rows] = tails[rows].levels_m(risk[rows])
    return levels
