"""One formula for plain floats and arrays: each of its parts gives the same bits for both."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camber.integrity.scalar_or_array import (
    any_of,
    exp,
    finite_or_inf,
    larger_eigenvalue,
    log,
    log_sum_exp,
    logical_not,
    positive_or_nan,
    sqrt,
    where,
)

VALUES = [-math.inf, -1.0, -0.0, 0.0, 5e-324, 0.1, 1.0, 1e308, math.inf, math.nan]


def same(one: float, other: float) -> bool:
    return np.float64(one).tobytes() == np.float64(other).tobytes()


@pytest.mark.parametrize(
    "part", [positive_or_nan, finite_or_inf, lambda x: where(x > 0.5, x, -x), lambda x: sqrt(abs(x))]
)
def test_each_part_is_the_same_for_both(part) -> None:
    for one, other in zip(VALUES, part(np.array(VALUES)), strict=True):
        assert same(abs(part(one)), abs(other))


def test_what_may_be_divided_by_is_positive_and_finite() -> None:
    assert [math.isnan(positive_or_nan(value)) for value in VALUES] == [*[True] * 4, *[False] * 4, True, True]
    assert [positive_or_nan(value) for value in VALUES[4:8]] == VALUES[4:8]


def test_what_numpy_compares_by_itself_chooses_a_plain_number() -> None:
    one, other = np.array([1.0, 2.0])
    for condition, expected in ((one < other, 3.0), (one > other, 4.0)):
        assert isinstance(condition, np.bool_)
        chosen = where(condition, 3.0, 4.0)
        assert type(chosen) is float
        assert chosen == expected


def test_what_is_not_known_is_infinite() -> None:
    assert finite_or_inf(math.nan) == math.inf
    assert finite_or_inf(3.0) == 3.0


def test_a_condition_applies_to_one_at_least() -> None:
    assert [any_of(np.array(a)) for a in ([False, False], [False, True], [True, True])] == [False, True, True]
    assert (any_of(True), any_of(False)) == (True, False)


@pytest.mark.parametrize("function", [sqrt, exp, log])
def test_a_function_of_a_float_is_one_and_of_an_array_as_many(function: Callable[[Any], Any]) -> None:
    one, many = (function(x) for x in (0.3, np.array([0.3])))
    assert isinstance(one, float)
    assert many.shape == (1,)
    assert one == pytest.approx(many[0], rel=1e-15)


def test_a_condition_is_turned_round() -> None:
    assert logical_not(np.array([True, False])).tolist() == [False, True]
    assert (logical_not(True), logical_not(False)) == (False, True)


@given(st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_the_larger_eigenvalue_is_that_of_another_implementation(m: tuple[float, float, float]) -> None:
    expected = np.linalg.eigvalsh([[m[0], m[1]], [m[1], m[2]]])[1]
    assert larger_eigenvalue(*m) == pytest.approx(expected, abs=1e-9)
    assert same(larger_eigenvalue(*m), larger_eigenvalue(*(np.array([x]) for x in m))[0])


@given(st.floats(-800.0, 800.0), st.floats(-800.0, 800.0))
def test_the_logarithm_of_a_sum_is_that_of_another_implementation(one: float, other: float) -> None:
    expected = pytest.approx(np.logaddexp(one, other), abs=1e-12)
    assert log_sum_exp(one, other) == expected
    assert log_sum_exp(np.array([one]), np.array([other]))[0] == expected


def test_logarithms_are_natural_ones() -> None:
    assert log(math.e) == pytest.approx(1.0)
    assert log(np.array([math.e])) == pytest.approx([1.0])
