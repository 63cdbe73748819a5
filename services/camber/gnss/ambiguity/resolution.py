"""Integer ambiguities out of float ones: all, or the largest part of them that is sure enough, or none.

Sources: Teunissen, J. Geodesy 70 (1995), LAMBDA; Teunissen, J. Geodesy 72 (1998), success rate of bootstrapping;
Teunissen and Odijk (1997), ADOP; Euler and Schaffrin (1991), ratio test; Teunissen et al. (1999), partial resolution.

All kernels take and give arrays and may be called from compiled code. Ambiguities are in cycles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.gnss.ambiguity.lambda_decorrelation import decorrelated
from camber.gnss.ambiguity.lambda_search import nearest_integers
from camber.gnss.ambiguity.ratio_thresholds import ratio_for_failure_rate

Floats = NDArray[np.float64]

RESOLVED = 0
RATIO_TOO_LOW = 1
"""A second vector of integers is nearly as good as the best."""
UNLIKELY = 2
"""Too few ambiguities, or no part of them that is large enough, reach the success rate asked for."""
SEARCH_CUT = 3
"""The search ended at its limit of nodes: nothing is known."""
INVALID = 4
"""The floats or their covariance are not finite, do not fit one another, or are not positive definite."""

_LARGEST_EXACT = 2.0**52
_REFINEMENTS = 4


class Resolution(NamedTuple):
    """What `resolve` found, n ambiguities, of which the decorrelated z[n − fixed:] are integers.

    Only with `status` RESOLVED is anything fixed; otherwise `fixed` is 0 and the numbers tell of the last trial.
    """

    status: int
    fixed: int
    """k: so many decorrelated ambiguities, the last k, have become integers."""
    ratio: float
    """Second-best squared norm by the best; NaN before any search."""
    ratio_needed: float
    """What the ratio had to exceed."""
    squared_norm: float
    """(ẑ − ž)ᵀ Q_z⁻¹ (ẑ − ž) of the best integers, of the subset searched."""
    second_squared_norm: float
    success_rate: float
    """Of integer bootstrapping of the subset searched: a lower bound of that of integer least squares."""
    adop_cycles: float
    """Ambiguity dilution of precision, of all n."""
    nodes: int
    trials: int
    """Subsets searched: one, and one more each time the ratio was too low."""
    transform: Floats
    """Z (n, n): z = Z a; its last k rows are the combinations that are fixed."""
    upper: Floats
    """U (n, n) of Q_z = U D Uᵀ."""
    variances: Floats
    """D (n,): of each z given those behind it."""
    z_fixed: Floats
    """ž (n,): integers, NaN where not fixed."""
    z_residual: Floats
    """ẑ − ž (n,), NaN where not fixed."""
    ambiguities: Floats
    """a (n,) given the fixed z: exact integers where all are fixed, the floats where nothing is."""


@compiled
def bootstrapped_log_success(variances: Floats, count: int) -> float:
    """Logarithm of the chance that integer bootstrapping of the last `count` of z fixes all rightly.

    Π (2 Φ(1 / 2σ_i) − 1), Teunissen (1998), equation 15; the logarithm keeps failure rates below 1e-16 apart.
    """
    total = 0.0
    for place in range(variances.size - count, variances.size):
        total += math.log1p(-math.erfc(math.sqrt(0.125 / variances[place])))
    return total


@compiled
def adop_cycles(variances: Floats) -> float:
    """|Q|^(1 / 2n) in cycles, from the conditional variances (n,)."""
    total = 0.0
    for place in range(variances.size):
        total += math.log(variances[place])
    return math.exp(0.5 * total / variances.size)


@compiled
def resolve(
    floats: Floats,
    covariance: Floats,
    least_ratio: float,
    least_success: float,
    least_fixed: int,
    most_nodes: int,
    partial: bool,
    failure_rate: float = 0.0,
) -> Resolution:
    """Integers of float ambiguities (n,) with covariance (n, n).

    They are taken if the second-best squared norm exceeds `least_ratio` times the best. With `partial` the largest
    subset, in order of conditional variance, whose bootstrapped success rate is at least `least_success` is tried,
    and a smaller one as long as the ratio is too low, down to `least_fixed` of z; without it all or none, and all
    must reach `least_success` (0 to do without). `most_nodes` bounds all searches together. A `failure_rate` above zero
    replaces `least_ratio` by the ratio that keeps it (`camber.gnss.ambiguity.ratio_thresholds`).
    """
    count = floats.size
    valid = count > 0 and covariance.shape == (count, count)
    for place in range(count):
        valid = valid and np.isfinite(floats[place])
    if not valid:
        nothing = np.zeros((0, 0))
        return _nothing(INVALID, floats, nothing, nothing, np.zeros(0))
    definite, upper, variances, transform = decorrelated(covariance)
    if not definite:
        return _nothing(INVALID, floats, transform, upper, variances)
    whole = np.rint(floats)
    z_whole, z_floats = np.zeros(count), np.zeros(count)
    for row in range(count):
        size = 0.0
        for column in range(count):
            entry = transform[row, column]
            size += abs(entry * whole[column])
            z_whole[row] += entry * whole[column]
            z_floats[row] += entry * (floats[column] - whole[column])
        if not size < _LARGEST_EXACT:
            return _nothing(INVALID, floats, transform, upper, variances)

    least = max(1, least_fixed)
    tried = count
    least_log = math.log(least_success) if least_success > 0.0 else -np.inf
    while tried >= least and bootstrapped_log_success(variances, tried) < least_log:
        tried = tried - 1 if partial else 0
    needed = least_ratio
    status, ratio, best, second, nodes, trials, log_success = UNLIKELY, np.nan, np.nan, np.nan, 0, 0, np.nan
    z_fixed, z_residual, ambiguities = np.full(count, np.nan), np.full(count, np.nan), floats.copy()
    while tried >= least:
        first = count - tried
        log_success = bootstrapped_log_success(variances, tried)
        found, vectors, norms, visited = nearest_integers(
            upper[first:, first:], variances[first:], z_floats[first:], 2, most_nodes - nodes
        )
        nodes += visited
        trials += 1
        if found < 2:
            status = SEARCH_CUT
            break
        best, second = norms[0], norms[1]
        ratio = second / best if best > 0.0 else np.inf
        if failure_rate > 0.0:
            needed = ratio_for_failure_rate(tried, -math.expm1(log_success), failure_rate)
        if ratio > needed:
            status = RESOLVED
            for place in range(first, count):
                z_fixed[place] = z_whole[place] + vectors[0, place - first]
                z_residual[place] = z_floats[place] - vectors[0, place - first]
            correction = _correction(covariance, transform, upper, variances, z_residual[first:])
            ambiguities -= correction
            if tried == count and not _made_exact(
                ambiguities, z_fixed, covariance, transform, upper, variances
            ):
                status = INVALID
            break
        status = RATIO_TOO_LOW
        if not partial:
            break
        tried -= 1
    fixed = tried if status == RESOLVED else 0
    if fixed == 0:
        z_fixed[:], z_residual[:], ambiguities[:] = np.nan, np.nan, floats
    return Resolution(
        status,
        fixed,
        ratio,
        needed,
        best,
        second,
        math.exp(log_success),
        adop_cycles(variances),
        nodes,
        trials,
        transform,
        upper,
        variances,
        z_fixed,
        z_residual,
        ambiguities,
    )


@compiled
def conditional_update(
    state: Floats, state_covariance: Floats, cross_covariance: Floats, resolution: Resolution
) -> tuple[Floats, Floats]:
    """State x (m,) and its covariance (m, m) given the fixed ambiguities: x̌ = x̂ − Q_xz Q_z⁻¹ (ẑ − ž).

    `cross_covariance` is Q_xa (m, n). Where nothing is fixed, what was given comes back.
    """
    count, size, fixed = resolution.variances.size, state.size, resolution.fixed
    first = count - fixed
    updated, covariance = state.copy(), state_covariance.copy()
    rows = np.zeros((fixed, size))
    residual = np.zeros(fixed)
    for place in range(fixed - 1, -1, -1):
        for column in range(count):
            entry = resolution.transform[first + place, column]
            if entry != 0.0:
                for item in range(size):
                    rows[place, item] += entry * cross_covariance[item, column]
        residual[place] = resolution.z_residual[first + place]
        for behind in range(place + 1, fixed):
            factor = resolution.upper[first + place, first + behind]
            residual[place] -= factor * residual[behind]
            for item in range(size):
                rows[place, item] -= factor * rows[behind, item]
    for place in range(fixed):
        variance = resolution.variances[first + place]
        for item in range(size):
            gain = rows[place, item] / variance
            updated[item] -= gain * residual[place]
            for other in range(size):
                covariance[item, other] -= gain * rows[place, other]
    return updated, covariance


@compiled
def _nothing(status: int, floats: Floats, transform: Floats, upper: Floats, variances: Floats) -> Resolution:
    unknown = np.full(floats.size, np.nan)
    nan = np.nan
    return Resolution(
        status,
        0,
        nan,
        nan,
        nan,
        nan,
        nan,
        nan,
        0,
        0,
        transform,
        upper,
        variances,
        unknown,
        unknown.copy(),
        floats.copy(),
    )


@compiled
def _correction(
    covariance: Floats, transform: Floats, upper: Floats, variances: Floats, residual: Floats
) -> Floats:
    """Q_az Q_z⁻¹ (ẑ − ž) (n,) of the last k of z, whose residual (k,) is given."""
    count, fixed = variances.size, residual.size
    first = count - fixed
    solved = residual.copy()
    for place in range(fixed - 1, -1, -1):
        for behind in range(place + 1, fixed):
            solved[place] -= upper[first + place, first + behind] * solved[behind]
    for place in range(fixed):
        solved[place] /= variances[first + place]
    combined = np.zeros(count)
    for place in range(fixed):
        for behind in range(place + 1, fixed):
            solved[behind] -= upper[first + place, first + behind] * solved[place]
        for column in range(count):
            combined[column] += transform[first + place, column] * solved[place]
    correction = np.zeros(count)
    for column in range(count):
        for row in range(count):
            correction[row] += covariance[column, row] * combined[column]
    return correction


@compiled
def _made_exact(
    ambiguities: Floats,
    z_fixed: Floats,
    covariance: Floats,
    transform: Floats,
    upper: Floats,
    variances: Floats,
) -> bool:
    """Round the ambiguities to the integers with Z a = ž, and whether they have been found."""
    count = ambiguities.size
    residual = np.empty(count)
    for _ in range(_REFINEMENTS):
        exact = True
        for row in range(count):
            ambiguities[row] = np.rint(ambiguities[row])
        for row in range(count):
            residual[row] = -z_fixed[row]
            for column in range(count):
                residual[row] += transform[row, column] * ambiguities[column]
            exact = exact and residual[row] == 0.0
        if exact:
            return True
        ambiguities -= _correction(covariance, transform, upper, variances, residual)
    return False
