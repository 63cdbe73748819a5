"""Has the difference of two ways changed since the drive began? A tyre, a load, a mount that has come loose.

Two ways differ by constants: what was measured of the vehicle is a centimetre wrong. Those are the same from the
beginning and leave by comparing the difference with itself, so a change may be seen that is smaller than either way's
own σ. What is left is the road's texture, the body's movements, and what a map errs by from place to place. The first
two take turns within a second or two; a map's error stays for ten, and half a minute of it holds two samples, not
three hundred. A difference is taken for a Gauss–Markov process of the pair's own correlation time, averaged over
blocks of driving, and blocks before are compared with the newest ones (a chart of moving means of correlated data;
Montgomery, Introduction to Statistical Quality Control, chapters on moving averages and on autocorrelated data). What
passes is no change of the vehicle: a change has to last for longer than the correlation.

A tyre that was changed in the garage shows against what earlier drives have seen. Each time it is switched on a sensor
errs by another constant, so that takes a larger difference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

BLOCK_NS = 4_000_000_000
"""Of driving: as long as the body's movements and a road's waves take to average out."""
_BLOCK_S = BLOCK_NS / 1e9
_NEWEST = 5  # blocks that are compared with those before, at least
_LASTING = 1.5  # times the correlation, and two blocks at least, must a change have lasted
_EACH = 0.5  # of the change must be in each block of that
_BEFORE = 4  # blocks before there is anything to compare with
_REMEMBERED = 450  # blocks, half an hour: older ones fade
_LONGEST_STEP_NS = 500_000_000
SCATTER_M = 0.002
"""Of a block's mean at least: nobody's road is better."""


@dataclass(frozen=True, slots=True)
class ChangeRules:
    """A change is told beyond `least_m` and `sigmas` of it."""

    least_m: float = 0.006
    sigmas: float = 4.0


@dataclass(frozen=True, slots=True)
class Expected:
    """What is known of a difference before any was seen: after how long of driving it errs by something else, how the
    means of blocks scatter, and for how many independent blocks that word counts against what is seen."""

    correlation_s: float = 1.0
    scatter_m: float = SCATTER_M
    counts: float = 4.0


@dataclass(frozen=True, slots=True)
class Change:
    """The difference is now `by_m` more than it was, since `since_ns`."""

    by_m: float
    since_ns: int


@dataclass(slots=True)
class _Block:
    start_ns: int = 0
    driven_ns: int = 0
    count: int = 0
    sum_m: float = 0.0

    @property
    def mean_m(self) -> float:
        return self.sum_m / self.count


@dataclass(frozen=True, slots=True)
class Reference:
    """What a difference was: mean and sum of squares (Welford) of the means of blocks, of which the oldest fade."""

    count: float = 0.0
    mean_m: float = 0.0
    squares_m2: float = 0.0

    def and_then(self, block_m: float) -> Reference:
        """These and one block more."""
        count, squares_m2 = self.count, self.squares_m2
        if count >= _REMEMBERED:
            count, squares_m2 = count - 1.0, squares_m2 * (1.0 - 1.0 / count)
        off_m = block_m - self.mean_m
        mean_m = self.mean_m + off_m / (count + 1.0)
        return Reference(count + 1.0, mean_m, squares_m2 + off_m * (block_m - mean_m))

    def and_all(self, other: Reference) -> Reference:
        """These and all of the others' (Chan, Golub and LeVeque's update)."""
        count = self.count + other.count
        if not count:
            return self
        off_m, share = other.mean_m - self.mean_m, other.count / count
        squares_m2 = self.squares_m2 + other.squares_m2 + off_m**2 * self.count * share
        kept = min(1.0, _REMEMBERED / count)
        return Reference(kept * count, self.mean_m + share * off_m, kept * squares_m2)

    def sigma_m(self, blocks: int, expected: Expected) -> float:
        """Of the mean of so many blocks against those before, wider where few have shown how they scatter.

        Blocks in a row count as so many independent ones as `_independent` says. 1 + 6 / f is Student's t of f degrees
        of freedom against the normal distribution, at four sigma, within a tenth for f ≥ 8.
        """
        before = _independent(self.count, expected.correlation_s)
        freedom = before + expected.counts - 1.0
        squares_m2 = self.squares_m2 * before / self.count + expected.counts * expected.scatter_m**2
        scatter_m = max(math.sqrt(squares_m2 / freedom), SCATTER_M)
        newest = _independent(blocks, expected.correlation_s)
        return scatter_m * (1.0 + 6.0 / freedom) * math.sqrt(1.0 / newest + 1.0 / before)


def _independent(blocks: float, correlation_s: float) -> float:
    """How many independent blocks have a mean as sure as that of so many in a row."""
    one = _BLOCK_S / correlation_s
    return _mean_variance(one) / _mean_variance(blocks * one)


def _mean_variance(times: float) -> float:
    """Of the mean of a Gauss–Markov process of variance 1 over so many of its correlation times (Papoulis, Probability,
    Random Variables, and Stochastic Processes, chapter on ergodicity)."""
    return 2.0 * (times - 1.0 + math.exp(-times)) / times**2


@dataclass(slots=True)
class ChangeWatch:
    """Of one pair of ways."""

    rules: ChangeRules
    earlier: Reference | None = None
    """Of drives before this one."""
    expected: Expected = Expected()
    least_m: float = 0.0
    """More than the rules' least, where a way may wander by itself so far."""
    earlier_least_m: float = math.inf
    """The same against earlier drives."""
    change: Change | None = None
    _last_ns: int = 0
    _block: _Block = field(default_factory=_Block)
    _newest: list[_Block] = field(default_factory=list)
    _before: Reference = field(default_factory=Reference)
    _was: Reference = field(default_factory=Reference)  # what has changed, where something has

    @property
    def _lasting(self) -> int:
        """Blocks that a change must have lasted."""
        return max(2, math.ceil(_LASTING * self.expected.correlation_s / _BLOCK_S))

    @property
    def reference(self) -> Reference:
        """What the next drive is to compare with; of two that contradict each other the older one."""
        if self.earlier is None:
            return self._before
        if self.change is not None and self._was is self.earlier:
            return self.earlier
        return self.earlier.and_all(self._before)

    def add(self, time_ns: int, difference_m: float) -> None:
        """One difference while the vehicle drives; those of a standing one say the same again and again."""
        step_ns, self._last_ns = time_ns - self._last_ns, time_ns
        block = self._block
        if block.count == 0:
            block.start_ns = time_ns
        elif 0 <= step_ns <= _LONGEST_STEP_NS:
            block.driven_ns += step_ns
        block.count += 1
        block.sum_m += difference_m
        if block.driven_ns >= BLOCK_NS:
            self._block = _Block()
            self._newest.append(block)
            self.change = self._found() if self.change is None else self._left(self.change)

    def _found(self) -> Change | None:
        """From whichever of the newest blocks it may have begun: those from there against all before."""
        before, newest = self._before, self._newest
        most, found = 1.0, None
        for k in range(len(newest) - self._lasting + 1):
            part = newest[k:]
            by_m = _mean(part) - before.mean_m
            limit_m = max(self.rules.least_m, self.least_m, self._limit_m(before, part))
            if abs(by_m) > most * limit_m and _lasts(part, before.mean_m, by_m):
                most, found = abs(by_m) / limit_m, (before, part, Change(by_m, part[0].start_ns))
            before = before.and_then(newest[k].mean_m)
        if found is not None:
            self._before, self._newest, change = found
            self._was = self._before
            return change
        if len(newest) > max(_NEWEST, 2 * self._lasting):
            self._before = self._before.and_then(newest.pop(0).mean_m)
        return self._found_since_earlier()

    def _found_since_earlier(self) -> Change | None:
        earlier, newest = self.earlier, self._newest
        if earlier is None or len(newest) < self._lasting:
            return None
        by_m = _mean(newest) - earlier.mean_m
        least_m = max(self.rules.least_m, self.least_m, self.earlier_least_m)
        if abs(by_m) <= max(least_m, self._limit_m(earlier, newest)):
            return None
        self._was = earlier
        return Change(by_m, newest[0].start_ns)

    def _limit_m(self, before: Reference, newest: list[_Block]) -> float:
        if before.count < _BEFORE:
            return math.inf
        return self.rules.sigmas * before.sigma_m(len(newest), self.expected)

    def _left(self, change: Change) -> Change | None:
        """What is left of a change that was told: it stands until it has been half way back for as long."""
        self._newest = self._newest[-self._lasting :]
        by_m = _mean(self._newest) - self._was.mean_m
        return Change(by_m, change.since_ns) if abs(by_m) >= 0.5 * abs(change.by_m) else None


def _lasts(blocks: list[_Block], before_m: float, by_m: float) -> bool:
    """Is it in each of them, and not an excursion of one?"""
    return all((block.mean_m - before_m) * by_m >= _EACH * by_m**2 for block in blocks)


def _mean(blocks: list[_Block]) -> float:
    return math.fsum(block.mean_m for block in blocks) / len(blocks)
