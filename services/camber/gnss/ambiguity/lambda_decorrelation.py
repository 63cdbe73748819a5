"""Decorrelation of carrier ambiguities by an integer transformation: the first half of LAMBDA.

Sources: Teunissen, The least-squares ambiguity decorrelation adjustment, J. Geodesy 70 (1995); de Jonge and Tiberius,
LGR series 12 (1996); Chang, Yang and Zhou, MLAMBDA, J. Geodesy 79 (2005): symmetric pivoting; Xie, Chang and
Al-Borno, Partial LLL reduction (2011): entries are made small only where that leads to an exchange.

With ambiguities `a` and their covariance `Q` the results hold

    z = Z a,   Q_z = Z Q Zᵀ = U D Uᵀ

Z integer with determinant ±1, U upper triangular with ones on its diagonal, D diagonal. `D[i]` is the variance of z_i
given z_{i+1} … z_{n−1}: the last is the most precise, and the last k of z with the last k rows and columns of U and D
are a problem of their own, the k most precise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled

Floats = NDArray[np.float64]

_LEAST_PIVOT = 1e-13
"""A conditional variance below this share of the variance is rounding: the covariance is singular."""
_ASYMMETRY = 1e-6
_EXCHANGE = 1.0 - 1e-9
"""Only a conditional variance that falls by more than rounding makes an exchange: so the exchanges come to an end."""
_MOST_EXCHANGES = 50
"""For each pair of ambiguities. Beyond, the reduction is left as it is: right, only less decorrelated."""
_LARGEST_INTEGER = 2.0**50
"""Integers are kept in doubles: exact up to 2⁵³."""


@compiled
def decorrelated(covariance: Floats) -> tuple[bool, Floats, Floats, Floats]:
    """Whether the covariance (n, n) could be decorrelated, and U (n, n), D (n,), Z (n, n) as in the module's text.

    False for anything but a symmetric positive definite matrix of finite numbers; U, D, Z then mean nothing.
    """
    count = covariance.shape[0]
    upper = np.zeros((count, count))
    variances = np.zeros(count)
    transform = np.zeros((count, count))
    if covariance.shape[1] != count or not _factorised(covariance, upper, variances, transform):
        return False, upper, variances, transform
    _reduce(upper, variances, transform)
    largest = 0.0
    for row in range(count):
        for column in range(count):
            largest = max(largest, abs(transform[row, column]))
        if not (variances[row] > 0.0 and np.isfinite(variances[row])):
            return False, upper, variances, transform
    return largest < _LARGEST_INTEGER, upper, variances, transform


@compiled
def _factorised(covariance: Floats, upper: Floats, variances: Floats, transform: Floats) -> bool:
    """U D Uᵀ of the covariance in an order in which the smallest conditional variance left comes last."""
    count = covariance.shape[0]
    rest = np.empty((count, count))
    for row in range(count):
        if not (covariance[row, row] > 0.0 and np.isfinite(covariance[row, row])):
            return False
        for column in range(row + 1):
            value = covariance[row, column]
            other = covariance[column, row]
            scale = np.sqrt(covariance[row, row] * covariance[column, column])
            if not (abs(value - other) <= _ASYMMETRY * scale and abs(value) <= 2.0 * scale):
                return False
            rest[row, column] = value
            rest[column, row] = value
    order = np.arange(count)
    pivot_column = np.empty(count)
    for last in range(count - 1, -1, -1):
        least = last
        for row in range(last):
            if rest[row, row] < rest[least, least]:
                least = row
        if least != last:
            _exchange_in_rest(rest, least, last)
            order[least], order[last] = order[last], order[least]
            for column in range(last + 1, count):
                upper[least, column], upper[last, column] = upper[last, column], upper[least, column]
        pivot = rest[last, last]
        if not pivot > _LEAST_PIVOT * covariance[order[last], order[last]]:
            return False
        variances[last] = pivot
        upper[last, last] = 1.0
        for row in range(last):
            pivot_column[row] = rest[last, row]
        for row in range(last):
            factor = pivot_column[row] / pivot
            upper[row, last] = factor
            for column in range(row + 1):
                rest[row, column] -= factor * pivot_column[column]
    for row in range(count):
        transform[row, order[row]] = 1.0
    return True


@compiled
def _exchange_in_rest(rest: Floats, one: int, last: int) -> None:
    """Exchange two rows and columns, one < last, of the lower triangle whose last row is `last`."""
    rest[one, one], rest[last, last] = rest[last, last], rest[one, one]
    for place in range(one):
        rest[one, place], rest[last, place] = rest[last, place], rest[one, place]
    for place in range(one + 1, last):
        rest[place, one], rest[last, place] = rest[last, place], rest[place, one]


@compiled
def _reduce(upper: Floats, variances: Floats, transform: Floats) -> None:
    """Subtract integer multiples of later rows and exchange neighbours until no variance falls any further."""
    count = variances.size
    left = _MOST_EXCHANGES * count * count
    place = count - 2
    while place >= 0 and left > 0:
        multiple = np.rint(upper[place, place + 1])
        small = upper[place, place + 1] - multiple
        variance = variances[place] + small * small * variances[place + 1]
        if variance < _EXCHANGE * variances[place + 1]:
            if multiple != 0.0:
                for other in range(place + 1, count):
                    _subtract(upper, transform, place, other)
            _exchange(upper, variances, transform, place, variance)
            left -= 1
            place = min(place + 1, count - 2)
        else:
            place -= 1
    for place in range(count - 2, -1, -1):
        for other in range(place + 1, count):
            _subtract(upper, transform, place, other)


@compiled
def _subtract(upper: Floats, transform: Floats, row: int, other: int) -> None:
    """Take that integer multiple of a later row from a row which makes their entry smallest."""
    multiple = np.rint(upper[row, other])
    if multiple == 0.0:
        return
    count = upper.shape[0]
    for column in range(other, count):
        upper[row, column] -= multiple * upper[other, column]
    for column in range(count):
        transform[row, column] -= multiple * transform[other, column]


@compiled
def _exchange(upper: Floats, variances: Floats, transform: Floats, place: int, variance: float) -> None:
    """Exchange z[place] and z[place + 1]; `variance` is that of z[place] given what follows z[place + 1]."""
    count = variances.size
    after = place + 1
    entry = upper[place, after]
    share = variances[place] / variance
    turned = variances[after] * entry / variance
    variances[place] = share * variances[after]
    variances[after] = variance
    for row in range(place):
        first, second = upper[row, place], upper[row, after]
        upper[row, place] = second - entry * first
        upper[row, after] = share * first + turned * second
    upper[place, after] = turned
    for column in range(after + 1, count):
        upper[place, column], upper[after, column] = upper[after, column], upper[place, column]
    for column in range(count):
        transform[place, column], transform[after, column] = (
            transform[after, column],
            transform[place, column],
        )
