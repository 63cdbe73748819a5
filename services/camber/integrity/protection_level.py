"""Protection levels: the smallest L that the error exceeds with no more than a chosen probability.

The error of a position is a mixture of normal distributions: it is right, or wrong in one way or another, each with
its weight, mean m and covariance. Let a, b be the eigenvalues of a horizontal covariance. Whitened, the error about its
mean has a direction φ that is uniform and a length that is Rayleigh's. In the direction n it leaves the circle of
radius L ≥ |m| after r = √(L² − |m|² + (m·n)²) − m·n, hence

    P(|N(m, C)| > L) = mean over φ of exp(−r² / (2 s)),    s = a cos² φ + b sin² φ,    n = (√a cos φ, √b sin φ) / √s

exactly; the mean over evenly spaced φ converges faster than any power. b = 0 is the normal distribution on a line (with
m = 0 the form of J. W. Craig, MILCOM 1991): heights are horizontal errors to the east alone. Nearer than its mean a
part counts in full.

P falls with L, and its slope comes with it: L is found by Newton's steps of ln P over L², between what was seen to keep
to the risk and what was not.

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
_STEPS = 40  # two to four do, some fourteen where P jumps
_SMALLEST_M2 = 1e-30  # in place of no variance at all
_LEAST = 1e-300  # in place of nothing that divides or has a logarithm
_ROWS = 100  # at a time: what their nodes take stays in the cache, and few wait for the slowest
_ROUNDING = 1e-9
_MARGIN = (
    0.03  # of the risk: what the nodes are wrong by where an ellipse is thin or a part's mean just within
)
_AIM = 1e-4  # below the risk, in ln P; what is as much below that is near enough
_NARROW = 1e-4  # of L²: between what keeps to the risk and what does not, where P jumps


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
        """At the nodes −1 / (2 s), m·n and its square (n, k, nodes), and |m|² (n, k).

        A quarter of the nodes where no part has a mean: the others give the same.
        """
        used = _NODES if self.along_m.any() or self.across_m.any() else _NODES // 4
        x = np.sqrt(self.larger_m2)[..., None] * _COS[:used]
        y = np.sqrt(np.maximum(self.smaller_m2, 0.0))[..., None] * _SIN[:used]
        square = np.maximum(x * x + y * y, _SMALLEST_M2)
        outwards = (self.along_m[..., None] * x + self.across_m[..., None] * y) / np.sqrt(square)
        length2 = self.along_m * self.along_m + self.across_m * self.across_m
        return -0.5 / square, outwards, outwards * outwards, length2

    def _beyond(
        self, level_m2: Floats, nodes: tuple[Floats, Floats, Floats, Floats]
    ) -> tuple[Floats, Floats]:
        """P(|error| > L), or never less, and its slope over L², both (n,)."""
        rate, outwards, outwards2, length2 = nodes
        room = level_m2[:, None] - length2
        # In place: an array of its own for each step takes longer than the step.
        straight = np.maximum(room, _LEAST)[..., None] + outwards2
        np.sqrt(straight, out=straight)
        both = np.empty((2, *rate.shape))
        tail, fall = both
        way = straight - outwards
        np.multiply(way, rate, out=fall)
        np.multiply(way, fall, out=tail)
        np.exp(tail, out=tail)
        fall *= tail
        fall /= straight
        mean = np.add.reduce(both, axis=-1)
        mean /= rate.shape[-1]
        tail, fall = mean
        # By more than rounding: where P jumps the level is on the far side for whoever looks again.
        nearer = room < _ROUNDING * level_m2[:, None]
        np.putmask(tail, nearer, 1.0)
        np.putmask(fall, nearer, 0.0)
        mean *= self.weight
        probability, slope = np.add.reduce(mean, axis=-1)
        return probability, slope

    def levels_m(self, risk: Floats) -> Floats:
        """Of rows that are known, risks above 0."""
        nodes, risk = self._nodes(), (1.0 - _MARGIN) * risk
        low, high, at = self._about(risk, np.sqrt(nodes[3]))
        aim = np.log(risk) - _AIM
        found, steps = np.zeros(len(risk), bool), 0
        while steps < _STEPS and not found.all():
            steps += 1
            probability, slope = self._beyond(at, nodes)
            kept = probability <= risk
            np.putmask(high, kept, at)
            np.putmask(low, ~kept, at)
            above = np.log(np.maximum(probability, _LEAST)) - aim
            found = (kept & (above >= -_AIM)) | (high - low <= _NARROW * high)
            at = at - above * probability / np.minimum(slope, -_LEAST)
            outside = ~((at > low) & (at < high))
            np.putmask(at, outside, 0.5 * (low + high))
            # Once found a level stays as it is: it does not depend on those beside it.
            np.putmask(at, found, high)
        return np.asarray(np.sqrt(high))

    def _about(self, risk: Floats, length_m: Floats) -> tuple[Floats, Floats, Floats]:
        """L² (n,) that is too small, one that is large enough, and one between to begin with."""
        alone = np.log(np.maximum(self.weight / risk[:, None], _LEAST))
        twice_m2 = 2.0 * self.larger_m2
        # Each part's tail is at most Rayleigh's of its larger variance: here each has its even share of the risk.
        share = np.maximum(alone + math.log(self.weight.shape[1]), 0.0)
        reach = ((length_m + np.sqrt(share * twice_m2)) * (share > 0.0)).max(axis=1)
        # Far out it is about exp(−t) / √(π t (1 − b / a)), with t = L² / (2 a): where the part alone spends the risk.
        alone = np.maximum(alone, 0.0)
        thin = 1.0 - self.smaller_m2 / np.maximum(self.larger_m2, _SMALLEST_M2)
        rest = np.maximum(alone - 0.5 * np.log1p(math.pi * thin * alone), 0.0)
        first = ((length_m + np.sqrt(rest * twice_m2)) * (alone > 0.0)).max(axis=1)
        return np.zeros(len(risk)), reach * reach, np.minimum(first, reach) ** 2


def levels_m(tails: Tails, risk: Floats) -> Floats:
    """The smallest L (n,) with P(|error| > L) ≤ risk (n,); ∞ where there is none.

    P, the mean over the nodes, is at most the risk less 3 %, which is more than the nodes are wrong by: 1 % of errors
    without a mean, 2 % with, and 3 % at a level that lies just beyond a part's mean, where P falls steeply or jumps. L
    is too large by what twice that share of the risk makes, a five-hundredth of it at 1e-7, or beside such a jump by a
    ten-thousandth more.
    """
    possible = np.flatnonzero(tails.known & (risk > 0.0))
    if 0 < len(possible) == len(risk) <= _ROWS:
        return tails.levels_m(risk)
    levels = np.full(len(risk), np.inf)
    for at in range(0, len(possible), _ROWS):
        rows = possible[at : at + _ROWS]
        levels[rows] = tails[rows].levels_m(risk[rows])
    return levels
