"""Two hypotheses where fixes contradict a pose that others have anchored by their height alone: which of them is wrong?

A pose that is wide agrees with everything, so the road's height alone confirms a fix, and the filter takes it: a wrong
one captures the pose, and every right one then contradicts it. So what is confirmed under such a pose opens the
hypothesis that the pose is captured. Let A be the run of fixes that agree with the pose since, of duration T_A, and B
the run that contradicts it now and agrees with height, odometry and itself, of duration T_B. One of both is wrong, and
has the road's height by chance. Runs of fixes alternate (Cox 1962, Renewal Theory, chapter 7): wrong ones of mean
duration τ, exponential, right ones of τ_r = τ (1 − π) / π with the share π of wrong fixes. After a wrong run a right
one follows with probability r, else another wrong one. If n runs have been rejected before A,

    A wrong, B right:  (1 − r) · (1/τ) exp(−T_A / τ) · r exp(−T_B / τ_r)
    A right, B wrong:  r · (1/τ_r) exp(−T_A / τ_r) · exp(−T_B / τ)

With r = 1 / (1 + n), as n wrong runs one after the other suggest, and as τ_r is much longer than τ,

    B right : A right ≈ n / (1 + n) · (1 − π) / π · o_A / o_B · exp((T_B − T_A) / τ)

with the odds o of being wrong by the number of satellites. If none was rejected before A, wrong runs are as frequent as
the share π says, and the first two factors are 1 together. Below `least_odds` the fixes of B are *unknown*; from there
on they are confirmed, and the pose follows them. A pose that has been agreed with for so long that no fix makes it
doubtful at once is captured no more.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

_MOST_LOG_ODDS = 30.0  # chosen: odds of 1e13 are certainty, and exp does not overflow


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureRules:
    """When a run of fixes wins against the pose that it contradicts.

    `least_odds`: that the run is right and the pose wrong. Chosen: one such run in twenty may be wrong, about as many
    as of the fixes that the height alone confirms under a wide pose. `settled_odds`: below it, at the first fix of a
    run, the pose is not in doubt. Fixes of a run are at most `longest_gap_s` apart and move with the vehicle within
    `horizontal_m`.
    """

    least_odds: float = 20.0
    settled_odds: float = 1e-3
    longest_gap_s: float = 1.0
    horizontal_m: float = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class FixRun:
    """Fixes one after the other: first and last time, odds that such a fix is wrong before any test, offset from the
    pose east and north of the last one, and their number. `carried`: the fix goes on with the integers of the one
    before, as the engine has carried them (`is_same_draw`); `carried_ns` is the time that such fixes take, which is no
    evidence: a wrong one would have gone on as well."""

    first_ns: int
    last_ns: int
    odds: float
    offset_m: tuple[float, float]
    fixes: int = 1
    carried: bool = False
    carried_ns: int = 0

    @property
    def duration_s(self) -> float:
        """From the first to the last, without the time of carried integers."""
        return (self.last_ns - self.first_ns - self.carried_ns) / 1e9

    def extend(self, later: FixRun) -> FixRun:
        """With one more fix; the best odds count, for one right fix of a run makes it right."""
        carried_ns = self.carried_ns + later.carried_ns
        if later.carried:
            carried_ns += later.first_ns - self.last_ns
        return replace(
            later,
            first_ns=self.first_ns,
            odds=min(self.odds, later.odds),
            fixes=self.fixes + later.fixes,
            carried_ns=carried_ns,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturedPose:
    """The hypothesis: `support` of the pose since it was wide, None: not in doubt; `rival` contradicts it.

    `won`: the rival has been confirmed, and the pose has not followed yet. `rejected` is the last run that was
    rejected, `rejected_runs` their number since the last confirmed fix, `rejected_before` that before the support.
    """

    support: FixRun | None = None
    rival: FixRun | None = None
    won: bool = False
    rejected: FixRun | None = None
    rejected_runs: int = 0
    rejected_before: int = 0

    def rival_with(self, fix: FixRun, rules: CaptureRules) -> FixRun:
        """The run that contradicts the pose, with one more fix."""
        return _continued(self.rival, fix, rules)

    def odds_of(self, rival: FixRun, *, prior: float, episode_s: float) -> float:
        """That the rival is right and the pose captured; 0 where the pose is not in doubt."""
        if self.support is None:
            return 0.0
        longer_s = min(max(rival.duration_s - self.support.duration_s, -1e3), 1e3)
        n = self.rejected_before
        before = n / (1.0 + n) * (1.0 - prior) / prior if n else 1.0
        return before * self.support.odds / rival.odds * math.exp(min(longer_s / episode_s, _MOST_LOG_ODDS))

    def contradicted(self, fix: FixRun, rules: CaptureRules, *, won: bool) -> CapturedPose:
        """After a fix that contradicts the pose and was held back, or confirmed where its run has `won`."""
        return replace(self, rival=self.rival_with(fix, rules), won=won)

    def rejects(self, fix: FixRun, rules: CaptureRules) -> CapturedPose:
        """After a fix that was compared and not confirmed."""
        run = _continued(self.rejected, fix, rules)
        return replace(self, rejected=run, rejected_runs=self.rejected_runs + (run is fix))

    def agreed(self, fix: FixRun, rules: CaptureRules, *, opens: bool) -> CapturedPose:
        """After a confirmed fix that agrees with the pose; `opens`: by its height alone, under a wide pose."""
        if self.won and self.rival is not None:  # the pose has followed
            return CapturedPose(support=self.rival.extend(fix), rejected_before=self.rejected_before)
        support = self.support
        # A pose that has become wide meanwhile is anchored anew.
        if opens and (support is None or fix.first_ns - support.last_ns > rules.longest_gap_s * 1e9):
            return CapturedPose(support=fix, rejected_before=self.rejected_runs)
        if support is None:
            return CapturedPose()
        return CapturedPose(support=support.extend(fix), rejected_before=self.rejected_before)

    def settled(self, rules: CaptureRules, *, prior: float, episode_s: float) -> CapturedPose:
        """No hypothesis any more where the support has lasted so long that no fix would make it doubtful."""
        if self.support is None:
            return self
        start = replace(self.support, last_ns=self.support.first_ns)
        doubtful = self.odds_of(start, prior=prior, episode_s=episode_s) >= rules.settled_odds
        return self if doubtful else CapturedPose()


def _continued(run: FixRun | None, fix: FixRun, rules: CaptureRules) -> FixRun:
    """The run with one more fix; the fix itself where it does not continue it."""
    if run is None or not 0 < fix.first_ns - run.last_ns <= rules.longest_gap_s * 1e9:
        return fix
    (east, north), (east_before, north_before) = fix.offset_m, run.offset_m
    if not math.hypot(east - east_before, north - north_before) <= rules.horizontal_m:
        return fix
    return run.extend(fix)
