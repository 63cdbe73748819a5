"""The decision on a testable fix as data: ordered rules, of which the first that applies gives verdict and reason.

The judge runs exactly these rules; `camber.tools.generate_docs.decision_table` prints them in
`docs/services/integrity.md`. A condition may rely on all rules before it not having applied.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from camber.integrity.checks.chi2_test import CONTRADICTS
from camber.integrity.checks.consistency_tests import (
    ALL_AGREE,
    BOTH_CONTRADICT,
    HEIGHT_CONTRADICTS,
    HEIGHT_UNVERIFIED,
    POSITION_CONTRADICTS,
    POSITION_UNVERIFIED,
    REASONS,
)
from camber.integrity.checks.fix_conditions import FixConditions
from camber.integrity.epoch_inputs import ANTENNA_CHECKS, POSE_CHECKS, ROAD_CHECKS, Check, EpochInputs
from camber.integrity.judgement import FixJudgement
from camber.schemas.integrity import Evidence, Reason, VerdictValue

Condition = Callable[[FixConditions], bool]
Detail = Callable[[FixConditions], str]


@dataclass(frozen=True, slots=True, kw_only=True)
class DecisionRule:
    """One check: where `applies` holds and no rule before did, `outcome` is the verdict, with this reason.

    `compared`: the verdict rests on the comparison with pose and height model and publishes its figures. `for_height`:
    it is only checked where the height is tested.
    """

    reason: Reason
    explanation: str
    applies: Condition
    detail: Detail
    outcome: VerdictValue = "unknown"
    evidence: Callable[[FixConditions], tuple[Evidence, ...]] = lambda _: ()
    compared: bool = False
    for_height: bool = False


def _rule(
    reason: Reason, explanation: str, applies: Condition, detail: Detail = lambda _: "", **more: Any
) -> DecisionRule:
    return DecisionRule(reason=reason, explanation=explanation, applies=applies, detail=detail, **more)


_compared = partial(_rule, compared=True)


def _input_rule(check: Check[EpochInputs], *, for_height: bool) -> DecisionRule:
    applies = check.applies
    return _rule(
        check.reason,
        check.explanation,
        lambda tests: applies(tests.inputs, tests.fix.time_ns, tests.rules),
        for_height=for_height,
    )


def _verified_rule(reason: Reason, explanation: str, applies: Condition, detail: Detail) -> DecisionRule:
    return _compared(
        reason,
        f"{explanation}, and [other evidence](#verification) confirms the fix",
        lambda tests: applies(tests) and bool(tests.verification),
        detail,
        outcome="confirmed_after_verification",
        evidence=lambda tests: tests.verification,
    )


def _has_outcome(outcome: int) -> Condition:
    return lambda tests: tests.outcome == outcome


def _figures(tests: FixConditions) -> str:
    return tests.detail


def _failed_rule(outcome: int, verdict: VerdictValue, explanation: str) -> DecisionRule:
    return _compared(REASONS[outcome], explanation, _has_outcome(outcome), _figures, outcome=verdict)


def _independent_figures(tests: FixConditions) -> str:
    return tests.independent_detail


def _uncertain_model(tests: FixConditions) -> str:
    most = f"expected at most the largest tolerance, {tests.determination.largest_tolerance_m} m"
    return f"σ {tests.model_sigma_m:.2f} m of road and antenna, {most}"


def _disagreeing_subset(tests: FixConditions) -> str:
    return "without one system its satellites are fixed elsewhere"


def _evidence_for_confirmation(tests: FixConditions) -> tuple[Evidence, ...]:
    return (*tests.evidence, "track") if tests.is_starting else tests.evidence


TEST_RULES: tuple[DecisionRule, ...] = (
    _rule(
        "phase_residuals_contradict",
        "its phases contradict its integers",
        lambda tests: tests.has_contradictory_phases,
        outcome="erroneous",
    ),
    _rule(
        "receiver_warns",
        "the receiver warns of spoofing, critical jamming or failed RAIM, within the last 2 s",
        lambda tests: bool(tests.receiver_warning),
        lambda tests: tests.receiver_warning,
    ),
    _rule(
        "continuity_disagrees",
        "its integers contradict those of a fix confirmed within `series_gap_s`",
        lambda tests: tests.contradicts_confirmed_integers,
        lambda tests: f"other integers than those confirmed {tests.since_confirmed_s:.1f} s ago",
    ),
    *(_input_rule(check, for_height=False) for check in POSE_CHECKS),
    *(_input_rule(check, for_height=True) for check in (*ANTENNA_CHECKS, *ROAD_CHECKS)),
    _rule(
        "datum_mismatch",
        "fix and road are in different datums",
        lambda tests: tests.has_datum_mismatch,
        lambda tests: f"fix {tests.fix.datum}, map {tests.pose.road.datum}",
    ),
    _rule(
        "pose_too_uncertain",
        "beyond the planes of the map without contradicting the pose: the pose is too uncertain",
        lambda tests: tests.is_off_road and not tests.contradicts_pose,
        lambda _: "the fix is beyond the surface's plane",
    ),
    _rule(
        "road_unknown",
        "σ of road and antenna height above the largest tolerance, the road is worse known",
        lambda tests: tests.has_uncertain_model and tests.has_uncertain_road,
        _uncertain_model,
    ),
    _rule(
        "antenna_height_missing",
        "σ of road and antenna height above the largest tolerance, the antenna is worse known",
        lambda tests: tests.has_uncertain_model,
        _uncertain_model,
    ),
    _rule(
        "road_unknown",
        "the expected height is not a number",
        lambda tests: tests.has_invalid_model,
        lambda _: "the height is not a number",
    ),
    _compared(
        "common_offset",
        "a test below contradicts or is unverified, and all fixes have one common offset: base, datum or drift",
        lambda tests: tests.outcome != ALL_AGREE and tests.has_common_offset,
        lambda tests: f"{REASONS[tests.outcome]}: {tests.detail}",
    ),
    _compared(
        "common_offset",
        "all fixes have one offset from the independent position: base, datum, or fixes that are led away",
        lambda tests: tests.independent is not None and tests.has_common_offset,
        lambda tests: tests.independent_detail,
    ),
    *(
        _verified_rule(REASONS[outcome], explanation, _has_outcome(outcome), _figures)
        for outcome, explanation in (
            (BOTH_CONTRADICT, "height and position contradict together, the position alone agrees"),
            (HEIGHT_CONTRADICTS, "the height contradicts, the position agrees"),
            (HEIGHT_UNVERIFIED, "the height is unverified, the position agrees"),
            (POSITION_UNVERIFIED, "the position is unverified, the height agrees"),
        )
    ),
    _failed_rule(
        BOTH_CONTRADICT, "erroneous", "height and position contradict, each alone or only both together"
    ),
    _failed_rule(HEIGHT_CONTRADICTS, "erroneous", "the height contradicts"),
    _compared(
        "position_disagrees",
        "the position contradicts a pose that rests on unconfirmed fixes: fixes contradict one another",
        lambda tests: tests.outcome == POSITION_CONTRADICTS and tests.is_starting,
        _figures,
    ),
    _compared(
        "position_disagrees",
        "the position contradicts a pose that rests on fixes and agrees with the independent position: "
        "the pose may be wrong",
        lambda tests: (
            tests.outcome == POSITION_CONTRADICTS and tests.has_position_evidence and tests.has_pose_of_fixes
        ),
        _independent_figures,
    ),
    _compared(
        "position_disagrees",
        "the position contradicts a pose that others have anchored by their height alone, and a run of such fixes "
        "[is likelier to be right](../theory/integrity.md#a-captured-pose)",
        lambda tests: tests.may_be_captured and tests.wins_against_pose,
        lambda tests: tests.rival_detail,
        outcome="confirmed_after_verification",
        evidence=lambda _: ("height", "track"),
    ),
    _compared(
        "position_disagrees",
        "the position contradicts such a pose, and the odds do not suffice: the fix or the pose is wrong",
        lambda tests: tests.may_be_captured,
        lambda tests: tests.rival_detail,
    ),
    _failed_rule(POSITION_CONTRADICTS, "erroneous", "the position contradicts the pose"),
    _compared(
        "position_disagrees",
        "the position contradicts the independent position alone: the fix, all fixes, or that position is wrong",
        lambda tests: tests.contradicts_independent,
        _independent_figures,
    ),
    _compared(
        "position_disagrees",
        "the fix begins, or goes on from fixes that began, elsewhere than where [earlier confirmed ones "
        "lead](../theory/integrity.md#carried-position)",
        lambda tests: tests.began_elsewhere,
        _figures,
    ),
    *(
        _failed_rule(
            outcome, "unknown", f"the {part} is between agreement and contradiction, or beyond its cap"
        )
        for outcome, part in ((HEIGHT_UNVERIFIED, "height"), (POSITION_UNVERIFIED, "position"))
    ),
    _compared(
        "position_unverified",
        "the position is between agreement with the independent position and contradiction",
        lambda tests: tests.is_unverified_by_independent,
        _independent_figures,
    ),
    _verified_rule(
        "subsets_disagree",
        "a [subset](gnss.md#subsets-of-a-fix) of its satellites is fixed elsewhere, all else agrees",
        lambda tests: tests.has_disagreeing_subset,
        _disagreeing_subset,
    ),
    _compared(
        "subsets_disagree",
        "a subset of its satellites is fixed elsewhere",
        lambda tests: tests.has_disagreeing_subset,
        _disagreeing_subset,
    ),
    _compared(
        "height_unverified",
        "no test in use supports the fix",
        lambda tests: not tests.evidence,
        lambda _: "nothing that is asked speaks for the fix",
    ),
    _compared(
        "starting",
        "the pose rests on unconfirmed fixes, and not enough of them agree yet",
        lambda tests: tests.needs_more_fixes_to_start,
        lambda tests: f"{tests.start.fixes} in a row agree, {tests.rules.start.fixes} are needed",
    ),
    _compared(
        "height_agrees",
        "everything agrees",
        lambda tests: tests.determination.asks_height,
        outcome="confirmed",
        evidence=_evidence_for_confirmation,
    ),
    _compared(
        "none",
        "everything agrees, the height is not tested",
        lambda _: True,
        outcome="confirmed",
        evidence=_evidence_for_confirmation,
    ),
)


_RULES_WITHOUT_HEIGHT = tuple(rule for rule in TEST_RULES if not rule.for_height)


def decide(tests: FixConditions) -> FixJudgement:
    """Return the judgement of the first rule that applies."""
    rules = TEST_RULES if tests.determination.asks_height else _RULES_WITHOUT_HEIGHT
    rule = next(rule for rule in rules if rule.applies(tests))
    road = tests.road if rule.compared else None
    cause = tests.cause_here if rule.compared else tests.common_cause
    failed = rule.compared and tests.outcome != ALL_AGREE and rule.reason != "common_offset"
    if failed and tests.comparison.position == CONTRADICTS:
        road = None  # a fix that is not where the vehicle is carries no information on the road there
    return FixJudgement(
        fix=tests.fix,
        verdict=rule.outcome,
        reason=rule.reason,
        detail=rule.detail(tests),
        evidence=rule.evidence(tests),
        comparison=tests.comparison if rule.compared else None,
        correction_m=tests.correction.correction_m,
        road=road,
        pose=tests.inputs.pose,
        antenna=tests.inputs.antenna,
        cause=cause,
        trials=tests.trials,
        off_road_since_ns=tests.off_road_since_ns if rule.compared else None,
    )
