"""One epoch of rover and base, from their observations to an estimate, in one compiled call."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats, Integers, ObservationEpoch
from camber.gnss.ambiguity.fixed_solution import Estimate, Limits, estimate
from camber.gnss.observations.satellite_states import (
    EphemerisTable,
    SatelliteStates,
    states_at_transmission,
)
from camber.gnss.observations.signal_pairs import pair_signals
from camber.gnss.observations.single_differences import (
    Booleans,
    Masks,
    Noise,
    Pairs,
    Rows,
    single_differences,
)
from camber.gnss.position.float_solution import float_with_prior
from camber.gnss.position.small_algebra import inner

# How near the approximate position has to be: 3 m of height are 1 mm of the troposphere, and of curvature nothing.
_NEAR_M = 3.0
_ROUNDS = 4
_MOST_CYCLES = 1.0e12


class Columns(NamedTuple):
    """Of one receiver's epoch (n,), as the compiled code takes them; the names are those of `ObservationEpoch`."""

    satellite: Integers
    signal: Integers
    pseudorange_m: Floats
    carrier_phase_cycles: Floats
    cn0_dbhz: Floats
    half_cycle: Booleans


class Prior(NamedTuple):
    """Where the rover is before its codes are looked at, ECEF (3,), and the information of it (3, 3); zeros: none."""

    position_ecef_m: Floats
    information: Floats


NO_PRIOR = Prior(np.zeros(3), np.zeros((3, 3)))


class Sky(NamedTuple):
    """What is known of the satellites that the rover observes, m of them.

    `place` (n,) is that of a satellite by row of the rover's epoch, or −1; `ephemeris` (m,) its row in the table.
    """

    place: Integers
    ephemeris: Integers
    states: SatelliteStates


def columns_of(epoch: ObservationEpoch) -> Columns:
    """The columns that differences are made of."""
    return Columns(
        epoch.satellite,
        epoch.signal,
        epoch.pseudorange_m,
        epoch.carrier_phase_cycles,
        epoch.cn0_dbhz,
        epoch.half_cycle,
    )


@compiled
def usable_parts(columns: Columns) -> Integers:
    """By row (n,): 2 with code and phase, 1 with the code only, 0 without a code.

    A phase that may be off by half a cycle is no phase. Of a signal that is there twice and says different things,
    nothing can be used.
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


@compiled
def solve_differenced(
    rover: Columns,
    base: Columns,
    base_time_ns: int,
    sky: Sky,
    table: EphemerisTable,
    groups: Booleans,
    start_ecef_m: Floats,
    base_ecef_m: Floats,
    age_s: float,
    prior: Prior,
    noise: Noise,
    masks: Masks,
    limits: Limits,
) -> tuple[Floats, int, Rows, Estimate]:
    """The position (3,) at which the epoch was linearised, how many satellites are in its rows, rows and estimate."""
    rover_parts, base_parts = usable_parts(rover), usable_parts(base)
    of_rover, of_base, group = pair_signals(
        rover.satellite, rover.signal, rover_parts, base.satellite, base.signal, base_parts, groups
    )
    place = np.empty(group.size, np.int64)
    base_code_m = np.full(sky.ephemeris.size, np.nan)
    for i in range(group.size):
        place[i] = sky.place[of_rover[i]]
        if place[i] >= 0 and np.isnan(base_code_m[place[i]]):
            base_code_m[place[i]] = base.pseudorange_m[of_base[i]]
    base_states = states_at_transmission(table, sky.ephemeris, base_time_ns, base_code_m)
    pairs = Pairs(of_rover, of_base, group, place)
    of_rover_values = (rover.satellite, rover.pseudorange_m, rover.carrier_phase_cycles, rover.cn0_dbhz)
    of_base_values = (base.satellite, base.pseudorange_m, base.carrier_phase_cycles, base.cn0_dbhz)
    approximate = start_ecef_m.copy()
    usable = np.ones(0, np.bool_)
    for further in range(_ROUNDS):
        rows = single_differences(
            pairs, of_rover_values, of_base_values, sky.states, base_states, approximate, base_ecef_m, age_s,
            noise, masks,
        )  # fmt: skip
        usable = np.ones(rows.group.size, np.bool_)
        prior_m = prior.position_ecef_m - approximate
        coarse = float_with_prior(rows, usable, prior_m, prior.information, limits.code_outlier)
        if coarse.freedom < 0 or inner(coarse.dx_m, coarse.dx_m) < _NEAR_M**2 or further == _ROUNDS - 1:
            break
        approximate += coarse.dx_m
    for a in range(rows.group.size):
        if rover_parts[rows.rover[a]] < 2 or base_parts[rows.base[a]] < 2:
            rows.phase_m[a] = np.nan
    satellites = 0
    for a in range(rows.group.size):
        first = True
        for b in range(a):
            first = first and rows.satellite[b] != rows.satellite[a]
        satellites += 1 if first else 0
    prior_m = prior.position_ecef_m - approximate
    found = estimate(rows, usable, prior_m, prior.information, limits)
    return approximate, satellites, rows, found
