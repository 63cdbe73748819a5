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

The judge evaluates one mixture, in plain floats, the lab many: there is one implementation (`scalar_or_array`). An
input that is not finite, a covariance that is none, or no risk left to spend gives an infinite level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from camber.integrity.scalar_or_array import FloatOrArray, any_of, functions_of, logical_not, where

TailComponent: TypeAlias = tuple[FloatOrArray, FloatOrArray, FloatOrArray, FloatOrArray, FloatOrArray]
"""Of one part of the mixture: weight, mean along and across the major axis, larger and smaller variance; each a float
or (n,)."""

_NODES = 24  # chosen: the tails are then within _MARGIN of the exact ones (test_protection_level.py)
_ANGLES = [(k + 0.5) * (2.0 * math.pi / _NODES) for k in range(_NODES // 2)]
_AROUND = [(math.cos(angle), math.sin(angle)) for angle in _ANGLES]
_SQUARES = [(c * c, s * s) for c, s in _AROUND[: _NODES // 4]]
_DIAGONAL = [(0.5, 0.5)]
_STEPS = 40  # two or three do, some fourteen where P jumps
_SMALLEST_M2 = 1e-30  # beside a variance that may be nothing at all
_LEAST = 1e-300  # in place of nothing that divides or has a logarithm
_ROWS = 4000  # at a time: what their nodes take stays in the cache
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
    known = _known(parts)
    if not isinstance(known, np.ndarray):
        return _levels_m(parts, risks) if known else [math.inf] * len(risks)
    result = np.full((len(risks), len(known)), np.inf)
    possible = np.flatnonzero(known)
    for at in range(0, len(possible), _ROWS):
        rows = possible[at : at + _ROWS]
        some: list[TailComponent] = [(w[rows], x[rows], y[rows], a[rows], b[rows]) for w, x, y, a, b in parts]
        result[:, rows] = _levels_m(some, [risk[rows] for risk in risks])
    return list(result)


def _known(parts: Sequence[TailComponent]) -> FloatOrArray:
    """Is all of it finite, and each covariance one?"""
    sound: FloatOrArray = True
    for weight, along_m, across_m, larger_m2, smaller_m2 in parts:
        sound = sound & (smaller_m2 >= -_ROUNDING * larger_m2) & (larger_m2 >= 0.0) & (larger_m2 < math.inf)
        sound = sound & (abs(weight) < math.inf) & (abs(along_m) < math.inf) & (abs(across_m) < math.inf)
    return sound


def _levels_m(parts: Sequence[TailComponent], risks: Sequence[FloatOrArray]) -> list[FloatOrArray]:
    """Of what is known."""
    mixture = _TailProbability(parts)
    levels = [mixture.level_m((1.0 - _MARGIN) * where(risk > 0.0, risk, 1.0)) for risk in risks]
    return [where(risk > 0.0, level, math.inf) for risk, level in zip(risks, levels, strict=True)]


class _TailProbability:
    """P(|error| > L) by what is needed of each part at its nodes: −1 / (2 s), m·n and its square.

    Opposite nodes differ in the sign of m·n alone, so a half of them is held; a quarter where the mean lies along the
    axis, for those on both sides of it say the same, and without a mean; one where all directions are alike.
    """

    def __init__(self, parts: Sequence[TailComponent]) -> None:
        self._by = functions_of(parts[0][0])
        self._reaches: list[tuple[FloatOrArray, FloatOrArray, FloatOrArray, FloatOrArray]] = []
        self._centred: list[tuple[FloatOrArray, FloatOrArray]] = []
        self._off_centre: list[
            tuple[FloatOrArray, FloatOrArray, list[tuple[FloatOrArray, FloatOrArray, FloatOrArray]]]
        ] = []
        log, sqrt = self._by.log, self._by.sqrt
        for weight, along_m, across_m, larger_m2, smaller_m2 in parts:
            smaller_m2 = where(smaller_m2 > 0.0, smaller_m2, 0.0)
            thin = 1.0 - smaller_m2 / (larger_m2 + _SMALLEST_M2)
            length2 = along_m * along_m + across_m * across_m
            self._reaches.append((log(weight + _LEAST), sqrt(length2), 2.0 * larger_m2, math.pi * thin))
            if not any_of(length2 > 0.0):
                squares = _SQUARES if any_of(thin > _ROUNDING) else _DIAGONAL
                share = weight / len(squares)
                self._centred += [
                    (share, -0.5 / (larger_m2 * c2 + smaller_m2 * s2 + _SMALLEST_M2)) for c2, s2 in squares
                ]
                continue
            major_m, minor_m, nodes = sqrt(larger_m2), sqrt(smaller_m2), []
            for c, s in _AROUND if any_of(across_m != 0.0) else _AROUND[: _NODES // 4]:
                x, y = major_m * c, minor_m * s
                square = x * x + y * y + _SMALLEST_M2
                outwards = (along_m * x + across_m * y) / sqrt(square)
                nodes.append((-0.5 / square, outwards, outwards * outwards))
            self._off_centre.append((weight, length2, nodes))

    def level_m(self, risk: FloatOrArray) -> FloatOrArray:
        """By what the nodes say."""
        log_risk = self._by.log(risk)
        low, high, at = self._about(log_risk)
        result: FloatOrArray = False
        steps = 0
        while steps < _STEPS and any_of(logical_not(result)):
            steps += 1
            probability, slope = self._beyond(at)
            kept = probability <= risk
            high, low = where(kept, at, high), where(kept, low, at)
            above = self._by.log(probability + _LEAST) - log_risk + _AIM
            result = (kept & (above >= -_AIM)) | (high - low <= _NARROW * high)
            at = at + above * probability / (_LEAST - slope)
            at = where((at > low) & (at < high), at, 0.5 * (low + high))
            # Once found a level stays as it is: it does not depend on those beside it.
            at = where(result, high, at)
        return self._by.sqrt(high)

    def _beyond(self, level_m2: FloatOrArray) -> tuple[FloatOrArray, FloatOrArray]:
        """P(|error| > L), or never less, and its slope over L²."""
        exp, sqrt = self._by.exp, self._by.sqrt
        probability, slope = 0.0, 0.0
        for share, rate in self._centred:
            at_node = share * exp(level_m2 * rate)
            probability = probability + at_node
            slope = slope + at_node * rate
        for weight, length2, nodes in self._off_centre:
            room = level_m2 - length2
            # By more than rounding: where P jumps the level lies on the far side, also when it is evaluated again.
            nearer = room < _ROUNDING * level_m2
            some_nearer = any_of(nearer)
            if some_nearer:
                room = where(nearer, _LEAST, room)
            tail, fall = 0.0, 0.0
            for rate, outwards, outwards2 in nodes:
                straight = sqrt(room + outwards2)
                near, far = straight - outwards, straight + outwards
                steep, steeper = near * rate, far * rate
                at_node, opposite = exp(near * steep), exp(far * steeper)
                tail = tail + (at_node + opposite)
                fall = fall + (at_node * steep + opposite * steeper) / straight
            share = 0.5 * weight / len(nodes)
            tail, fall = share * tail, share * fall
            if some_nearer:
                tail, fall = where(nearer, weight, tail), where(nearer, 0.0, fall)
            probability, slope = probability + tail, slope + fall
        return probability, slope

    def _about(self, log_risk: FloatOrArray) -> tuple[FloatOrArray, FloatOrArray, FloatOrArray]:
        """L² that is too small, one that is large enough, and one between to begin with."""
        log1p, sqrt = self._by.log1p, self._by.sqrt
        reach, first, parts = 0.0, 0.0, math.log(len(self._reaches))
        for log_weight, length_m, twice_m2, thin in self._reaches:
            alone = log_weight - log_risk
            # Each part's tail is at most Rayleigh's of its larger variance: here each has its even share of the risk.
            share = alone + parts
            spends = share > 0.0
            if not any_of(spends):
                continue
            far = where(spends, length_m + sqrt(where(spends, share, 0.0) * twice_m2), 0.0)
            reach = where(far > reach, far, reach)
            # Far out it is about exp(−t) / √(π t (1 − b / a)), t = L² / (2 a): where the part alone spends the risk.
            spends = alone > 0.0
            alone = where(spends, alone, 0.0)
            rest = alone - 0.5 * log1p(thin * alone)
            far = length_m + sqrt(where(rest > 0.0, rest, 0.0) * twice_m2)
            first = where(spends & (far > first), far, first)
        first = where(first < reach, first, reach)
        return 0.0 * reach, reach * reach, first * first
