"""Continuity of the integers from one fix to the next.

Along an arc without cycle slip a double-difference integer never changes. Differences of integers within a group do not
depend on the reference satellite, so fixes with different references can be compared. Continuous integers mean that
both fixes are right or both are wrong; broken ones mean that at least one is wrong.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Integers
from camber.gnss.observations.signal_pairs import GROUPS

Continuity = Literal["continuous", "broken", "no_evidence"]
_LEAST_EVIDENCE = 3  # chosen: double differences that two fixes must share


class FixedIntegers(NamedTuple):
    """The integers of one fix, columns (n,), the reference of a group with 0; `arc` (n, 2) of rover and base."""

    satellite: Integers
    group: Integers
    integer: Integers
    arc: Integers


class ContinuityTracker:
    """Compares each fix with the last one."""

    def __init__(self) -> None:
        self._last: FixedIntegers | None = None
        self._since_ns: int | None = None

    def update(self, time_ns: int, fix: FixedIntegers) -> tuple[Continuity, int]:
        """Continuity of this fix, and the time of the first fix of the continuous chain (GPS time, ns)."""
        continuity = "no_evidence" if self._last is None else compare(self._last, fix, _LEAST_EVIDENCE)
        if continuity != "continuous" or self._since_ns is None:
            self._since_ns = time_ns
        self._last = fix
        return continuity, self._since_ns

    def reset(self) -> None:
        """Start a new chain: the receiver or the base was restarted."""
        self._last = self._since_ns = None


def compare(before: FixedIntegers, after: FixedIntegers, least_evidence: int) -> Continuity:
    """Compare two fixes by the rows that both have on the same arcs."""
    evidence = _evidence(before, after)
    if evidence < 0:
        return "broken"
    return "continuous" if evidence >= least_evidence else "no_evidence"


@compiled
def _evidence(before: FixedIntegers, after: FixedIntegers) -> int:
    """Number of double differences that are equal in both; −1 where one differs."""
    step = np.zeros(GROUPS, np.int64)
    seen = np.zeros(GROUPS, np.bool_)
    evidence = 0
    for i in range(after.satellite.size):
        for j in range(before.satellite.size):
            g = before.group[j]
            if before.satellite[j] != after.satellite[i] or g != after.group[i]:
                continue
            same = before.arc[j, 0] == after.arc[i, 0] and before.arc[j, 1] == after.arc[i, 1]
            if not same or before.arc[j, 0] == 0 or before.arc[j, 1] == 0:
                continue
            moved = after.integer[i] - before.integer[j]
            if not seen[g]:
                seen[g], step[g] = True, moved
            elif moved != step[g]:
                return -1
            else:
                evidence += 1
    return evidence
