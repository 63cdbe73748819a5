"""Float solution of a single epoch: the rover's position from code, robust against multipath.

In a single epoch phases with unknown ambiguities add nothing to the position, so it comes from code, and a prior where
there is one. Reflected codes are metres off: the row with the largest normalised residual is excluded until none
exceeds the threshold (Baarda, "A testing procedure for use in geodetic networks", 1968).

A prior from earlier codes shares multipath errors with the present codes, to an unknown degree: the two are joined by
covariance intersection, which is consistent for any correlation (Julier
and Uhlmann, "A non-divergent estimation algorithm in the presence of unknown correlations", 1997).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats
from camber.gnss.observations.differenced_observations import SingleDifferences, without_clocks
from camber.gnss.observations.signal_pairs import GROUPS, Booleans
from camber.gnss.position.small_algebra import form, product

_SHARES = 10  # weights tried in the covariance intersection; chosen: steps of 0.1


class PositionPrior(NamedTuple):
    """Prior of the rover's position (3,) in ECEF or as an offset, and its information (3, 3); zeros: none."""

    position_m: Floats
    information: Floats


NO_PRIOR = PositionPrior(np.zeros(3), np.zeros((3, 3)))


@compiled
def relative_to(prior: PositionPrior, origin_m: Floats) -> PositionPrior:
    """The prior as an offset from a point (3,)."""
    return PositionPrior(prior.position_m - origin_m, prior.information)


class FloatPosition(NamedTuple):
    """`dx_m` (3,) and its covariance (3, 3) in ECEF; which codes were used (n,); freedom < 0: no position."""

    dx_m: Floats
    covariance_m2: Floats
    used: Booleans
    chi2: float
    freedom: int


@compiled
def inverse_3(m: Floats) -> tuple[Floats, bool]:
    """Inverse of a symmetric (3, 3) matrix; False where it is not positive definite or nearly singular."""
    out = np.zeros((3, 3))
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * co_a + b * co_b + c * co_c
    scale = a * d * f
    if not (a > 0.0 and d > 0.0 and f > 0.0 and determinant > 1e-12 * scale):
        return out, False
    out[0, 0], out[0, 1], out[0, 2] = co_a, co_b, co_c
    out[1, 1], out[1, 2], out[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return out / determinant, True


@compiled
def float_position(
    rows: SingleDifferences, usable: Booleans, prior: PositionPrior, outlier_threshold: float
) -> FloatPosition:
    """Weighted least squares of the codes of `usable` rows with a prior of `dx_m`.

    The covariance is scaled up where the codes scatter more than their variances say, never down.
    """
    n = rows.code_m.size
    weights, used = np.zeros(n), np.zeros(n, np.bool_)
    count = 0
    for i in range(n):
        if usable[i] and rows.code_m[i] == rows.code_m[i]:
            weights[i] = 1.0 / rows.code_variance_m2[i]
            used[i] = True
            count += 1
    dx, covariance = np.zeros(3), np.zeros((3, 3))
    chi2, freedom = 0.0, -1
    left_out, most_left_out = 0, count // 3
    has_prior = prior.information[0, 0] > 0.0
    while True:
        directions, reduced, total = without_clocks(rows, rows.code_m, weights)
        information = prior.information.copy()
        right = product(prior.information, prior.position_m)
        rank = 0
        for i in range(n):
            if used[i]:
                rank += 1
                for k in range(3):
                    right[k] += weights[i] * directions[i, k] * reduced[i]
                    for m in range(3):
                        information[k, m] += weights[i] * directions[i, k] * directions[i, m]
        groups = 0
        seen = np.zeros(GROUPS, np.bool_)
        for i in range(n):
            if used[i] and not seen[rows.group[i]]:
                seen[rows.group[i]] = True
                groups += 1
        covariance, solvable = inverse_3(information)
        freedom = rank - groups - (0 if has_prior else 3)
        if not solvable or freedom < 0:
            return FloatPosition(dx, covariance, used, 0.0, freedom=-1)
        dx = product(covariance, right)
        misfit = dx - prior.position_m
        chi2, worst, worst_row = form(misfit, prior.information), 0.0, -1
        for i in range(n):
            if not used[i]:
                continue
            residual = reduced[i]
            leverage = 1.0 / total[i]
            for k in range(3):
                residual -= directions[i, k] * dx[k]
                for m in range(3):
                    leverage += directions[i, k] * covariance[k, m] * directions[i, m]
            chi2 += weights[i] * residual * residual
            free = 1.0 - weights[i] * leverage
            if free > 1e-6:
                normalised = abs(residual) * np.sqrt(weights[i] / free)
                if normalised > worst:
                    worst, worst_row = normalised, i
        if worst <= outlier_threshold or left_out >= most_left_out or freedom <= 1:
            break
        used[worst_row] = False
        weights[worst_row] = 0.0
        left_out += 1
    if freedom > 0 and chi2 > freedom:
        covariance = covariance * (chi2 / freedom)
    return FloatPosition(dx, covariance, used, chi2, freedom=freedom)


@compiled
def float_with_prior(
    rows: SingleDifferences, usable: Booleans, prior: PositionPrior, outlier_threshold: float
) -> FloatPosition:
    """As `float_position`, with a prior whose errors may be correlated with those of the codes.

    The prior helps to identify outliers. Where the other codes determine no position, the prior is the result.
    """
    tested = float_position(rows, usable, prior, outlier_threshold)
    if not prior.information[0, 0] > 0.0 or tested.freedom < 0:
        return tested
    codes = float_position(rows, tested.used, PositionPrior(np.zeros(3), np.zeros((3, 3))), np.inf)
    prior_covariance, _ = inverse_3(prior.information)
    best, best_covariance = prior.position_m.copy(), prior_covariance
    if codes.freedom < 0:
        return FloatPosition(best, best_covariance, tested.used, tested.chi2, freedom=tested.freedom)
    information, _ = inverse_3(codes.covariance_m2)
    right, prior_right = product(information, codes.dx_m), product(prior.information, prior.position_m)
    least = np.trace(best_covariance)
    for step in range(_SHARES):
        share = step / _SHARES
        covariance, solvable = inverse_3(share * prior.information + (1.0 - share) * information)
        if solvable and np.trace(covariance) < least:
            least = np.trace(covariance)
            best = product(covariance, share * prior_right + (1.0 - share) * right)
            best_covariance = covariance
    return FloatPosition(best, best_covariance, tested.used, codes.chi2, freedom=codes.freedom)
