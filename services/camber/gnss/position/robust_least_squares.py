"""Weighted least squares that leaves out what contradicts the rest, and says so; compiled.

Sources: W. Baarda, "A testing procedure for use in geodetic networks" (1968): the normalised residual w = v / σ_v; its
square is what χ² loses when the row is left out, so that the greatest w marks the leave-one-out that fits best.
M. Abramowitz, I. Stegun, "Handbook of mathematical functions", 26.4.4 and 26.4.5 (χ² distribution).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers

Booleans = NDArray[np.bool_]

OK, TOO_FEW, DEGENERATE, INCONSISTENT = range(4)
"""`TOO_FEW`: fewer rows than unknowns. `DEGENERATE`: the rows do not tell the unknowns apart."""

_SMALLEST_PIVOT = 1.0e-8  # of the diagonal: a dilution of about 10⁴
_MOST_OF_THREES = 40  # rows of which every three are tried: 9,880 of them, a third of a millisecond
_TESTABLE = 1.0e-6  # of its variance, what a residual must keep: else nothing else measures what the row does


class Fit(NamedTuple):
    """p unknowns from n rows. `value` (p,) is NaN where no row that is used has the unknown, as is its covariance.

    `residual` (n,): observed less fitted, of the rows that are left out too. `degrees` of freedom: 0 says that nothing
    could be tested.
    """

    status: int
    value: Floats
    covariance: Floats
    residual: Floats
    used: Booleans
    chi_squared: float
    degrees: int


@compiled
def consistent_fit(
    design: Floats,
    observed: Floats,
    sigma: Floats,
    prior_sigma: Floats,
    candidate: Booleans,
    false_alarm: float,
) -> Fit:
    """Fit `observed` (n,) of standard deviations `sigma` (n,) by `design` (n, p), of the candidate rows (n,).

    An unknown is zero before, with `prior_sigma` (p,), or free where that is not finite. Rows are taken for wrong when
    χ² of all, or the greatest normalised residual among n, would be so with probability `false_alarm` or less; then the
    row of the greatest goes, again and again, and at last those that fit after all come back. Wrong rows that agree
    with one another hide in that order and may take the right ones' place: where more than two would go, or none do,
    every two are tried too, and every three, and the fewest that have to go are what goes. It is `INCONSISTENT` where
    the test fails and nothing would be left to test with, or half of the rows would go.
    """
    n = observed.size
    used = candidate.copy()
    count = 0
    for i in range(n):
        count += candidate[i]
    least = count - count // 2
    status, value, covariance, chi_squared, degrees = _solve(design, observed, sigma, prior_sigma, used)
    residual = np.full(n, np.nan)
    while status == OK and degrees > 0:
        worst, w_squared = _worst(design, observed, sigma, used, value, covariance)
        if not is_suspect(chi_squared, degrees, w_squared, count, false_alarm):
            break
        if worst < 0 or degrees < 2 or count_of(used) <= least:
            status = INCONSISTENT
            break
        used[worst] = False
        status, value, covariance, chi_squared, degrees = _solve(design, observed, sigma, prior_sigma, used)
    if status == INCONSISTENT or (status == OK and count - count_of(used) > 2):
        most = count - count_of(used) if status == OK else 4
        fewer = _fewest_left_out(design, observed, sigma, prior_sigma, candidate, most, least, false_alarm)
        if fewer.size > 0:
            used[:] = candidate
            used[fewer] = False
            status, value, covariance, chi_squared, degrees = _solve(
                design, observed, sigma, prior_sigma, used
            )
    if status == OK:
        for _ in range(count - count_of(used)):
            best = _best_left_out(
                design, observed, sigma, candidate, used, value, covariance, count, false_alarm
            )
            if best < 0:
                break
            used[best] = True
            again = _solve(design, observed, sigma, prior_sigma, used)
            _, w_squared = _worst(design, observed, sigma, used, again[1], again[2])
            if again[0] != OK or is_suspect(again[3], again[4], w_squared, count, false_alarm):
                used[best] = False
                break
            status, value, covariance, chi_squared, degrees = again
    for i in range(n):
        if candidate[i]:
            residual[i] = observed[i] - _fitted(design[i], value)
    return Fit(status, value, covariance, residual, used, chi_squared, degrees)


@compiled
def _fewest_left_out(
    design: Floats,
    observed: Floats,
    sigma: Floats,
    prior_sigma: Floats,
    candidate: Booleans,
    most: int,
    least: int,
    false_alarm: float,
) -> Integers:
    """Two rows, or three, fewer than `most`, without which the others agree; empty where there are none.

    With v the residuals of all in units of σ and H what of the observations is in what is fitted (the hat matrix), χ²
    loses v_S · (I − H_SS)⁻¹ v_S with the rows S. Those with which it loses most are tried.
    """
    rows = np.flatnonzero(candidate)
    n = rows.size
    _, value, covariance, _, _ = _solve(design, observed, sigma, prior_sigma, candidate)
    v, left = np.empty(n), np.empty((n, n))
    for i in range(n):
        at = rows[i]
        v[i] = (observed[at] - _fitted(design[at], value)) / sigma[at]
        for j in range(i + 1):
            fitted = _shared(design[at], design[rows[j]], covariance) / (sigma[at] * sigma[rows[j]])
            left[i, j] = left[j, i] = (1.0 if i == j else 0.0) - fitted
    for size in range(2, 4):
        if size >= most or n - size < least or (size == 3 and n > _MOST_OF_THREES):
            break
        chosen = rows[_two(v, left) if size == 2 else _three(v, left)]
        if chosen.size == 0:
            continue
        used = candidate.copy()
        used[chosen] = False
        status, value, covariance, chi_squared, degrees = _solve(design, observed, sigma, prior_sigma, used)
        if status == OK and degrees > 0:
            _, w_squared = _worst(design, observed, sigma, used, value, covariance)
            if not is_suspect(chi_squared, degrees, w_squared, n, false_alarm):
                return chosen
    return rows[:0]


@compiled
def _with_both(v: Floats, left: Floats, i: int, j: int) -> tuple[float, float]:
    """Determinant of what is left of two rows, and what χ² loses with them: nothing where all others hang on them."""
    a, b, c = left[i, i], left[i, j], left[j, j]
    determinant = a * c - b * b
    if not determinant > _TESTABLE:
        return determinant, 0.0
    return determinant, (c * v[i] * v[i] - 2.0 * b * v[i] * v[j] + a * v[j] * v[j]) / determinant


@compiled
def _two(v: Floats, left: Floats) -> Integers:
    """The two rows with which χ² loses most; empty where all others hang on any two."""
    n, best, greatest = v.size, np.empty(0, np.int64), 0.0
    for i in range(n):
        for j in range(i):
            _, lost = _with_both(v, left, i, j)
            if lost > greatest:
                greatest, best = lost, np.array([j, i])
    return best


@compiled
def _three(v: Floats, left: Floats) -> Integers:
    """The three rows with which χ² loses most; empty where all others hang on any three."""
    n, best, greatest = v.size, np.empty(0, np.int64), 0.0
    for i in range(n):
        for j in range(i):
            determinant, lost = _with_both(v, left, i, j)
            if not determinant > _TESTABLE:
                continue
            a, b, c = left[i, i], left[i, j], left[j, j]
            for k in range(j):
                d, e = left[i, k], left[j, k]
                # The third beside the two: what it has on its own, and how far it is off what they say of it.
                f, g = (c * d - b * e) / determinant, (a * e - b * d) / determinant
                own = left[k, k] - f * d - g * e
                if own > _TESTABLE:
                    off = v[k] - f * v[i] - g * v[j]
                    if lost + off * off / own > greatest:
                        greatest, best = lost + off * off / own, np.array([k, j, i])
    return best


@compiled
def count_of(rows: Booleans) -> int:
    """How many are true."""
    count = 0
    for i in range(rows.size):
        count += rows[i]
    return count


@compiled
def is_suspect(chi_squared: float, degrees: int, w_squared: float, count: int, false_alarm: float) -> bool:
    """Whether χ², or the greatest of `count` normalised residuals, is too great for chance."""
    if chi_squared_survival(chi_squared, degrees) < false_alarm:
        return True
    return math.erfc(math.sqrt(0.5 * w_squared)) * count < false_alarm


@compiled
def chi_squared_survival(chi_squared: float, degrees: int) -> float:
    """Probability of at least this χ²: the finite sums for an even and an odd number of degrees ≥ 1. NaN gives 0."""
    if degrees < 1:
        return 1.0
    if not 0.0 <= chi_squared < np.inf:
        return 0.0
    half = 0.5 * chi_squared
    if degrees % 2 == 0:
        term, total = math.exp(-half), 0.0
        for k in range(degrees // 2):
            total += term
            term *= half / (k + 1.0)
        return min(total, 1.0)
    total = math.erfc(math.sqrt(half))
    term = math.exp(-half) * math.sqrt(half) / math.sqrt(0.25 * math.pi)
    for k in range(degrees // 2):
        total += term
        term *= half / (k + 1.5)
    return min(total, 1.0)


@compiled
def _fitted(row: Floats, value: Floats) -> float:
    """NaN where the row has an unknown that no row in use has."""
    total = 0.0
    for a in range(value.size):
        if row[a] != 0.0:
            total += row[a] * value[a]
    return total


@compiled
def _spread(row: Floats, covariance: Floats) -> float:
    """Variance of what is fitted for a row."""
    return _shared(row, row, covariance)


@compiled
def _shared(one: Floats, other: Floats, covariance: Floats) -> float:
    """Covariance of what is fitted for two rows."""
    total = 0.0
    for a in range(one.size):
        if one[a] == 0.0:
            continue
        for b in range(other.size):
            if other[b] != 0.0:
                total += one[a] * covariance[a, b] * other[b]
    return total


@compiled
def _worst(
    design: Floats, observed: Floats, sigma: Floats, used: Booleans, value: Floats, covariance: Floats
) -> tuple[int, float]:
    """The row of the greatest normalised residual and its square; −1 where none can be tested."""
    worst, greatest = -1, 0.0
    for i in range(observed.size):
        if not used[i]:
            continue
        variance = sigma[i] * sigma[i]
        left = variance - _spread(design[i], covariance)
        if left > _TESTABLE * variance:
            v = observed[i] - _fitted(design[i], value)
            w_squared = v * v / left
            if w_squared > greatest:
                worst, greatest = i, w_squared
    return worst, greatest


@compiled
def _best_left_out(
    design: Floats,
    observed: Floats,
    sigma: Floats,
    candidate: Booleans,
    used: Booleans,
    value: Floats,
    covariance: Floats,
    count: int,
    false_alarm: float,
) -> int:
    """The row left out that is nearest to what the others say of it, if that is near enough; −1 else."""
    best, least = -1, np.inf
    for i in range(observed.size):
        if candidate[i] and not used[i]:
            v = observed[i] - _fitted(design[i], value)
            w_squared = v * v / (sigma[i] * sigma[i] + _spread(design[i], covariance))
            # NaN where no row that is used has one of its unknowns.
            if w_squared < least:
                best, least = i, w_squared
    if best >= 0 and math.erfc(math.sqrt(0.5 * least)) * count < false_alarm:
        return -1
    return best


@compiled
def _solve(
    design: Floats, observed: Floats, sigma: Floats, prior_sigma: Floats, used: Booleans
) -> tuple[int, Floats, Floats, float, int]:
    """Status, values, covariance, χ² with what the priors add to it, degrees of freedom."""
    n, p = design.shape
    normal, right = np.zeros((p, p)), np.zeros(p)
    rows = 0
    for i in range(n):
        if not used[i]:
            continue
        rows += 1
        weight = 1.0 / (sigma[i] * sigma[i])
        for a in range(p):
            scaled = weight * design[i, a]
            if scaled != 0.0:
                right[a] += scaled * observed[i]
                for b in range(a + 1):
                    normal[a, b] += scaled * design[i, b]
    free = 0
    active = np.zeros(p, np.bool_)
    for a in range(p):
        active[a] = normal[a, a] > 0.0
        if not active[a]:
            normal[a, a] = 1.0
        elif prior_sigma[a] < np.inf:
            normal[a, a] += 1.0 / (prior_sigma[a] * prior_sigma[a])
        else:
            free += 1
    value, covariance = np.full(p, np.nan), np.full((p, p), np.nan)
    if rows < free or rows == 0:
        return TOO_FEW, value, covariance, np.nan, 0
    inverse = _inverse_of_lower(normal)
    if inverse.shape[0] == 0:
        return DEGENERATE, value, covariance, np.nan, 0
    # C = L⁻ᵀ L⁻¹, x = C b.
    for a in range(p):
        for b in range(a + 1):
            if active[a] and active[b]:
                total = 0.0
                for k in range(a, p):
                    total += inverse[k, a] * inverse[k, b]
                covariance[a, b] = total
                covariance[b, a] = total
    for a in range(p):
        if active[a]:
            total = 0.0
            for b in range(p):
                if active[b]:
                    total += covariance[a, b] * right[b]
            value[a] = total
    chi_squared = 0.0
    for i in range(n):
        if used[i]:
            v = (observed[i] - _fitted(design[i], value)) / sigma[i]
            chi_squared += v * v
    for a in range(p):
        if active[a] and prior_sigma[a] < np.inf:
            chi_squared += (value[a] / prior_sigma[a]) ** 2
    return OK, value, covariance, chi_squared, rows - free


@compiled
def _inverse_of_lower(normal: Floats) -> Floats:
    """Inverse of the Cholesky factor of a symmetric matrix given by its lower triangle; (0, 0) if it is singular."""
    p = normal.shape[0]
    lower = np.zeros((p, p))
    for a in range(p):
        for b in range(a + 1):
            total = normal[a, b]
            for k in range(b):
                total -= lower[a, k] * lower[b, k]
            if a == b:
                if not _SMALLEST_PIVOT * normal[a, a] < total < np.inf:
                    return np.zeros((0, 0))
                lower[a, a] = math.sqrt(total)
            else:
                lower[a, b] = total / lower[b, b]
    inverse = np.zeros((p, p))
    for b in range(p):
        inverse[b, b] = 1.0 / lower[b, b]
        for a in range(b + 1, p):
            total = 0.0
            for k in range(b, a):
                total += lower[a, k] * inverse[k, b]
            inverse[a, b] = -total / lower[a, a]
    return inverse


@compiled
def dilutions(design: Floats, used: Booleans, rotation: Floats) -> tuple[float, float, float]:
    """GDOP, HDOP, VDOP of a design whose first three unknowns are a position in ECEF; `rotation` (3, 3) turns to ENU.

    NaN where there is none.
    """
    n, p = design.shape
    free, ones = np.full(p, np.inf), np.ones(n)
    status, _, covariance, _, _ = _solve(design, np.zeros(n), ones, free, used)
    if status != OK or not covariance[0, 0] + covariance[1, 1] + covariance[2, 2] < np.inf:
        return np.nan, np.nan, np.nan
    total = 0.0
    for a in range(p):
        if covariance[a, a] == covariance[a, a]:
            total += covariance[a, a]
    of_axis = np.zeros(3)
    for k in range(3):
        of_axis[k] = _spread(rotation[k], covariance[:3, :3])
    return math.sqrt(total), math.sqrt(of_axis[0] + of_axis[1]), math.sqrt(of_axis[2])
