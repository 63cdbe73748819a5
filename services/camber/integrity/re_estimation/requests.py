"""New estimates after an error determination (JP7707657B2, fifth embodiment): what gnss is asked, and what follows.

Two ways. *one_by_one* is the document's: estimates from other choices of satellites are judged one after the other,
until one passes or the limit is reached; the height picks one out of many. *agreement*, the default: first the
estimates have to agree with one another (`subset_agreement.py`), which no height has a part in; then the one they
agree on is judged, once, as any fix is. In both ways every estimate that was made is charged to what passes: it has to
agree within limits that may hold back so many times more right fixes, and it is wrong with the probability of so many
trials.

Asked is of fixes that were found erroneous and, as set, of epochs whose integers the engine could not resolve with all
satellites: a part of them may do. gnss that does not answer leaves the verdict as it was.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal

from camber.integrity.checks.consistency_tests import ConsistencyLimits, ConsistencyParameters
from camber.integrity.judgement import FixJudgement
from camber.integrity.re_estimation.subset_agreement import AgreementRules, agreement_of
from camber.schemas.gnss import Candidate, Estimates, EstimatesRequest, Fix

_MOST_HELD_BACK = 0.1  # chosen: beyond one in ten hardly a right fix would pass
_PAUSE_NS = 2_000_000_000  # chosen: a gnss that hangs costs one verdict in twenty the 0.1 s of a query

Judged = Callable[[Fix, int], FixJudgement]
"""Judges another estimate of a fix, given how many there are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReEstimationRules:
    """Which method, how many estimates of a fix at most, and whether epochs without a fix are asked for too.

    `subsets_for_height_alone` estimates have to agree where the pose is too vague to speak of the position.
    """

    method: Literal["agreement", "one_by_one", "off"] = "agreement"
    most_trials: int = 20
    unresolved: bool = True
    agreement: AgreementRules = field(default_factory=AgreementRules)
    subsets_for_height_alone: int = 3


class QueryBackoff:
    """Does gnss answer? After a question that it did not answer it is left alone for two seconds, so that the judge
    never waits for longer than once in that time."""

    def __init__(self) -> None:
        self._silent_ns: int | None = None

    def is_ready(self, now_ns: int) -> bool:
        """Is it worth to wait for an answer now?"""
        return self._silent_ns is None or not 0 <= now_ns - self._silent_ns < _PAUSE_NS

    def register_timeout(self, now_ns: int) -> None:
        """It has not answered."""
        self._silent_ns = now_ns


def estimates_request(judgement: FixJudgement, rules: ReEstimationRules) -> EstimatesRequest | None:
    """What to ask gnss; None where the judgement calls for no other estimate, or a receiver made the fix."""
    fix = judgement.fix
    unresolved = judgement.reason == "not_a_fix" and fix.quality == "float" and rules.unresolved
    if (
        rules.method == "off"
        or fix.origin != "engine"
        or not (judgement.verdict == "erroneous" or unresolved)
    ):
        return None
    return EstimatesRequest(time_ns=fix.time_ns, fix_id=fix.fix_id, maximum_trials=rules.most_trials)


def without_estimates(judgement: FixJudgement, why: str) -> FixJudgement:
    """The judgement as it was, with the reason why there is no other estimate."""
    return replace(judgement, detail=_joined(judgement.detail, f"no other estimates: {why}"))


def conclude_re_estimation(
    judgement: FixJudgement, answer: Estimates, judged: Judged, rules: ReEstimationRules
) -> FixJudgement:
    """The judgement of the estimate that passes; else the one there was, final now, with why."""
    if answer.status != "available" or answer.fix_id != judgement.fix.fix_id:
        return without_estimates(judgement, answer.reason or answer.status)
    trials, disputed, subsets = judgement.trials + answer.trials, False, 0
    if rules.method == "one_by_one":
        candidates, why, support = list(answer.candidates), "none passes", "one after the other"
    else:
        result = agreement_of(answer.candidates, rules.agreement)
        candidates = [] if result.candidate is None else [result.candidate]
        subsets, disputed = result.subsets, result.disputed
        why, support = result.why, f"{subsets} agree"
    for candidate in candidates:
        other = judged(other_fix(judgement.fix, candidate), trials)
        if (
            other.verdict == "confirmed"
            and rules.method == "agreement"
            and not _carried(other, subsets, rules)
        ):
            why = f"{support}, {rules.subsets_for_height_alone} are needed where only the height speaks"
        elif other.verdict == "confirmed":
            left_out = ", ".join(candidate.excluded_satellites)
            detail = f"of {answer.trials} other estimates, {support}; this one without {left_out}"
            return replace(other, evidence=(*other.evidence, "estimates"), detail=_cut(detail))
        elif rules.method == "agreement":
            why = f"{support}, {other.reason}: {other.detail}"
    detail = _joined(judgement.detail, f"{answer.trials} other estimates: {why}")
    if disputed and judgement.verdict == "erroneous":
        detail = _cut(f"{judgement.reason}: {detail}")
        return replace(judgement, reason="estimates_disagree", detail=detail, trials=trials)
    return replace(judgement, detail=detail, trials=trials)


def _carried(other: FixJudgement, subsets: int, rules: ReEstimationRules) -> bool:
    """Could the position have contradicted it, or do enough estimates name the place for the height to be enough?

    Up to one in ten wrong places has the height of the road, and twenty were tried.
    """
    return (
        bool({"position", "consistency"}.intersection(other.evidence))
        or subsets >= rules.subsets_for_height_alone
    )


def other_fix(fix: Fix, candidate: Candidate) -> Fix:
    """Another estimate in place of the fix. Its integers are not compared with those of other epochs."""
    return fix.model_copy(
        update={
            "quality": "fixed",
            "latitude_rad": candidate.latitude_rad,
            "longitude_rad": candidate.longitude_rad,
            "height_m": candidate.height_m,
            "covariance_enu_m2": candidate.covariance_enu_m2,
            "satellites": None,
            "ratio": candidate.ratio,
            "ambiguities_fixed": candidate.ambiguities,
            "success_rate": candidate.success_rate,
            "ambiguity_mode": "single_epoch",
            "ambiguity_continuity": "no_evidence",
            "continuous_since_ns": None,
            "phase_residuals": "unknown",
            "subset_agreement": "unknown",
        }
    )


@lru_cache(maxsize=256)
def limits_after(rules: ConsistencyParameters, trials: int) -> ConsistencyLimits:
    """The limits for the last of so many estimates: so many times more right ones may be held back."""
    rate = min(rules.hold_back_rate * max(trials, 1), max(rules.hold_back_rate, _MOST_HELD_BACK))
    return replace(rules, hold_back_rate=rate).limits()


def _joined(before: str, more: str) -> str:
    return _cut(f"{before}; {more}" if before else more)


def _cut(text: str) -> str:
    return text[:512]
