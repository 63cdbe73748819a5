"""LAMBDA, first half: decorrelation of the ambiguities by an integer transformation.

Sources: Teunissen 1995; de Jonge and Tiberius,
LGR series 12 (1996); Chang, Yang and Zhou, MLAMBDA, J. Geodesy 79 (2005): symmetric pivoting; Xie, Chang and
Al-Borno, Partial LLL reduction (2011): entries are reduced only where that leads to an exchange.

With ambiguities `a` and their covariance `Q` the results hold

    z = Z a,   Q_z = Z Q Zᵀ = U D Uᵀ

Z integer with determinant ±1, U upper triangular with ones on its diagonal, D diagonal. `D[i]` is the variance of z_i
given z_{i+1} … z_{n−1}. The last is the most precise; the last k of z, with the last k rows and columns of U and D, are
the subproblem of the k most precise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats

_LEAST_PIVOT = 1e-13
"""A conditional variance below this share of the variance is rounding: the covariance is singular."""
_ASYMMETRY = 1e-6  # chosen: rounding of the callers' covariances stays below it
_EXCHANGE = 1.0 - 1e-9
"""Only a conditional variance that falls by more than rounding makes an exchange, which guarantees termination."""
_MOST_EXCHANGES = 50
"""For each pair of ambiguities; chosen. Beyond, the reduction stays correct but less decorrelated."""
_LARGEST_INTEGER = 2.0**50
"""Integers are kept in doubles: exact up to 2⁵³."""


class Decorrelation(NamedTuple):
    """U (n, n), D (n,), Z (n, n) as in the module's text."""

    upper: Floats
    variances: Floats
    transform: Floats


@compiled
def decorrelated(covariance: Floats) -> tuple[bool, Decorrelation]:
    """Whether the covariance (n, n) could be decorrelated, and U, D, Z.

    False for anything but a symmetric positive definite matrix of finite numbers; U, D, Z are then undefined.
    """
    count = covariance.shape[0]
    z = Decorrelation(np.zeros((count, count)), np.zeros(count), np.zeros((count, count)))
    if covariance.shape[1] != count or not _factorised(covariance, z):
        return False, z
    _reduce(z)
    largest = 0.0
    for row in range(count):
        for column in range(count):
            largest = max(largest, abs(z.transform[row, column]))
        if not (z.variances[row] > 0.0 and np.isfinite(z.variances[row])):
            return False, z
    return largest < _LARGEST_INTEGER, z


@compiled
def _factorised(covariance: Floats, z: Decorrelation) -> bool:
    """Write U D Uᵀ of the covariance, ordered so that the smallest remaining conditional variance comes last."""
    count, upper = covariance.shape[0], z.upper
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
        z.variances[last] = pivot
        upper[last, last] = 1.0
        for row in range(last):
            pivot_column[row] = rest[last, row]
        for row in range(last):
            factor = pivot_column[row] / pivot
            upper[row, last] = factor
            for column in range(row + 1):
                rest[row, column] -= factor * pivot_column[column]
    for row in range(count):
        z.transform[row, order[row]] = 1.0
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
def _reduce(z: Decorrelation) -> None:
    """Subtract integer multiples of later rows and exchange neighbours until no variance falls any further."""
    upper, variances, count = z.upper, z.variances, z.variances.size
    left = _MOST_EXCHANGES * count * count
    at = count - 2
    while at >= 0 and left > 0:
        multiple = np.rint(upper[at, at + 1])
        small = upper[at, at + 1] - multiple
        variance = variances[at] + small * small * variances[at + 1]
        if variance < _EXCHANGE * variances[at + 1]:
            if multiple != 0.0:
                for other in range(at + 1, count):
                    _subtract(z, at, other)
            _exchange(z, at, variance)
            left -= 1
            at = min(at + 1, count - 2)
        else:
            at -= 1
    for row in range(count - 2, -1, -1):
        for other in range(row + 1, count):
            _subtract(z, row, other)


@compiled
def _subtract(z: Decorrelation, row: int, other: int) -> None:
    """Subtract the integer multiple of a later row that makes their entry smallest."""
    multiple = np.rint(z.upper[row, other])
    if multiple == 0.0:
        return
    count = z.upper.shape[0]
    for column in range(other, count):
        z.upper[row, column] -= multiple * z.upper[other, column]
    for column in range(count):
        z.transform[row, column] -= multiple * z.transform[other, column]


@compiled
def _exchange(z: Decorrelation, at: int, variance: float) -> None:
    """Exchange z[at] and z[at + 1]; `variance` is that of z[at] given z[at + 2] and later."""
    upper, variances, transform = z.upper, z.variances, z.transform
    count, after = variances.size, at + 1
    entry = upper[at, after]
    share = variances[at] / variance
    turned = variances[after] * entry / variance
    variances[at] = share * variances[after]
    variances[after] = variance
    for row in range(at):
        first, second = upper[row, at], upper[row, after]
        upper[row, at] = second - entry * first
        upper[row, after] = share * first + turned * second
    upper[at, after] = turned
    for column in range(after + 1, count):
        upper[at, column], upper[after, column] = upper[after, column], upper[at, column]
    for column in range(count):
        transform[at, column], transform[after, column] = transform[after, column], transform[at, column]
