"""Change of the difference of two methods since the drive began: a tyre, a load, a mount that has come loose.

Two methods differ by constants: the vehicle's dimensions are known to a centimetre. Comparing the difference with its
earlier values removes them, so that a change smaller than the σ of both methods is detected. What remains is the
road's texture, the body's movements, and the map's error from place to place. The first two average out within a
second or two; a map's error stays for ten, and half a minute of it holds two samples, not three hundred. So the
difference is taken for a Gauss–Markov process with the pair's own correlation time, averaged over blocks of driving,
and earlier blocks are compared with the newest (a chart of moving means of correlated data; Montgomery, Introduction
to Statistical Quality Control, chapters on moving averages and on autocorrelated data). A change must last longer
than the correlation: what passes is none of the vehicle.

A tyre that was changed in the garage shows against earlier drives. A sensor has another constant error each time it is
switched on, so that needs a larger difference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

BLOCK_NS = 4_000_000_000
"""Chosen: of driving, in which the body's movements and a road's waves average out."""
_BLOCK_S = BLOCK_NS / 1e9
_NEWEST = 5  # chosen: blocks, at least, that are compared with those before
_LASTING = 1.5  # chosen: times the correlation, and two blocks at least, that a change must have lasted
_EACH = 0.5  # chosen: share of the change that must be in each block of that
_BEFORE = 4  # chosen: blocks before a comparison is possible
REMEMBERED_BLOCKS = 450
"""Chosen: half an hour; older ones fade."""
_LONGEST_STEP_NS = 500_000_000  # chosen: a longer gap between two differences counts as no driving
SCATTER_M = 0.002
"""Chosen: least scatter of a block's mean; no road is smoother."""


@dataclass(frozen=True, slots=True)
class ChangeRules:
    """A change is reported beyond both `least_m` and `sigmas` of it."""

    least_m: float = 0.006
    sigmas: float = 4.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferencePrior:
    """Knowledge of a difference before any measurement: correlation time of its error, scatter of the means of blocks,
    and the number of independent blocks for which this counts."""

    correlation_s: float = 1.0
    scatter_m: float = SCATTER_M
    counts: float = 4.0


@dataclass(frozen=True, slots=True)
class Change:
    """The difference is now `by_m` more than it was, since `since_ns`."""

    by_m: float
    since_ns: int


@dataclass(slots=True, kw_only=True)
class _DrivenBlock:
    start_ns: int = 0
    driven_ns: int = 0
    count: int = 0
    sum_m: float = 0.0

    @property
    def mean_m(self) -> float:
        return self.sum_m / self.count


class Reference(NamedTuple):
    """Earlier differences: mean and sum of squares (Welford) of the means of blocks, of which the oldest fade."""

    blocks: float = 0.0
    mean_m: float = 0.0
    squares_m2: float = 0.0

    def add(self, block_m: float) -> Reference:
        """Return these blocks and one more."""
        blocks, squares_m2 = self.blocks, self.squares_m2
        if blocks >= REMEMBERED_BLOCKS:
            blocks, squares_m2 = blocks - 1.0, squares_m2 * (1.0 - 1.0 / blocks)
        off_m = block_m - self.mean_m
        mean_m = self.mean_m + off_m / (blocks + 1.0)
        return Reference(blocks + 1.0, mean_m, squares_m2 + off_m * (block_m - mean_m))

    def merged(self, other: Reference) -> Reference:
        """Return these blocks and all of the other's (Chan, Golub and LeVeque's update)."""
        blocks = self.blocks + other.blocks
        if not blocks:
            return self
        off_m, share = other.mean_m - self.mean_m, other.blocks / blocks
        squares_m2 = self.squares_m2 + other.squares_m2 + off_m**2 * self.blocks * share
        kept = min(1.0, REMEMBERED_BLOCKS / blocks)
        return Reference(kept * blocks, self.mean_m + share * off_m, kept * squares_m2)

    def sigma_m(self, newest: int, prior: DifferencePrior) -> float:
        """Return σ of the mean of the newest blocks against these, wider where few show how they scatter.

        Consecutive blocks count as fewer independent ones, `_independent`. 1 + 6 / f is Student's t of f degrees of
        freedom against the normal distribution, at four sigma, within a tenth for f ≥ 8.
        """
        before = _independent(self.blocks, prior.correlation_s)
        freedom = before + prior.counts - 1.0
        squares_m2 = self.squares_m2 * before / self.blocks + prior.counts * prior.scatter_m**2
        scatter_m = max(math.sqrt(squares_m2 / freedom), SCATTER_M)
        after = _independent(newest, prior.correlation_s)
        return scatter_m * (1.0 + 6.0 / freedom) * math.sqrt(1.0 / after + 1.0 / before)


def _independent(blocks: float, correlation_s: float) -> float:
    """Return the number of independent blocks whose mean is as certain as that of consecutive ones."""
    one = _BLOCK_S / correlation_s
    return _mean_variance(one) / _mean_variance(blocks * one)


def _mean_variance(times: float) -> float:
    """Return the variance of the mean of a Gauss–Markov process of variance 1 over so many of its correlation times
    (Papoulis, Probability, Random Variables, and Stochastic Processes, chapter on ergodicity)."""
    return 2.0 * (times - 1.0 + math.exp(-times)) / times**2


_NO_BLOCKS = Reference()


@dataclass(slots=True, kw_only=True)
class ChangeDetector:
    """Detects changes of one pair's difference. `earlier`: of earlier drives.

    `least_m`: more than the rules' least, where a method may wander by so much; `earlier_least_m`: the same against
    earlier drives.
    """

    rules: ChangeRules
    earlier: Reference | None = None
    prior: DifferencePrior = DifferencePrior()
    least_m: float = 0.0
    earlier_least_m: float = math.inf
    change: Change | None = None
    _last_ns: int = 0
    _block: _DrivenBlock = field(default_factory=_DrivenBlock)
    _newest: list[_DrivenBlock] = field(default_factory=list)
    _before: Reference = _NO_BLOCKS
    _changed: Reference = _NO_BLOCKS  # what the newest blocks differ from, where something has changed

    @property
    def _lasting(self) -> int:
        """Blocks that a change must have lasted."""
        return max(2, math.ceil(_LASTING * self.prior.correlation_s / _BLOCK_S))

    @property
    def reference(self) -> Reference:
        """The reference for the next drive; of two that contradict each other the older one."""
        if self.earlier is None:
            return self._before
        if self.change is not None and self._changed is self.earlier:
            return self.earlier
        return self.earlier.merged(self._before)

    def add(self, time_ns: int, difference_m: float) -> None:
        """Add a difference of a driving vehicle; those at a standstill repeat one another."""
        step_ns, self._last_ns = time_ns - self._last_ns, time_ns
        block = self._block
        if block.count == 0:
            block.start_ns = time_ns
        elif 0 <= step_ns <= _LONGEST_STEP_NS:
            block.driven_ns += step_ns
        block.count += 1
        block.sum_m += difference_m
        if block.driven_ns >= BLOCK_NS:
            self._block = _DrivenBlock()
            self._newest.append(block)
            self.change = self._detect() if self.change is None else self._remaining(self.change)

    def _detect(self) -> Change | None:
        """Return the largest change from one of the newest blocks on, against all blocks before it."""
        before, newest = self._before, self._newest
        most, largest = 1.0, None
        for k in range(len(newest) - self._lasting + 1):
            part = newest[k:]
            by_m = _mean(part) - before.mean_m
            limit_m = max(self.rules.least_m, self.least_m, self._limit_m(before, part))
            if abs(by_m) > most * limit_m and _is_lasting(part, before.mean_m, by_m):
                most, largest = abs(by_m) / limit_m, (before, part, Change(by_m, part[0].start_ns))
            before = before.add(newest[k].mean_m)
        if largest is not None:
            self._before, self._newest, change = largest
            self._changed = self._before
            return change
        if len(newest) > max(_NEWEST, 2 * self._lasting):
            self._before = self._before.add(newest.pop(0).mean_m)
        return self._detect_since_earlier()

    def _detect_since_earlier(self) -> Change | None:
        earlier, newest = self.earlier, self._newest
        if earlier is None or len(newest) < self._lasting:
            return None
        by_m = _mean(newest) - earlier.mean_m
        least_m = max(self.rules.least_m, self.least_m, self.earlier_least_m)
        if abs(by_m) <= max(least_m, self._limit_m(earlier, newest)):
            return None
        self._changed = earlier
        return Change(by_m, newest[0].start_ns)

    def _limit_m(self, before: Reference, newest: list[_DrivenBlock]) -> float:
        if before.blocks < _BEFORE:
            return math.inf
        return self.rules.sigmas * before.sigma_m(len(newest), self.prior)

    def _remaining(self, change: Change) -> Change | None:
        """Return what remains of a reported change: it ends when half of it has gone for as long as it had to last."""
        self._newest = self._newest[-self._lasting :]
        by_m = _mean(self._newest) - self._changed.mean_m
        return Change(by_m, change.since_ns) if abs(by_m) >= 0.5 * abs(change.by_m) else None


def _is_lasting(blocks: list[_DrivenBlock], before_m: float, by_m: float) -> bool:
    """Whether each of the blocks has the change, not one alone."""
    return all((block.mean_m - before_m) * by_m >= _EACH * by_m**2 for block in blocks)


def _mean(blocks: list[_DrivenBlock]) -> float:
    return math.fsum(block.mean_m for block in blocks) / len(blocks)
