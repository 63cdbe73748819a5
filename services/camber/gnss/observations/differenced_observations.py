"""Single differences of one epoch: code and phase of the rover minus the base, minus modelled terms.

A row is a satellite in one band. The ranges to an approximate position of the rover and to the base, the satellite's
clock and the troposphere are subtracted, which leaves `−u · dx + clock of the group (+ λ N)`, with u the line of sight
and dx the rover's offset from the approximate position. The clock of a group is common to its rows: differences within
a group are double differences (Kikuchi (TUMSAT): `L = ρ + λ n + ε`, `P = ρ + ε`). Solutions from satellite subsets use
the same rows.

Phases of GLONASS are left out. Their carriers differ, so that a double difference has no integer, and receivers of
different makers have phase biases that differ from channel to channel. Float ambiguities, one a satellite, would take
all that the phases of one epoch contain.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats, Integers
from camber.gnss.observations.atmosphere import slant_troposphere_m, troposphere_at
from camber.gnss.observations.satellite_states import (
    SatelliteStates,
    enu_from_ecef_rotation,
    geodetic,
    range_to,
)
from camber.gnss.observations.signal_pairs import (
    GROUPS,
    L1_M,
    WAVELENGTH_M,
    SignalColumns,
    SignalPairs,
    has_integers,
)
from camber.gnss.position.small_algebra import inner


class SingleDifferences(NamedTuple):
    """Columns (n,) of one epoch; `direction` (n, 3) is −u in ECEF. A NaN phase is missing, not usable,
    or of GLONASS.

    `rover` and `base` are the differenced rows of their epochs. `atmosphere_m2` (3, 3) is not a column: the covariance
    in ECEF of the atmosphere's effect on a position, which does not shrink with the number of rows.
    """

    rover: Integers
    base: Integers
    satellite: Integers
    group: Integers
    wavelength_m: Floats
    direction: Floats
    code_m: Floats
    phase_m: Floats
    code_variance_m2: Floats
    phase_variance_m2: Floats
    elevation_rad: Floats
    cn0_dbhz: Floats
    atmosphere_m2: Floats


@compiled
def without_clocks(rows: SingleDifferences, values: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Directions (n, 3) and values (n,) minus their weighted mean in each group, and each group's weight by row (n,).

    Eliminating the clock by the weighted mean is equivalent to double differences with their full covariance.
    """
    n = values.size
    total, mean, level = np.zeros(GROUPS), np.zeros((GROUPS, 3)), np.zeros(GROUPS)
    for i in range(n):
        w = weights[i]
        if w > 0.0:
            g = rows.group[i]
            total[g] += w
            level[g] += w * values[i]
            for k in range(3):
                mean[g, k] += w * rows.direction[i, k]
    directions, reduced, weight = np.zeros((n, 3)), np.zeros(n), np.zeros(n)
    for i in range(n):
        g = rows.group[i]
        if weights[i] > 0.0:
            weight[i] = total[g]
            reduced[i] = values[i] - level[g] / total[g]
            for k in range(3):
                directions[i, k] = rows.direction[i, k] - mean[g, k] / total[g]
    return directions, reduced, weight


class Noise(NamedTuple):
    """Standard deviations of one receiver's code and phase: background / sin(elevation), and noise at 45 dB-Hz.

    The background is multipath; the noise grows as the signal weakens, by 10^((45 − C/N0) / 20). `ionosphere`: residual
    per metre of baseline on the first band. `satellite_clock` [s/s]: drift against the broadcast clock between the
    epochs of base and rover. `horizontal`, `vertical`: effect of the atmosphere on a fixed position per metre of
    baseline, as in receivers' data sheets (1 ppm, 2 ppm). `glonass_code`: factor of the code's σ for GLONASS, whose
    chips are twice as long; as RTKLIB's (`EFACT_GLO`). `glonass_channel_m`: difference of two receivers' code delays
    from channel to channel. Chosen: float positions keep within their covariance where it is 2 m, and receivers of one
    make still gain fixes.
    """

    code_background_m: float = 0.20
    code_noise_m: float = 0.30
    phase_background_m: float = 0.002
    phase_noise_m: float = 0.002
    ionosphere: float = 0.5e-6
    satellite_clock: float = 5.0e-12
    horizontal: float = 1.0e-6
    vertical: float = 2.0e-6
    glonass_code: float = 1.5
    glonass_channel_m: float = 2.0


class Masks(NamedTuple):
    """Lowest elevation and least C/N0 at the rover."""

    lowest_elevation_rad: float
    least_cn0_dbhz: float


class ReceiverAtEpoch(NamedTuple):
    """Observations of one receiver, the satellites' states (m,) for them, and its position (3,)."""

    observations: SignalColumns
    states: SatelliteStates
    ecef_m: Floats


@compiled
def variance_m2(background_m: float, noise_m: float, sin_elevation: float, cn0_dbhz: float) -> float:
    """Variance of one receiver's code or phase; an unknown C/N0 counts as 40 dB-Hz."""
    level = cn0_dbhz if cn0_dbhz == cn0_dbhz else 40.0
    noise = noise_m * 10.0 ** ((45.0 - level) / 20.0)
    return float((background_m / sin_elevation) ** 2 + noise * noise)


@compiled
def single_differences(
    pairs: SignalPairs, rover: ReceiverAtEpoch, base: ReceiverAtEpoch, noise: Noise, masks: Masks
) -> SingleDifferences:
    """Rows of the pairs that can be used; the rover's position is the approximate one.

    A row is dropped without a satellite's position, below the lowest elevation as the rover sees it, or with a C/N0
    below the least at the rover. A NaN phase stays NaN.
    """
    n = pairs.group.size
    rover_rows, base_rows = rover.observations, base.observations
    rover_latitude, rover_longitude, rover_height_m = geodetic(rover.ecef_m)
    base_latitude, base_longitude, base_height_m = geodetic(base.ecef_m)
    up, base_up = np.empty(3), np.empty(3)
    rotation = enu_from_ecef_rotation(rover_latitude, rover_longitude)
    up[:] = rotation[2]
    base_up[:] = enu_from_ecef_rotation(base_latitude, base_longitude)[2]
    baseline_m = 0.0
    for k in range(3):
        baseline_m += (rover.ecef_m[k] - base.ecef_m[k]) ** 2
    baseline_m = np.sqrt(baseline_m)
    ionosphere_m = noise.ionosphere * baseline_m
    atmosphere_m2 = np.zeros((3, 3))
    for axis, share in enumerate((noise.horizontal, noise.horizontal, noise.vertical)):
        along_axis_m2 = (share * baseline_m) ** 2
        for i in range(3):
            for j in range(3):
                atmosphere_m2[i, j] += along_axis_m2 * (rotation[axis, i] * rotation[axis, j])
    m = rover.states.clock_s.size
    direction, base_direction = np.empty((m, 3)), np.empty((m, 3))
    sine, base_sine, model_m = np.empty(m), np.empty(m), np.empty(m)
    for k in range(m):
        # A NaN position gives NaN throughout.
        rover_range_m = range_to(rover.states.position_m[k], rover.ecef_m, direction[k])
        base_range_m = range_to(base.states.position_m[k], base.ecef_m, base_direction[k])
        sine[k], base_sine[k] = inner(direction[k], up), inner(base_direction[k], base_up)
        clocks_m = SPEED_OF_LIGHT_M_S * (rover.states.clock_s[k] - base.states.clock_s[k])
        model_m[k] = rover_range_m - base_range_m - clocks_m
    lowest_sine = np.sin(masks.lowest_elevation_rad)
    rover_air = troposphere_at(rover_latitude, rover_height_m)
    base_air = troposphere_at(base_latitude, base_height_m)
    for k in range(m):
        above = sine[k] >= lowest_sine and base_sine[k] > 0.0
        if not (above and rover_air.known and base_air.known):
            model_m[k] = np.nan
            continue
        model_m[k] += slant_troposphere_m(rover_air, sine[k]) - slant_troposphere_m(base_air, base_sine[k])
    keep = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        weak = rover_rows.cn0_dbhz[pairs.rover[i]] < masks.least_cn0_dbhz
        if pairs.place[i] >= 0 and not np.isnan(model_m[pairs.place[i]]) and not weak:
            keep[count] = i
            count += 1
    rows = SingleDifferences(
        rover=np.empty(count, np.int64),
        base=np.empty(count, np.int64),
        satellite=np.empty(count, np.int64),
        group=np.empty(count, np.int64),
        wavelength_m=np.empty(count),
        direction=np.empty((count, 3)),
        code_m=np.empty(count),
        phase_m=np.empty(count),
        code_variance_m2=np.empty(count),
        phase_variance_m2=np.empty(count),
        elevation_rad=np.empty(count),
        cn0_dbhz=np.empty(count),
        atmosphere_m2=atmosphere_m2,
    )
    age_s = abs((rover_rows.time_ns - base_rows.time_ns) * 1e-9)
    for a in range(count):
        i = keep[a]
        r, b, k, group = pairs.rover[i], pairs.base[i], pairs.place[i], pairs.group[i]
        wavelength = WAVELENGTH_M[group]
        rows.rover[a], rows.base[a] = r, b
        rows.satellite[a], rows.group[a], rows.wavelength_m[a] = rover_rows.satellite[r], group, wavelength
        rows.code_m[a] = rover_rows.pseudorange_m[r] - base_rows.pseudorange_m[b] - model_m[k]
        cycles = rover_rows.carrier_phase_cycles[r] - base_rows.carrier_phase_cycles[b]
        integers = has_integers(group)
        rows.phase_m[a] = cycles * wavelength - model_m[k] if integers else np.nan
        code_factor = 1.0 if integers else noise.glonass_code
        for axis in range(3):
            rows.direction[a, axis] = -direction[k, axis]
        scatter = (ionosphere_m * (wavelength / L1_M) ** 2) ** 2 / sine[k] ** 2
        scatter += (SPEED_OF_LIGHT_M_S * noise.satellite_clock * age_s) ** 2
        rows.code_variance_m2[a] = scatter + (0.0 if integers else noise.glonass_channel_m**2)
        rows.phase_variance_m2[a] = scatter
        for level in (rover_rows.cn0_dbhz[r], base_rows.cn0_dbhz[b]):
            rows.code_variance_m2[a] += variance_m2(
                code_factor * noise.code_background_m, code_factor * noise.code_noise_m, sine[k], level
            )
            rows.phase_variance_m2[a] += variance_m2(
                noise.phase_background_m, noise.phase_noise_m, sine[k], level
            )
        rows.elevation_rad[a] = np.arcsin(sine[k])
        rows.cn0_dbhz[a] = rover_rows.cn0_dbhz[r]
    return rows
