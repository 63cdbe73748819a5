"""Comparison of the methods: a disagreement is reported with both heights, never averaged.

Two tests for each pair: are the heights further apart than `sigmas` of their difference, and has their difference
changed since the drive began (`change_detection`)? A disagreement ends when the two agree again; when they can no
longer be compared it lasts for `kept_s`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TypeAlias

from camber.antenna_height.change_detection import ChangeDetector, ChangeRules, DifferencePrior, Reference
from camber.schemas.antenna import HeightByMethod, HeightMethod

_AT_ONCE = 2.0  # chosen: times the limit, beyond which a disagreement is reported without delay
_WANDERING = ("fixed", "scan_matching")
_WANDERING_SIGMAS = 1.5
"""Chosen: a stored height does not follow the springs, a matched one errs with the map from place to place: so much of
its σ is no change."""
_MANOEUVRE_S = 2.0
"""Chosen: of driving, after which the springs are loaded by another manoeuvre."""
_MAP_S = 10.0
"""Chosen: of driving, after which another stretch of the map has another error."""
_MATCHED_SCATTER = 0.6
"""Chosen: of a matched height's σ; half its variance is constant for a drive (the vehicle's measured dimensions)."""
_MATCHED_COUNTS = 32.0
"""Chosen: the other half comes with the place, seldom and at once, so that a quiet minute predicts little."""
_EARLIER_SIGMAS = 1.0
"""Chosen: a sensor has another constant error each time it is switched on, as part of its σ: so much of the
difference's σ is no change since earlier drives."""

MethodPair: TypeAlias = tuple[HeightMethod, HeightMethod]
References: TypeAlias = Mapping[MethodPair, Reference]
"""Of the first less the second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonRules:
    """Apart: beyond `sigmas` for `after_s`; at once beyond twice that, and where two methods have never agreed.

    Agreed again: within it for `after_s`. A disagreement that cannot be tested any more lasts for `kept_s`.
    """

    sigmas: float = 4.0
    after_s: float = 1.0
    kept_s: float = 60.0
    change: ChangeRules = field(default_factory=ChangeRules)


def disagree(a: HeightByMethod, b: HeightByMethod, sigmas: float = 4.0) -> bool:
    """Whether two heights differ by more than `sigmas` of their difference."""
    return not abs(a.height_m - b.height_m) <= sigmas * math.hypot(a.sigma_m, b.sigma_m)


@dataclass(slots=True, kw_only=True)
class _ComparedPair:
    """Two methods over time. `apart_ns`, `together_ns`: since when they disagree or agree. `agreed`: ever."""

    rules: ComparisonRules
    changes: ChangeDetector
    first: HeightByMethod
    second: HeightByMethod
    tested_ns: int = 0
    apart_ns: int | None = None
    together_ns: int | None = None
    is_apart: bool = False
    agreed: bool = False

    def test(self, now_ns: int, first: HeightByMethod, second: HeightByMethod, *, driving: bool) -> None:
        if now_ns < self.tested_ns:  # the clock was set back
            self.apart_ns = self.together_ns = None
        self.tested_ns, self.first, self.second = now_ns, first, second
        after_ns = round(self.rules.after_s * 1e9)
        if disagree(first, second, self.rules.sigmas):
            self.together_ns = None
            self.apart_ns = now_ns if self.apart_ns is None else self.apart_ns
            at_once = not self.agreed or disagree(first, second, _AT_ONCE * self.rules.sigmas)
            self.is_apart = self.is_apart or at_once or now_ns - self.apart_ns >= after_ns
        else:
            self.agreed = True
            self.together_ns = now_ns if self.together_ns is None else self.together_ns
            if not self.is_apart or now_ns - self.together_ns >= after_ns:
                self.is_apart, self.apart_ns = False, None
        if driving:
            wandering_m = (one.sigma_m for one in (first, second) if one.way in _WANDERING)
            self.changes.least_m = _WANDERING_SIGMAS * max(wandering_m, default=0.0)
            self.changes.prior = _difference_prior(first, second)
            self.changes.earlier_least_m = _EARLIER_SIGMAS * math.hypot(first.sigma_m, second.sigma_m)
            self.changes.add(now_ns, first.height_m - second.height_m)

    def disagreement(self, now_ns: int) -> str:
        """Return by how much the two disagree, and for how long; empty where they do not."""
        change = self.changes.change
        is_recent = 0 <= now_ns - self.tested_ns <= self.rules.kept_s * 1e9
        if not is_recent or (not self.is_apart and change is None):
            return ""
        a, b = self.first, self.second
        text = f"{a.way} {a.height_m:.3f} m, {b.way} {b.height_m:.3f} m"
        if self.is_apart and self.apart_ns is not None:
            text += f" for {(now_ns - self.apart_ns) / 1e9:.0f} s"
        if change is not None:
            text += (
                f" ({a.way} less {b.way} is {change.by_m:+.3f} m from what it was, "
                f"for {(now_ns - change.since_ns) / 1e9:.0f} s)"
            )
        return text


def _difference_prior(*heights: HeightByMethod) -> DifferencePrior:
    matched = next((one for one in heights if one.way == "scan_matching"), None)
    if matched is not None:
        scatter_m = _MATCHED_SCATTER * matched.sigma_m
        return DifferencePrior(correlation_s=_MAP_S, scatter_m=scatter_m, counts=_MATCHED_COUNTS)
    is_stored = any(one.way == "fixed" for one in heights)
    return DifferencePrior(correlation_s=_MANOEUVRE_S) if is_stored else DifferencePrior()


class Comparison:
    """All pairs of methods. `earlier`: their differences in earlier drives."""

    def __init__(self, rules: ComparisonRules, earlier: References | None = None) -> None:
        self._rules = rules
        self._earlier = earlier or {}
        self._pairs: dict[MethodPair, _ComparedPair] = {}

    def test(self, now_ns: int, heights: Sequence[HeightByMethod], *, driving: bool) -> None:
        """Compare the present heights, each method at most once, in the same order every time."""
        for first, second in combinations(heights, 2):
            key = first.way, second.way
            if key not in self._pairs:
                changes = ChangeDetector(rules=self._rules.change, earlier=self._earlier.get(key))
                self._pairs[key] = _ComparedPair(
                    rules=self._rules, changes=changes, first=first, second=second
                )
            self._pairs[key].test(now_ns, first, second, driving=driving)

    @property
    def references(self) -> References:
        """The differences, for the next drive; of methods that gave nothing those of earlier drives."""
        return {**self._earlier, **{key: pair.changes.reference for key, pair in self._pairs.items()}}

    def text(self, now_ns: int) -> str:
        """Return the disagreements, and the one method that deviates from all others, in a line; empty: none."""
        texts = {key: text for key, pair in self._pairs.items() if (text := pair.disagreement(now_ns))}
        if not texts:
            return ""
        compared = {method for key in self._pairs for method in key}
        deviating = [method for method in compared if all(method in key for key in texts)]
        line = "; ".join(list(texts.values())[:2])
        if len(texts) > 2:
            line += f"; {len(texts) - 2} more"
        return f"{deviating[0]} deviates: {line}" if len(compared) > 2 and len(deviating) == 1 else line
