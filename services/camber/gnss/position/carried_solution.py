"""One epoch with carried ambiguities: float position and integers from the state and the epoch's rows.

An arc goes on where its phase agrees with the others and a slip of one cycle would have been seen: both by the
normalised residual (Baarda 1968) of the phase against the carried state, the displacement by Doppler and the other
phases. Else it begins anew.

**Errors that last.** Reflections do not change between epochs at 10 Hz, so that a hundred codes are not a hundred
observations. An error with the correlation φ = exp(−t / τ) from one epoch to the next leaves of each further
observation of a constant the share (1 − φ) / (1 + φ) of the first one's information: whitened, y_k − φ y_{k−1} has the
variance (1 − φ²) σ² and contains (1 − φ) of the constant. So the first observation of a signal counts in full and the
others by that share, for the background of the error model (reflections) with a τ of its own and for the noise of the
tracking loop with another. The phases of the present epoch count in full for its position, and by their share for the
state.

**Codes of a state that has lost most of its arcs** are correlated with what is left of it to an unknown degree. Both
are joined by covariance intersection (Julier and Uhlmann 1997) where that gives the smaller covariance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers
from camber.gnss.ambiguity.ambiguity_resolution import FixCriteria
from camber.gnss.ambiguity.carried_information import (
    CarriedArcs,
    Factor,
    add_rows,
    at_next_epoch,
    factor,
    solution,
    with_new_arcs,
    without,
)
from camber.gnss.ambiguity.fixed_solution import (
    NO_POSITION,
    Ambiguities,
    Estimate,
    fixed_estimate,
    group_references,
    without_integers,
    without_misplaced,
)
from camber.gnss.observations.differenced_observations import Noise, SingleDifferences
from camber.gnss.observations.signal_pairs import GROUPS, Booleans, has_integers
from camber.gnss.position.float_solution import (
    FloatPosition,
    PositionPrior,
    float_position,
    inverse_3,
)
from camber.gnss.position.small_algebra import inner, product

LONGEST_GAP_NS = 2_100_000_000
"""As that of `CycleSlipDetector`; an arc that was not seen for so long is at its end."""
_PRIOR_M = 100.0  # derived: without codes the position is within the range of the linearisation
_TESTABLE = 1.0e-6  # least redundancy; chosen: below it nothing else measures the same
_SHARES = 4  # weights tried in the covariance intersection; chosen: steps of a quarter


class CarriedParameters(NamedTuple):
    """Error model and tests of the carried state.

    `background_s`: correlation time of reflections. Derived: h = 2 m above the ground, a reflection's detour 2 h sin el
    changes by 4 m · cos el · 0.1 mrad/s, a wavelength in 500 s, so that its phase is correlated over 500 s / 2 π, 80 s;
    from walls in 20 m as far as a car drives, tenths of a second. Chosen between. `noise_s`: of the code's tracking
    loop, 1 / (4 B) for a bandwidth B of 0.5 Hz. `slip_threshold`: normalised residual of a slip; chosen: 6 in 100,000
    right ones exceed it. `slip_power`: a slip of one cycle is so many σ, or the arc begins anew; chosen: the threshold
    and 2.3 σ, of 100 slips 99 exceed it.
    """

    noise: Noise
    background_s: float = 30.0
    noise_s: float = 0.5
    slip_threshold: float = 4.0
    slip_power: float = 6.3


class PositionLink(NamedTuple):
    """Displacement (3,) since the last epoch in ECEF, and its information (3, 3); zeros: not known."""

    moved_m: Floats
    information: Floats


NO_LINK = PositionLink(np.zeros(3), np.zeros((3, 3)))


class EpochRows(NamedTuple):
    """Rows of one epoch (k,), their arcs at rover and base, 0 for none, C/N0 at the base; the linearisation point."""

    rows: SingleDifferences
    rover_arc: Integers
    base_arc: Integers
    base_cn0_dbhz: Floats
    time_ns: int
    approximate_ecef_m: Floats


class CarriedEpoch(NamedTuple):
    """The state after an epoch, its estimate, and the number of arcs that did not go on."""

    arcs: CarriedArcs
    estimate: Estimate
    broken: int


@compiled
def correlation_factor(elapsed_ns: int, time_constant_s: float) -> float:
    """(1 + φ) / (1 − φ) of an error with φ = exp(−t / τ)."""
    return 1.0 / math.tanh(0.5e-9 * elapsed_ns / time_constant_s)


@compiled
def _noise_m2(epoch: EpochRows, i: int, noise_m: float) -> float:
    """Variance of the receivers' noise, without background; as in `variance_m2`."""
    total = 0.0
    for level in (epoch.rows.cn0_dbhz[i], epoch.base_cn0_dbhz[i]):
        known = level if level == level else 40.0
        total += noise_m * noise_m * 10.0 ** ((45.0 - known) / 10.0)
    return float(total)


@compiled
def _code_slot(satellite: int) -> int:
    """A satellite's place among those of its group, which QZSS shares with GPS."""
    return (satellite & 63) + (64 if satellite >> 8 == 74 else 0)


@compiled
def columns_of_rows(arcs: CarriedArcs, epoch: EpochRows) -> Integers:
    """The ambiguity of each row (k,) in the state; −1: none."""
    column = np.full(epoch.rover_arc.size, -1, np.int64)
    for i in range(column.size):
        one, other = epoch.rover_arc[i], epoch.base_arc[i]
        if one == 0 or other == 0 or np.isnan(epoch.rows.phase_m[i]):
            continue
        for a in range(arcs.rover_arc.size):
            if arcs.rover_arc[a] == one and arcs.base_arc[a] == other:
                column[i] = a
                break
    return column


@compiled
def _relative_phases(rows: SingleDifferences, arcs: CarriedArcs, column: Integers) -> Floats:
    """Phases (k,) less the datum of their ambiguity."""
    value = np.zeros(column.size)
    for i in range(column.size):
        if column[i] >= 0:
            value[i] = rows.phase_m[i] - arcs.datum_cycles[column[i]] * rows.wavelength_m[i]
    return value


class _PhaseRows(NamedTuple):
    """Phases of one epoch whose arcs go on (k,): the ambiguity's column, −1 for none, phase less datum, weight."""

    group: Integers
    column: Integers
    value_m: Floats
    weight: Floats
    wavelength_m: Floats
    direction: Floats


@compiled
def _slipped(
    arcs: CarriedArcs, rows: SingleDifferences, column: Integers, parameters: CarriedParameters
) -> Booleans:
    """Rows (k,) whose arc does not go on: the phase contradicts the others, or a slip of a cycle would not be seen."""
    weight = np.zeros(column.size)
    for i in range(column.size):
        if column[i] >= 0:
            weight[i] = 1.0 / rows.phase_variance_m2[i]
    phases = _PhaseRows(
        group=rows.group,
        column=column.copy(),
        value_m=_relative_phases(rows, arcs, column),
        weight=weight,
        wavelength_m=rows.wavelength_m,
        direction=rows.direction,
    )
    broken = np.zeros(column.size, np.bool_)
    for _ in range(column.size):
        row = _next_slip(arcs, rows, phases, parameters)
        if row < 0:
            break
        broken[row] = True
        phases.weight[row], phases.column[row] = 0.0, -1
    return broken


@compiled
def _next_slip(
    arcs: CarriedArcs, rows: SingleDifferences, phases: _PhaseRows, parameters: CarriedParameters
) -> int:
    """The row with the largest normalised residual, if too large, else the one that is tested least, if too little."""
    n = arcs.vector.size - 3
    information, vector = arcs.information.copy(), arcs.vector.copy()
    add_rows(information, vector, rows, phases.column, value_m=phases.value_m, weight=phases.weight)
    for axis in range(3):
        information[n + axis, n + axis] += 1.0 / _PRIOR_M**2
    parts = factor(information, vector)
    position_covariance, solvable = inverse_3(parts.position_information)
    if not solvable:
        return int(np.argmax(phases.column)) if phases.column.max() >= 0 else -1
    position_m = product(position_covariance, parts.position_vector)
    mean, covariance = solution(parts, position_m, position_covariance)
    misfit, redundancy = _normalised_residuals(phases, mean, covariance)
    worst, weakest, worst_row, weakest_row = parameters.slip_threshold, parameters.slip_power, -1, -1
    for i in range(misfit.size):
        if not redundancy[i] >= 0.0:
            continue
        if misfit[i] > worst:
            worst, worst_row = misfit[i], i
        power = phases.wavelength_m[i] * math.sqrt(phases.weight[i] * redundancy[i])
        if power < weakest:
            weakest, weakest_row = power, i
    return worst_row if worst_row >= 0 else weakest_row


@compiled
def _normalised_residuals(phases: _PhaseRows, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Residual over its σ and redundancy (k,), NaN for rows without weight and for one alone in its group."""
    k = phases.column.size
    misfit, redundancy = np.full(k, np.nan), np.full(k, np.nan)
    for g in range(GROUPS):
        total, count = 0.0, 0
        for i in range(k):
            if phases.weight[i] > 0.0 and phases.group[i] == g:
                total += phases.weight[i]
                count += 1
        if count >= 2:
            _test_group(phases, mean, covariance, g, total=total, misfit=misfit, redundancy=redundancy)
    return misfit, redundancy


@compiled
def _test_group(
    phases: _PhaseRows,
    mean: Floats,
    covariance: Floats,
    g: int,
    total: float,
    misfit: Floats,
    redundancy: Floats,
) -> None:
    """Write residuals and redundancies of one group, whose clock is the weighted mean."""
    size = mean.size
    n, k = size - 3, phases.column.size
    design, level = np.zeros(size), 0.0
    for i in range(k):
        if phases.weight[i] > 0.0 and phases.group[i] == g:
            share, fitted = phases.weight[i] / total, mean[phases.column[i]]
            design[phases.column[i]] += share
            for axis in range(3):
                design[n + axis] += share * phases.direction[i, axis]
                fitted += phases.direction[i, axis] * mean[n + axis]
            level += share * (phases.value_m[i] - fitted)
    spread = product(covariance, design)
    common = 1.0 / total + inner(design, spread)
    for i in range(k):
        if not (phases.weight[i] > 0.0 and phases.group[i] == g):
            continue
        c = phases.column[i]
        residual = phases.value_m[i] - level - mean[c]
        leverage = common + covariance[c, c] - 2.0 * spread[c]
        for axis in range(3):
            along = phases.direction[i, axis]
            residual -= along * mean[n + axis]
            leverage += 2.0 * along * (covariance[c, n + axis] - spread[n + axis])
            for other in range(3):
                leverage += along * covariance[n + axis, n + other] * phases.direction[i, other]
        redundancy[i] = max(1.0 - phases.weight[i] * leverage, 0.0)
        if redundancy[i] > _TESTABLE:
            misfit[i] = abs(residual) * math.sqrt(phases.weight[i] / redundancy[i])


@compiled
def _phase_weights(
    arcs: CarriedArcs, epoch: EpochRows, column: Integers, parameters: CarriedParameters
) -> tuple[Floats, Floats]:
    """Weights (k,) of the phases at this epoch, and of what they add to the state."""
    weight, slow = np.zeros(column.size), np.zeros(column.size)
    for i in range(column.size):
        if column[i] < 0:
            continue
        variance, seen = epoch.rows.phase_variance_m2[i], arcs.seen_ns[column[i]]
        weight[i] = slow[i] = 1.0 / variance
        if 0 < seen < epoch.time_ns:
            noise = min(_noise_m2(epoch, i, parameters.noise.phase_noise_m), variance)
            lasting = correlation_factor(epoch.time_ns - seen, parameters.background_s)
            slow[i] = 1.0 / (noise + (variance - noise) * lasting)
    return weight, slow


@compiled
def _code_weights(
    code_ns: Integers, epoch: EpochRows, tested: FloatPosition, parameters: CarriedParameters
) -> tuple[Floats, Floats]:
    """Weights (k,) of the codes by themselves, and after those of the same satellites before; `code_ns` is written."""
    rows, time_ns, k = epoch.rows, epoch.time_ns, epoch.rover_arc.size
    full, slow = np.zeros(k), np.zeros(k)
    scale = max(1.0, tested.chi2 / tested.freedom) if tested.freedom > 0 else 1.0
    for i in range(k):
        if not tested.used[i]:
            continue
        variance, slot = rows.code_variance_m2[i] * scale, _code_slot(rows.satellite[i])
        full[i] = slow[i] = 1.0 / variance
        seen = code_ns[rows.group[i], slot]
        if 0 < seen < time_ns:
            glonass = 1.0 if has_integers(rows.group[i]) else parameters.noise.glonass_code
            noise = min(scale * _noise_m2(epoch, i, glonass * parameters.noise.code_noise_m), variance)
            slow[i] = 1.0 / (
                noise * correlation_factor(time_ns - seen, parameters.noise_s)
                + (variance - noise) * correlation_factor(time_ns - seen, parameters.background_s)
            )
        code_ns[rows.group[i], slot] = time_ns
    return full, slow


@compiled
def _intersection_share(before: Floats, slow_code: Floats, full_code: Floats) -> float:
    """Share of the carried information; 1: with the codes by their slow weights, else a covariance intersection."""
    share, best = 1.0, np.inf
    covariance, solvable = inverse_3(before + slow_code)
    if solvable:
        best = np.trace(covariance)
    for step in range(_SHARES):
        part = step / _SHARES
        covariance, solvable = inverse_3(part * before + (1.0 - part) * full_code)
        if solvable and np.trace(covariance) < best:
            best, share = np.trace(covariance), part
    return share


@compiled
def _tested_codes(rows: SingleDifferences, parts: Factor, outlier_threshold: float) -> FloatPosition:
    """The codes without outliers, tested with what the carried state and the phases know of the position."""
    prior = PositionPrior(np.zeros(3), np.zeros((3, 3)))
    covariance, known = inverse_3(parts.position_information)
    if known:
        prior = PositionPrior(product(covariance, parts.position_vector), parts.position_information)
    return float_position(rows, np.ones(rows.group.size, np.bool_), prior, outlier_threshold)


@compiled
def carried_epoch(
    arcs: CarriedArcs,
    code_ns: Integers,
    epoch: EpochRows,
    motion: PositionLink,
    criteria: FixCriteria,
    parameters: CarriedParameters,
) -> CarriedEpoch:
    """Carry the state to an epoch and resolve the ambiguities of its rows.

    `code_ns` (160, 128) is when the code of a group and satellite was used last; it is written.
    """
    rows, since_ns = epoch.rows, epoch.time_ns - LONGEST_GAP_NS
    predicted = at_next_epoch(
        arcs, epoch.approximate_ecef_m, motion.moved_m, link_information=motion.information, since_ns=since_ns
    )
    broken = _slipped(predicted, rows, columns_of_rows(predicted, epoch), parameters)
    state = _renewed(predicted, epoch, broken)
    column, nothing = columns_of_rows(state, epoch), np.full(broken.size, -1, np.int64)
    value = _relative_phases(rows, state, column)
    weight, slow = _phase_weights(state, epoch, column, parameters)
    present, right = state.information.copy(), state.vector.copy()
    add_rows(present, right, rows, column, value_m=value, weight=weight)
    parts = factor(present, right)
    tested = _tested_codes(rows, parts, criteria.code_outlier)
    if tested.freedom < 0:
        return CarriedEpoch(state, without_integers(rows, tested, NO_POSITION), int(broken.sum()))
    full, code = _code_weights(code_ns, epoch, tested, parameters)
    share = _intersection_share(parts.position_information, _codes(rows, code), _codes(rows, full))
    if share < 1.0:
        state.information[:] *= share
        state.vector[:] *= share
        code = full * (1.0 - share)
        present, right = state.information.copy(), state.vector.copy()
        add_rows(present, right, rows, column, value_m=value, weight=weight)
    for i in range(column.size):
        if column[i] >= 0:
            state.seen_ns[column[i]] = epoch.time_ns
    add_rows(present, right, rows, nothing, value_m=rows.code_m, weight=code)
    add_rows(state.information, state.vector, rows, column, value_m=value, weight=slow)
    add_rows(state.information, state.vector, rows, nothing, value_m=rows.code_m, weight=code)
    known = _KnownPart(present, right, column, tested)
    return CarriedEpoch(state, _resolved(state, rows, known, criteria), int(broken.sum()))


class _KnownPart(NamedTuple):
    """What is known at an epoch, with its phases in full: information and vector, columns of the rows, tested codes."""

    information: Floats
    vector: Floats
    column: Integers
    tested: FloatPosition


@compiled
def _resolved(
    arcs: CarriedArcs, rows: SingleDifferences, known: _KnownPart, criteria: FixCriteria
) -> Estimate:
    """Float position and ambiguities of an epoch, and the integers."""
    tested, column = known.tested, known.column
    parts = factor(known.information, known.vector)
    position_covariance, solvable = inverse_3(parts.position_information)
    if not solvable:
        return without_integers(rows, tested, NO_POSITION)
    position_m = product(position_covariance, parts.position_vector)
    mean, covariance = solution(parts, position_m, position_covariance)
    position = FloatPosition(
        position_m, position_covariance, tested.used, tested.chi2, freedom=tested.freedom
    )
    kept = without_misplaced(rows, np.ones(column.size, np.bool_), position)
    unknown = _differences_of(
        rows, kept & (column >= 0), arcs, column=column, mean=mean, covariance_m2=covariance
    )
    return fixed_estimate(rows, position, unknown, criteria)


@compiled
def _codes(rows: SingleDifferences, weight: Floats) -> Floats:
    """Information of codes about the position (3, 3)."""
    information, vector = np.zeros((3, 3)), np.zeros(3)
    column = np.full(weight.size, -1, np.int64)
    add_rows(information, vector, rows, column, value_m=rows.code_m, weight=weight)
    return information


@compiled
def _renewed(arcs: CarriedArcs, epoch: EpochRows, broken: Booleans) -> CarriedArcs:
    """The state without the arcs of the broken rows (k,), and with new ones for them and for rows without one."""
    rows, before = epoch.rows, columns_of_rows(arcs, epoch)
    gone = np.zeros(arcs.rover_arc.size, np.bool_)
    for i in range(broken.size):
        if broken[i]:
            gone[before[i]] = True
    information, vector = without(arcs.information, arcs.vector, gone)
    kept = np.flatnonzero(~gone)
    left = CarriedArcs(
        rover_arc=arcs.rover_arc[kept],
        base_arc=arcs.base_arc[kept],
        datum_cycles=arcs.datum_cycles[kept],
        seen_ns=arcs.seen_ns[kept],
        held=arcs.held[kept],
        information=information,
        vector=vector,
        origin_ecef_m=arcs.origin_ecef_m,
    )
    column = columns_of_rows(left, epoch)
    new = np.zeros(column.size, np.bool_)
    datum = np.zeros(column.size)
    for i in range(column.size):
        one, other = epoch.rover_arc[i], epoch.base_arc[i]
        new[i] = column[i] < 0 and one > 0 and other > 0 and rows.phase_m[i] == rows.phase_m[i]
        if new[i]:
            code = rows.code_m[i] if rows.code_m[i] == rows.code_m[i] else 0.0
            datum[i] = np.rint((rows.phase_m[i] - code) / rows.wavelength_m[i])
    rows_of_new = np.flatnonzero(new)
    return with_new_arcs(left, epoch.rover_arc[rows_of_new], epoch.base_arc[rows_of_new], datum[rows_of_new])


@compiled
def _differences_of(
    rows: SingleDifferences,
    usable: Booleans,
    arcs: CarriedArcs,
    column: Integers,
    mean: Floats,
    covariance_m2: Floats,
) -> Ambiguities:
    """Double differences of the ambiguities of the usable rows with an arc."""
    n = arcs.vector.size - 3
    row, reference = group_references(rows, usable)
    count = row.size
    value, covariance, mixed = np.empty(count), np.empty((count, count)), np.empty((3, count))
    for a in range(count):
        i, j = column[row[a]], column[reference[a]]
        wavelength = rows.wavelength_m[row[a]]
        value[a] = arcs.datum_cycles[i] - arcs.datum_cycles[j] + (mean[i] - mean[j]) / wavelength
        for axis in range(3):
            mixed[axis, a] = (covariance_m2[n + axis, i] - covariance_m2[n + axis, j]) / wavelength
        for b in range(a + 1):
            p, q = column[row[b]], column[reference[b]]
            spread = covariance_m2[i, p] - covariance_m2[i, q] - covariance_m2[j, p] + covariance_m2[j, q]
            covariance[a, b] = covariance[b, a] = spread / (wavelength * rows.wavelength_m[row[b]])
    return Ambiguities(value, covariance, mixed, row=row, reference=reference)


@compiled
def with_integers(arcs: CarriedArcs, epoch: EpochRows, integer: Floats) -> CarriedArcs:
    """The state given integers by row (k,), as observations as precise as a phase; those held already are left."""
    rows, column = epoch.rows, columns_of_rows(arcs, epoch)
    k = column.size
    information, vector, held = arcs.information.copy(), arcs.vector.copy(), arcs.held.copy()
    for g in range(GROUPS):
        base = -1
        for i in range(k):
            if rows.group[i] == g and column[i] >= 0 and integer[i] == integer[i]:
                better = base < 0 or (held[column[i]] and not held[column[base]])
                if better:
                    base = i
        if base < 0:
            continue
        b = column[base]
        for i in range(k):
            a = column[i]
            if rows.group[i] != g or a < 0 or i == base or held[a] or np.isnan(integer[i]):
                continue
            cycles = integer[i] - integer[base] - arcs.datum_cycles[a] + arcs.datum_cycles[b]
            value = cycles * rows.wavelength_m[i]
            weight = 1.0 / (rows.phase_variance_m2[i] + rows.phase_variance_m2[base])
            information[a, a] += weight
            information[b, b] += weight
            information[a, b] -= weight
            information[b, a] -= weight
            vector[a] += weight * value
            vector[b] -= weight * value
            held[a] = held[b] = True
    return CarriedArcs(
        rover_arc=arcs.rover_arc,
        base_arc=arcs.base_arc,
        datum_cycles=arcs.datum_cycles,
        seen_ns=arcs.seen_ns,
        held=held,
        information=information,
        vector=vector,
        origin_ecef_m=arcs.origin_ecef_m,
    )
