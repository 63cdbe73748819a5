"""Position of one receiver from one epoch of code, with what it was made of and what contradicted.

Sources: IS-GPS-200N, 20.3.3.3.3.2 (group delays), 20.3.3.5.2.5 (ionosphere); P. Misra, P. Enge, "Global positioning
system: signals, measurements and performance", 6 (linearised equations); RTCA DO-229, appendix J (weights by the sum of
the variances of what is not modelled).

Model of a pseudorange on the carrier f of a satellite of group g:

    P = ρ + c (δt_g − δt_s + τ_f) + T + (f₁/f)² (I + m(el) (I₀ + ψ (g_e sin az + g_n cos az))) + ε

with a clock per group (GPS with QZSS, Galileo, BeiDou), T and I from models; I₀ and its gradients g by the angle ψ at
the earth's centre are what the model misses of the vertical ionosphere on L1, unknowns of mean zero: errors of the
ionosphere are common to all satellites (south of Japan the equator's crest makes the model metres too small), and a sum
that takes them for independent is too sure of itself and blind to small faults. The variance of ε is

    (noise 10^((45 − C/N0) / 20))² + (background² + troposphere²) / sin² el + satellite² + (rest I)².
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import (
    CARRIER_OF_BAND_HZ,
    SPEED_OF_LIGHT_M_S,
    Floats,
    Integers,
    ObservationEpoch,
    satellite_name,
)
from camber.geodesy.gps_time import NS_PER_SECOND, NS_PER_WEEK
from camber.gnss.observations.atmosphere import (
    IONOSPHERE_CARRIER_HZ,
    has_ionosphere,
    klobuchar_m,
    slant_troposphere_m,
    troposphere_at,
)
from camber.gnss.observations.ephemeris_store import EphemerisStore
from camber.gnss.observations.satellite_states import (
    MOST_BANDS,
    EphemerisTable,
    SatelliteStates,
    enu_from_ecef_rotation,
    geodetic,
    range_to,
    states_at_transmission,
)
from camber.gnss.position.robust_least_squares import (
    DEGENERATE,
    INCONSISTENT,
    OK,
    TOO_FEW,
    Booleans,
    Fit,
    consistent_fit,
    dilutions,
)

Status = Literal["ok", "too_few", "degenerate", "inconsistent", "no_convergence"]
"""`inconsistent`: what was measured contradicts itself and no part of it is left that does not and can be tested."""
CLOCK_GROUPS = "GEC"
"""A receiver clock for each; QZSS goes with GPS."""

_NO_CONVERGENCE = 4
_STATUS: dict[int, Status] = {
    OK: "ok",
    TOO_FEW: "too_few",
    DEGENERATE: "degenerate",
    INCONSISTENT: "inconsistent",
    _NO_CONVERGENCE: "no_convergence",
}
_BAND_RANK = {"G": "125", "J": "125", "E": "17586", "C": "216758"}  # the least ionosphere first
_UNKNOWNS = 9  # x, y, z, three clocks, the vertical ionosphere and its gradients to the east and north
_SHELL_RATIO = 6371.0 / (6371.0 + 350.0)
_COARSE_STEPS, _FINE_STEPS = 15, 10
_COARSE_M = 1000.0
_NO_START_M = 1.0e5
# Within so much of the solution a linear step misses it by 10² / 4e7 m: nothing.
_FINE_M = 10.0
_LOWEST_RADIUS_M, _GREATEST_RADIUS_M = 6.3e6, 6.5e6


class SinglePointOptions(NamedTuple):
    """Masks, test and standard deviations of the module's error model."""

    lowest_elevation_rad: float = math.radians(10.0)
    false_alarm: float = 1.0e-4
    noise_m: float = 0.3
    background_m: float = 0.3
    troposphere_m: float = 0.1
    satellite_m: float = 0.8
    ionosphere_share: float = 0.5
    """Of the vertical delay of the model, what it misses (IS-GPS-200N: half of it at most, r.m.s.)."""
    least_ionosphere_m: float = 0.5
    ionosphere_scale_rad: float = math.radians(10.0)
    """Over which a gradient changes the vertical delay by as much as the model misses."""
    unknown_ionosphere_m: float = 7.0
    """In place of both where the coefficients of the model are not known."""
    ionosphere_rest: float = 0.1
    """Of the slant delay of the model, what differs from satellite to satellite."""


def _carriers() -> Floats:
    table = np.full((128, MOST_BANDS), np.nan)
    for letter, bands in CARRIER_OF_BAND_HZ.items():
        for band, carrier in bands.items():
            table[ord(letter), int(band)] = carrier
    return table


def _ranks() -> Integers:
    table = np.full((128, MOST_BANDS), -1, np.int64)
    for letter, bands in _BAND_RANK.items():
        for rank, band in enumerate(bands):
            table[ord(letter), int(band)] = rank
    return table


def _groups() -> Integers:
    table = np.full(128, -1, np.int64)
    for group, letters in enumerate(("GJ", "E", "C")):
        for letter in letters:
            table[ord(letter)] = group
    return table


CARRIER_HZ = _carriers()
"""By system letter and band (128, 10); NaN for a band that the system has not got."""
_RANK = _ranks()
_GROUP = _groups()
NO_IONOSPHERE: Floats = np.zeros(0)


class Codes(NamedTuple):
    """Each satellite of an epoch once (m,): `row` of its code in the epoch; `place` (n,) by row of the epoch, or −1."""

    row: Integers
    place: Integers


@dataclass(frozen=True, slots=True, eq=False)
class SinglePoint:
    """Of one epoch; columns (m,) by satellite, each satellite once, in the order of the epoch.

    `position_ecef_m` (3,), `covariance_ecef_m2`, `covariance_enu_m2` (3, 3), `clock_m` (3,) by `CLOCK_GROUPS` (receiver
    clock minus system time, times c) are NaN unless the status is `ok`, a clock also where its group was not used;
    `approximate_ecef_m` is where the iteration came to, consistent or not: only to linearise at. `used` went into the
    position, `excluded` contradicted the others; neither: no ephemeris, no code, too low. `degrees` 0: ok, but
    untested. Directions, elevation, azimuth, residuals are NaN where they are not known.
    """

    time_ns: int
    status: Status
    position_ecef_m: Floats
    covariance_ecef_m2: Floats
    covariance_enu_m2: Floats
    approximate_ecef_m: Floats
    clock_m: Floats
    chi_squared: float
    degrees: int
    gdop: float
    hdop: float
    vdop: float
    satellite: Integers
    codes: Codes
    states: SatelliteStates
    used: Booleans
    excluded: Booleans
    residual_m: Floats
    sigma_m: Floats
    direction: Floats
    elevation_rad: Floats
    azimuth_rad: Floats

    @property
    def excluded_names(self) -> list[str]:
        """The satellites that contradicted the others, `["G05"]`."""
        return [satellite_name(s) for s in self.satellite[self.excluded].tolist()]


def single_point(
    epoch: ObservationEpoch,
    ephemerides: EphemerisStore,
    options: SinglePointOptions = SinglePointOptions(),  # noqa: B008 (immutable)
    ionosphere: Floats = NO_IONOSPHERE,
    start_ecef_m: Floats | None = None,
) -> SinglePoint:
    """Position of an epoch; `ionosphere` (8,) as in `klobuchar_m`, a start (3,) where one is known to some km.

    Never raises for what an epoch holds: no satellites, many, the same twice, NaN.
    """
    codes = codes_of(epoch.satellite, epoch.signal, epoch.pseudorange_m, epoch.cn0_dbhz)
    satellite = epoch.satellite[codes.row]
    rows = ephemerides.rows_at(epoch.time_ns, satellite)
    table = ephemerides.table
    pseudorange_m = epoch.pseudorange_m[codes.row]
    states = states_at_transmission(table, rows, epoch.time_ns, pseudorange_m)
    solved = _position(
        table,
        rows,
        states,
        satellite,
        epoch.signal[codes.row],
        pseudorange_m,
        epoch.cn0_dbhz[codes.row],
        np.zeros(3) if start_ecef_m is None else start_ecef_m,
        ionosphere,
        epoch.time_ns % NS_PER_WEEK / NS_PER_SECOND,
        options,
    )
    status, position, covariance, covariance_enu, approximate, clock, numbers, degrees, used, excluded = (
        solved[:10]
    )
    chi_squared, gdop, hdop, vdop = numbers.tolist()
    residual, sigma, direction, elevation, azimuth = solved[10:]
    return SinglePoint(
        epoch.time_ns, _STATUS[status], position, covariance, covariance_enu, approximate, clock, chi_squared, degrees,
        gdop, hdop, vdop, satellite, codes, states, used, excluded, residual, sigma, direction, elevation, azimuth,
    )  # fmt: skip


@compiled
def codes_of(satellite: Integers, signal: Integers, pseudorange_m: Floats, cn0_dbhz: Floats) -> Codes:
    """For each satellite of an epoch (n,) the code of the band with the least ionosphere, of its best C/N0."""
    n = satellite.size
    row, place = np.empty(n, np.int64), np.full(n, -1, np.int64)
    rank, level = np.empty(n, np.int64), np.empty(n)
    count = 0
    for i in range(n):
        s, band = satellite[i], (signal[i] >> 8) - 48
        if not (0 <= s < 128 << 8 and 0 <= band < MOST_BANDS):
            continue
        of_band = _RANK[s >> 8, band]
        if of_band < 0:
            continue
        at = count
        for k in range(count):
            if satellite[row[k]] == s:
                at = k
                break
        place[i] = at
        if not abs(pseudorange_m[i]) < SPEED_OF_LIGHT_M_S:
            of_band = 99
        of_level = cn0_dbhz[i] if cn0_dbhz[i] == cn0_dbhz[i] else -1.0
        if at == count:
            count += 1
        elif of_band > rank[at] or (of_band == rank[at] and of_level <= level[at]):
            continue
        row[at], rank[at], level[at] = i, of_band, of_level
    return Codes(row[:count].copy(), place)


@compiled
def _position(
    table: EphemerisTable,
    rows: Integers,
    states: SatelliteStates,
    satellite: Integers,
    signal: Integers,
    pseudorange_m: Floats,
    cn0_dbhz: Floats,
    start_ecef_m: Floats,
    ionosphere: Floats,
    of_week_s: float,
    options: SinglePointOptions,
) -> tuple[
    int, Floats, Floats, Floats, Floats, Floats, Floats, int, Booleans, Booleans,
    Floats, Floats, Floats, Floats, Floats,
]:  # fmt: skip
    m = rows.size
    measured, stretch = np.full(m, np.nan), np.full(m, np.nan)
    group, possible = np.empty(m, np.int64), np.zeros(m, np.bool_)
    for k in range(m):
        letter, band = satellite[k] >> 8, (signal[k] >> 8) - 48
        group[k] = _GROUP[letter]
        stretch[k] = (IONOSPHERE_CARRIER_HZ / CARRIER_HZ[letter, band]) ** 2
        if rows[k] >= 0:
            delay_s = table.group_delay_s[rows[k], band]
            measured[k] = pseudorange_m[k] + SPEED_OF_LIGHT_M_S * (states.clock_s[k] - delay_s)
        possible[k] = abs(measured[k] * stretch[k]) < np.inf
    at = start_ecef_m.copy()
    status, design = OK, np.zeros((m, _UNKNOWNS))
    sigma, free = np.ones(m), np.full(_UNKNOWNS, np.inf)
    direction, observed = np.full((m, 3), np.nan), np.full(m, np.nan)
    elevation, azimuth = np.full(m, np.nan), np.full(m, np.nan)
    started = _is_near_the_ground(at)
    if not started:
        at[:] = 0.0
        status = _coarse(states, group, possible, measured, at, design)
    candidate = np.zeros(m, np.bool_)
    fit = Fit(OK, np.full(_UNKNOWNS, np.nan), np.zeros((0, 0)), np.full(m, np.nan), candidate, np.nan, 0)
    converged = False
    for _ in range(_FINE_STEPS):
        if status != OK:
            break
        _linearise(
            states, group, possible, measured, stretch, cn0_dbhz, ionosphere, of_week_s, options, at,
            design, observed, sigma, free, candidate, direction, elevation, azimuth,
        )  # fmt: skip
        fit = consistent_fit(design, observed, sigma, free, candidate, options.false_alarm)
        step = math.sqrt(fit.value[0] ** 2 + fit.value[1] ** 2 + fit.value[2] ** 2)
        if started and not step < _NO_START_M:
            # A start so far off is none: with it satellites were looked for below the horizon.
            started = False
            at[:] = 0.0
            status = _coarse(states, group, possible, measured, at, design)
            continue
        if fit.status != OK and fit.status != INCONSISTENT:
            status = fit.status
            break
        if not step < np.inf:
            status = DEGENERATE
            break
        for k in range(3):
            at[k] += fit.value[k]
        if not _is_near_the_ground(at):
            status = _NO_CONVERGENCE
        elif step < _FINE_M:
            converged = True
            status = fit.status
            break
    if status == OK and not converged:
        status = _NO_CONVERGENCE
    position, covariance, turned = np.full(3, np.nan), np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    approximate, clock = np.full(3, np.nan), np.full(3, np.nan)
    numbers = np.full(4, np.nan)
    excluded = candidate & ~fit.used
    used = fit.used
    if converged:
        approximate[:] = at
        numbers[0] = fit.chi_squared
    if status == OK:
        latitude, longitude, _ = geodetic(at)
        rotation = enu_from_ecef_rotation(latitude, longitude)
        position[:], clock[:] = at, fit.value[3:6]
        covariance[:, :] = fit.covariance[:3, :3]
        turned[:, :] = turned_covariance(rotation, covariance)
        numbers[1], numbers[2], numbers[3] = dilutions(design[:, :6], used, rotation)
    elif status != INCONSISTENT:
        used = np.zeros(m, np.bool_)
        excluded = np.zeros(m, np.bool_)
    return (
        status, position, covariance, turned, approximate, clock, numbers, fit.degrees, used, excluded,
        fit.residual, sigma, direction, elevation, azimuth,
    )  # fmt: skip


@compiled
def turned_covariance(rotation: Floats, covariance: Floats) -> Floats:
    """R C Rᵀ of (3, 3) matrices."""
    out = np.zeros((3, 3))
    for a in range(3):
        for b in range(3):
            for i in range(3):
                for j in range(3):
                    out[a, b] += rotation[a, i] * covariance[i, j] * rotation[b, j]
    return out


@compiled
def _is_near_the_ground(ecef_m: Floats) -> bool:
    radius = math.sqrt(ecef_m[0] ** 2 + ecef_m[1] ** 2 + ecef_m[2] ** 2)
    return _LOWEST_RADIUS_M < radius < _GREATEST_RADIUS_M


@compiled
def _coarse(
    states: SatelliteStates, group: Integers, possible: Booleans, measured: Floats, at: Floats, design: Floats
) -> int:
    """From anywhere to some km of the solution, all satellites alike and no atmosphere; `at` is moved there."""
    m = possible.size
    direction, observed, ones = np.empty(3), np.zeros(m), np.ones(m)
    free = np.full(6, np.inf)
    for _ in range(_COARSE_STEPS):
        for k in range(m):
            design[k, :] = 0.0
            if possible[k]:
                observed[k] = measured[k] - range_to(states.position_m[k], at, direction)
                for axis in range(3):
                    design[k, axis] = -direction[axis]
                design[k, 3 + group[k]] = 1.0
        # A test that is never failed: one wrong satellite moves this by km, and the fine steps look at that.
        fit = consistent_fit(design[:, :6], observed, ones, free, possible, 0.0)
        if fit.status != OK:
            return fit.status
        step = 0.0
        for axis in range(3):
            at[axis] += fit.value[axis]
            step += fit.value[axis] ** 2
        if not step < 1e18:
            return DEGENERATE
        if step < _COARSE_M * _COARSE_M:
            return OK
    return _NO_CONVERGENCE


@compiled
def _linearise(
    states: SatelliteStates,
    group: Integers,
    possible: Booleans,
    measured: Floats,
    stretch: Floats,
    cn0_dbhz: Floats,
    ionosphere: Floats,
    of_week_s: float,
    options: SinglePointOptions,
    at: Floats,
    design: Floats,
    observed: Floats,
    sigma: Floats,
    prior_sigma: Floats,
    candidate: Booleans,
    direction: Floats,
    elevation: Floats,
    azimuth: Floats,
) -> None:
    """Writes the rows of the fit about a place `at`, from `design` on."""
    latitude, longitude, height = geodetic(at)
    rotation = enu_from_ecef_rotation(latitude, longitude)
    air = troposphere_at(latitude, height)
    known = has_ionosphere(ionosphere)
    vertical_m = klobuchar_m(ionosphere, of_week_s, latitude, longitude, 0.5 * np.pi, 0.0)
    missed_m = options.unknown_ionosphere_m
    if known:
        missed_m = max(options.ionosphere_share * vertical_m, options.least_ionosphere_m)
    prior_sigma[6] = missed_m
    prior_sigma[7] = missed_m / options.ionosphere_scale_rad
    prior_sigma[8] = prior_sigma[7]
    for k in range(possible.size):
        design[k, :] = 0.0
        candidate[k] = False
        if not possible[k]:
            continue
        distance = range_to(states.position_m[k], at, direction[k])
        x, y, z = direction[k, 0], direction[k, 1], direction[k, 2]
        east = rotation[0, 0] * x + rotation[0, 1] * y
        north = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
        sine = min(rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z, 1.0)
        elevation[k] = math.asin(max(sine, -1.0))
        azimuth[k] = math.atan2(east, north)
        if not elevation[k] >= options.lowest_elevation_rad:
            continue
        candidate[k] = True
        modelled_m = klobuchar_m(ionosphere, of_week_s, latitude, longitude, elevation[k], azimuth[k])
        observed[k] = measured[k] - distance - slant_troposphere_m(air, sine) - stretch[k] * modelled_m
        for axis in range(3):
            design[k, axis] = -direction[k, axis]
        design[k, 3 + group[k]] = 1.0
        cosine = _SHELL_RATIO * math.cos(elevation[k])
        mapping = stretch[k] / math.sqrt(1.0 - cosine * cosine)
        away_rad = math.acos(cosine) - elevation[k]
        design[k, 6] = mapping
        design[k, 7] = mapping * away_rad * math.sin(azimuth[k])
        design[k, 8] = mapping * away_rad * math.cos(azimuth[k])
        level = cn0_dbhz[k] if abs(cn0_dbhz[k]) < 100.0 else 40.0
        noise = options.noise_m * 10.0 ** ((45.0 - level) / 20.0)
        low = (options.background_m**2 + options.troposphere_m**2) / (sine * sine)
        rest = options.ionosphere_rest * stretch[k] * modelled_m
        sigma[k] = math.sqrt(noise * noise + low + options.satellite_m**2 + rest * rest)
