"""The start without an anchor: how many fixes in a row must agree before the first is confirmed.

Until a pose is supported by something else, its only evidence is the fixes themselves. One fix that agrees with the
road says little (a wrong one does so by chance in up to one case of ten); several in a row, each as far from the one
before as the wheels say that the vehicle has come, say more. A wrong one among them begins the count anew, and so does
a jump of the fixes that the pose has followed. See docs/decisions/0002-start-without-an-anchor.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from camber.geodesy.horizontal_offsets import east_north_between


@dataclass(frozen=True, slots=True, kw_only=True)
class StartRules:
    """How many agreeing fixes in a row, over at least which time, with which longest gap between two.

    The distance between two must be that of the wheels within `distance_m` and `distance_share` of it.
    """

    fixes: int = 5
    duration_s: float = 0.8
    longest_gap_s: float = 1.0
    distance_m: float = 0.3
    distance_share: float = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class StartFix:
    """A fix that agrees with the road and the provisional pose; the speed is that of the wheels, None: not known."""

    time_ns: int
    latitude_rad: float
    longitude_rad: float
    speed_m_s: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class StartCount:
    """Agreeing fixes in a row so far."""

    fixes: int = 0
    first_ns: int = 0
    last: StartFix | None = None

    def after(self, fix: StartFix, rules: StartRules) -> StartCount:
        """The count after one more fix that agrees; 1 where it does not follow the one before."""
        if self.last is None or not follows(self.last, fix, rules):
            return StartCount(fixes=1, first_ns=fix.time_ns, last=fix)
        return StartCount(fixes=self.fixes + 1, first_ns=self.first_ns, last=fix)

    def enough(self, rules: StartRules) -> bool:
        """May the last of them be confirmed?"""
        if self.last is None:
            return False
        return self.fixes >= rules.fixes and self.last.time_ns - self.first_ns >= rules.duration_s * 1e9


def follows(before: StartFix, now: StartFix, rules: StartRules) -> bool:
    """Are two fixes as far from one another as the wheels have rolled? Not known is no."""
    gap_s = (now.time_ns - before.time_ns) / 1e9
    if before.speed_m_s is None or now.speed_m_s is None or not 0.0 < gap_s <= rules.longest_gap_s:
        return False
    rolled_m = 0.5 * abs(before.speed_m_s + now.speed_m_s) * gap_s
    moved = east_north_between(before.latitude_rad, before.longitude_rad, now.latitude_rad, now.longitude_rad)
    return abs(math.hypot(*moved) - rolled_m) <= rules.distance_m + rules.distance_share * rolled_m
