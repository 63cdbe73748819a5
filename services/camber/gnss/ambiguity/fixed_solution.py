"""Float solution → LAMBDA → ratio test → fixed solution, of any subset of an epoch's rows.

Source: Teunissen 1995; for a single epoch the ambiguities follow from the phases and the float position,
`â = (φ − G x̂)/λ`, `Q_a = (Q_φ + G Q_x Gᵀ)/(λ λᵀ)`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers
from camber.gnss.ambiguity.ambiguity_resolution import (
    RESOLVED,
    UNLIKELY,
    FixCriteria,
    Resolution,
    conditional_update,
    resolve,
)
from camber.gnss.observations.differenced_observations import SingleDifferences, without_clocks
from camber.gnss.observations.signal_pairs import GROUPS, Booleans
from camber.gnss.position.float_solution import FloatPosition, PositionPrior, float_with_prior, inverse_3
from camber.gnss.position.small_algebra import form, inner

# Status beyond those of `camber.gnss.ambiguity.ambiguity_resolution`.
NO_POSITION, CONTRADICTORY, IMPRECISE, FAR = range(5, 9)
"""`NO_POSITION`: too few codes for a float position. `CONTRADICTORY`: the residuals of the fixed phases are too large.
`IMPRECISE`: too few ambiguities are fixed for a position of centimetres. `FAR`: the position is too far from the
linearisation point."""

_FAR_M = 100.0  # derived: the curvature of a range over 100 m is 0.25 mm
_GROSS_M = 1000.0  # derived: 3.3 µs of travel time at a range rate of 0.9 km/s: 3 mm of range
# Chosen: an integer that other fixed ambiguities determine is certain at 5 σ (0.1 cycles) and within 0.2 cycles.
_IMPLIED_SIGMA, _IMPLIED_FRACTION = 0.1, 0.2


class Estimate(NamedTuple):
    """Float and fixed position from a subset of rows, as offsets from the linearisation point in ECEF (3,), (3, 3).

    `status` is that of `resolution` or one of this module; fixed only where it is RESOLVED. `integer`
    (rows,) is that of a row against the reference of its group (0 there), NaN where unknown. `phase_freedom`: degrees
    of freedom of the fixed phases' residuals; 0: they cannot be tested. `code_used` (rows,): codes in the float
    position, those without outliers.
    """

    status: int
    float_dx_m: Floats
    float_covariance_m2: Floats
    dx_m: Floats
    covariance_m2: Floats
    ambiguities: int
    fixed: int
    ratio: float
    success_rate: float
    phase_freedom: int
    integer: Floats
    code_used: Booleans


class Ambiguities(NamedTuple):
    """Double-difference ambiguities (n,) in cycles, covariance (n, n), covariance with the position (3, n).

    `row` and `reference` (n,) are the differenced rows.
    """

    value: Floats
    covariance: Floats
    position_covariance_m: Floats
    row: Integers
    reference: Integers


@compiled
def group_references(rows: SingleDifferences, usable: Booleans) -> tuple[Integers, Integers]:
    """Usable rows with a phase (n,), and for each the most precise phase of its group, which has no row itself."""
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
    return row[:count].copy(), reference[:count].copy()


@compiled
def ambiguities(
    rows: SingleDifferences, usable: Booleans, dx_m: Floats, covariance_m2: Floats
) -> Ambiguities:
    """Ambiguities of the usable rows with a phase, against the most precise phase of their group."""
    row, reference = group_references(rows, usable)
    count = row.size
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
    return Ambiguities(value, covariance, mixed, row=row, reference=reference)


@compiled
def chi2_limit(freedom: int, normal_quantile: float) -> float:
    """χ² quantile at the probability of a normal quantile: Wilson & Hilferty, PNAS 17 (1931)."""
    part = 2.0 / (9.0 * freedom)
    return float(freedom * (1.0 - part + normal_quantile * np.sqrt(part)) ** 3)


@compiled
def phase_residuals(rows: SingleDifferences, integer: Floats) -> tuple[float, int]:
    """χ² and degrees of freedom of the phases with known integers, about the position from these phases alone."""
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
def _cycles(rows: SingleDifferences, row: int, reference: int, dx_m: Floats) -> float:
    """A double-difference ambiguity at a given position."""
    metres = rows.phase_m[row] - rows.phase_m[reference]
    for k in range(3):
        metres -= (rows.direction[row, k] - rows.direction[reference, k]) * dx_m[k]
    return float(metres / rows.wavelength_m[row])


@compiled
def _sigma_cycles(rows: SingleDifferences, row: int, reference: int, covariance_m2: Floats) -> float:
    """σ of that ambiguity for a position's covariance."""
    variance = rows.phase_variance_m2[row] + rows.phase_variance_m2[reference]
    for k in range(3):
        for m in range(3):
            variance += (
                (rows.direction[row, k] - rows.direction[reference, k])
                * covariance_m2[k, m]
                * (rows.direction[row, m] - rows.direction[reference, m])
            )
    return float(np.sqrt(variance) / rows.wavelength_m[row])


@compiled
def without_misplaced(rows: SingleDifferences, usable: Booleans, position: FloatPosition) -> Booleans:
    """The usable rows (n,) without satellites whose code error is so large that it misplaces the satellite.

    A satellite's position is computed at the code's time of transmission: 1 km of code error is 3 mm of range. A
    smaller error excludes the code from the float position, but not its phase from the ambiguities: a correct phase
    helps, a wrong one makes a wrong fix contradict itself.
    """
    n = usable.size
    total, count = np.zeros(GROUPS), np.zeros(GROUPS)
    residual = np.empty(n)
    for i in range(n):
        residual[i] = rows.code_m[i]
        for k in range(3):
            residual[i] -= rows.direction[i, k] * position.dx_m[k]
        if position.used[i]:
            total[rows.group[i]] += residual[i]
            count[rows.group[i]] += 1.0
    kept = usable.copy()
    for i in range(n):
        g = rows.group[i]
        if not usable[i] or position.used[i] or not count[g] > 0.0:
            continue
        if abs(residual[i] - total[g] / count[g]) > _GROSS_M:
            for j in range(n):
                if rows.satellite[j] == rows.satellite[i]:
                    kept[j] = False
    return kept


@compiled
def _integers(
    rows: SingleDifferences, unknown: Ambiguities, resolution: Resolution, dx_m: Floats, covariance_m2: Floats
) -> Floats:
    """Integers by row (n,) of a fixed solution; of a partial one those that the fixed position determines."""
    integer = np.full(rows.phase_m.size, np.nan)
    for a in range(unknown.value.size):
        i, j = unknown.row[a], unknown.reference[a]
        if resolution.fixed == unknown.value.size:
            integer[i], integer[j] = resolution.ambiguities[a], 0.0
            continue
        cycles = _cycles(rows, i, j, dx_m)
        certain = _sigma_cycles(rows, i, j, covariance_m2) < _IMPLIED_SIGMA
        if certain and abs(cycles - np.rint(cycles)) < _IMPLIED_FRACTION:
            integer[i], integer[j] = np.rint(cycles), 0.0
    return integer


@compiled
def estimate(
    rows: SingleDifferences, usable: Booleans, prior: PositionPrior, criteria: FixCriteria
) -> Estimate:
    """Position from the usable rows (n,): float, and fixed where it passes all criteria; the prior is an offset."""
    position = float_with_prior(rows, usable, prior, criteria.code_outlier)
    if position.freedom < 0:
        return without_integers(rows, position, NO_POSITION)
    if not inner(position.dx_m, position.dx_m) < _FAR_M**2:
        return without_integers(rows, position, FAR)
    kept = without_misplaced(rows, usable, position)
    unknown = ambiguities(rows, kept, position.dx_m, position.covariance_m2)
    return fixed_estimate(rows, position, unknown, criteria)


@compiled
def without_integers(rows: SingleDifferences, position: FloatPosition, status: int) -> Estimate:
    """The estimate of a float position alone."""
    return Estimate(
        status=status,
        float_dx_m=position.dx_m,
        float_covariance_m2=position.covariance_m2,
        dx_m=position.dx_m,
        covariance_m2=position.covariance_m2,
        ambiguities=0,
        fixed=0,
        ratio=np.nan,
        success_rate=np.nan,
        phase_freedom=0,
        integer=np.full(rows.phase_m.size, np.nan),
        code_used=position.used,
    )


@compiled
def fixed_estimate(
    rows: SingleDifferences, position: FloatPosition, unknown: Ambiguities, criteria: FixCriteria
) -> Estimate:
    """Resolve the ambiguities that belong to a float position; fixed where it passes all criteria."""
    dx, covariance, integer = position.dx_m, position.covariance_m2, np.full(rows.phase_m.size, np.nan)
    status, fixed, ratio, success_rate, freedom = UNLIKELY, 0, np.nan, np.nan, 0
    count = unknown.value.size
    if count >= max(criteria.least_fixed, 1):
        resolution = resolve(unknown.value, unknown.covariance, criteria)
        status, fixed = resolution.status, resolution.fixed
        ratio, success_rate = resolution.ratio, resolution.success_rate
        if status == RESOLVED:
            dx, covariance = conditional_update(dx, covariance, unknown.position_covariance_m, resolution)
            integer = _integers(rows, unknown, resolution, dx_m=dx, covariance_m2=covariance)
            chi2, freedom = phase_residuals(rows, integer)
            contradictory = resolution.squared_norm > chi2_limit(fixed, criteria.residual_quantile)
            if freedom > 0:
                contradictory = contradictory or chi2 > chi2_limit(freedom, criteria.residual_quantile)
            if contradictory:
                status = CONTRADICTORY
            elif covariance[0, 0] + covariance[1, 1] + covariance[2, 2] > criteria.largest_sigma_m**2:
                status = IMPRECISE
            covariance = covariance + rows.atmosphere_m2
    return Estimate(
        status=status,
        float_dx_m=position.dx_m,
        float_covariance_m2=position.covariance_m2,
        dx_m=dx,
        covariance_m2=covariance,
        ambiguities=count,
        fixed=fixed,
        ratio=ratio,
        success_rate=success_rate,
        phase_freedom=freedom,
        integer=integer,
        code_used=position.used,
    )
