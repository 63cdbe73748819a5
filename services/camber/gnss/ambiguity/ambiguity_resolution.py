"""Integer ambiguity resolution: all float ambiguities, the largest subset that passes the tests, or none.

Sources: Teunissen, J. Geodesy 70 (1995), LAMBDA; Teunissen, J. Geodesy 72 (1998), success rate of bootstrapping;
Teunissen and Odijk (1997), ADOP; Euler and Schaffrin (1991), ratio test; Teunissen et al. (1999), partial resolution.

All functions may be called from compiled code. Ambiguities are in cycles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats
from camber.gnss.ambiguity.lambda_decorrelation import Decorrelation, decorrelated
from camber.gnss.ambiguity.lambda_search import nearest_integers
from camber.gnss.ambiguity.ratio_threshold_table import ratio_for_failure_rate

# Status of a resolution.
RESOLVED, RATIO_TOO_LOW, UNLIKELY, SEARCH_CUT, INVALID = range(5)
"""`RATIO_TOO_LOW`: a second vector of integers is nearly as good as the best. `UNLIKELY`: no large enough subset of the
ambiguities reaches the success rate. `SEARCH_CUT`: the search hit its limit of nodes, nothing is known. `INVALID`: the
floats or their covariance are not finite, of inconsistent shapes, or not positive definite."""

_LARGEST_EXACT = 2.0**52  # below it a double holds every integer and half of one
_REFINEMENTS = 4  # chosen: one suffices unless the transformation amplifies rounding


class FixCriteria(NamedTuple):
    """Acceptance tests of a fix. A `failure_rate` above 0 replaces `least_ratio` by the ratio that keeps it.

    The settings' parameters come first; the others are not varied by a user.
    """

    least_ratio: float
    least_success_rate: float
    least_fixed: int
    partial: bool
    failure_rate: float
    most_nodes: int = 20_000
    """Limit of the integer search; chosen: bounds the time of an epoch, and a search cut off gives no fix."""
    code_outlier: float = 3.5
    """Threshold of a code's normalised residual; chosen: 5 in 10,000 right ones exceed it."""
    residual_quantile: float = 3.72
    """Normal quantile of the χ² tests of a fix: a false-alarm rate of 1 in 10,000."""
    largest_sigma_m: float = 0.10
    """Largest 3D σ of a fix; chosen: beyond it a position is not of centimetres."""


class Resolution(NamedTuple):
    """Result of `resolve` for n ambiguities, of which the decorrelated z[n − fixed:] are integers.

    Only with `status` RESOLVED is anything fixed; otherwise `fixed` is 0 and the numbers are those of the last trial,
    NaN before any. `ratio`: second-best squared norm over the best, `squared_norm`, (ẑ − ž)ᵀ Q_z⁻¹ (ẑ − ž).
    `success_rate`: of integer bootstrapping of the subset searched, a lower bound of that of integer least squares.
    `nodes` visited in all searches, `trials`: one, and one more each time the ratio was too low. z = Z a; `z_fixed` ž
    and `z_residual` ẑ − ž (n,) are NaN where not fixed. `ambiguities` (n,): a given the fixed z, exact integers where
    all are fixed, the floats where nothing is.
    """

    status: int
    fixed: int
    ratio: float
    ratio_needed: float
    squared_norm: float
    success_rate: float
    nodes: int
    trials: int
    z: Decorrelation
    z_fixed: Floats
    z_residual: Floats
    ambiguities: Floats


@compiled
def bootstrapped_log_success(variances: Floats, count: int) -> float:
    """Logarithm of the probability that integer bootstrapping of the last `count` of z fixes all correctly.

    Π (2 Φ(1 / 2σ_i) − 1), Teunissen (1998), equation 15; the logarithm keeps failure rates below 1e-16 apart.
    """
    total = 0.0
    for i in range(variances.size - count, variances.size):
        total += math.log1p(-math.erfc(math.sqrt(0.125 / variances[i])))
    return total


@compiled
def resolve(floats: Floats, covariance: Floats, criteria: FixCriteria) -> Resolution:
    """Integers of float ambiguities (n,) with covariance (n, n), by LAMBDA.

    They are accepted if the second-best squared norm exceeds `least_ratio` times the best. With `partial` the largest
    subset, in order of conditional variance, whose bootstrapped success rate is at least `least_success_rate` is tried,
    and a smaller one as long as the ratio is too low, down to `least_fixed` of z; without it all or none, and all
    must reach `least_success_rate` (0 to do without). `most_nodes` bounds all searches together.
    """
    count, least = floats.size, max(1, criteria.least_fixed)
    valid, z, z_whole, z_floats = _decorrelated_floats(floats, covariance)
    status, tried = (UNLIKELY, count) if valid else (INVALID, 0)
    least_log = math.log(criteria.least_success_rate) if criteria.least_success_rate > 0.0 else -np.inf
    while tried >= least and bootstrapped_log_success(z.variances, tried) < least_log:
        tried = tried - 1 if criteria.partial else 0
    ratio, needed, best, nodes, trials, log_success = np.nan, criteria.least_ratio, np.nan, 0, 0, np.nan
    z_fixed, z_residual, ambiguities = np.full(count, np.nan), np.full(count, np.nan), floats.copy()
    while tried >= least:
        first = count - tried
        log_success = bootstrapped_log_success(z.variances, tried)
        obtained, vectors, norms, visited = nearest_integers(
            z.upper[first:, first:],
            z.variances[first:],
            z_floats[first:],
            wanted=2,
            most_nodes=criteria.most_nodes - nodes,
        )
        nodes += visited
        trials += 1
        if obtained < 2:
            status = SEARCH_CUT
            break
        best = norms[0]
        ratio = norms[1] / best if best > 0.0 else np.inf
        if criteria.failure_rate > 0.0:
            needed = ratio_for_failure_rate(tried, -math.expm1(log_success), criteria.failure_rate)
        if ratio > needed:
            status = RESOLVED
            for i in range(first, count):
                z_fixed[i] = z_whole[i] + vectors[0, i - first]
                z_residual[i] = z_floats[i] - vectors[0, i - first]
            ambiguities -= _correction(covariance, z, z_residual[first:])
            if tried == count and not _made_exact(ambiguities, z_fixed, covariance, z):
                status = INVALID
            break
        status = RATIO_TOO_LOW
        if not criteria.partial:
            break
        tried -= 1
    fixed = tried if status == RESOLVED else 0
    if fixed == 0:
        z_fixed[:], z_residual[:], ambiguities[:] = np.nan, np.nan, floats
    return Resolution(
        status=status,
        fixed=fixed,
        ratio=ratio,
        ratio_needed=needed,
        squared_norm=best,
        success_rate=math.exp(log_success),
        nodes=nodes,
        trials=trials,
        z=z,
        z_fixed=z_fixed,
        z_residual=z_residual,
        ambiguities=ambiguities,
    )


@compiled
def conditional_update(
    state: Floats, state_covariance: Floats, cross_covariance: Floats, resolution: Resolution
) -> tuple[Floats, Floats]:
    """State x (m,) and its covariance (m, m) given the fixed ambiguities: x̌ = x̂ − Q_xz Q_z⁻¹ (ẑ − ž).

    `cross_covariance` is Q_xa (m, n). Where nothing is fixed, both are unchanged.
    """
    z, fixed = resolution.z, resolution.fixed
    count, size = z.variances.size, state.size
    first = count - fixed
    updated, covariance = state.copy(), state_covariance.copy()
    rows = np.zeros((fixed, size))
    residual = np.zeros(fixed)
    for i in range(fixed - 1, -1, -1):
        for column in range(count):
            entry = z.transform[first + i, column]
            if entry != 0.0:
                for item in range(size):
                    rows[i, item] += entry * cross_covariance[item, column]
        residual[i] = resolution.z_residual[first + i]
        for j in range(i + 1, fixed):
            factor = z.upper[first + i, first + j]
            residual[i] -= factor * residual[j]
            for item in range(size):
                rows[i, item] -= factor * rows[j, item]
    for i in range(fixed):
        for item in range(size):
            gain = rows[i, item] / z.variances[first + i]
            updated[item] -= gain * residual[i]
            for other in range(size):
                covariance[item, other] -= gain * rows[i, other]
    return updated, covariance


@compiled
def _decorrelated_floats(floats: Floats, covariance: Floats) -> tuple[bool, Decorrelation, Floats, Floats]:
    """Whether the input is valid, its decorrelation, and Z times the integers nearest to the floats and the rest."""
    count = floats.size
    z_whole, z_floats = np.zeros(count), np.zeros(count)
    if count == 0 or covariance.shape != (count, count) or not np.isfinite(floats).all():
        nothing = np.zeros((0, 0))
        return False, Decorrelation(nothing, np.zeros(0), nothing), z_whole, z_floats
    valid, z = decorrelated(covariance)
    if valid:
        whole = np.rint(floats)
        for row in range(count):
            size = 0.0
            for column in range(count):
                entry = z.transform[row, column]
                size += abs(entry * whole[column])
                z_whole[row] += entry * whole[column]
                z_floats[row] += entry * (floats[column] - whole[column])
            valid = valid and size < _LARGEST_EXACT
    return valid, z, z_whole, z_floats


@compiled
def _correction(covariance: Floats, z: Decorrelation, residual: Floats) -> Floats:
    """Q_az Q_z⁻¹ (ẑ − ž) (n,) of the last k of z, whose residual (k,) is given."""
    count, fixed = z.variances.size, residual.size
    first = count - fixed
    solved = residual.copy()
    for i in range(fixed - 1, -1, -1):
        for j in range(i + 1, fixed):
            solved[i] -= z.upper[first + i, first + j] * solved[j]
    for i in range(fixed):
        solved[i] /= z.variances[first + i]
    combined = np.zeros(count)
    for i in range(fixed):
        for j in range(i + 1, fixed):
            solved[j] -= z.upper[first + i, first + j] * solved[i]
        for column in range(count):
            combined[column] += z.transform[first + i, column] * solved[i]
    correction = np.zeros(count)
    for column in range(count):
        for row in range(count):
            correction[row] += covariance[column, row] * combined[column]
    return correction


@compiled
def _made_exact(ambiguities: Floats, z_fixed: Floats, covariance: Floats, z: Decorrelation) -> bool:
    """Round the ambiguities to the integers with Z a = ž; whether that succeeded."""
    count = ambiguities.size
    residual = np.empty(count)
    for _ in range(_REFINEMENTS):
        exact = True
        for row in range(count):
            ambiguities[row] = np.rint(ambiguities[row])
        for row in range(count):
            residual[row] = -z_fixed[row]
            for column in range(count):
                residual[row] += z.transform[row, column] * ambiguities[column]
            exact = exact and residual[row] == 0.0
        if exact:
            return True
        ambiguities -= _correction(covariance, z, residual)
    return False
