"""Each fix is judged once, and only forward in time."""

import math

import pytest

from camber.integrity.checks.fix_sequence import FixSequence
from camber.integrity.rules import Rules
from support.judging import at, fix

RULES = Rules()
NO_COVARIANCE = (1.0, 2.0, 0.0, 1.0, 0.0, 0.0)


def place_all(order, *epochs):
    return [order.check_arrival(fix(epoch), at(epoch), RULES) for epoch in epochs]


def test_fixes_in_order_are_in_place():
    order = FixSequence()
    assert place_all(order, 0, 1, 2) == [None, None, None]
    assert order.last_ns == at(2)


def test_a_second_one_of_an_epoch_is_repeated_an_earlier_one_out_of_order():
    order = FixSequence()
    assert place_all(order, 1, 1, 0) == [None, "fix_repeated", "fix_out_of_order"]
    assert order.last_ns == at(1)


@pytest.mark.parametrize(("late_epochs", "reason"), [(2.5, None), (2.6, "gnss_stale")])
def test_one_that_comes_late_is_stale(late_epochs, reason):
    assert FixSequence().check_arrival(fix(0), at(late_epochs), RULES) == reason


def test_one_that_is_dated_ahead_is_implausible_and_does_not_make_the_others_old():
    order = FixSequence()
    assert order.check_arrival(fix(100), at(0), RULES) == "fix_implausible"
    assert order.last_ns is None
    assert place_all(order, 1) == [None]


def test_each_fix_has_one_verdict():
    order = FixSequence()
    assert [order.register_once(fix(epoch)) for epoch in (0, 1, 0, 1)] == [False, False, True, True]


def test_only_the_latest_are_remembered():
    order = FixSequence()
    ids = [fix(0, fix_id=number) for number in range(1025)]
    assert not any(order.register_once(one) for one in ids)
    assert order.register_once(ids[1])
    assert not order.register_once(ids[0])


def test_when_the_clock_is_set_back_later_fixes_are_forgotten():
    order = FixSequence()
    place_all(order, 50)
    order.forget_after(at(50))
    assert order.last_ns == at(50)
    order.forget_after(at(1))
    assert order.last_ns is None
    assert place_all(order, 1) == [None]
    FixSequence().forget_after(at(0))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, None),
        ({"quality": "float"}, "not_a_fix"),
        ({"quality": "none"}, "not_a_fix"),
        ({"covariance_enu_m2": None}, "fix_implausible"),
        ({"covariance_enu_m2": NO_COVARIANCE}, "fix_implausible"),
        ({"covariance_enu_m2": (0.26, 0.0, 0.0, 0.01, 0.0, 0.01)}, "fix_implausible"),
        ({"covariance_enu_m2": (0.01, 0.0, 0.0, 0.01, 0.0, 0.26)}, "fix_implausible"),
        ({"covariance_enu_m2": (0.24, 0.0, 0.0, 0.01, 0.0, 0.24)}, None),
        ({"covariance_enu_m2": (0.0,) * 6}, None),
    ],
)
def test_a_solution_that_claims_to_be_no_fix_is_not_judged(changes, reason):
    assert FixSequence().check_arrival(fix(**changes), at(0), RULES) == reason


def test_a_claim_of_no_number_is_no_fix():
    claimed = fix().model_copy(update={"covariance_enu_m2": (math.nan, 0.0, 0.0, 0.01, 0.0, 0.01)})
    assert FixSequence().check_arrival(claimed, at(0), RULES) == "fix_implausible"
