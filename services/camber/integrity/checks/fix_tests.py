"""The examination of one fix: the tests in their order, and the reason of the first that has something to say.

The order is that of the table in `docs/services/integrity.md`. Nothing is remembered here, and nothing changed: what
was heard, what the fixes before have left and what was learnt is only asked.
"""

from __future__ import annotations

import math
from dataclasses import replace

from camber.integrity.checks.chi2_test import AGREES, CONTRADICTS
from camber.integrity.checks.comparison import FixComparison, compare
from camber.integrity.checks.consistency import (
    ALL_AGREE,
    HEIGHT_CONTRADICTS,
    POSITION_CONTRADICTS,
    POSITION_UNVERIFIED,
    REASONS,
)
from camber.integrity.checks.fix_history import FixHistory, is_precise
from camber.integrity.checks.height_check import HeightModel, road_at
from camber.integrity.checks.pose_gate import offset_from_pose, pose_sigma_m
from camber.integrity.checks.verification import phase_residuals_agree, scan_matching_agrees, verified
from camber.integrity.epoch_inputs import age_s
from camber.integrity.judgement import FixJudgement
from camber.integrity.latest_inputs import LatestInputs
from camber.integrity.learning.height_correction import Learning
from camber.integrity.learning.height_residual import base_of, key_of
from camber.integrity.protection.position_output import is_provisional
from camber.integrity.re_estimation.requests import limits_after
from camber.integrity.rules import Rules
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Evidence, Reason, VerdictValue


class FixTests:
    """Says what is to be said of a fix that can be judged."""

    def __init__(self, rules: Rules, heard: LatestInputs, before: FixHistory, learning: Learning) -> None:
        self._rules, self._heard, self._before, self._learning = rules, heard, before, learning

    def examine(self, fix: Fix, alive: frozenset[str], trials: int) -> FixJudgement:
        """What is to be said of it, the last of so many estimates; `alive` are the services on the bus."""
        inputs = self._heard.inputs(fix.time_ns, alive)
        key = key_of(base_of(fix), inputs.pose, inputs.antenna)
        draft = FixJudgement(
            fix,
            "unknown",
            "none",
            correction_m=self._learning.correction(key).correction_m,
            pose=inputs.pose,
            antenna=inputs.antenna,
            cause=self._learning.diagnosis(None).cause,
            trials=trials,
        )
        against = self._against_itself(draft)
        if against is not None:
            return against
        reason = inputs.missing(fix.time_ns, self._rules)
        return self._locate(draft) if reason is None else replace(draft, reason=reason)

    def _against_itself(self, draft: FixJudgement) -> FixJudgement | None:
        """What is against a fix before anything else is asked: its phases, its receiver, the integers before it."""
        fix, tests = draft.fix, self._rules.determination.tests
        if "phase_residuals" in tests and fix.phase_residuals == "contradictory":
            return replace(draft, verdict="erroneous", reason="phase_residuals_contradict")
        warning = self._heard.receiver.warning(fix.time_ns, self._rules.receiver_max_age_s)
        if "receiver" in tests and warning is not None:
            return replace(draft, reason="receiver_warns", detail=warning)
        if "continuity" in tests and self._before.integers.contradict(fix, self._rules.series.longest_gap_s):
            ago_s = age_s(self._before.integers.last_ns, fix.time_ns)
            detail = f"other integers than those confirmed {ago_s:.1f} s ago"
            return replace(draft, reason="continuity_disagrees", detail=detail)
        return None

    def _locate(self, draft: FixJudgement) -> FixJudgement:
        """Is there a road below the fix, known well enough to check anything by it?"""
        fix, pose, rules = draft.fix, draft.pose, self._rules.determination
        assert pose is not None
        if pose.road.datum is not None and pose.road.datum != fix.datum:
            return replace(draft, reason="datum_mismatch", detail=f"fix {fix.datum}, map {pose.road.datum}")
        if not rules.asks_height:
            return self._determine(draft, None)
        # The road's planes are told from where the pose was when it was made.
        road = road_at(pose.road, *offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, pose.time_ns))
        if road is None:
            return self._off_the_road(draft)
        assert draft.antenna is not None
        assert draft.antenna.height_m is not None
        assert draft.antenna.sigma_m is not None
        correction = self._learning.correction(key_of(base_of(fix), pose, draft.antenna))
        height = HeightModel(
            draft.antenna.height_m,
            correction.correction_m,
            math.hypot(draft.antenna.sigma_m, correction.sigma_m),
        )
        model_sigma_m = math.sqrt(height.variance_m2(road))
        if not model_sigma_m <= rules.largest_tolerance_m:
            worse: Reason = "road_unknown" if not road.sigma_m <= height.sigma_m else "antenna_height_missing"
            most = f"expected at most the largest tolerance, {rules.largest_tolerance_m} m"
            return replace(draft, reason=worse, detail=f"σ {model_sigma_m:.2f} m of road and antenna, {most}")
        if not math.isfinite(height.expected_m(road)):
            return replace(draft, reason="road_unknown", detail="the height is not a number")
        cause = self._learning.diagnosis(road.surface_id).cause
        return self._determine(replace(draft, road=road, cause=cause), height)

    def _off_the_road(self, draft: FixJudgement) -> FixJudgement:
        """The planes of the map do not reach the fix: because it is off the pose, or because the pose is."""
        assert draft.pose is not None
        limits = limits_after(self._rules.determination, draft.trials)
        result = compare(draft.fix, draft.pose, None, None, self._rules.true_sigma, limits)
        if "position" in self._rules.determination.tests and result.position == CONTRADICTS:
            return self._disagreed(replace(draft, comparison=result), result, POSITION_CONTRADICTS)
        detail = "the fix is beyond the surface's plane"
        return replace(draft, reason="pose_too_uncertain", detail=detail)

    def _determine(self, draft: FixJudgement, height: HeightModel | None) -> FixJudgement:
        """HeightModel and position, alone and together."""
        assert draft.pose is not None
        limits = limits_after(self._rules.determination, draft.trials)
        result = compare(draft.fix, draft.pose, draft.road, height, self._rules.true_sigma, limits)
        draft = replace(draft, comparison=result)
        if result.outcome == ALL_AGREE:
            return self._agreed(draft, result)
        return self._disagreed(draft, result, result.outcome)

    def _agreed(self, draft: FixJudgement, result: FixComparison) -> FixJudgement:
        """Confirmed, where anything speaks for the fix and the start is over."""
        assert draft.pose is not None
        starting, rules = is_provisional(draft.pose), self._rules
        if "subset_agreement" in rules.determination.tests and draft.fix.subset_agreement == "disagree":
            return self._split(draft)
        evidence = self._evidence(draft, result)
        if not evidence:
            detail = "nothing that is asked speaks for the fix"
            return replace(draft, reason="height_unverified", detail=detail)
        if starting:
            speed_m_s = self._heard.speed_at(draft.fix.time_ns, rules.motion_max_age_s)
            count = self._before.start_after(draft.fix, speed_m_s)
            if not count.enough(rules.start):
                detail = f"{count.fixes} in a row agree, {rules.start.fixes} are needed"
                return replace(draft, reason="starting", detail=detail)
            evidence = (*evidence, "track")
        reason: Reason = "height_agrees" if rules.determination.asks_height else "none"
        return replace(draft, verdict="confirmed", reason=reason, evidence=evidence)

    def _evidence(self, draft: FixJudgement, result: FixComparison) -> tuple[Evidence, ...]:
        """What speaks for a fix that nothing speaks against, and what could have spoken against it."""
        assert draft.pose is not None
        rules, evidence = self._rules.determination, list[Evidence]()
        if rules.asks_height:
            evidence.append("height")
        # A pose that stems from the fixes themselves, or is metres wide, agrees with everything.
        narrow = result.acceptance_radius_m <= rules.position_cap_m
        if rules.asks_position and narrow and not is_provisional(draft.pose):
            evidence.append("position")
        if "phase_residuals" in rules.tests and draft.fix.phase_residuals == "consistent":
            evidence.append("phase_residuals")
        if "subset_agreement" in rules.tests and draft.fix.subset_agreement == "agree":
            evidence.append("subset_agreement")
        return tuple(evidence)

    def _split(self, draft: FixJudgement) -> FixJudgement:
        """All else agrees, but a part of its satellites is fixed elsewhere: one of both is wrong. Verified?"""
        detail = "without one system its satellites are fixed elsewhere"
        held = replace(draft, reason="subsets_disagree", detail=detail)
        return self._unless_verified(held, self._witnesses(held)) if self._may_be_verified(held) else held

    def _disagreed(self, draft: FixJudgement, result: FixComparison, outcome: int) -> FixJudgement:
        """Common to all fixes? Verified by something else? Else erroneous, or not known."""
        assert draft.pose is not None
        starting = is_provisional(draft.pose)
        reason, detail = REASONS[outcome], result.describe(pose_sigma_m(draft.pose))
        if draft.cause == "base":
            return replace(draft, reason="common_offset", detail=f"{reason}: {detail}")
        # The place of a provisional pose is that of the fixes before: they contradict one another.
        wrong = outcome >= HEIGHT_CONTRADICTS and not (starting and outcome == POSITION_CONTRADICTS)
        # A fix that is not where the vehicle is says nothing of the road there.
        road = None if result.position == CONTRADICTS else draft.road
        verdict: VerdictValue = "erroneous" if wrong else "unknown"
        held = replace(draft, verdict=verdict, reason=reason, detail=detail, road=road)
        if not self._may_be_verified(draft):
            return held
        witnesses = self._witnesses(draft)
        if result.position != AGREES:
            # With the height agreed, the pose is in doubt as much as the fix: what speaks owes nothing to the pose.
            doubtful = outcome == POSITION_UNVERIFIED
            witnesses = tuple(w for w in witnesses if doubtful and w == "ambiguity_continuity")
        return self._unless_verified(held, witnesses)

    def _may_be_verified(self, draft: FixJudgement) -> bool:
        """Is the pose of its own making, and the fix sharp enough not to fit anything?"""
        assert draft.pose is not None
        return not is_provisional(draft.pose) and is_precise(draft.fix, self._rules)

    def _unless_verified(self, held: FixJudgement, witnesses: tuple[Evidence, ...]) -> FixJudgement:
        """As it was held, or confirmed where what speaks for it suffices."""
        if not verified(frozenset(witnesses), self._rules.verification):
            return held
        return replace(held, verdict="confirmed_after_verification", evidence=witnesses)

    def _witnesses(self, draft: FixJudgement) -> tuple[Evidence, ...]:
        """What speaks for the fix although height or position are against it."""
        fix, pose, rules = draft.fix, draft.pose, self._rules
        assert pose is not None
        spoken: dict[Evidence, bool] = {
            "time_series": self._continues(fix),
            "ambiguity_continuity": self._before.integers.carry(fix, rules.verification),
            "scan_matching": rules.determination.asks_position
            and scan_matching_agrees(
                pose,
                pose_sigma_m(pose),
                fix.time_ns,
                rules.pose_max_age_s,
                rules.verification.scan_sigma_m,
            ),
            "phase_residuals": phase_residuals_agree(fix, rules.verification),
        }
        return tuple(name for name, speaks in spoken.items() if speaks)

    def _continues(self, fix: Fix) -> bool:
        """Does it continue the right ones before it, by the poses of both times?"""
        last = self._before.chain
        if last is None:
            return False
        then, now = self._heard.pose_near(last.time_ns), self._heard.pose_near(fix.time_ns)
        return self._before.is_consistent_with_previous(fix, then, now)
