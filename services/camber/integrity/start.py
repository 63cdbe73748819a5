"""The start without an anchor: how many fixes in a row must agree before the first is confirmed.

Until a pose is supported by something else, its only evidence is the fixes themselves. One fix that agrees with the road
says little (a wrong one does so by chance in up to one case of ten); several in a row that also moved as the vehicle did
say more. A wrong one among them begins the count anew.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StartRules:
    """How many agreeing fixes in a row, over at least which time, with which longest gap between two."""

    fixes: int = 5
    duration_s: float = 0.8
    longest_gap_s: float = 1.0


@dataclass(frozen=True, slots=True)
class StartCount:
    """Agreeing fixes in a row so far."""

    fixes: int = 0
    first_ns: int = 0
    last_ns: int = 0

    def after(self, time_ns: int, *, agrees: bool, rules: StartRules) -> StartCount:
        """The count after one more fix."""
        if not agrees:
            return StartCount()
        if self.fixes == 0 or time_ns - self.last_ns > rules.longest_gap_s * 1e9:
            return StartCount(1, time_ns, time_ns)
        return StartCount(self.fixes + 1, self.first_ns, time_ns)

    def enough(self, rules: StartRules) -> bool:
        """May the last of them be confirmed?"""
        return self.fixes >= rules.fixes and self.last_ns - self.first_ns >= rules.duration_s * 1e9
