"""Without an anchor the first fix is confirmed only after several in a row that went where the wheels went."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.checks.start_rule import StartCount, StartFix, StartRules, follows
from support.judging import SPEED_M_S, at, place

RULES = StartRules(fixes=5, duration_s=0.8, longest_gap_s=1.0, distance_m=0.3, distance_share=0.02)


def fix(epoch, *, east_m=0.0, speed_m_s=SPEED_M_S):
    latitude_rad, longitude_rad = place(epoch, east_m)
    return StartFix(
        time_ns=at(epoch), latitude_rad=latitude_rad, longitude_rad=longitude_rad, speed_m_s=speed_m_s
    )


def count_after(fixes, rules=RULES):
    count = StartCount()
    for one in fixes:
        count = count.after(one, rules)
    return count


def test_no_fix_is_not_enough():
    assert not StartCount().enough(replace(RULES, fixes=0, duration_s=0.0))


@pytest.mark.parametrize(("fixes", "enough"), [(4, False), (5, True), (6, True)])
def test_the_fifth_in_a_row_is_enough(fixes, enough):
    assert count_after([fix(k) for k in range(fixes)]).enough(RULES) is enough


def test_five_within_too_short_a_time_are_not():
    count = count_after([fix(0.5 * k) for k in range(5)])
    assert count.fixes == 5
    assert not count.enough(RULES)


@pytest.mark.parametrize(("fixes", "enough"), [(4, False), (5, True)])
def test_however_long_a_few_take_they_are_not_enough(fixes, enough):
    count = count_after([fix(1.5 * k) for k in range(fixes)])
    assert at(1.5 * (fixes - 1)) - at(0) > RULES.duration_s * 1e9
    assert count.enough(RULES) is enough


@pytest.mark.parametrize(
    "odd",
    [
        fix(5, east_m=0.5),
        fix(5, east_m=-3.0),
        fix(5, speed_m_s=None),
        fix(5, speed_m_s=0.0),
        fix(5, speed_m_s=math.nan),
        fix(10),
        fix(4),
    ],
    ids=["jumps ahead", "jumps back", "no speed", "wheels stand", "speed is no number", "gap", "same time"],
)
def test_one_that_does_not_follow_begins_the_count_anew(odd):
    assert count_after([fix(k) for k in range(5)]).fixes == 5
    assert count_after([*(fix(k) for k in range(5)), odd]).fixes == 1


def test_after_one_without_a_speed_the_next_begins_too():
    assert count_after([fix(0, speed_m_s=None), fix(1)]).fixes == 1


def test_a_vehicle_that_stands_counts():
    standing = [replace(fix(0, speed_m_s=0.0), time_ns=at(k)) for k in range(5)]
    assert count_after(standing).enough(RULES)


def test_a_vehicle_that_goes_backwards_counts():
    assert follows(fix(0, speed_m_s=-SPEED_M_S), fix(1, speed_m_s=-SPEED_M_S), RULES)


@pytest.mark.parametrize(("east_m", "does"), [(0.49, True), (-0.49, True), (0.51, False), (-0.51, False)])
def test_wheels_may_differ_by_two_percent_of_the_distance(east_m, does):
    assert follows(fix(0), fix(5, east_m=east_m), RULES) is does  # 10 m in a second


@given(jump_m=st.floats(0.4, 1000.0))
def test_a_jump_is_never_followed(jump_m):
    assert not follows(fix(0), fix(1, east_m=jump_m), RULES)
