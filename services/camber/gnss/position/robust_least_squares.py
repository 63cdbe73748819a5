"""Weighted least squares with outlier exclusion; compiled.

Sources: W. Baarda, "A testing procedure for use in geodetic networks" (1968): the normalised residual w = v / σ_v; its
square is the fall of χ² when the row is excluded, so that the largest w marks the best single exclusion.
M. Abramowitz, I. Stegun, "Handbook of mathematical functions", 26.4.4 and 26.4.5 (χ² distribution).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers
from camber.gnss.observations.signal_pairs import Booleans

OK, TOO_FEW, DEGENERATE, INCONSISTENT = range(4)
"""`TOO_FEW`: fewer rows than unknowns. `DEGENERATE`: the rows do not determine all unknowns."""

_SMALLEST_PIVOT = 1.0e-8  # share of the diagonal; derived: a dilution of precision of about 10⁴
_MOST_OF_THREES = 40  # rows of which all triples are tried; chosen: 9,880 triples
_TESTABLE = 1.0e-6  # least redundancy, share of the variance; chosen: below it nothing else measures the same


class LinearModel(NamedTuple):
    """n observations (n,) of standard deviations `sigma` (n,), linear in p unknowns by `design` (n, p).

    Each unknown has a prior of mean zero and `prior_sigma` (p,), or none where that is infinite.
    """

    design: Floats
    observed: Floats
    sigma: Floats
    prior_sigma: Floats


class RobustFit(NamedTuple):
    """p unknowns from n rows. `value` (p,) and its covariance are NaN for an unknown that no row in use has.

    χ² includes the priors. `degrees` of freedom: 0 means untested.
    """

    status: int
    value: Floats
    covariance: Floats
    used: Booleans
    chi_squared: float
    degrees: int


@compiled
def empty_model(n: int, p: int) -> LinearModel:
    """A model of zeros, without priors, to be written."""
    return LinearModel(np.zeros((n, p)), np.zeros(n), sigma=np.ones(n), prior_sigma=np.full(p, np.inf))


@compiled
def empty_fit(status: int, n: int, p: int) -> RobustFit:
    """The fit of no rows."""
    return RobustFit(
        status,
        np.full(p, np.nan),
        covariance=np.full((p, p), np.nan),
        used=np.zeros(n, np.bool_),
        chi_squared=np.nan,
        degrees=0,
    )


@compiled
def consistent_fit(model: LinearModel, candidate: Booleans, false_alarm: float) -> RobustFit:
    """Fit the candidate rows (n,) and exclude outliers.

    Rows are inconsistent when χ² of all, or the largest normalised residual among n, would be so with probability
    `false_alarm` or less. The row with the largest residual is then excluded, repeatedly, and finally the excluded rows
    that fit after all are readmitted. Outliers that agree with one another can mask each other in that order and push
    out the right rows: where more than two would be excluded, or the sequence fails, all pairs and all triples are
    tried too, and the smallest set wins. `INCONSISTENT`: the test fails and nothing would be left to test with, or half
    of the rows would be excluded.
    """
    used = candidate.copy()
    count = candidate.sum()
    least = count - count // 2
    fit = _solve(model, used)
    status = fit.status
    while status == OK and fit.degrees > 0:
        worst, w_squared = _largest_residual(model, used, fit)
        if not is_suspect(fit, w_squared, count, false_alarm):
            break
        if worst < 0 or fit.degrees < 2 or used.sum() <= least:
            status = INCONSISTENT
            break
        used[worst] = False
        fit = _solve(model, used)
        status = fit.status
    if status == INCONSISTENT or (status == OK and count - used.sum() > 2):
        most = count - used.sum() if status == OK else 4
        excluded = _smallest_exclusion(model, candidate, most, false_alarm)
        if excluded.size > 0:
            used = candidate.copy()
            used[excluded] = False
            fit = _solve(model, used)
            status = fit.status
    if status == OK:
        for _ in range(count - used.sum()):
            row = _row_to_readmit(model, candidate & ~used, fit, count=count, false_alarm=false_alarm)
            if row < 0:
                break
            used[row] = True
            again = _solve(model, used)
            _, w_squared = _largest_residual(model, used, again)
            if again.status != OK or is_suspect(again, w_squared, count, false_alarm):
                used[row] = False
                break
            fit = again
    return RobustFit(
        status, fit.value, fit.covariance, used=used, chi_squared=fit.chi_squared, degrees=fit.degrees
    )


@compiled
def _smallest_exclusion(model: LinearModel, candidate: Booleans, most: int, false_alarm: float) -> Integers:
    """Two rows, or three, fewer than `most`, without which the others agree; empty where there are none.

    With v the residuals of all in units of σ and H the hat matrix, excluding the rows S lowers χ² by
    v_S · (I − H_SS)⁻¹ v_S. The set that lowers it most is tried.
    """
    rows = np.flatnonzero(candidate)
    n = rows.size
    fit = _solve(model, candidate)
    v, redundancy = np.empty(n), np.empty((n, n))
    for i in range(n):
        at = rows[i]
        v[i] = _residual(model, at, fit.value) / model.sigma[at]
        for j in range(i + 1):
            hat = _fitted_covariance(model.design[at], model.design[rows[j]], fit.covariance)
            hat /= model.sigma[at] * model.sigma[rows[j]]
            redundancy[i, j] = redundancy[j, i] = (1.0 if i == j else 0.0) - hat
    for size in range(2, 4):
        if size >= most or n - size < n - n // 2 or (size == 3 and n > _MOST_OF_THREES):
            break
        chosen = rows[_best_exclusion(v, redundancy, size)]
        if chosen.size == 0:
            continue
        used = candidate.copy()
        used[chosen] = False
        fit = _solve(model, used)
        if fit.status == OK and fit.degrees > 0:
            _, w_squared = _largest_residual(model, used, fit)
            if not is_suspect(fit, w_squared, n, false_alarm):
                return chosen
    return rows[:0]


@compiled
def _best_exclusion(v: Floats, redundancy: Floats, size: int) -> Integers:
    """The two or three rows whose exclusion lowers χ² most; empty where none can be tested."""
    n, best, greatest = v.size, np.empty(0, np.int64), 0.0
    for i in range(n):
        for j in range(i):
            a, b, c = redundancy[i, i], redundancy[i, j], redundancy[j, j]
            determinant = a * c - b * b
            if not determinant > _TESTABLE:
                continue
            lost = (c * v[i] * v[i] - 2.0 * b * v[i] * v[j] + a * v[j] * v[j]) / determinant
            if size == 2 and lost > greatest:
                greatest, best = lost, np.array([j, i])
            for k in range(j if size == 3 else 0):
                d, e = redundancy[i, k], redundancy[j, k]
                # The third row given the other two: its remaining redundancy and its residual.
                f, g = (c * d - b * e) / determinant, (a * e - b * d) / determinant
                remaining = redundancy[k, k] - f * d - g * e
                if remaining > _TESTABLE:
                    off = v[k] - f * v[i] - g * v[j]
                    if lost + off * off / remaining > greatest:
                        greatest, best = lost + off * off / remaining, np.array([k, j, i])
    return best


@compiled
def is_suspect(fit: RobustFit, w_squared: float, count: int, false_alarm: float) -> bool:
    """Whether χ², or the largest of `count` normalised residuals, is too large for chance."""
    if chi_squared_survival(fit.chi_squared, fit.degrees) < false_alarm:
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
def _residual(model: LinearModel, row: int, value: Floats) -> float:
    """Observed minus fitted; NaN where the row has an unknown that no row in use has."""
    total = 0.0
    for a in range(value.size):
        if model.design[row, a] != 0.0:
            total += model.design[row, a] * value[a]
    return float(model.observed[row] - total)


@compiled
def _fitted_covariance(one: Floats, other: Floats, covariance: Floats) -> float:
    """Covariance of the fitted values of two rows of the design."""
    total = 0.0
    for a in range(one.size):
        if one[a] == 0.0:
            continue
        for b in range(other.size):
            if other[b] != 0.0:
                total += one[a] * covariance[a, b] * other[b]
    return total


@compiled
def _largest_residual(model: LinearModel, used: Booleans, fit: RobustFit) -> tuple[int, float]:
    """The row of the largest normalised residual and its square; −1 where none can be tested."""
    worst, greatest = -1, 0.0
    for i in range(model.observed.size):
        if not used[i]:
            continue
        variance = model.sigma[i] * model.sigma[i]
        redundant = variance - _fitted_covariance(model.design[i], model.design[i], fit.covariance)
        if redundant > _TESTABLE * variance:
            v = _residual(model, i, fit.value)
            w_squared = v * v / redundant
            if w_squared > greatest:
                worst, greatest = i, w_squared
    return worst, greatest


@compiled
def _row_to_readmit(
    model: LinearModel, excluded: Booleans, fit: RobustFit, count: int, false_alarm: float
) -> int:
    """The excluded row that agrees best with the fit of the others, if well enough; −1 else."""
    best, least = -1, np.inf
    for i in range(model.observed.size):
        if excluded[i]:
            v = _residual(model, i, fit.value)
            predicted = _fitted_covariance(model.design[i], model.design[i], fit.covariance)
            w_squared = v * v / (model.sigma[i] * model.sigma[i] + predicted)
            # NaN where no row that is used has one of its unknowns.
            if w_squared < least:
                best, least = i, w_squared
    if best >= 0 and math.erfc(math.sqrt(0.5 * least)) * count < false_alarm:
        return -1
    return best


@compiled
def _solve(model: LinearModel, used: Booleans) -> RobustFit:
    """Weighted least squares of the rows in use, by Cholesky decomposition of the normal equations."""
    design, sigma, prior_sigma = model.design, model.sigma, model.prior_sigma
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
                right[a] += scaled * model.observed[i]
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
    if rows < free or rows == 0:
        return empty_fit(TOO_FEW, n, p)
    inverse = _inverse_of_lower(normal)
    if inverse.shape[0] == 0:
        return empty_fit(DEGENERATE, n, p)
    # C = L⁻ᵀ L⁻¹, x = C b.
    value, covariance = np.full(p, np.nan), np.full((p, p), np.nan)
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
            v = _residual(model, i, value) / sigma[i]
            chi_squared += v * v
    for a in range(p):
        if active[a] and prior_sigma[a] < np.inf:
            chi_squared += (value[a] / prior_sigma[a]) ** 2
    return RobustFit(OK, value, covariance, used=used, chi_squared=chi_squared, degrees=rows - free)


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
def horizontal_dilution(design: Floats, used: Booleans) -> float:
    """HDOP of a design whose first two unknowns are east and north; NaN where there is none."""
    n, p = design.shape
    model = LinearModel(design, np.zeros(n), sigma=np.ones(n), prior_sigma=np.full(p, np.inf))
    covariance = _solve(model, used).covariance
    return math.sqrt(covariance[0, 0] + covariance[1, 1])
