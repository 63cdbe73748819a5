"""Float position → integers → fixed position, of any part of an epoch's rows.

Source: P. Teunissen, "The least-squares ambiguity decorrelation adjustment", 1995; for a single epoch the ambiguities
follow from the phases and the float position, `â = (φ − G x̂)/λ`, `Q_a = (Q_φ + G Q_x Gᵀ)/(λ λᵀ)`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers
from camber.gnss.ambiguity.resolution import RESOLVED, UNLIKELY, conditional_update, resolve
from camber.gnss.observations.signal_pairs import GROUPS
from camber.gnss.observations.single_differences import Booleans, Rows, without_clocks
from camber.gnss.position.float_solution import FloatPosition, float_with_prior, inverse_3
from camber.gnss.position.small_algebra import form, inner

NO_POSITION = 5
"""Status beside those of `camber.gnss.ambiguity.resolution`: too few codes for a float position."""
CONTRADICTORY = 6
"""Integers were found, but the phases do not go with them."""
IMPRECISE = 7
"""Integers were found, but not enough of them to make a position of centimetres."""
FAR = 8
"""The position is so far from the approximate one that it was not linearised where it is."""

_FAR_M, _GROSS_M = 100.0, 1000.0

_FOLLOWS_SIGMA, _FOLLOWS_PART = 0.1, 0.2


class Limits(NamedTuple):
    """What a fix has to pass. `normal_quantile`: of the residual test, 3.72 is a false alarm in 10,000.

    `failure_rate` above 0 replaces `least_ratio` (`camber.gnss.ambiguity.resolution.resolve`).
    """

    code_outlier: float
    least_ratio: float
    least_success: float
    least_fixed: int
    most_nodes: int
    partial: bool
    normal_quantile: float
    largest_sigma_m: float
    failure_rate: float


class Estimate(NamedTuple):
    """Float and fixed position of one choice of rows, as corrections of the approximate one in ECEF (3,), (3, 3).

    `status` is that of `resolution` or one of this module; fixed only where it is RESOLVED. `integer`
    (rows,) is that of a row against the reference of its group (0 there), NaN where unknown. `phase_chi2` with
    `phase_freedom` degrees of freedom: residuals of the fixed phases; freedom 0: cannot be tested.
    """

    status: int
    float_dx_m: Floats
    float_covariance_m2: Floats
    dx_m: Floats
    covariance_m2: Floats
    codes: int
    ambiguities: int
    fixed: int
    ratio: float
    success_rate: float
    squared_norm: float
    phase_chi2: float
    phase_freedom: int
    integer: Floats


class Ambiguities(NamedTuple):
    """Double-difference ambiguities (n,) in cycles, covariance (n, n), covariance with the position (3, n).

    `row` and `reference` (n,) say between which rows.
    """

    value: Floats
    covariance: Floats
    position_covariance_m: Floats
    row: Integers
    reference: Integers


@compiled
def ambiguities(rows: Rows, usable: Booleans, dx_m: Floats, covariance_m2: Floats) -> Ambiguities:
    """Of the usable rows that have a phase, against the most precise phase of their group."""
    n = rows.phase_m.size
    best = np.full(GROUPS, -1, np.int64)
    for i in range(n):
        if usable[i] and rows.phase_m[i] == rows.phase_m[i]:
            g = rows.group[i]
            if best[g] < 0 or rows.phase_variance_m2[i] < rows.phase_variance_m2[best[g]]:
                best[g] = i
    row, reference = np.empty(n, np.int64), np.empty(n, np.int64)
    count = 0
    for i in range(n):
        if usable[i] and rows.phase_m[i] == rows.phase_m[i] and best[rows.group[i]] != i:
            row[count], reference[count] = i, best[rows.group[i]]
            count += 1
    row, reference = row[:count].copy(), reference[:count].copy()
    value, covariance, mixed = np.empty(count), np.empty((count, count)), np.empty((3, count))
    direction, spread = np.empty((count, 3)), np.empty((count, 3))
    for a in range(count):
        i, j = row[a], reference[a]
        wavelength = rows.wavelength_m[i]
        moved = 0.0
        for k in range(3):
            direction[a, k] = (rows.direction[i, k] - rows.direction[j, k]) / wavelength
            moved += direction[a, k] * dx_m[k]
        value[a] = (rows.phase_m[i] - rows.phase_m[j]) / wavelength - moved
        for k in range(3):
            spread[a, k] = 0.0
            for m in range(3):
                spread[a, k] += covariance_m2[k, m] * direction[a, m]
            mixed[k, a] = -spread[a, k]
    for a in range(count):
        for b in range(a + 1):
            q = 0.0
            for k in range(3):
                q += direction[a, k] * spread[b, k]
            if reference[a] == reference[b]:
                q += rows.phase_variance_m2[reference[a]] / rows.wavelength_m[row[a]] ** 2
            if a == b:
                q += rows.phase_variance_m2[row[a]] / rows.wavelength_m[row[a]] ** 2
            covariance[a, b] = covariance[b, a] = q
    return Ambiguities(value, covariance, mixed, row, reference)


@compiled
def chi2_limit(freedom: int, normal_quantile: float) -> float:
    """The χ² quantile that belongs to one of the normal distribution: Wilson & Hilferty, PNAS 17 (1931)."""
    part = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - part + normal_quantile * np.sqrt(part)) ** 3)


@compiled
def phase_residuals(rows: Rows, integer: Floats) -> tuple[float, int]:
    """χ² and degrees of freedom of the phases whose integers are known, in a position from these phases alone."""
    n = integer.size
    metres, weights = np.zeros(n), np.zeros(n)
    freedom = -3
    seen = np.zeros(GROUPS, np.bool_)
    for i in range(n):
        if integer[i] == integer[i]:
            metres[i] = rows.phase_m[i] - integer[i] * rows.wavelength_m[i]
            weights[i] = 1.0 / rows.phase_variance_m2[i]
            freedom += 1
            if not seen[rows.group[i]]:
                seen[rows.group[i]] = True
                freedom -= 1
    if freedom < 1:
        return 0.0, 0
    directions, reduced, _ = without_clocks(rows, metres, weights)
    information, right, chi2 = np.zeros((3, 3)), np.zeros(3), 0.0
    for i in range(n):
        chi2 += weights[i] * reduced[i] ** 2
        for k in range(3):
            right[k] += weights[i] * directions[i, k] * reduced[i]
            for m in range(3):
                information[k, m] += weights[i] * directions[i, k] * directions[i, m]
    covariance, solvable = inverse_3(information)
    if not solvable:
        return 0.0, 0
    return float(chi2 - form(right, covariance)), freedom


@compiled
def _cycles(rows: Rows, row: int, reference: int, dx_m: Floats) -> float:
    """A double-difference ambiguity in a given position."""
    metres = rows.phase_m[row] - rows.phase_m[reference]
    for k in range(3):
        metres -= (rows.direction[row, k] - rows.direction[reference, k]) * dx_m[k]
    return float(metres / rows.wavelength_m[row])


@compiled
def _follows(rows: Rows, row: int, reference: int, dx_m: Floats, covariance_m2: Floats) -> bool:
    """Does an integer follow from a position that others have fixed, beyond doubt?"""
    variance = rows.phase_variance_m2[row] + rows.phase_variance_m2[reference]
    for k in range(3):
        for m in range(3):
            variance += (
                (rows.direction[row, k] - rows.direction[reference, k])
                * covariance_m2[k, m]
                * (rows.direction[row, m] - rows.direction[reference, m])
            )
    cycles = _cycles(rows, row, reference, dx_m)
    sigma = np.sqrt(variance) / rows.wavelength_m[row]
    return bool(sigma < _FOLLOWS_SIGMA and abs(cycles - np.rint(cycles)) < _FOLLOWS_PART)


@compiled
def _placed(rows: Rows, usable: Booleans, found: FloatPosition) -> Booleans:
    """The usable rows (n,) without satellites of which a code is so wrong that it misplaces the satellite.

    Satellites are placed where a code says the signal left: 1 km of it is 3 mm along the orbit. What is wrong by less
    takes its code out of the float position, but not its phase from the integers: a phase that is sound helps, one
    that is not makes a wrong fix contradict itself.
    """
    n = usable.size
    level, count = np.zeros(GROUPS), np.zeros(GROUPS)
    left = np.empty(n)
    for i in range(n):
        left[i] = rows.code_m[i]
        for k in range(3):
            left[i] -= rows.direction[i, k] * found.dx_m[k]
        if found.used[i]:
            level[rows.group[i]] += left[i]
            count[rows.group[i]] += 1.0
    placed = usable.copy()
    for i in range(n):
        g = rows.group[i]
        if (
            usable[i]
            and not found.used[i]
            and count[g] > 0.0
            and abs(left[i] - level[g] / count[g]) > _GROSS_M
        ):
            for j in range(n):
                if rows.satellite[j] == rows.satellite[i]:
                    placed[j] = False
    return placed


@compiled
def estimate(
    rows: Rows, usable: Booleans, prior_m: Floats, prior_information: Floats, limits: Limits
) -> Estimate:
    """The position from the usable rows (n,): float, and fixed where its integers pass all of `limits`."""
    n = rows.phase_m.size
    integer = np.full(n, np.nan)
    first = float_with_prior(rows, usable, prior_m, prior_information, limits.code_outlier)
    codes = 0
    for i in range(n):
        codes += 1 if first.used[i] else 0
    status, nan = NO_POSITION, np.nan
    if first.freedom >= 0 and not inner(first.dx_m, first.dx_m) < _FAR_M**2:
        status = FAR
    if first.freedom < 0 or status == FAR:
        return Estimate(
            status, first.dx_m, first.covariance_m2, first.dx_m, first.covariance_m2, codes, 0, 0, nan, nan, nan,
            0.0, 0, integer,
        )  # fmt: skip
    unknown = ambiguities(rows, _placed(rows, usable, first), first.dx_m, first.covariance_m2)
    count = unknown.value.size
    if count < max(limits.least_fixed, 1):
        return Estimate(
            UNLIKELY, first.dx_m, first.covariance_m2, first.dx_m, first.covariance_m2, codes, count, 0, nan, nan,
            nan, 0.0, 0, integer,
        )  # fmt: skip
    found = resolve(
        unknown.value,
        unknown.covariance,
        limits.least_ratio,
        limits.least_success,
        limits.least_fixed,
        limits.most_nodes,
        limits.partial,
        limits.failure_rate,
    )
    status, chi2, freedom = found.status, 0.0, 0
    dx, covariance = first.dx_m, first.covariance_m2
    if status == RESOLVED:
        dx, covariance = conditional_update(
            first.dx_m, first.covariance_m2, unknown.position_covariance_m, found
        )
        for a in range(count):
            i, j = unknown.row[a], unknown.reference[a]
            if found.fixed == count:
                integer[i], integer[j] = found.ambiguities[a], 0.0
            elif _follows(rows, i, j, dx, covariance):
                integer[i], integer[j] = np.rint(_cycles(rows, i, j, dx)), 0.0
        chi2, freedom = phase_residuals(rows, integer)
        contradictory = found.squared_norm > chi2_limit(found.fixed, limits.normal_quantile)
        if freedom > 0:
            contradictory = contradictory or chi2 > chi2_limit(freedom, limits.normal_quantile)
        if contradictory:
            status = CONTRADICTORY
        elif covariance[0, 0] + covariance[1, 1] + covariance[2, 2] > limits.largest_sigma_m**2:
            status = IMPRECISE
        covariance = covariance + rows.atmosphere_m2
    return Estimate(
        status, first.dx_m, first.covariance_m2, dx, covariance, codes, count, found.fixed, found.ratio,
        found.success_rate, found.squared_norm, chi2, freedom, integer,
    )  # fmt: skip
