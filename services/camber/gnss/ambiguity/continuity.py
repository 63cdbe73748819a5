"""Continuity of the integers from one fix to the next.

Along an arc without cycle slip a double-difference integer never changes. Differences of integers within a group do not
depend on the reference satellite, so fixes with different references can be compared. Continuous integers mean that
both fixes are right or both are wrong; broken ones mean that at least one is wrong.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers
from camber.gnss.observations.differenced_observations import SingleDifferences
from camber.gnss.observations.signal_pairs import GROUPS

Continuity = Literal["continuous", "broken", "no_evidence"]
_LEAST_EVIDENCE = 3  # chosen: double differences that two fixes must share


FIXED_INTEGER = np.dtype(
    [(name, np.int64) for name in ("satellite", "group", "integer", "rover_arc", "base_arc")]
)
"""One integer of a fix; the reference of a group has 0. An arc is 0 where there is none."""
FixedIntegers = NDArray[np.void]
"""The integers of one fix (n,) of `FIXED_INTEGER`: one array crosses to compiled code faster than five."""


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
def fixed_integers(
    rows: SingleDifferences, integer: Floats, rover_arcs: Integers, base_arcs: Integers
) -> FixedIntegers:
    """Integers that an estimate has fixed: `integer` by row, NaN where unknown; arcs by row of each epoch."""
    fix = np.empty(integer.size, FIXED_INTEGER)
    count = 0
    for i in range(integer.size):
        if np.isnan(integer[i]):
            continue
        fix["satellite"][count] = rows.satellite[i]
        fix["group"][count] = rows.group[i]
        fix["integer"][count] = int(integer[i])
        fix["rover_arc"][count] = rover_arcs[rows.rover[i]]
        fix["base_arc"][count] = base_arcs[rows.base[i]]
        count += 1
    return fix[:count].copy()


@compiled
def _evidence(before: FixedIntegers, after: FixedIntegers) -> int:
    """Number of double differences that are equal in both; −1 where one differs."""
    step = np.zeros(GROUPS, np.int64)
    seen = np.zeros(GROUPS, np.bool_)
    evidence = 0
    for i in range(after.size):
        for j in range(before.size):
            one, other = before[j], after[i]
            g = one["group"]
            if one["satellite"] != other["satellite"] or g != other["group"]:
                continue
            same = one["rover_arc"] == other["rover_arc"] and one["base_arc"] == other["base_arc"]
            if not same or one["rover_arc"] == 0 or one["base_arc"] == 0:
                continue
            moved = other["integer"] - one["integer"]
            if not seen[g]:
                seen[g], step[g] = True, moved
            elif moved != step[g]:
                return -1
            else:
                evidence += 1
    return evidence
