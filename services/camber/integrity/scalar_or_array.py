"""What plain floats and arrays do not share in numpy, so that one formula serves both: the judge asks of one fix, the
lab of millions, and numpy takes longer over one number than over a hundred.

Formulas are written with operators and these. Plain floats are Python's own: a formula divides by what it knows is not
zero (NaN will do), for that would raise. Both kinds of number give the same bits.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np

FloatOrArray: TypeAlias = Any
"""A float or an array of them, all (n,); outcomes and booleans too. numpy's types cannot say that both agree."""


def any_of(condition: FloatOrArray) -> bool:
    """Does it apply to one of them at least?"""
    if condition is True or condition is False:
        return condition
    return bool(condition.any()) if isinstance(condition, np.ndarray) else condition


def where(condition: FloatOrArray, yes: FloatOrArray, no: FloatOrArray) -> FloatOrArray:
    """`yes` where it applies, else `no`; what does not apply may be anything."""
    if condition is True or condition is False:  # plain floats, asked for most often
        return yes if condition else no
    return np.where(condition, yes, no) if isinstance(condition, np.ndarray) else yes if condition else no


def logical_not(condition: FloatOrArray) -> FloatOrArray:
    """Where it does not apply."""
    return ~condition if isinstance(condition, np.ndarray) else not condition


def positive_or_nan(value: FloatOrArray) -> FloatOrArray:
    """The value where it is above zero and finite, else NaN: what may be divided by and has a root."""
    return where((value > 0.0) & (value < math.inf), value, math.nan)


def finite_or_inf(value: FloatOrArray) -> FloatOrArray:
    """Infinite where it is not a number."""
    return where(value < math.inf, value, math.inf)


def sqrt(value: FloatOrArray) -> FloatOrArray:
    """√ of what is not negative."""
    return np.sqrt(value) if isinstance(value, np.ndarray) else math.sqrt(value)


def exp(value: FloatOrArray) -> FloatOrArray:
    """e to the power of it."""
    return np.exp(value) if isinstance(value, np.ndarray) else math.exp(value)


def log(value: FloatOrArray) -> FloatOrArray:
    """Natural logarithm of a positive number."""
    return np.log(value) if isinstance(value, np.ndarray) else math.log(value)


def log_sum_exp(one: FloatOrArray, other: FloatOrArray) -> FloatOrArray:
    """ln (eᵃ + eᵇ)."""
    larger, smaller = where(one > other, one, other), where(one > other, other, one)
    return larger + log(1.0 + exp(smaller - larger))


def larger_eigenvalue(ee: FloatOrArray, en: FloatOrArray, nn: FloatOrArray) -> FloatOrArray:
    """Of [[ee, en], [en, nn]]."""
    half = 0.5 * (ee - nn)
    return 0.5 * (ee + nn) + sqrt(half * half + en * en)
