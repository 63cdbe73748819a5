"""RTK solution of one epoch of rover and base: single differences, float solution, LAMBDA, ratio test, fixed solution.

Two compiled calls: from observations to single differences, and from these to the estimate, which subsets use alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats, Integers
from camber.gnss.ambiguity.ambiguity_resolution import FixCriteria
from camber.gnss.ambiguity.fixed_solution import Estimate, estimate
from camber.gnss.observations.differenced_observations import (
    Masks,
    Noise,
    ReceiverAtEpoch,
    SingleDifferences,
    single_differences,
)
from camber.gnss.observations.satellite_states import EphemerisTable, SatelliteStates, states_at_transmission
from camber.gnss.observations.signal_pairs import Booleans, SignalColumns, SignalPairs, pair_signals
from camber.gnss.position.float_solution import PositionPrior, float_with_prior, relative_to
from camber.gnss.position.small_algebra import inner

_NEAR_M = 3.0  # derived: 3 m of height are 1 mm of troposphere, and no curvature of the range
_LINEARISATIONS = 4  # chosen: an upper bound; the loop ends once the step is below _NEAR_M
_MOST_CYCLES = 1.0e12  # larger than any carrier phase; a double then still resolves 1e-4 cycles


class SatelliteView(NamedTuple):
    """The m satellites that the rover observes.

    `place` (n,) is the index of a satellite by row of the rover's epoch, or −1; `ephemeris` (m,) its row in the table.
    """

    place: Integers
    ephemeris: Integers
    states: SatelliteStates
    table: EphemerisTable


class EngineParameters(NamedTuple):
    """Signal groups in use (160,), error model, masks and acceptance tests."""

    groups: Booleans
    noise: Noise
    masks: Masks
    criteria: FixCriteria


class EpochSolution(NamedTuple):
    """Linearisation point (3,) in ECEF, number of satellites in the rows, the rows and the estimate."""

    approximate_ecef_m: Floats
    satellites: int
    rows: SingleDifferences
    estimate: Estimate


@compiled
def usable_parts(columns: SignalColumns) -> Integers:
    """By row (n,): 2 with code and phase, 1 with the code only, 0 without a code.

    A phase with an open half-cycle ambiguity is not usable, nor is a signal that occurs twice with different values.
    """
    n = columns.satellite.size
    parts = np.zeros(n, np.int64)
    for i in range(n):
        if abs(columns.pseudorange_m[i]) < SPEED_OF_LIGHT_M_S:
            phase = abs(columns.carrier_phase_cycles[i]) < _MOST_CYCLES and not columns.half_cycle[i]
            parts[i] = 2 if phase else 1
    for i in range(n):
        for j in range(i):
            if columns.satellite[i] != columns.satellite[j] or columns.signal[i] != columns.signal[j]:
                continue
            if columns.pseudorange_m[i] != columns.pseudorange_m[j] or (
                parts[i] == 2 and parts[j] == 2
                and columns.carrier_phase_cycles[i] != columns.carrier_phase_cycles[j]
            ):  # fmt: skip
                parts[i] = parts[j] = 0
    return parts


def solve_epoch(
    rover: SignalColumns,
    base: SignalColumns,
    sky: SatelliteView,
    start_ecef_m: Floats,
    base_ecef_m: Floats,
    prior: PositionPrior,
    parameters: EngineParameters,
) -> EpochSolution:
    """Float and fixed position of one epoch; the prior is in ECEF."""
    approximate, rows, near, satellites = difference_epoch(
        rover=rover,
        base=base,
        sky=sky,
        start_ecef_m=start_ecef_m,
        base_ecef_m=base_ecef_m,
        prior=prior,
        parameters=parameters,
    )
    usable = np.ones(rows.group.size, np.bool_)
    result = estimate(rows, usable, near, parameters.criteria)
    return EpochSolution(approximate, satellites, rows, result)


@compiled
def difference_epoch(
    rover: SignalColumns,
    base: SignalColumns,
    sky: SatelliteView,
    start_ecef_m: Floats,
    base_ecef_m: Floats,
    prior: PositionPrior,
    parameters: EngineParameters,
) -> tuple[Floats, SingleDifferences, PositionPrior, int]:
    """Linearisation point (3,), single differences, the prior relative to the point, and the number of satellites."""
    rover_parts, base_parts = usable_parts(rover), usable_parts(base)
    pairs = pair_signals(rover, rover_parts, base, base_usable=base_parts, groups=parameters.groups)
    base_states = _base_states(pairs, base, sky)
    approximate = start_ecef_m.copy()
    for further in range(_LINEARISATIONS):
        rows = single_differences(
            pairs,
            ReceiverAtEpoch(rover, sky.states, approximate),
            ReceiverAtEpoch(base, base_states, base_ecef_m),
            noise=parameters.noise,
            masks=parameters.masks,
        )
        usable = np.ones(rows.group.size, np.bool_)
        coarse = float_with_prior(
            rows, usable, relative_to(prior, approximate), parameters.criteria.code_outlier
        )
        converged = coarse.freedom < 0 or inner(coarse.dx_m, coarse.dx_m) < _NEAR_M**2
        if converged or further == _LINEARISATIONS - 1:
            break
        approximate += coarse.dx_m
    for a in range(rows.group.size):
        if rover_parts[rows.rover[a]] < 2 or base_parts[rows.base[a]] < 2:
            rows.phase_m[a] = np.nan
    return approximate, rows, relative_to(prior, approximate), _count_distinct(rows.satellite)


@compiled
def _count_distinct(numbers: Integers) -> int:
    count = 0
    for i in range(numbers.size):
        count += 1
        for j in range(i):
            if numbers[j] == numbers[i]:
                count -= 1
                break
    return count


@compiled
def _base_states(pairs: SignalPairs, base: SignalColumns, sky: SatelliteView) -> SatelliteStates:
    """Satellite states for the base's codes; `place` of the pairs is written."""
    base_code_m = np.full(sky.ephemeris.size, np.nan)
    for i in range(pairs.group.size):
        place = sky.place[pairs.rover[i]]
        pairs.place[i] = place
        if place >= 0 and np.isnan(base_code_m[place]):
            base_code_m[place] = base.pseudorange_m[pairs.base[i]]
    return states_at_transmission(sky.table, sky.ephemeris, base.time_ns, base_code_m)
