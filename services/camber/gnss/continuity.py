"""Do the integers of a fix go on from those of the fix before?

Along an unbroken arc a double-difference integer never changes. Differences of integers within a group do not depend
on the reference satellite, so fixes are compared by them, whatever their references were. That integers go on says
that both fixes are right or both are wrong; that they do not go on says that at least one is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.formats.observations import Integers
from camber.gnss.signals import GROUPS

Continuity = Literal["continuous", "broken", "no_evidence"]


@dataclass(frozen=True, slots=True, eq=False)
class FixedIntegers:
    """The integers of one fix, columns (n,): the reference of a group among them with 0.

    `arc` (n, 2) are those of rover and base.
    """

    satellite: Integers
    group: Integers
    integer: Integers
    arc: Integers


class ContinuityTracker:
    """Compares each fix with the last one. `least_evidence`: so many double differences must be there in both."""

    def __init__(self, *, least_evidence: int = 3) -> None:
        self._least = least_evidence
        self._last: FixedIntegers | None = None
        self._since_ns: int | None = None

    def update(self, time_ns: int, fix: FixedIntegers) -> tuple[Continuity, int]:
        """What the integers of this fix say, and the time of the first fix of the unbroken chain (GPS time, ns)."""
        verdict = "no_evidence" if self._last is None else compare(self._last, fix, self._least)
        if verdict != "continuous" or self._since_ns is None:
            self._since_ns = time_ns
        self._last = fix
        return verdict, self._since_ns

    def forget(self) -> None:
        """The receiver or the base began anew."""
        self._last = self._since_ns = None


def compare(before: FixedIntegers, after: FixedIntegers, least_evidence: int) -> Continuity:
    """Two fixes by the rows that both have on the same arcs."""
    of_before = _keys(before)
    of_after = _keys(after)
    _, old, new = np.intersect1d(of_before, of_after, assume_unique=True, return_indices=True)
    same = (before.arc[old] == after.arc[new]).all(axis=1) & (before.arc[old] > 0).all(axis=1)
    old, new = old[same], new[same]
    steps, groups = after.integer[new] - before.integer[old], after.group[new]
    evidence = 0
    for group in np.unique(groups):
        step = steps[groups == group]
        if (step != step[0]).any():
            return "broken"
        evidence += step.size - 1
    return "continuous" if evidence >= least_evidence else "no_evidence"


def _keys(fix: FixedIntegers) -> Integers:
    return fix.satellite * GROUPS + fix.group
