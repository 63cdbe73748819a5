"""Where exactly a run goes on, what a hypothesis keeps from fix to fix, and its odds by number."""

import math
from dataclasses import replace

import pytest

from camber.integrity.checks.captured_pose import CapturedPose, CaptureRules, FixRun

RULES, PRIOR, EPISODE_S = CaptureRules(), 0.1, 10.0
S = 1_000_000_000


def run(first_s, last_s=None, odds=0.1, offset_m=(0.0, 0.0)):
    last_s = first_s if last_s is None else last_s
    return FixRun(first_ns=round(first_s * S), last_ns=round(last_s * S), odds=odds, offset_m=offset_m)


@pytest.mark.parametrize(
    ("fix", "same"),
    [
        (run(2.0, offset_m=(1.0, 2.0)), True),
        (run(2.0 + 1e-9, offset_m=(1.0, 2.0)), False),
        (run(2.0, offset_m=(1.0, 2.2)), False),
        (run(2.0, offset_m=(1.2, 2.0)), False),
        (run(2.0, offset_m=(1.1, 2.11)), True),
        (run(2.0, offset_m=(1.11, 2.11)), False),
    ],
)
def test_a_run_goes_on_for_a_second_and_within_its_distance(fix, same):
    state = CapturedPose(rival=run(0.0, 1.0, offset_m=(1.0, 2.0)))
    assert (state.rival_with(fix, RULES) is not fix) == same


def test_a_step_of_the_distance_itself_is_within_it():
    state = CapturedPose(rival=run(0.0, 1.0))
    step = run(1.2, offset_m=(RULES.horizontal_m, 0.0))
    assert state.rival_with(step, RULES).fixes == 2


def test_the_best_odds_of_a_run_count_whichever_fix_has_them():
    for first, later in ((0.1, 0.4), (0.4, 0.1)):
        assert run(0.0, odds=first).extend(run(0.2, odds=later)).odds == 0.1


def test_what_was_rejected_before_the_support_counts_as_long_as_the_hypothesis_lasts():
    agreed = CapturedPose(support=run(0.0, 1.0), rejected_before=2).agreed(run(1.5), RULES, opens=False)
    assert agreed.rejected_before == 2
    followed = CapturedPose(support=run(0.0), rival=run(1.0, 12.0), won=True, rejected_before=2)
    assert followed.agreed(run(12.2), RULES, opens=False).rejected_before == 2


def test_a_run_that_has_won_is_what_the_pose_follows_next():
    state = CapturedPose(support=run(0.0, 1.0))
    won = state.contradicted(run(2.0, odds=0.3), RULES, won=True)
    assert won.agreed(run(2.2), RULES, opens=False).support.odds == 0.1
    assert won.agreed(run(2.2), RULES, opens=False).support.first_ns == 2 * S
    held_back = state.contradicted(run(2.0), RULES, won=False)
    assert held_back.agreed(run(2.2), RULES, opens=False).support.first_ns == 0


def test_a_pose_is_anchored_anew_after_more_than_the_gap_and_not_at_it():
    state = CapturedPose(support=run(0.0, 1.0))
    assert state.agreed(run(2.0), RULES, opens=True).support.first_ns == 0
    assert state.agreed(run(2.001), RULES, opens=True).support.first_ns == 2_001_000_000


@pytest.mark.parametrize(("rejected", "before"), [(0, 1.0), (1, 4.5), (3, 6.75), (8, 8.0)])
def test_the_odds_by_number(rejected, before):
    """n / (1 + n) · (1 − π) / π, 9 with the prior of 0.1; longer by 20 s, of odds 3 : 1 before."""
    state = CapturedPose(support=run(0.0, 5.0, odds=0.3), rejected_before=rejected)
    result = state.odds_of(run(6.0, 31.0, odds=0.1), prior=PRIOR, episode_s=EPISODE_S)
    assert result == pytest.approx(before * 3.0 * math.exp(2.0))


@pytest.mark.parametrize("longer", [1, -1])
def test_no_more_than_a_thousand_seconds_count(longer):
    def odds(seconds):
        support, rival = (0.0, seconds) if longer > 0 else (seconds, 0.0)
        state = CapturedPose(support=run(0.0, support))
        return state.odds_of(run(9000.0, 9000.0 + rival), prior=PRIOR, episode_s=100.0)

    assert odds(5000.0) == pytest.approx(math.exp(longer * 10.0), rel=1e-6)
    assert odds(900.0) == pytest.approx(math.exp(longer * 9.0), rel=1e-6)


def test_a_pose_is_in_doubt_up_to_the_odds_of_one_that_is_settled():
    state = CapturedPose(support=run(0.0, 30.0))
    start = state.odds_of(run(0.0), prior=PRIOR, episode_s=EPISODE_S)
    for settled_odds, kept in ((start, True), (math.nextafter(start, 1.0), False)):
        rules = replace(RULES, settled_odds=settled_odds)
        assert (state.settled(rules, prior=PRIOR, episode_s=EPISODE_S) is state) == kept
