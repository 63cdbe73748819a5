"""The integrity judge: one verdict per fix, from fix, prior pose with road, and antenna height (JP7707657B2, 140, 150).

Pure: messages and times go in, a judgement comes out. Judging has two phases: `judge` decides and remembers nothing but
the fix's id and time; `settle` makes a judgement final, for history and learning. Between them the service may replace
it by that of another estimate of the fix. The decision itself is the list in `decision_table.py`.
"""

from __future__ import annotations

from camber.integrity.checks.carried_position import odds_of
from camber.integrity.checks.fix_conditions import FixConditions, JudgeState
from camber.integrity.checks.fix_history import FixHistory
from camber.integrity.checks.fix_sequence import FixSequence
from camber.integrity.decision_table import decide
from camber.integrity.epoch_inputs import EpochInputs
from camber.integrity.judgement import FixJudgement
from camber.integrity.latest_inputs import LatestInputs
from camber.integrity.learning.height_correction import Correction, Learning
from camber.integrity.learning.height_residual import base_of, independent_residual_of, key_of, residual_of
from camber.integrity.learning.residuals import FixResidual
from camber.integrity.rules import Rules
from camber.schemas.gnss import Fix


class Judge:
    """One verdict on each fix, and what is learnt from it."""

    def __init__(self, rules: Rules, learning: Learning | None = None) -> None:
        self.rules = rules
        self.learning = learning if learning is not None else Learning(rules.learning)
        self.latest = LatestInputs()
        self.before = FixHistory(rules)
        self._state = JudgeState(rules, self.latest, self.before, self.learning)
        self._fixes = FixSequence()
        self._base = ""  # of the newest fix

    @property
    def last_fix_ns(self) -> int | None:
        """Time of the last solution, of whatever quality."""
        return self._fixes.last_ns

    def forget_future(self, now_ns: int) -> None:
        """Drop what is dated ahead: from a clock that is wrong, or from before ours was set back.

        Kept, it would stay the newest for as long as the clock was off, and all that is true would count as old.
        """
        limit_ns = now_ns + round(self.rules.future_limit_s * 1e9)
        self.latest.forget_after(limit_ns)
        self.before.forget_after(limit_ns)
        self._state.carried.forget_after(limit_ns)
        self._fixes.forget_after(limit_ns)

    def inputs(self, at_ns: int, alive: frozenset[str]) -> EpochInputs:
        """What is known at this time besides the fix."""
        return self._state.inputs(at_ns, alive)

    def correction(self, inputs: EpochInputs) -> Correction:
        """The correction in force, for a height that needs no fix."""
        return self.learning.correction(key_of(self._base, inputs.pose, inputs.antenna))

    def judge(self, fix: Fix, now_ns: int, alive: frozenset[str]) -> FixJudgement | None:
        """Return the judgement of a fix, None where it was judged before; `settle` it, or one that replaces it."""
        if self._fixes.register_once(fix):
            return None
        reason = self._fixes.check_arrival(fix, now_ns, self.rules)
        if reason is not None:
            return FixJudgement(fix=fix, verdict="unknown", reason=reason, testable=False)
        return self.examine(fix, alive)

    def examine(self, fix: Fix, alive: frozenset[str], trials: int = 1) -> FixJudgement:
        """Return the judgement of a testable fix, the last of `trials` estimates; nothing is remembered."""
        return decide(FixConditions(fix, self._state, alive=alive, trials=trials))

    def settle(self, judgement: FixJudgement) -> None:
        """Make a judgement final: update history and learning."""
        if not judgement.testable:
            return
        fix = judgement.fix
        speed_m_s = self.latest.speed_at(fix.time_ns, self.rules.motion_max_age_s)
        self._base = base_of(fix)
        self.before.settle(judgement, speed_m_s)
        self._carry(judgement)
        residual = self._residual(judgement, speed_m_s)
        if residual is not None:
            self.learning.update(residual)

    def _residual(self, judgement: FixJudgement, speed_m_s: float | None) -> FixResidual | None:
        if judgement.comparison is not None:
            return residual_of(judgement, judgement.comparison, speed_m_s)
        pose = self.latest.pose_near(judgement.fix.time_ns)
        if pose is None:
            return None
        return independent_residual_of(judgement, pose, self.latest.antenna, speed_m_s)

    def _carry(self, judgement: FixJudgement) -> None:
        """Carry the position of confirmed fixes on by one more fix."""
        fix, pose = judgement.fix, self.latest.pose_near(judgement.fix.time_ns)
        if pose is None or fix.covariance_enu_m2 is None:
            return
        odds = None
        if judgement.confirmed and judgement.comparison is not None:
            wrong = self.rules.levels.wrong_fix
            odds = odds_of(judgement.comparison, wrong, fix.satellites, judgement.trials)
        off_road = judgement.off_road_since_ns is not None
        self._state.carried.settle(fix, pose, odds, off_road=off_road)
