"""One epoch with carried ambiguities."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import Floats, Integers
from camber.gnss.ambiguity.ambiguity_resolution import RESOLVED, FixCriteria
from camber.gnss.ambiguity.carried_information import (
    CarriedArcs,
    Factor,
    add_rows,
    at_next_epoch,
    factor,
    no_arcs,
    solution,
    with_new_arcs,
    without,
)
from camber.gnss.ambiguity.fixed_solution import (
    CONTRADICTORY,
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
from camber.gnss.position.doppler_prior import Velocity, displacement
from camber.gnss.position.float_solution import (
    FloatPosition,
    PositionPrior,
    float_position,
    inverse_3,
)
from camber.gnss.position.small_algebra import inner, product

_LONGEST_GAP_NS = 2_100_000_000
_PRIOR_M = 100.0
_TESTABLE = 1.0e-6
_SHARES = 4


AmbiguityMode = Literal["single_epoch", "carried"]


class CarriedParameters(NamedTuple):
    noise: Noise
    background_s: float = 30.0
    white_s: float = 0.5
    slip_threshold: float = 4.0
    slip_power: float = 6.3
    phase_test: bool = True


class Motion(NamedTuple):
    moved_m: Floats
    information: Floats


NO_MOTION = Motion(np.zeros(3), np.zeros((3, 3)))


class CarriedEpoch(NamedTuple):
    arcs: CarriedArcs
    estimate: Estimate
    slips: int
    share: float


@compiled
def correlation_factor(elapsed_ns: int, time_constant_s: float) -> float:
    """(1 + φ) / (1 − φ) of an error with φ = exp(−t / τ)."""
    return 1.0 / math.tanh(0.5e-9 * elapsed_ns / time_constant_s)


@compiled
def _white_m2(rows: SingleDifferences, i: int, base_cn0: Floats, noise_m: float) -> float:
    total = 0.0
    for level in (rows.cn0_dbhz[i], base_cn0[rows.base[i]]):
        known = level if level == level else 40.0
        total += noise_m * noise_m * 10.0 ** ((45.0 - known) / 10.0)
    return total


@compiled
def _code_slot(satellite: int) -> int:
    return (satellite & 63) + (64 if satellite >> 8 == 74 else 0)


@compiled
def _columns(arcs: CarriedArcs, rows: SingleDifferences, rover_arcs: Integers, base_arcs: Integers) -> Integers:
    column = np.full(rows.group.size, -1, np.int64)
    for i in range(column.size):
        one, other = rover_arcs[rows.rover[i]], base_arcs[rows.base[i]]
        if one == 0 or other == 0 or not rows.phase_m[i] == rows.phase_m[i]:
            continue
        for a in range(arcs.rover_arc.size):
            if arcs.rover_arc[a] == one and arcs.base_arc[a] == other:
                column[i] = a
                break
    return column


@compiled
def _relative_phases(rows: SingleDifferences, arcs: CarriedArcs, column: Integers) -> Floats:
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
        rows.group, column.copy(), _relative_phases(rows, arcs, column), weight, rows.wavelength_m, rows.direction
    )
    broken = np.zeros(column.size, np.bool_)
    for _ in range(column.size):
        row = _next_slip(arcs.information, arcs.vector, rows, phases, parameters)
        if row < 0:
            break
        broken[row] = True
        phases.weight[row], phases.column[row] = 0.0, -1
    return broken


@compiled
def _next_slip(
    information: Floats,
    vector: Floats,
    rows: SingleDifferences,
    phases: _PhaseRows,
    parameters: CarriedParameters,
) -> int:
    """The row with the largest normalised residual, if too large, else the one that is tested least, if too little."""
    n = vector.size - 3
    information, vector = information.copy(), vector.copy()
    add_rows(information, vector, rows, phases.column, phases.value_m, phases.weight)
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
            _test_group(phases, mean, covariance, g, total, misfit, redundancy)
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
    arcs: CarriedArcs,
    rows: SingleDifferences,
    column: Integers,
    base_cn0: Floats,
    time_ns: int,
    parameters: CarriedParameters,
) -> tuple[Floats, Floats]:
    """Weights (k,) of the phases at this epoch, and of what they add to the state."""
    weight, slow = np.zeros(column.size), np.zeros(column.size)
    for i in range(column.size):
        if column[i] < 0:
            continue
        variance, seen = rows.phase_variance_m2[i], arcs.seen_ns[column[i]]
        weight[i] = slow[i] = 1.0 / variance
        if 0 < seen < time_ns:
            white = min(_white_m2(rows, i, base_cn0, parameters.noise.phase_noise_m), variance)
            correlated = (variance - white) * correlation_factor(time_ns - seen, parameters.background_s)
            slow[i] = 1.0 / (white + correlated)
    return weight, slow


@compiled
def _code_weights(
    code_ns: Integers,
    rows: SingleDifferences,
    tested: FloatPosition,
    base_cn0: Floats,
    time_ns: int,
    parameters: CarriedParameters,
) -> tuple[Floats, Floats]:
    """Weights (k,) of the codes by themselves, and after those of the same satellites before; `code_ns` is written."""
    k = rows.group.size
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
            white = scale * _white_m2(rows, i, base_cn0, glonass * parameters.noise.code_noise_m)
            white = min(white, variance)
            slow[i] = 1.0 / (
                white * correlation_factor(time_ns - seen, parameters.white_s)
                + (variance - white) * correlation_factor(time_ns - seen, parameters.background_s)
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
    rows: SingleDifferences,
    rover_arcs: Integers,
    base_arcs: Integers,
    base_cn0: Floats,
    motion: Motion,
    approximate_ecef_m: Floats,
    time_ns: int,
    criteria: FixCriteria,
    parameters: CarriedParameters,
) -> CarriedEpoch:
    """Carry the state to this epoch and resolve the ambiguities of its rows."""
    predicted = at_next_epoch(
        arcs, approximate_ecef_m, motion.moved_m, motion.information, time_ns - _LONGEST_GAP_NS
    )
    broken = _slipped(predicted, rows, _columns(predicted, rows, rover_arcs, base_arcs), parameters)
    state = _renewed(predicted, rows, broken, rover_arcs, base_arcs)
    column, nothing = _columns(state, rows, rover_arcs, base_arcs), np.full(broken.size, -1, np.int64)
    value = _relative_phases(rows, state, column)
    weight, slow = _phase_weights(state, rows, column, base_cn0, time_ns, parameters)
    present, right = state.information.copy(), state.vector.copy()
    add_rows(present, right, rows, column, value, weight)
    parts = factor(present, right)
    tested = _tested_codes(rows, parts, criteria.code_outlier)
    slips = int(broken.sum())
    if tested.freedom < 0:
        return CarriedEpoch(state, without_integers(rows, tested, NO_POSITION), slips, 0.0)
    full, code = _code_weights(code_ns, rows, tested, base_cn0, time_ns, parameters)
    share = _intersection_share(parts.position_information, _codes(rows, code), _codes(rows, full))
    if share < 1.0:
        state.information[:] *= share
        state.vector[:] *= share
        code = full * (1.0 - share)
        present, right = state.information.copy(), state.vector.copy()
        add_rows(present, right, rows, column, value, weight)
    for i in range(column.size):
        if column[i] >= 0:
            state.seen_ns[column[i]] = time_ns
    add_rows(present, right, rows, nothing, rows.code_m, code)
    add_rows(state.information, state.vector, rows, column, value, slow)
    add_rows(state.information, state.vector, rows, nothing, rows.code_m, code)
    estimate = _resolved(state, rows, column, present, right, tested, criteria)
    return CarriedEpoch(state, estimate, slips, share)


@compiled
def _resolved(
    arcs: CarriedArcs,
    rows: SingleDifferences,
    column: Integers,
    information: Floats,
    vector: Floats,
    tested: FloatPosition,
    criteria: FixCriteria,
) -> Estimate:
    """Float position and ambiguities of an epoch, and the integers."""
    parts = factor(information, vector)
    position_covariance, solvable = inverse_3(parts.position_information)
    if not solvable:
        return without_integers(rows, tested, NO_POSITION)
    position_m = product(position_covariance, parts.position_vector)
    mean, covariance = solution(parts, position_m, position_covariance)
    position = FloatPosition(position_m, position_covariance, tested.used, tested.chi2, freedom=tested.freedom)
    kept = without_misplaced(rows, np.ones(column.size, np.bool_), position)
    unknown = _differences_of(rows, kept, arcs, column, mean, covariance)
    return fixed_estimate(rows, position, unknown, criteria)


@compiled
def _codes(rows: SingleDifferences, weight: Floats) -> Floats:
    """Information of codes about the position (3, 3)."""
    information, vector = np.zeros((3, 3)), np.zeros(3)
    add_rows(information, vector, rows, np.full(weight.size, -1, np.int64), rows.code_m, weight)
    return information


@compiled
def _renewed(
    arcs: CarriedArcs, rows: SingleDifferences, broken: Booleans, rover_arcs: Integers, base_arcs: Integers
) -> CarriedArcs:
    """The state without the arcs of the broken rows (k,), and with new ones for them and for rows without one."""
    before = _columns(arcs, rows, rover_arcs, base_arcs)
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
    column = _columns(left, rows, rover_arcs, base_arcs)
    new = np.zeros(column.size, np.bool_)
    datum = np.zeros(column.size)
    for i in range(column.size):
        one, other = rover_arcs[rows.rover[i]], base_arcs[rows.base[i]]
        new[i] = column[i] < 0 and one > 0 and other > 0 and rows.phase_m[i] == rows.phase_m[i]
        if new[i]:
            code = rows.code_m[i] if rows.code_m[i] == rows.code_m[i] else 0.0
            datum[i] = np.rint((rows.phase_m[i] - code) / rows.wavelength_m[i])
    rows_of_new = np.flatnonzero(new)
    return with_new_arcs(
        left, rover_arcs[rows.rover[rows_of_new]], base_arcs[rows.base[rows_of_new]], datum[rows_of_new]
    )


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
    row, reference = group_references(rows, usable & (column >= 0))
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
def with_integers(
    arcs: CarriedArcs, rows: SingleDifferences, integer: Floats, rover_arcs: Integers, base_arcs: Integers
) -> CarriedArcs:
    """The state given integers by row (k,), as observations as precise as a phase; those held already are left."""
    column = _columns(arcs, rows, rover_arcs, base_arcs)
    k, n = column.size, arcs.vector.size - 3
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
            if rows.group[i] != g or a < 0 or i == base or held[a] or not integer[i] == integer[i]:
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


class CarriedAmbiguities:
    """The state from epoch to epoch."""

    def __init__(self, noise: Noise, criteria: FixCriteria) -> None:
        self._parameters, self._criteria = CarriedParameters(noise), criteria
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._arcs = no_arcs()
        self._held: CarriedArcs | None = None
        self._support = 0
        self._since_ns = 0
        self._code_ns = np.zeros((GROUPS, 128), np.int64)
        self._last: Velocity | None = None
        self._last_ns = 0
        self.slips = 0
        self.share = 0.0
        self.event = ""

    def solve(
        self,
        rows: SingleDifferences,
        approximate_ecef_m: Floats,
        alone: Estimate,
        *,
        rover_arcs: Integers,
        base_arcs: Integers,
        base_cn0_dbhz: Floats,
        velocity: Velocity | None,
        time_ns: int,
    ) -> tuple[AmbiguityMode, Estimate]:
        """Carry the state to this epoch."""
        elapsed_ns = time_ns - self._last_ns
        if not 0 < elapsed_ns <= _LONGEST_GAP_NS:
            self.reset()
        motion = NO_MOTION
        if self._last is not None and velocity is not None:
            moved_m, covariance_m2 = displacement(self._last, velocity, elapsed_ns)
            motion = Motion(moved_m, inverse_3(covariance_m2)[0])

        def step(arcs: CarriedArcs, code_ns: Integers) -> CarriedEpoch:
            return carried_epoch(
                arcs,
                code_ns,
                rows,
                rover_arcs,
                base_arcs,
                base_cn0_dbhz,
                motion,
                approximate_ecef_m,
                time_ns,
                self._criteria,
                self._parameters,
            )

        held = None if self._held is None else step(self._held, self._code_ns.copy())
        floats = step(self._arcs, self._code_ns)
        self._arcs, self._last, self._last_ns = floats.arcs, velocity, time_ns
        self.slips, self.share = floats.slips, floats.share
        self.event = ""
        direct: tuple[AmbiguityMode, Estimate] = ("carried", floats.estimate)
        if floats.estimate.status == NO_POSITION:
            direct = ("single_epoch", alone)
        elif floats.estimate.status != RESOLVED and alone.status == RESOLVED:
            if _agree(floats.estimate, alone.dx_m):
                direct = ("single_epoch", alone)
            else:
                self.event = "alone_contradicts_floats"
        resolved = direct[1].status == RESOLVED
        if held is not None:
            usable = held.estimate.status == RESOLVED
            if usable and not _agree(floats.estimate, held.estimate.dx_m):
                self.event = "refuted_by_floats"
                self._held = held = None
            elif usable and resolved and not self._same(held.estimate, direct[1]):
                self.event = "refuted_by_integers"
                self._held = held = None
                return "carried", floats.estimate._replace(status=CONTRADICTORY)
            elif usable:
                self._support += resolved
                self._held = with_integers(held.arcs, rows, held.estimate.integer, rover_arcs, base_arcs)
                if self._support >= 5 and time_ns - self._since_ns > 1_000_000_000:
                    self.event = "held"
                    return "carried", held.estimate
            else:
                self._held = held.arcs
        if resolved and (self._held is None):
            self._held = with_integers(floats.arcs, rows, direct[1].integer, rover_arcs, base_arcs)
            self._support, self._since_ns = 1, time_ns
        return direct

    def _same(self, one: Estimate, other: Estimate) -> bool:
        """Whether two fixes of one epoch are at the same place."""
        apart = one.dx_m - other.dx_m
        return float(apart @ apart) < 0.3**2


def _agree(floats: Estimate, dx_m: Floats) -> bool:
    apart = dx_m - floats.float_dx_m
    chi2 = float(apart @ np.linalg.solve(floats.float_covariance_m2, apart))
    return chi2 < 21.1 * 2.0
