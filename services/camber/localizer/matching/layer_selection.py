"""Selection of one estimate from the layers': least mean distance, means (JP2016-109650A, step 13), or those that
agree.

Voting: layers whose estimates differ by more than their covariances allow do not agree. The largest group in which
every two agree is used if it is more than half of the layers and no other group is as large; its members are fused by
information, so that a direction observed by one of them is taken from that one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, Literal, TypeAlias

import numpy as np

from camber.localizer.arrays import Floats

SelectionRule: TypeAlias = Literal["best", "mean", "weighted", "voted"]

AGREEMENT_CHI2: Final = 16.27
"""χ² of three degrees of freedom at 99.9 %."""
_LEAST_DISTANCE_M: Final = 1.0e-3  # chosen: of a mean distance, before it divides


@dataclass(frozen=True, eq=False, kw_only=True)
class LayerEstimate:
    """One layer's estimate: east, north [m], yaw [rad] from the guess (3,), covariance (3, 3), eᵢ of eq. (7)."""

    offset: Floats
    covariance: Floats
    mean_distance_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class SelectedEstimate:
    """The selected estimate. `agreed`: false without a majority; then the covariance has the layers' spread."""

    offset: Floats
    covariance: Floats
    used: tuple[bool, ...]
    agreed: bool


def select(estimates: Sequence[LayerEstimate], rule: SelectionRule) -> SelectedEstimate:
    """Return one estimate from at least one layer's. Only "voted" tests whether they agree."""
    if rule == "voted":
        return _vote(estimates)
    if rule == "best":
        best = int(np.argmin([e.mean_distance_m for e in estimates]))
        weights = np.zeros(len(estimates))
        weights[best] = 1.0
    elif rule == "mean":
        weights = np.ones(len(estimates))
    else:
        weights = np.array([1.0 / max(e.mean_distance_m, _LEAST_DISTANCE_M) for e in estimates])
    weights = weights / weights.sum()
    return SelectedEstimate(
        offset=sum((w * e.offset for w, e in zip(weights, estimates, strict=True)), np.zeros(3)),
        covariance=sum((w * e.covariance for w, e in zip(weights, estimates, strict=True)), np.zeros((3, 3))),
        used=tuple(bool(w > 0.0) for w in weights),
        agreed=True,
    )


def _vote(estimates: Sequence[LayerEstimate]) -> SelectedEstimate:
    n, groups = len(estimates), _largest_groups(estimates)
    if len(groups) == 1 and 2 * len(groups[0]) > n:
        members = groups[0]
        offset, covariance = fuse([estimates[i] for i in members])
        used = tuple(i in members for i in range(n))
        return SelectedEstimate(offset=offset, covariance=covariance, used=used, agreed=True)
    offset, covariance = fuse(estimates)
    spread = np.array([e.offset - offset for e in estimates])
    return SelectedEstimate(
        offset=offset, covariance=covariance + spread.T @ spread, used=(True,) * n, agreed=False
    )


def fuse(estimates: Sequence[LayerEstimate]) -> tuple[Floats, Floats]:
    """Return the information-weighted mean and its covariance, scaled up where the estimates scatter more than that."""
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
    """Return the groups of the greatest size in which every two agree."""
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
    difference = a.offset - b.offset
    return bool(difference @ np.linalg.solve(a.covariance + b.covariance, difference) <= AGREEMENT_CHI2)
