"""The decision on a testable fix as data: ordered rules, of which the first that applies gives verdict and reason.

The judge runs exactly these rules; `camber.tools.generate_docs.decision_table` prints them in
`docs/services/integrity.md`. A condition may rely on all rules before it not having applied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from camber.integrity.checks.chi2_test import CONTRADICTS
from camber.integrity.checks.consistency import (
    ALL_AGREE,
    BOTH_CONTRADICT,
    HEIGHT_CONTRADICTS,
    HEIGHT_UNVERIFIED,
    POSITION_CONTRADICTS,
    POSITION_UNVERIFIED,
    REASONS,
)
from camber.integrity.checks.fix_tests import FixTests
from camber.integrity.epoch_inputs import ANTENNA_CHECKS, POSE_CHECKS, ROAD_CHECKS, InputCheck
from camber.integrity.judgement import FixJudgement
from camber.schemas.integrity import Evidence, Reason, VerdictValue


@dataclass(frozen=True, slots=True, kw_only=True)
class DecisionRule:
    """One check: where `applies` holds and no rule before did, `outcome` is the verdict, with this reason.

    `compared`: the verdict rests on the comparison with pose and height model and publishes its figures.
    """

    name: str
    applies: Callable[[FixTests], bool]
    outcome: VerdictValue
    reason: Reason
    explanation: str
    detail: Callable[[FixTests], str] = lambda _: ""
    evidence: Callable[[FixTests], tuple[Evidence, ...]] = lambda _: ()
    compared: bool = False


def _lacks_input(check: InputCheck, tests: FixTests) -> bool:
    return check.applies(tests.inputs, tests.fix.time_ns, tests.rules)


def _lacks_height_input(check: InputCheck, tests: FixTests) -> bool:
    return tests.determination.asks_height and _lacks_input(check, tests)


def _input_rules(
    checks: Iterable[InputCheck], applies: Callable[[InputCheck, FixTests], bool]
) -> tuple[DecisionRule, ...]:
    return tuple(
        DecisionRule(
            name="input",
            applies=partial(applies, check),
            outcome="unknown",
            reason=check.reason,
            explanation=check.explanation,
        )
        for check in checks
    )


def _has_outcome(outcome: int, tests: FixTests) -> bool:
    return tests.outcome == outcome


def _verified_rule(outcome: int, explanation: str) -> DecisionRule:
    return DecisionRule(
        name="verification",
        applies=lambda tests: tests.outcome == outcome and bool(tests.verification),
        outcome="confirmed_after_verification",
        reason=REASONS[outcome],
        explanation=f"{explanation}, and [other evidence](#verification) confirms the fix",
        detail=lambda tests: tests.detail,
        evidence=lambda tests: tests.verification,
        compared=True,
    )


def _failed_rule(outcome: int, verdict: VerdictValue, explanation: str) -> DecisionRule:
    return DecisionRule(
        name="consistency",
        applies=partial(_has_outcome, outcome),
        outcome=verdict,
        reason=REASONS[outcome],
        explanation=explanation,
        detail=lambda tests: tests.detail,
        compared=True,
    )


def _uncertain_model(tests: FixTests) -> str:
    most = f"expected at most the largest tolerance, {tests.determination.largest_tolerance_m} m"
    return f"σ {tests.model_sigma_m:.2f} m of road and antenna, {most}"


def _evidence_for_confirmation(tests: FixTests) -> tuple[Evidence, ...]:
    return (*tests.evidence, "track") if tests.is_starting else tests.evidence


TEST_RULES: tuple[DecisionRule, ...] = (
    DecisionRule(
        name="phase residuals",
        applies=lambda tests: tests.has_contradictory_phases,
        outcome="erroneous",
        reason="phase_residuals_contradict",
        explanation="its phases contradict its integers",
    ),
    DecisionRule(
        name="receiver",
        applies=lambda tests: bool(tests.receiver_warning),
        outcome="unknown",
        reason="receiver_warns",
        explanation="the receiver warns of spoofing, critical jamming or failed RAIM, within the last 2 s",
        detail=lambda tests: tests.receiver_warning,
    ),
    DecisionRule(
        name="continuity",
        applies=lambda tests: tests.contradicts_confirmed_integers,
        outcome="unknown",
        reason="continuity_disagrees",
        explanation="its integers contradict those of a fix confirmed within `series_gap_s`",
        detail=lambda tests: f"other integers than those confirmed {tests.since_confirmed_s:.1f} s ago",
    ),
    *_input_rules(POSE_CHECKS, _lacks_input),
    *_input_rules((*ANTENNA_CHECKS, *ROAD_CHECKS), _lacks_height_input),
    DecisionRule(
        name="datum",
        applies=lambda tests: tests.has_datum_mismatch,
        outcome="unknown",
        reason="datum_mismatch",
        explanation="fix and road are in different datums",
        detail=lambda tests: f"fix {tests.fix.datum}, map {tests.pose.road.datum}",
    ),
    DecisionRule(
        name="off the road",
        applies=lambda tests: tests.is_off_road and not tests.contradicts_pose,
        outcome="unknown",
        reason="pose_too_uncertain",
        explanation="beyond the planes of the map without contradicting the pose: the pose is too uncertain",
        detail=lambda _: "the fix is beyond the surface's plane",
    ),
    DecisionRule(
        name="uncertain road",
        applies=lambda tests: tests.has_uncertain_model and tests.has_uncertain_road,
        outcome="unknown",
        reason="road_unknown",
        explanation="σ of road and antenna height above the largest tolerance, the road is worse known",
        detail=_uncertain_model,
    ),
    DecisionRule(
        name="uncertain antenna height",
        applies=lambda tests: tests.has_uncertain_model,
        outcome="unknown",
        reason="antenna_height_missing",
        explanation="σ of road and antenna height above the largest tolerance, the antenna is worse known",
        detail=_uncertain_model,
    ),
    DecisionRule(
        name="invalid height",
        applies=lambda tests: tests.has_invalid_model,
        outcome="unknown",
        reason="road_unknown",
        explanation="the expected height is not a number",
        detail=lambda _: "the height is not a number",
    ),
    DecisionRule(
        name="base station",
        applies=lambda tests: tests.outcome != ALL_AGREE and tests.cause_here == "base",
        outcome="unknown",
        reason="common_offset",
        explanation="a test below contradicts or is unverified, and all fixes have one common offset: base or datum",
        detail=lambda tests: f"{REASONS[tests.outcome]}: {tests.detail}",
        compared=True,
    ),
    _verified_rule(BOTH_CONTRADICT, "height and position contradict together, the position alone agrees"),
    _verified_rule(HEIGHT_CONTRADICTS, "the height contradicts, the position agrees"),
    _verified_rule(HEIGHT_UNVERIFIED, "the height is unverified, the position agrees"),
    _verified_rule(POSITION_UNVERIFIED, "the position is unverified, the height agrees"),
    _failed_rule(
        BOTH_CONTRADICT, "erroneous", "height and position contradict, each alone or only both together"
    ),
    _failed_rule(HEIGHT_CONTRADICTS, "erroneous", "the height contradicts"),
    DecisionRule(
        name="position of provisional pose",
        applies=lambda tests: tests.outcome == POSITION_CONTRADICTS and tests.is_starting,
        outcome="unknown",
        reason="position_disagrees",
        explanation="the position contradicts a pose that rests on unconfirmed fixes: fixes contradict one another",
        detail=lambda tests: tests.detail,
        compared=True,
    ),
    _failed_rule(POSITION_CONTRADICTS, "erroneous", "the position contradicts the pose"),
    _failed_rule(
        HEIGHT_UNVERIFIED, "unknown", "the height is between agreement and contradiction, or beyond its cap"
    ),
    _failed_rule(
        POSITION_UNVERIFIED,
        "unknown",
        "the position is between agreement and contradiction, or beyond its cap",
    ),
    DecisionRule(
        name="subset, verified",
        applies=lambda tests: tests.has_disagreeing_subset and bool(tests.verification),
        outcome="confirmed_after_verification",
        reason="subsets_disagree",
        explanation="a [subset](gnss.md#subsets-of-a-fix) of its satellites is fixed elsewhere, all else agrees, "
        "and [other evidence](#verification) confirms the fix",
        detail=lambda _: "without one system its satellites are fixed elsewhere",
        evidence=lambda tests: tests.verification,
        compared=True,
    ),
    DecisionRule(
        name="subset",
        applies=lambda tests: tests.has_disagreeing_subset,
        outcome="unknown",
        reason="subsets_disagree",
        explanation="a subset of its satellites is fixed elsewhere",
        detail=lambda _: "without one system its satellites are fixed elsewhere",
        compared=True,
    ),
    DecisionRule(
        name="no evidence",
        applies=lambda tests: not tests.evidence,
        outcome="unknown",
        reason="height_unverified",
        explanation="no test in use supports the fix",
        detail=lambda _: "nothing that is asked speaks for the fix",
        compared=True,
    ),
    DecisionRule(
        name="start",
        applies=lambda tests: tests.needs_more_fixes_to_start,
        outcome="unknown",
        reason="starting",
        explanation="the pose rests on unconfirmed fixes, and not enough of them agree yet",
        detail=lambda tests: f"{tests.start.fixes} in a row agree, {tests.rules.start.fixes} are needed",
        compared=True,
    ),
    DecisionRule(
        name="confirmed",
        applies=lambda tests: tests.determination.asks_height,
        outcome="confirmed",
        reason="height_agrees",
        explanation="everything agrees",
        evidence=_evidence_for_confirmation,
        compared=True,
    ),
    DecisionRule(
        name="confirmed without height",
        applies=lambda _: True,
        outcome="confirmed",
        reason="none",
        explanation="everything agrees, the height is not tested",
        evidence=_evidence_for_confirmation,
        compared=True,
    ),
)


def decide(tests: FixTests) -> FixJudgement:
    """Return the judgement of the first rule that applies."""
    rule = next(rule for rule in TEST_RULES if rule.applies(tests))
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
    )
