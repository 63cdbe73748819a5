"""The judge: from fix, pose with road, and antenna height to one verdict per fix (H, parts 140 and 150).

Pure: messages and times go in, a judgement comes out. `heard.py` keeps what came beside the fixes, `examination.py`
says what is to be said of one, `fixes_before.py` keeps what follows for the next; here is what becomes of each.
"""

from __future__ import annotations

from collections.abc import Callable

from camber.integrity.checks.fix_history import FixHistory
from camber.integrity.checks.fix_sequence import FixSequence
from camber.integrity.checks.fix_tests import FixTests
from camber.integrity.epoch_inputs import EpochInputs, unusable_fix
from camber.integrity.judgement import FixJudgement
from camber.integrity.latest_inputs import LatestInputs
from camber.integrity.learning.height_correction import Correction, Learning
from camber.integrity.learning.height_residual import base_of, key_of, residual_of
from camber.integrity.rules import Rules
from camber.schemas.gnss import Fix


class Judge:
    """One verdict on each fix, and what is learnt from it."""

    def __init__(self, rules: Rules, learning: Learning | None = None) -> None:
        self.rules = rules
        self.learning = learning if learning is not None else Learning(rules.learning)
        self.heard = LatestInputs()
        self.before = FixHistory(rules)
        self._examination = FixTests(rules, self.heard, self.before, self.learning)
        self._fixes = FixSequence()
        self._base = ""  # of the newest fix

    @property
    def last_fix_ns(self) -> int | None:
        """Time of the last solution heard, of whatever quality."""
        return self._fixes.last_ns

    def forget_future(self, now_ns: int) -> None:
        """Drop what is dated ahead: from a clock that is wrong, or from before ours was set back.

        Kept, it would stay the newest for as long as the clock was off, and all that is true would count as old.
        """
        limit_ns = now_ns + round(self.rules.future_limit_s * 1e9)
        self.heard.forget_after(limit_ns)
        self.before.forget_after(limit_ns)
        self._fixes.forget_after(limit_ns)

    def correction(self, inputs: EpochInputs) -> Correction:
        """The correction in force, for a height that needs no fix."""
        return self.learning.correction(key_of(self._base, inputs.pose, inputs.antenna))

    def judge(
        self,
        fix: Fix,
        now_ns: int,
        alive: frozenset[str],
        others: Callable[[FixJudgement], FixJudgement] = lambda judgement: judgement,
    ) -> FixJudgement | None:
        """The one verdict on a fix, None where it has had it; what is learnt from it is learnt here.

        `others` may put the judgement of another estimate in place of the first one.
        """
        if self._fixes.register_once(fix):
            return None
        reason = self._fixes.check_epoch(fix, now_ns, self.rules) or unusable_fix(fix, self.rules)
        if reason is not None:
            result = others(FixJudgement(fix, "unknown", reason))
            return self.settle(result) if result.confirmed else result
        return self.settle(others(self.examine(fix, alive)))

    def examine(self, fix: Fix, alive: frozenset[str], trials: int = 1) -> FixJudgement:
        """What is to be said of a usable fix, the last of so many estimates. Nothing is remembered until `settle`."""
        return self._examination.examine(fix, alive, trials)

    def settle(self, judgement: FixJudgement) -> FixJudgement:
        """Make a judgement the final one: remember what follows from it for the fixes to come."""
        fix = judgement.fix
        speed_m_s = self.heard.speed_at(fix.time_ns, self.rules.motion_max_age_s)
        self._base = base_of(fix)
        self.before.settle(judgement, speed_m_s)
        if judgement.comparison is not None:
            self.learning.update(residual_of(judgement, judgement.comparison, speed_m_s))
        return judgement
