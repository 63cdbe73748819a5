"""Do other estimates of one epoch agree with one another? Asked before, and without, any height of road or antenna.

Estimates from other choices of satellites that lead to the same place support it; those that lead elsewhere speak
against it. Wrong integers rarely lead twice to the same wrong place, so a place that several choices name, and no
other that nearly as many do, is worth to be judged. Were it the height that chose among the places, it would choose
the one that fits it by accident, and could not judge it afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.horizontal_offsets import east_north_between
from camber.schemas.gnss import Candidate

_IDENTICAL_M = (
    1e-6  # what is left out of a choice may have been rejected anyway: then nothing was asked twice
)


@dataclass(frozen=True, slots=True, kw_only=True)
class AgreementRules:
    """When estimates agree: within `distance_m` of one another, in 3D.

    The fewer estimates name a place, the surer the surest of them has to be: `success[0]` is the success rate that is
    asked of one alone, `success[1]` of the better of two, and so on; the last one of as many and of any more. The one
    that is chosen has at least `least_ambiguities` fixed. The place must be named `lead` times as often as any other.
    """

    distance_m: float = 0.1
    success: tuple[float, ...] = (0.95, 0.7, 0.5)
    least_ambiguities: int = 6
    lead: float = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """The best estimate of the place that the others name, and how many different positions name it.

    `candidate` is None where there is none, `why` says why; `disputed`: another place is named about as often.
    """

    candidate: Candidate | None
    subsets: int = 0
    why: str = ""
    disputed: bool = False


def agreement_of(candidates: Sequence[Candidate], rules: AgreementRules) -> Agreement:
    """The one estimate that is to be judged: that of the most fixed ambiguities, then of the highest success rate."""
    if not candidates:
        return Agreement(candidate=None, why="no other estimate passes")
    position_m = _positions_m(candidates)
    place = _places(position_m, rules.distance_m)
    support = np.array([_different(position_m[place == k]) for k in range(place.max() + 1)])
    best = int(np.argmax(support))
    subsets = int(support[best])
    rival = int(max(np.delete(support, best), default=0))
    if subsets < rules.lead * rival:
        return Agreement(
            candidate=None,
            subsets=subsets,
            why=f"{subsets} estimates name one place, {rival} another",
            disputed=True,
        )
    members = [candidates[k] for k in np.flatnonzero(place == best).tolist()]
    surest, needed = max(c.success_rate for c in members), rules.success[min(subsets, len(rules.success)) - 1]
    if not surest >= needed:
        why = f"the success rate of the surest of {subsets} that agree is {surest:.3f}, {needed} is needed"
        return Agreement(candidate=None, subsets=subsets, why=why)
    chosen = max(members, key=lambda c: (c.ambiguities, c.success_rate))
    if chosen.ambiguities < rules.least_ambiguities:
        few = f"{chosen.ambiguities} ambiguities are fixed, {rules.least_ambiguities} are needed"
        return Agreement(candidate=None, subsets=subsets, why=few)
    return Agreement(candidate=chosen, subsets=subsets)


def _positions_m(candidates: Sequence[Candidate]) -> NDArray[np.float64]:
    """East and north from the first, and the height (n, 3)."""
    at = (candidates[0].latitude_rad, candidates[0].longitude_rad)
    return np.array(
        [(*east_north_between(*at, c.latitude_rad, c.longitude_rad), c.height_m) for c in candidates]
    )


def _places(position_m: NDArray[np.float64], distance_m: float) -> NDArray[np.int64]:
    """Number of the place (n,) of each position: linked are those within the distance, and what is linked to them."""
    apart = np.linalg.norm(position_m[:, None] - position_m[None, :], axis=2)
    linked = apart <= distance_m
    while True:
        further = linked @ linked
        if (further == linked).all():
            break
        linked = further
    first = linked.argmax(axis=1)
    return np.unique(first, return_inverse=True)[1].astype(np.int64)


def _different(position_m: NDArray[np.float64]) -> int:
    """How many of the positions are not the very same as one before."""
    apart = np.linalg.norm(position_m[:, None] - position_m[None, :], axis=2)
    return int((~np.tril(apart <= _IDENTICAL_M, -1).any(axis=1)).sum())
