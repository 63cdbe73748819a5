"""What gnss is asked about a fix that failed, and what follows from the answer."""

from dataclasses import replace

import pytest

from camber.integrity.checks.consistency_tests import ConsistencyParameters
from camber.integrity.judgement import FixJudgement, verdict_of
from camber.integrity.protection.covariance_inflation import TrueSigma
from camber.integrity.re_estimation.requests import (
    QueryBackoff,
    ReEstimationRules,
    conclude_re_estimation,
    estimates_request,
    limits_after,
    other_fix,
    without_estimates,
)
from camber.integrity.re_estimation.subset_agreement import AgreementRules
from camber.integrity.rules import Rules
from camber.schemas.gnss import Estimates
from support.judging import ALL, SettlingJudge, antenna, at, candidate, fix, pose

RULES = ReEstimationRules()
ENGINE = {"origin": "engine"}


def erroneous(**changes):
    return FixJudgement(
        fix=fix(0, up_m=1.0, **ENGINE | changes),
        verdict="erroneous",
        reason="height_disagrees",
        detail="height +1.00 m",
    )


def unresolved(**changes):
    return FixJudgement(
        fix=fix(0, **{"quality": "float", **ENGINE, **changes}), verdict="unknown", reason="not_a_fix"
    )


def answer(*candidates, trials=20, **changes):
    fields = {"time_ns": at(0), "fix_id": fix(0).fix_id, "status": "available"}
    return Estimates(**fields | {"trials": trials, "candidates": candidates} | changes)


def right(n=3, **changes):
    return [candidate(east_m=0.01 * k, excluded=(f"G{k:02d}",), **changes) for k in range(1, n + 1)]


class Judged:
    """Gives the verdicts of the test, and remembers the fixes."""

    def __init__(self, *verdicts, evidence=("height",)):
        self.verdicts, self.seen, self.evidence = list(verdicts), [], evidence

    def __call__(self, other, trials):
        self.seen.append((other, trials))
        verdict = self.verdicts.pop(0)
        reason = "height_agrees" if verdict == "confirmed" else "height_disagrees"
        return FixJudgement(
            fix=other,
            verdict=verdict,
            reason=reason,
            detail="as given",
            evidence=self.evidence,
            trials=trials,
        )


# --- what is asked ------------------------------------------------------------------------------------------------


def test_of_an_erroneous_fix_of_the_engine_other_estimates_are_asked_up_to_the_limit():
    question = estimates_request(erroneous(), replace(RULES, most_trials=7))
    assert (question.fix_id, question.time_ns) == (fix(0).fix_id, at(0))
    assert (question.strategy, question.maximum_trials) == ("all", 7)


@pytest.mark.parametrize(("asked", "rules"), [(True, RULES), (False, replace(RULES, unresolved=False))])
def test_of_an_epoch_without_resolved_integers_as_set(asked, rules):
    assert (estimates_request(unresolved(), rules) is not None) == asked


@pytest.mark.parametrize(
    "judgement",
    [
        FixJudgement(fix=fix(0, **ENGINE), verdict="confirmed", reason="height_agrees"),
        FixJudgement(fix=fix(0, **ENGINE), verdict="confirmed_after_verification", reason="height_disagrees"),
        FixJudgement(fix=fix(0, **ENGINE), verdict="unknown", reason="height_unverified"),
        FixJudgement(fix=fix(0, **ENGINE), verdict="unknown", reason="pose_missing"),
        unresolved(quality="single"),
        unresolved(quality="none"),
        unresolved(origin="receiver"),
        erroneous(origin="receiver"),
    ],
)
def test_of_no_other(judgement):
    assert estimates_request(judgement, RULES) is None


def test_nothing_is_asked_where_it_is_switched_off():
    assert estimates_request(erroneous(), replace(RULES, method="off")) is None


# --- by what they agree on ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", [erroneous(), unresolved()], ids=["erroneous", "unresolved"])
def test_the_estimate_that_the_others_agree_on_is_judged_once_and_taken_if_it_passes(first):
    judged = Judged("confirmed")
    result = conclude_re_estimation(first, answer(*right()), judged, RULES)
    ((other, trials),) = judged.seen
    assert trials == result.trials == 21
    assert (result.verdict, result.reason, result.evidence) == (
        "confirmed",
        "height_agrees",
        ("height", "estimates"),
    )
    assert result.fix == other
    assert (other.fix_id, other.time_ns) == (first.fix.fix_id, first.fix.time_ns)
    assert result.detail == "of 20 other estimates, 3 agree; this one without G01"


def test_what_does_not_pass_leaves_the_first_judgement_final_with_all_that_was_tried():
    judged = Judged("erroneous")
    result = conclude_re_estimation(erroneous(), answer(*right()), judged, RULES)
    assert (result.verdict, result.reason, result.fix) == ("erroneous", "height_disagrees", erroneous().fix)
    assert result.trials == 21
    assert result.detail == "height +1.00 m; 20 other estimates: 3 agree, height_disagrees: as given"


@pytest.mark.parametrize("verdict", ["unknown", "confirmed_after_verification", "erroneous"])
def test_only_what_height_and_position_confirm_passes(verdict):
    assert (
        conclude_re_estimation(erroneous(), answer(*right()), Judged(verdict), RULES).verdict == "erroneous"
    )


@pytest.mark.parametrize(
    ("agree", "evidence", "verdict"),
    [
        (3, ("height",), "confirmed"),
        (2, ("height",), "erroneous"),
        (2, ("height", "position"), "confirmed"),
        (2, ("height", "consistency"), "confirmed"),
        (1, ("height", "phase_residuals"), "erroneous"),
    ],
)
def test_few_that_agree_need_a_position_that_could_have_contradicted_them(agree, evidence, verdict):
    result = answer(*right(agree, success_rate=0.99))
    judgement = conclude_re_estimation(erroneous(), result, Judged("confirmed", evidence=evidence), RULES)
    assert judgement.verdict == verdict
    assert verdict == "confirmed" or "3 are needed where only the height speaks" in judgement.detail


def test_height_does_not_choose_between_places():
    """The place that would pass is named by one estimate, another one by three: nothing is confirmed."""
    wrong = [candidate(up_m=2.0, east_m=0.01 * k) for k in range(3)]
    judged = Judged("erroneous")
    result = conclude_re_estimation(erroneous(), answer(candidate(), *wrong), judged, RULES)
    assert result.verdict == "erroneous"
    assert [round(other.height_m - fix(0).height_m) for other, _ in judged.seen] == [2]


def test_without_agreement_nothing_is_judged():
    judged = Judged()
    result = conclude_re_estimation(unresolved(), answer(candidate(), candidate(up_m=2.0)), judged, RULES)
    assert (result.verdict, result.reason, result.trials, judged.seen) == ("unknown", "not_a_fix", 21, [])
    assert result.detail == "20 other estimates: 1 estimates name one place, 1 another"


def test_of_a_wrong_fix_whose_other_estimates_name_several_places_that_is_the_reason():
    result = conclude_re_estimation(erroneous(), answer(candidate(), candidate(up_m=2.0)), Judged(), RULES)
    assert (result.verdict, result.reason, result.trials) == ("erroneous", "estimates_disagree", 21)
    assert result.detail.startswith("height_disagrees: height +1.00 m; 20 other estimates: 1 estimates name")


def test_an_estimate_brings_nothing_of_the_fix_that_failed():
    first = fix(
        0,
        up_m=1.0,
        east_m=3.0,
        north_m=2.0,
        **ENGINE,
        quality="float",
        covariance_enu_m2=(9.0, 0.0, 0.0, 9.0, 0.0, 9.0),
        ratio=9.0,
        satellites=12,
        phase_residuals="contradictory",
    )
    first = first.model_copy(update={"subset_agreement": "disagree"})
    first = first.model_copy(
        update={"ambiguity_continuity": "broken", "continuous_since_ns": at(-5), "ambiguities_fixed": 20}
    )
    other = other_fix(first, candidate(ambiguities=7, ratio=4.0, success_rate=0.97))
    assert (other.quality, other.height_m) == ("fixed", candidate().height_m)
    assert (other.latitude_rad, other.longitude_rad) == (candidate().latitude_rad, candidate().longitude_rad)
    assert (other.ambiguities_fixed, other.ratio, other.success_rate) == (7, 4.0, 0.97)
    assert (other.satellites, other.phase_residuals, other.subset_agreement) == (None, "unknown", "unknown")
    assert (other.ambiguity_continuity, other.continuous_since_ns) == ("no_evidence", None)
    assert other.covariance_enu_m2 == candidate().covariance_enu_m2


# --- the document's loop ------------------------------------------------------------------------------------------

LOOP = replace(RULES, method="one_by_one")


def test_one_after_the_other_is_judged_until_one_passes():
    judged = Judged("erroneous", "unknown", "confirmed")
    candidates = [
        candidate(up_m=2.0),
        candidate(up_m=1.0, excluded=("G02",)),
        candidate(excluded=("G03",)),
        candidate(),
    ]
    result = conclude_re_estimation(erroneous(), answer(*candidates), judged, LOOP)
    assert len(judged.seen) == 3
    assert result.verdict == "confirmed"
    assert result.trials == 21
    assert result.detail == "of 20 other estimates, one after the other; this one without G03"


def test_all_satellites_that_were_left_out_are_named():
    result = conclude_re_estimation(
        erroneous(), answer(candidate(excluded=("G05", "E11"))), Judged("confirmed"), LOOP
    )
    assert result.detail.endswith("this one without G05, E11")


def test_at_the_limit_the_error_is_final():
    judged = Judged("erroneous", "erroneous")
    result = conclude_re_estimation(erroneous(), answer(*right(2)), judged, LOOP)
    assert (result.verdict, result.trials) == ("erroneous", 21)
    assert result.detail == "height +1.00 m; 20 other estimates: none passes"


# --- no answer ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("status", ["unavailable", "forgotten"])
def test_where_gnss_has_no_estimates_the_judgement_is_as_it_was_and_says_so(status):
    result = conclude_re_estimation(
        erroneous(), answer(status=status, reason="not among the last"), Judged(), RULES
    )
    assert result == replace(
        erroneous(), detail="height +1.00 m; no other estimates: not among the last", trials=1
    )


def test_an_answer_about_another_fix_is_none():
    result = conclude_re_estimation(erroneous(), answer(*right(), fix_id=1), Judged(), RULES)
    assert (result.verdict, result.trials) == ("erroneous", 1)


def test_a_detail_is_never_longer_than_a_message_takes():
    result = without_estimates(replace(erroneous(), detail="x" * 500), "y" * 500)
    assert verdict_of(result, TrueSigma()).detail == result.detail
    assert len(result.detail) == 512


def test_after_silence_gnss_is_left_alone_for_two_seconds():
    answering = QueryBackoff()
    assert answering.is_ready(at(0))
    answering.register_timeout(at(0))
    assert not answering.is_ready(at(0))
    assert not answering.is_ready(at(9.9))
    assert answering.is_ready(at(10))
    assert answering.is_ready(at(-1))  # the clock was set back


# --- what every trial costs ---------------------------------------------------------------------------------------


def test_the_more_trials_the_narrower_the_limits_of_agreement_and_those_of_contradiction_stay():
    rules = ConsistencyParameters()
    assert limits_after(rules, 1) == rules.limits()
    last = rules.limits()
    for trials in (2, 5, 21, 100):
        limits = limits_after(rules, trials)
        for name in ("height", "position", "joint"):
            assert getattr(limits, name)[0] < getattr(last, name)[0]
            assert getattr(limits, name)[1] == getattr(last, name)[1]
        last = limits
    assert limits_after(rules, 1000) == last  # a tenth of the right ones, no more
    assert limits_after(replace(rules, hold_back_rate=0.5), 21).rules.hold_back_rate == 0.5


def ready():
    judge = SettlingJudge(Rules())
    judge.latest.add_pose(pose(0))
    judge.latest.set_antenna_height(antenna(0))
    return judge


def test_an_estimate_at_the_edge_passes_as_a_fix_and_not_as_one_of_many():
    limit_m = 0.0
    while ready().examine(fix(0, up_m=limit_m), ALL).verdict == "confirmed":
        limit_m += 0.005
    edge = fix(0, up_m=limit_m - 0.005)
    assert ready().examine(edge, ALL, 1).verdict == "confirmed"
    assert ready().examine(edge, ALL, 21).verdict == "unknown"
    assert ready().examine(edge, ALL, 21).trials == 21


def test_the_judge_settles_what_another_estimate_became():
    judge = ready()
    wrong, other = fix(0, up_m=1.0, **ENGINE), candidate()

    def others(first):
        assert (first.verdict, first.fix) == ("erroneous", wrong)
        return conclude_re_estimation(
            first, answer(*right()), lambda one, n: judge.examine(one, ALL, n), RULES
        )

    result = judge.judge(wrong, at(0), ALL, others)
    assert result.verdict == "confirmed"
    assert result.fix.height_m == other.height_m
    assert judge.judge(wrong, at(0), ALL, others) is None


def test_the_integers_after_another_estimate_are_not_compared_with_its():
    """The engine compares with those of its own fix, the wrong one: that the next are others is to be expected."""
    judge = ready()
    judge.judge(
        fix(0, up_m=1.0, **ENGINE),
        at(0),
        ALL,
        lambda first: conclude_re_estimation(
            first, answer(*right()), lambda one, n: judge.examine(one, ALL, n), RULES
        ),
    )
    judge.latest.add_pose(pose(1))
    judge.latest.set_antenna_height(antenna(1))
    result = judge.judge(
        fix(1, **ENGINE, ambiguity_continuity="broken", continuous_since_ns=at(1)), at(1), ALL
    )
    assert result.verdict == "confirmed"


def test_an_unresolved_epoch_with_other_estimates_is_settled_only_if_one_passes():
    judge = ready()
    float_ = fix(0, quality="float", **ENGINE)
    result = judge.judge(float_, at(0), ALL, lambda first: without_estimates(first, "gone"))
    assert (result.verdict, result.reason, result.detail) == (
        "unknown",
        "not_a_fix",
        "no other estimates: gone",
    )


def test_rules_of_agreement_are_part_of_the_rules():
    strict = replace(RULES, agreement=AgreementRules(least_ambiguities=11))
    assert conclude_re_estimation(erroneous(), answer(*right()), Judged(), strict).verdict == "erroneous"
