"""A pose that a wrong fix has captured is given up for a run of right ones, and a right pose not for a wrong run."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.integrity.checks.captured_pose import CapturedPose, CaptureRules, FixRun
from camber.integrity.rules import Rules
from support.judging import ALL, SettlingJudge, antenna, at, fix, independent, pose

RULES, PRIOR, EPISODE_S = CaptureRules(), 0.1, 10.0
S = 1_000_000_000
exactly = settings(derandomize=True, deadline=None)


def run(first_s, last_s=None, odds=0.1, offset_m=(0.0, 0.0)):
    last_s = first_s if last_s is None else last_s
    return FixRun(first_ns=round(first_s * S), last_ns=round(last_s * S), odds=odds, offset_m=offset_m)


def odds(state, rival):
    return state.odds_of(rival, prior=PRIOR, episode_s=EPISODE_S)


# --- the odds ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rejected", [0, 1, 3])
def test_of_the_runs_that_win_as_few_are_wrong_as_their_odds_say(rejected):
    """Runs drawn as the derivation says: the posterior of those between two odds is that of their odds."""
    rng, n = np.random.default_rng(7), 400_000
    right_s = EPISODE_S * (1.0 - PRIOR) / PRIOR
    follows = 1.0 / (1.0 + rejected) if rejected else None
    a_is_wrong = rng.random(n) < (1.0 - follows if rejected else PRIOR)
    # Both wrong runs have the road's height by the same chance, so that it cancels; a wrong run may follow a wrong one.
    seen = np.where(a_is_wrong, rng.random(n) < follows if rejected else True, True)
    a_s = rng.exponential(np.where(a_is_wrong, EPISODE_S, right_s))
    lasts_s = rng.exponential(np.where(a_is_wrong, right_s, EPISODE_S))
    b_s = rng.uniform(0.0, 60.0, n)  # what is seen of B until now
    seen &= lasts_s >= b_s
    factor = rejected / (1.0 + rejected) * (1.0 - PRIOR) / PRIOR if rejected else 1.0
    # Exactly, 1/τ − 1/τ_r is in the exponent: the odds that are used are never the smaller ones where B is longer.
    exponent = (b_s - a_s) * (1.0 / EPISODE_S - 1.0 / right_s)
    expected = factor * np.exp(exponent)
    for low, high in ((1.0, 3.0), (5.0, 20.0), (20.0, 60.0)):
        chosen = seen & (expected >= low) & (expected < high)
        share, mean = a_is_wrong[chosen].mean(), (expected[chosen] / (1.0 + expected[chosen])).mean()
        assert share == pytest.approx(mean, abs=5.0 * math.sqrt(0.25 / chosen.sum()))


@exactly
@given(st.floats(0.0, 60.0), st.floats(0.0, 60.0), st.floats(0.05, 19.0), st.integers(0, 20))
def test_the_longer_run_the_better_odds_and_the_more_rejected_before_it_the_sooner(a_s, b_s, better, n):
    state = CapturedPose(support=run(0.0, a_s, odds=0.4), rejected_before=n)
    here = odds(state, run(70.0, 70.0 + b_s, odds=0.4))
    assert odds(state, run(70.0, 71.0 + b_s, odds=0.4)) > here
    assert odds(replace(state, support=run(0.0, a_s + 1.0, odds=0.4)), run(70.0, 70.0 + b_s, odds=0.4)) < here
    assert (odds(state, run(70.0, 70.0 + b_s, odds=better)) > here) == (better < 0.4) or better == 0.4
    assert odds(replace(state, rejected_before=n + 1), run(70.0, 70.0 + b_s, odds=0.4)) > here
    assert odds(CapturedPose(), run(70.0, 70.0 + b_s)) == 0.0


def test_a_support_that_has_lasted_settles_it():
    lasting = CapturedPose(support=run(0.0, 60.0))
    assert lasting.settled(RULES, prior=PRIOR, episode_s=EPISODE_S) is lasting
    assert (
        CapturedPose(support=run(0.0, 70.0)).settled(RULES, prior=PRIOR, episode_s=EPISODE_S)
        == CapturedPose()
    )
    assert CapturedPose().settled(RULES, prior=PRIOR, episode_s=EPISODE_S) == CapturedPose()


# --- runs --------------------------------------------------------------------------------------------------------


def test_a_run_is_of_fixes_that_move_as_the_vehicle_without_a_gap():
    state = CapturedPose(rival=run(0.0, 1.0, odds=0.4, offset_m=(2.0, 0.0)))
    longer = state.rival_with(run(1.2, odds=0.1, offset_m=(2.1, 0.0)), RULES)
    assert (longer.fixes, longer.duration_s, longer.odds) == (2, pytest.approx(1.2), 0.1)
    for other in (
        run(1.2, offset_m=(2.3, 0.0)),
        run(2.2, offset_m=(2.0, 0.0)),
        run(1.0, offset_m=(2.0, 0.0)),
    ):
        assert state.rival_with(other, RULES) is other
    assert CapturedPose().rival_with(other, RULES) is other


def test_rejected_runs_are_counted_until_a_fix_is_confirmed():
    state = CapturedPose()
    for k, east_m in enumerate((5.0, 5.0, -3.0, -3.0, 7.0)):
        state = state.rejects(run(0.2 * k, offset_m=(east_m, 0.0)), RULES)
    assert state.rejected_runs == 3
    opened = state.agreed(run(2.0), RULES, opens=True)
    assert (opened.support, opened.rejected_before, opened.rejected_runs) == (run(2.0), 3, 0)
    assert state.agreed(run(2.0), RULES, opens=False) == CapturedPose()


def test_agreement_extends_the_support_and_a_pose_that_is_wide_again_begins_anew():
    state = CapturedPose(support=run(0.0, 1.0), rejected_before=2, rival=run(1.0))
    assert state.agreed(run(1.5), RULES, opens=True).support.duration_s == 1.5
    assert state.agreed(run(9.0), RULES, opens=False).support.duration_s == 9.0
    assert state.agreed(run(9.0), RULES, opens=False).rival is None
    assert state.agreed(run(9.0), RULES, opens=True).support == run(9.0)


def test_when_the_pose_has_followed_the_winner_is_its_support():
    state = CapturedPose(support=run(0.0), rival=run(1.0, 12.0), won=True)
    assert state.agreed(run(12.2), RULES, opens=False).support == replace(run(1.0, 12.2), fixes=2)


# --- the judge along a drive -------------------------------------------------------------------------------------

MANY = {"satellites": 14}


class Vehicle:
    """A judge whose pose follows what is confirmed: as the localizer's, after five that it contradicts in a row."""

    def __init__(self, rules=None):
        self.judge, self.rules = SettlingJudge(rules or Rules()), rules
        self.off_m, self.sigma_m, self.contradicted = 0.0, 1.0, 0

    def epoch(self, k, north_m=0.0, up_m=0.0, **changes):
        there = pose(k, sigma_m=self.sigma_m)
        latitude_rad = fix(k, north_m=self.off_m).latitude_rad
        self.judge.latest.add_pose(there.model_copy(update={"latitude_rad": latitude_rad, **changes}))
        self.judge.latest.set_antenna_height(antenna(k))
        self.judge.latest.add_wheel_speed(at(k), 10.0)
        judgement = self.judge.judge(fix(k, north_m=north_m, up_m=up_m, **MANY), at(k), ALL)
        if judgement.confirmed:
            near = abs(north_m - self.off_m) < 4.0 * math.hypot(self.sigma_m, 0.05)
            self.contradicted = 0 if near else self.contradicted + 1
            if near or self.contradicted >= 5:
                self.off_m, self.sigma_m, self.contradicted = north_m, 0.06, 0
        return judgement


def until_confirmed(vehicle, first, **changes):
    """Verdicts of right fixes until one is confirmed again, and how long that took in seconds."""
    verdicts = []
    for k in range(first, first + 400):
        verdicts.append(vehicle.epoch(k, **changes).verdict)
        if "confirmed" in verdicts[-1]:
            return verdicts, (k - first) * 0.2
    return verdicts, math.inf


def test_one_wrong_fix_captures_a_wide_pose_and_right_ones_win_it_back():
    vehicle = Vehicle()
    for k, off in enumerate((9.0, -14.0, 20.0)):  # wrong runs of which the height rejects all
        assert vehicle.epoch(k, north_m=off, up_m=1.5).verdict == "erroneous"
    captured = vehicle.epoch(4, north_m=2.0)
    assert (captured.verdict, captured.evidence) == ("confirmed", ("height",))
    verdicts, seconds = until_confirmed(vehicle, 5)
    assert set(verdicts[:-1]) == {"unknown"}
    assert seconds <= 15.0
    judgements = [vehicle.epoch(k) for k in range(5 + len(verdicts), 105 + len(verdicts))]
    assert all(judgement.confirmed for judgement in judgements)
    assert vehicle.off_m == 0.0


def test_where_nothing_was_rejected_before_either_may_be_wrong_for_longer():
    vehicle = Vehicle()
    vehicle.epoch(0, north_m=2.0)
    verdicts, seconds = until_confirmed(vehicle, 1)
    assert set(verdicts[:-1]) == {"unknown"}
    assert seconds == pytest.approx(EPISODE_S * math.log(RULES.least_odds), abs=0.4)


def test_a_wrong_run_does_not_win_against_a_pose_that_has_been_agreed_with_for_longer():
    vehicle = Vehicle()
    for k in range(100):
        assert vehicle.epoch(k).confirmed
    assert {vehicle.epoch(k, north_m=2.0).verdict for k in range(100, 200)} == {"unknown"}
    assert vehicle.epoch(200).confirmed
    assert "erroneous" not in {vehicle.epoch(k).verdict for k in range(201, 240)}


def test_a_pose_out_of_doubt_is_believed():
    vehicle = Vehicle()
    for k in range(400):
        assert vehicle.epoch(k).confirmed
    assert vehicle.epoch(400, north_m=2.0).verdict == "erroneous"


def test_position_evidence_takes_it_out_of_doubt_at_once():
    vehicle = Vehicle()
    vehicle.epoch(0)
    assert "position" in vehicle.epoch(1, independent=independent(1)).evidence
    assert vehicle.epoch(2, north_m=2.0).verdict == "erroneous"


def test_honest_fixes_need_no_such_hypothesis():
    vehicle = Vehicle(Rules(horizontal_reference="assumed"))
    vehicle.epoch(0, north_m=2.0)
    assert vehicle.epoch(1).verdict == "erroneous"


def test_a_clock_that_is_set_back_forgets_it():
    vehicle = Vehicle()
    vehicle.epoch(0, north_m=2.0)
    vehicle.judge.forget_future(at(10))
    assert vehicle.judge.before.captured.support is not None
    vehicle.judge.forget_future(at(-10))
    assert vehicle.judge.before.captured == CapturedPose()


# --- carried integers --------------------------------------------------------------------------------------------


def test_how_long_carried_integers_last_is_no_evidence():
    """A run of 60 s whose integers the engine carries counts as one fix; with one break of the chain as two."""
    single = carried = run(0.0)
    for second in range(1, 61):
        single = single.extend(run(float(second)))
        carried = carried.extend(replace(run(float(second)), carried=True))
    assert single.duration_s == pytest.approx(60.0)
    assert carried.duration_s == 0.0
    assert carried.last_ns == single.last_ns
    assert carried.fixes == single.fixes
    broken = carried.extend(run(61.0)).extend(replace(run(62.0), carried=True))
    assert broken.duration_s == pytest.approx(1.0)
    state = CapturedPose(support=run(0.0, odds=0.4))
    assert odds(state, carried) == pytest.approx(odds(state, run(0.0)))
    assert odds(state, single) > 100.0 * odds(state, carried)
