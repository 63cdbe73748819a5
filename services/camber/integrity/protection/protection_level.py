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

The judge evaluates one mixture, the lab many: all parts and nodes of a mixture are one array operation, which takes
hardly longer than one node alone. An input that is not finite, a covariance that is none, or no risk left to spend
gives an infinite level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from camber.integrity.scalar_or_array import FloatOrArray, any_of, log, logical_not, sqrt, where

Floats: TypeAlias = NDArray[np.float64]
TailComponent: TypeAlias = tuple[FloatOrArray, FloatOrArray, FloatOrArray, FloatOrArray, FloatOrArray]
"""Of one part of the mixture: weight, mean along and across the major axis, larger and smaller variance; each a float
or (n,)."""

_NODES = 24  # chosen: the tails are then within _MARGIN of the exact ones (test_protection_level.py)
_ANGLES = (np.arange(_NODES // 2)[:, None, None] + 0.5) * (2.0 * math.pi / _NODES)
_COS, _SIN = np.cos(_ANGLES), np.sin(_ANGLES)
_STEPS = 40  # two or three do, some fourteen where P jumps
_SMALLEST_M2 = 1e-30  # beside a variance that may be nothing at all
_LEAST = 1e-300  # in place of nothing that divides or has a logarithm
_AT_ONCE = 50_000  # chosen: nodes of some rows stay in the cache
_ROUNDING = 1e-9  # relative; chosen: far above the rounding of a float, 2e-16, and of no weight in a level
_MARGIN = (
    0.03  # of the risk: what the nodes are wrong by where an ellipse is thin or a part's mean just within
)
_AIM = 1e-4  # below the risk, in ln P; what is as much below that is near enough
_NARROW = 1e-4  # of L²: between what keeps to the risk and what does not, where P jumps


def levels_m(parts: Sequence[TailComponent], risks: Sequence[FloatOrArray]) -> list[FloatOrArray]:
    """Of each of these risks the smallest L with P(|error| > L) ≤ risk; ∞ where there is none. All floats, or (n,).

    P, the mean over the nodes, is at most the risk less 3 %, which is more than the nodes are wrong by: 1 % of errors
    without a mean, 2 % with, and 3 % at a level that lies just beyond a part's mean, where P falls steeply or jumps. L
    is too large by what twice that share of the risk makes, a five-hundredth of it at 1e-7, or beside such a jump by a
    ten-thousandth more.
    """
    table = np.array(parts, np.float64)
    if table.ndim == 2:
        return _levels_m(table[:, :, None], risks) if _are_known(table) else [math.inf] * len(risks)
    result = np.full((len(risks), table.shape[2]), np.inf)
    possible = np.flatnonzero(_are_known(table))
    step = max(_AT_ONCE // (_NODES * len(table)), 1)
    for at in range(0, len(possible), step):
        rows = possible[at : at + step]
        result[:, rows] = _levels_m(table[:, :, rows], [risk[rows] for risk in risks])
    return list(result)


def _are_known(table: Floats) -> NDArray[np.bool_]:
    """Is all of a mixture (k, 5, ...) finite, and each covariance one?"""
    larger_m2, smaller_m2 = table[:, 3], table[:, 4]
    finite = np.isfinite(table[:, :4]).all(axis=(0, 1))
    with np.errstate(invalid="ignore"):
        sound = (larger_m2 >= 0.0) & (smaller_m2 >= -_ROUNDING * larger_m2)
    return np.asarray(finite & sound.all(axis=0))


def _levels_m(table: Floats, risks: Sequence[FloatOrArray]) -> list[FloatOrArray]:
    """Of what is known, parts (k, 5, n)."""
    mixture = _TailProbability(table)
    levels = [mixture.level_m((1.0 - _MARGIN) * where(risk > 0.0, risk, 1.0)) for risk in risks]
    return [where(risk > 0.0, level, math.inf) for risk, level in zip(risks, levels, strict=True)]


class _TailProbability:
    """P(|error| > L) by what is needed of each part at its nodes (m, k, n): −1 / (2 s) and m·n.

    Opposite nodes differ in the sign of m·n alone and are two only beside a mean; a quarter of the circle is enough
    where each mean lies along the axis.
    """

    def __init__(self, table: Floats) -> None:
        weight, along_m, across_m, larger_m2, smaller_m2 = table.transpose(1, 0, 2)
        smaller_m2 = np.maximum(smaller_m2, 0.0)
        self._weight, self._length2 = weight, along_m * along_m + across_m * across_m
        self._log_weight, self._length = np.log(weight + _LEAST), np.sqrt(self._length2)
        self._twice_m2 = 2.0 * larger_m2
        self._farthest2 = self._length2.max().item()
        self._thin = math.pi * (1.0 - smaller_m2 / (larger_m2 + _SMALLEST_M2))
        nodes = _NODES // 2 if across_m.any() else _NODES // 4
        x, y = np.sqrt(larger_m2) * _COS[:nodes], np.sqrt(smaller_m2) * _SIN[:nodes]
        square = x * x + y * y + _SMALLEST_M2
        self._rate, self._outwards = -0.5 / square, (along_m * x + across_m * y) / np.sqrt(square)
        if self._farthest2 != 0.0:
            self._rate = np.concatenate((self._rate, self._rate))
            self._outwards = np.concatenate((self._outwards, -self._outwards))
        self._outwards2 = self._outwards * self._outwards
        self._share = weight / len(self._rate)

    def level_m(self, risk: FloatOrArray) -> FloatOrArray:
        """By what the nodes say, of a float one, of (n,) as many."""
        log_risk = log(risk)
        low, high, at = self._about(log_risk)
        result: FloatOrArray = False
        steps = 0
        while steps < _STEPS and any_of(logical_not(result)):
            steps += 1
            probability, slope = self._beyond(at)
            kept = probability <= risk
            high, low = where(kept, at, high), where(kept, low, at)
            above = log(probability + _LEAST) - log_risk + _AIM
            result = (kept & (above >= -_AIM)) | (high - low <= _NARROW * high)
            at = at + above * probability / (_LEAST - slope)
            at = where((at > low) & (at < high), at, 0.5 * (low + high))
            # Once found a level stays as it is: it does not depend on those beside it.
            at = where(result, high, at)
        return sqrt(high)

    def _beyond(self, level_m2: FloatOrArray) -> tuple[FloatOrArray, FloatOrArray]:
        """P(|error| > L), or never less, and its slope over L²."""
        room = level_m2 - self._length2
        straight = np.sqrt(np.maximum(room, _LEAST) + self._outwards2)
        distance = straight - self._outwards
        steep = distance * self._rate
        at_node = np.exp(distance * steep)
        tail = self._share * np.add.reduce(at_node)
        fall = self._share * np.add.reduce(at_node * steep / straight)
        # By more than rounding: where P jumps the level lies on the far side, also when it is evaluated again.
        if any_of(level_m2 - self._farthest2 < _ROUNDING * level_m2):
            nearer = room < _ROUNDING * level_m2
            tail, fall = np.where(nearer, self._weight, tail), np.where(nearer, 0.0, fall)
        return _alike(np.add.reduce(tail), level_m2), _alike(np.add.reduce(fall), level_m2)

    def _about(self, log_risk: FloatOrArray) -> tuple[FloatOrArray, FloatOrArray, FloatOrArray]:
        """L² that is too small, one that is large enough, and one between to begin with."""
        alone = self._log_weight - log_risk
        # Each part's tail is at most Rayleigh's of its larger variance: here each has its even share of the risk.
        share = alone + math.log(len(alone))
        far = self._length + np.sqrt(np.maximum(share, 0.0) * self._twice_m2)
        reach = np.where(share > 0.0, far, 0.0).max(axis=0)
        # Far out it is about exp(−t) / √(π t (1 − b / a)), t = L² / (2 a): where the part alone spends the risk.
        spends = np.maximum(alone, 0.0)
        rest = spends - 0.5 * np.log1p(self._thin * spends)
        near = self._length + np.sqrt(np.maximum(rest, 0.0) * self._twice_m2)
        first = np.minimum(np.where(alone > 0.0, near, 0.0).max(axis=0), reach)
        return tuple(_alike(square, log_risk) for square in (0.0 * reach, reach * reach, first * first))


def _alike(values: Floats, other: FloatOrArray) -> FloatOrArray:
    """The only one of the values as a float where the other is one: their loop is then in plain floats."""
    return values if isinstance(other, np.ndarray) else values.item()
