"""Do the integers of a fix go on from those of the fix before?

Along an unbroken arc a double-difference integer never changes. Differences of integers within a group do not depend
on the reference satellite, so fixes are compared by them, whatever their references were. That integers go on says
that both fixes are right or both are wrong; that they do not go on says that at least one is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Integers
from camber.gnss.observations.signal_pairs import GROUPS

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
    evidence = _evidence(
        before.satellite, before.group, before.integer, before.arc,
        after.satellite, after.group, after.integer, after.arc,
    )  # fmt: skip
    if evidence < 0:
        return "broken"
    return "continuous" if evidence >= least_evidence else "no_evidence"


@compiled
def _evidence(
    satellite: Integers,
    group: Integers,
    integer: Integers,
    arc: Integers,
    satellite_after: Integers,
    group_after: Integers,
    integer_after: Integers,
    arc_after: Integers,
) -> int:
    """How many double differences are the same in both; −1 where one is not."""
    step = np.zeros(GROUPS, np.int64)
    seen = np.zeros(GROUPS, np.bool_)
    evidence = 0
    for i in range(satellite_after.size):
        for j in range(satellite.size):
            g = group[j]
            if satellite[j] != satellite_after[i] or g != group_after[i]:
                continue
            same = arc[j, 0] == arc_after[i, 0] and arc[j, 1] == arc_after[i, 1]
            if not same or arc[j, 0] == 0 or arc[j, 1] == 0:
                continue
            moved = integer_after[i] - integer[j]
            if not seen[g]:
                seen[g], step[g] = True, moved
            elif moved != step[g]:
                return -1
            else:
                evidence += 1
    return evidence
