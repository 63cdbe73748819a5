"""From one estimate per layer to one: the layer of least mean distance, means (M, step 13), or those that agree.

The voted choice: layers whose estimates are farther apart than their covariances allow do not agree. The largest
group of which every two agree is kept if it is more than half of the layers and there is no other as large; its
members are fused by information, so that a direction only one of them sees is taken from that one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rule = Literal["best", "mean", "weighted", "voted"]

AGREEMENT_CHI2 = 16.27
"""χ² of three degrees of freedom at 99.9 %."""
_LEAST_DISTANCE_M = 1.0e-3  # of a mean distance, before it divides


@dataclass(frozen=True, eq=False)
class LayerEstimate:
    """One layer's answer: east, north [m], yaw [rad] from the guess (3,), covariance (3, 3), eᵢ (7)."""

    offset: Floats
    covariance: Floats
    mean_distance_m: float


@dataclass(frozen=True, eq=False)
class SelectedEstimate:
    """The answer of all. `agreed`: false where no majority was there, and the covariance holds the layers' spread."""

    offset: Floats
    covariance: Floats
    used: tuple[bool, ...]
    agreed: bool


def choose(estimates: Sequence[LayerEstimate], rule: Rule) -> SelectedEstimate:
    """One answer of at least one estimate. Only "voted" looks whether they agree."""
    if rule == "voted":
        return _voted(estimates)
    if rule == "best":
        best = int(np.argmin([e.mean_distance_m for e in estimates]))
        weights = np.zeros(len(estimates))
        weights[best] = 1.0
    elif rule == "mean":
        weights = np.ones(len(estimates))
    else:
        weights = np.array([1.0 / max(e.mean_distance_m, _LEAST_DISTANCE_M) for e in estimates])
    weights = weights / weights.sum()
    offset = sum((w * e.offset for w, e in zip(weights, estimates, strict=True)), np.zeros(3))
    covariance = sum((w * e.covariance for w, e in zip(weights, estimates, strict=True)), np.zeros((3, 3)))
    return SelectedEstimate(offset, covariance, tuple(bool(w > 0.0) for w in weights), True)


def _voted(estimates: Sequence[LayerEstimate]) -> SelectedEstimate:
    groups = _largest_groups(estimates)
    if len(groups) == 1 and 2 * len(groups[0]) > len(estimates):
        members = groups[0]
        offset, covariance = fused([estimates[i] for i in members])
        return SelectedEstimate(offset, covariance, tuple(i in members for i in range(len(estimates))), True)
    offset, covariance = fused(estimates)
    apart = np.array([e.offset - offset for e in estimates])
    return SelectedEstimate(offset, covariance + apart.T @ apart, (True,) * len(estimates), False)


def fused(estimates: Sequence[LayerEstimate]) -> tuple[Floats, Floats]:
    """Mean weighted by information and its covariance, scaled up where the estimates scatter more than they say."""
    information = [np.linalg.inv(e.covariance) for e in estimates]
    covariance = np.linalg.inv(sum(information, np.zeros((3, 3))))
    offset = covariance @ sum(
        (i @ e.offset for i, e in zip(information, estimates, strict=True)), np.zeros(3)
    )
    square = sum(
        float((e.offset - offset) @ i @ (e.offset - offset))
        for i, e in zip(information, estimates, strict=True)
    )
    freedom = 3 * (len(estimates) - 1)
    return offset, covariance * (max(1.0, square / freedom) if freedom else 1.0)


def _largest_groups(estimates: Sequence[LayerEstimate]) -> list[tuple[int, ...]]:
    """The groups of the greatest size of which every two agree."""
    n = len(estimates)
    agree = {(i, j): _agree(estimates[i], estimates[j]) for i, j in combinations(range(n), 2)}
    for size in range(n, 0, -1):
        groups = [
            group
            for group in combinations(range(n), size)
            if all(agree[pair] for pair in combinations(group, 2))
        ]
        if groups:
            return groups
    return []


def _agree(a: LayerEstimate, b: LayerEstimate) -> bool:
    apart = a.offset - b.offset
    return bool(apart @ np.linalg.solve(a.covariance + b.covariance, apart) <= AGREEMENT_CHI2)
