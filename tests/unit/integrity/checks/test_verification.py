"""What may speak for a fix that the height is against, and what suffices."""

from __future__ import annotations

import itertools

import pytest

from camber.integrity.checks.verification import (
    AmbiguityHistory,
    VerificationRules,
    phase_residuals_agree,
    scan_matching_agrees,
    verified,
)
from support.judging import at, fix, pose

RULES = VerificationRules()
WITNESSES = ("time_series", "ambiguity_continuity", "scan_matching", "phase_residuals")


def continued(epoch, since=0, **changes):
    """A fix whose integers are those since an epoch."""
    return fix(epoch, ambiguity_continuity="continuous", continuous_since_ns=at(since), **changes)


def first(epoch, continuity="no_evidence", **changes):
    """The first fix of a chain."""
    return fix(epoch, ambiguity_continuity=continuity, continuous_since_ns=at(epoch), **changes)


def broken(epoch):
    return first(epoch, "broken")


def after(*fixes, confirmed=True):
    """What is remembered after such fixes, all confirmed."""
    integers = AmbiguityHistory()
    for one in fixes:
        integers = integers.after(one, confirmed=confirmed, contradicted=False)
    return integers


FIVE = (first(0), *(continued(k) for k in range(1, 5)))


@pytest.mark.parametrize(
    "witnesses", [some for n in range(5) for some in itertools.combinations(WITNESSES, n)], ids=str
)
def test_which_witnesses_suffice(witnesses):
    alone = {"time_series", "ambiguity_continuity"} & set(witnesses)
    together = {"scan_matching", "phase_residuals"} <= set(witnesses)
    assert verified(frozenset(witnesses), RULES) is bool(alone or together)
    assert verified(frozenset({*witnesses, "height"}), RULES) is bool(alone or together)


def test_the_rules_may_ask_for_others():
    assert verified(frozenset({"scan_matching"}), VerificationRules(enough=("scan_matching",)))
    assert not verified(frozenset(WITNESSES), VerificationRules(enough=()))
    assert not verified(
        frozenset({"scan_matching", "phase_residuals"}), VerificationRules(enough=("time_series",))
    )


def test_the_integers_of_five_fixes_that_the_height_confirmed_carry_the_next():
    assert after(*FIVE).carry(continued(5), RULES)


NOT_CARRIED = {
    "nothing before": (AmbiguityHistory(), continued(5)),
    "four": (after(*FIVE[:4]), continued(5)),
    "a new chain": (after(*FIVE), first(5)),
    "broken": (after(*FIVE), broken(5)),
    "another chain": (after(*FIVE), continued(5, since=1)),
    "since when is not known": (after(*FIVE), fix(5, ambiguity_continuity="continuous")),
    "not later": (after(*FIVE), continued(4)),
    "too long ago": (after(*FIVE), continued(155)),
    "before": (after(*FIVE), continued(3.9)),
    "none was confirmed": (after(*FIVE, confirmed=False), continued(5)),
    "one of a new chain": (after(*FIVE, first(5)), continued(6, since=5)),
}


@pytest.mark.parametrize(("integers", "the_fix"), NOT_CARRIED.values(), ids=NOT_CARRIED)
def test_but_not(integers, the_fix):
    assert not integers.carry(the_fix, RULES)


def test_they_carry_for_thirty_seconds():
    assert after(*FIVE).carry(continued(154), RULES)


def test_unconfirmed_fixes_between_do_not_end_a_chain():
    integers = after(*FIVE).after(continued(5), confirmed=False, contradicted=False)
    assert integers.carry(continued(6), RULES)
    assert integers.after(continued(6), confirmed=True, contradicted=False).confirmed == 6


def test_other_integers_than_those_confirmed_just_before_contradict():
    assert after(*FIVE).contradict(broken(5), 1.0)
    assert not after(*FIVE).contradict(first(5), 1.0)
    assert not after(*FIVE).contradict(continued(5), 1.0)
    assert not after(*FIVE).contradict(fix(5, ambiguity_continuity="continuous"), 1.0)


def test_one_that_was_confirmed_is_enough_to_be_contradicted():
    assert after(first(5)).contradict(broken(6), 1.0)
    again = after(*FIVE).after(continued(5), confirmed=False, contradicted=False)
    assert again.after(continued(6), confirmed=True, contradicted=False).contradict(broken(7), 1.0)


def test_those_that_differ_from_a_fix_that_was_not_confirmed_do_not():
    assert not after(*FIVE, confirmed=False).contradict(broken(5), 1.0)
    unsure = after(*FIVE).after(first(5), confirmed=False, contradicted=False)
    assert unsure.contradict(broken(6), 1.0) is False


def test_a_chain_that_contradicts_goes_on_contradicting_for_a_second():
    integers = after(*FIVE).after(broken(5), confirmed=False, contradicted=True)
    assert integers.contradict(continued(6, since=5), 1.0)
    integers = integers.after(continued(6, since=5), confirmed=False, contradicted=True)
    assert integers.contradict(continued(9, since=5), 1.0)
    assert not integers.contradict(continued(10, since=5), 1.0)
    assert not integers.contradict(continued(9, since=0), 1.0)
    assert integers.contradict(broken(6), 1.0) is False  # back from the wrong ones: the old are right again


def test_once_the_old_chain_is_confirmed_again_the_dispute_is_over():
    integers = after(*FIVE).after(broken(5), confirmed=False, contradicted=True)
    assert integers.after(continued(6), confirmed=True, contradicted=False).disputed_ns is None


def test_a_break_that_does_not_say_since_when_holds_back_one_fix():
    unsaid = fix(5, ambiguity_continuity="broken")
    integers = after(*FIVE)
    assert integers.contradict(unsaid, 1.0)
    integers = integers.after(unsaid, confirmed=False, contradicted=True)
    assert not integers.contradict(fix(6, ambiguity_continuity="continuous"), 1.0)


def matched(**changes):
    return pose(0, **{"mode": "scan_match", "match_time_ns": at(0), **changes})


@pytest.mark.parametrize(
    ("the_pose", "sigma_m", "agrees"),
    [
        (matched(), 0.1, True),
        (matched(match_time_ns=at(-1.5)), 0.15, True),
        (matched(match_time_ns=at(-1.6)), 0.1, False),
        (matched(match_time_ns=at(1.6)), 0.1, False),
        (matched(match_time_ns=None), 0.1, False),
        (matched(mode="dead_reckoning"), 0.1, False),
        (matched(), 0.16, False),
        (matched(), float("nan"), False),
    ],
)
def test_only_a_fresh_and_narrow_scan_match_vouches(the_pose, sigma_m, agrees):
    assert scan_matching_agrees(the_pose, sigma_m, at(0), 0.3, 0.15) is agrees


@pytest.mark.parametrize(
    ("residuals", "ambiguities", "agree"),
    [
        ("consistent", 10, True),
        ("consistent", 9, False),
        ("consistent", None, False),
        ("unknown", 20, False),
        ("contradictory", 20, False),
    ],
)
def test_residuals_vouch_where_there_are_enough_of_them(residuals, ambiguities, agree):
    assert (
        phase_residuals_agree(fix(phase_residuals=residuals, ambiguities_fixed=ambiguities), RULES) is agree
    )
