"""Do the ways agree? A disagreement is told with both numbers, never averaged away.

Two tests for each pair: are the heights further apart than `sigmas` of their difference, and has their difference
changed since the drive began (`change`)? A disagreement ends when the two agree again; when they can no longer be
compared it stands for a while.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TypeAlias

from camber.antenna_height.change_detection import ChangeRules, ChangeWatch, Expected, Reference
from camber.schemas.antenna import HeightByMethod, HeightMethod

_NS = 1_000_000_000
_AT_ONCE = 2.0  # times the limit: nobody waits
_WANDERING = ("fixed", "scan_matching")
_WANDERING_SIGMAS = 1.5
"""A stored height does not follow the springs, a matched one errs with the map from place to place: so much of its own
σ is no change."""
_MANOEUVRE_S = 2.0
_MAP_S = 10.0
"""Of driving, after which a way errs by something else: a manoeuvre that leans on the springs has passed, another
stretch of the map is some centimetres wrong, or not as even as a plane."""
_MATCHED_SCATTER = 0.6
_MATCHED_COUNTS = 32.0
"""Of a matched height's σ: half its variance is constant for a drive (what was measured of the vehicle), the other half
comes with the place, seldom and at once: a quiet minute hardly speaks for the next."""
_EARLIER_SIGMAS = 1.0
"""A sensor errs by another constant each time it is switched on, which is part of its σ: so much of the difference's is
no change since earlier drives."""


References: TypeAlias = Mapping[tuple[HeightMethod, HeightMethod], Reference]
"""Of the first less the second."""


@dataclass(frozen=True, slots=True)
class ComparisonRules:
    """Apart: beyond `sigmas` for `after_s`; at once beyond twice that, and where two ways have never agreed.

    Agreed again: within it for `after_s`. A disagreement that cannot be tested any more stands for `kept_s`.
    """

    sigmas: float = 4.0
    after_s: float = 1.0
    kept_s: float = 60.0
    change: ChangeRules = field(default_factory=ChangeRules)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Of two ways; `text` says by how much and for how long."""

    ways: tuple[HeightMethod, HeightMethod]
    text: str


def disagree(a: HeightByMethod, b: HeightByMethod, sigmas: float = 4.0) -> bool:
    """Do two ways contradict each other beyond `sigmas` of their difference?"""
    return not abs(a.height_m - b.height_m) <= sigmas * math.hypot(a.sigma_m, b.sigma_m)


@dataclass(slots=True)
class _Pair:
    """Two ways over time. `apart_ns`: since when they have been, or None; `together_ns` likewise. `agreed`: ever."""

    rules: ComparisonRules
    watch: ChangeWatch
    first: HeightByMethod
    second: HeightByMethod
    tested_ns: int = 0
    apart_ns: int | None = None
    together_ns: int | None = None
    told: bool = False
    agreed: bool = False

    def test(self, now_ns: int, first: HeightByMethod, second: HeightByMethod, *, driving: bool) -> None:
        if now_ns < self.tested_ns:  # the clock was set back
            self.apart_ns = self.together_ns = None
        self.tested_ns, self.first, self.second = now_ns, first, second
        after_ns = round(self.rules.after_s * _NS)
        if disagree(first, second, self.rules.sigmas):
            self.together_ns = None
            self.apart_ns = now_ns if self.apart_ns is None else self.apart_ns
            at_once = not self.agreed or disagree(first, second, _AT_ONCE * self.rules.sigmas)
            self.told = self.told or at_once or now_ns - self.apart_ns >= after_ns
        else:
            self.agreed = True
            self.together_ns = now_ns if self.together_ns is None else self.together_ns
            if not self.told or now_ns - self.together_ns >= after_ns:
                self.told, self.apart_ns = False, None
        if driving:
            self.watch.least_m = max(
                (_WANDERING_SIGMAS * one.sigma_m for one in (first, second) if one.way in _WANDERING),
                default=0.0,
            )
            self.watch.expected = _expected(first, second)
            sigma_m = math.hypot(first.sigma_m, second.sigma_m)
            self.watch.earlier_least_m = _EARLIER_SIGMAS * sigma_m
            self.watch.add(now_ns, first.height_m - second.height_m)

    def disagreement(self, now_ns: int) -> Disagreement | None:
        if not 0 <= now_ns - self.tested_ns <= self.rules.kept_s * _NS:
            return None
        change = self.watch.change
        if not self.told and change is None:
            return None
        a, b = self.first, self.second
        text = f"{a.way} {a.height_m:.3f} m, {b.way} {b.height_m:.3f} m"
        if self.told and self.apart_ns is not None:
            text += f" for {(now_ns - self.apart_ns) / _NS:.0f} s"
        if change is not None:
            text += (
                f" ({a.way} less {b.way} is {change.by_m:+.3f} m from what it was, "
                f"for {(now_ns - change.since_ns) / _NS:.0f} s)"
            )
        return Disagreement((a.way, b.way), text)


def _expected(*heights: HeightByMethod) -> Expected:
    """Of the difference of two."""
    for one in heights:
        if one.way == "scan_matching":
            return Expected(_MAP_S, _MATCHED_SCATTER * one.sigma_m, _MATCHED_COUNTS)
    return Expected(_MANOEUVRE_S) if any(one.way == "fixed" for one in heights) else Expected()


class Comparison:
    """All pairs of ways. `earlier`: what their differences were in drives before this one."""

    def __init__(self, rules: ComparisonRules, earlier: References | None = None) -> None:
        self._rules = rules
        self._earlier = earlier or {}
        self._pairs: dict[tuple[HeightMethod, HeightMethod], _Pair] = {}

    def test(self, now_ns: int, heights: Sequence[HeightByMethod], *, driving: bool) -> None:
        """What the ways say now; each at most once, in the same order every time."""
        for first, second in combinations(heights, 2):
            pair = self._pairs.get((first.way, second.way))
            if pair is None:
                ways = first.way, second.way
                watch = ChangeWatch(self._rules.change, self._earlier.get(ways))
                pair = self._pairs[ways] = _Pair(self._rules, watch, first, second)
            pair.test(now_ns, first, second, driving=driving)

    @property
    def references(self) -> References:
        """What the differences have been, for the next drive; of ways that were not there what they were before."""
        return {**self._earlier, **{ways: pair.watch.reference for ways, pair in self._pairs.items()}}

    def disagreements(self, now_ns: int) -> list[Disagreement]:
        """Those that stand."""
        found = (pair.disagreement(now_ns) for pair in self._pairs.values())
        return [one for one in found if one is not None]

    def text(self, now_ns: int) -> str:
        """What stands, and which way is alone against others that agree, in one line; empty: nothing."""
        told = self.disagreements(now_ns)
        if not told:
            return ""
        compared = {way for pair in self._pairs.values() for way in (pair.first.way, pair.second.way)}
        alone = [way for way in compared if all(way in one.ways for one in told)]
        words = "; ".join(one.text for one in told[:2])
        if len(told) > 2:
            words += f"; {len(told) - 2} more"
        return f"{alone[0]} deviates: {words}" if len(compared) > 2 and len(alone) == 1 else words
