"""The height correction is learnt slowly, from right positions of a moving vehicle, and within its cap."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.learning import (
    Correction,
    LearningRules,
    correction_from_text,
    learn,
    text_from_correction,
)

RULES = LearningRules(gain=0.01, least_speed_m_s=3.0, cap_m=0.3)


def step(correction, *, receiver_m=41.9, speed_m_s=10.0):
    return learn(correction, RULES, receiver_m=receiver_m, antenna_m=1.8, road_m=40.0, speed_m_s=speed_m_s)


def test_one_position_moves_the_correction_by_the_gain():
    assert step(Correction()) == Correction(pytest.approx(0.01 * 0.1), 1)


def test_the_correction_before_keeps_the_rest():
    assert step(Correction(0.2, 5)) == Correction(pytest.approx(0.99 * 0.2 + 0.01 * 0.1), 6)


def test_it_ends_at_what_is_observed():
    correction = Correction()
    for _ in range(2000):
        correction = step(correction)
    assert correction.correction_m == pytest.approx(0.1, abs=1e-6)
    assert correction.samples == 2000


@pytest.mark.parametrize("speed_m_s", [None, 0.0, 2.99, -2.99, math.nan])
def test_in_the_stop_range_or_at_an_unknown_speed_nothing_is_learnt(speed_m_s):
    assert step(Correction(0.1, 3), speed_m_s=speed_m_s) == Correction(0.1, 3)


@pytest.mark.parametrize("speed_m_s", [3.0, -3.0])
def test_outside_the_stop_range_is_learnt_forwards_and_backwards(speed_m_s):
    assert step(Correction(), speed_m_s=speed_m_s).samples == 1


@pytest.mark.parametrize("receiver_m", [1e6, -1e6, math.nan, math.inf])
def test_what_would_go_beyond_the_cap_is_not_believed(receiver_m):
    assert step(Correction(0.1, 3), receiver_m=receiver_m) == Correction(0.1, 3)


@given(heights=st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=50))
def test_no_heights_whatever_take_it_beyond_the_cap(heights):
    correction = Correction()
    for receiver_m in heights:
        correction = step(correction, receiver_m=receiver_m)
        assert abs(correction.correction_m) <= RULES.cap_m


@given(st.floats(-0.3, 0.3), st.integers(0, 10**9))
def test_it_survives_a_restart(correction_m, samples):
    kept = Correction(correction_m, samples)
    assert correction_from_text(text_from_correction(kept), RULES) == kept


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        '{"correction_m": 0.1}',
        '{"correction_m": 0.1, "samples": 1, "more": 1}',
        '{"correction_m": 0.31, "samples": 1}',
        '{"correction_m": NaN, "samples": 1}',
        '{"correction_m": Infinity, "samples": 1}',
        '{"correction_m": true, "samples": 1}',
        '{"correction_m": "0.1", "samples": 1}',
        '{"correction_m": 0.1, "samples": -1}',
        '{"correction_m": 0.1, "samples": 1.5}',
        '{"correction_m": 0.1, "samples": Infinity}',
    ],
)
def test_a_damaged_one_is_refused(text):
    with pytest.raises(ValueError, match=r"expected|Expecting"):
        correction_from_text(text, RULES)
