"""Single-point position of one receiver from one epoch of code, with exclusion of outliers.

Sources: IS-GPS-200N, 20.3.3.3.3.2 (group delays), 20.3.3.5.2.5 (ionosphere); P. Misra, P. Enge, "Global positioning
system: signals, measurements and performance", 6 (linearised equations); RTCA DO-229, appendix J (weights by the sum of
the variances of what is not modelled).

Model of a pseudorange on the carrier f of a satellite of group g:

    P = ρ + c (δt_g − δt_s + τ_f) + T + (f₁/f)² (I + m(el) (I₀ + ψ (g_e sin az + g_n cos az))) + ε

with a clock per group (GPS with QZSS, Galileo, BeiDou, GLONASS), T and I from models. I₀ and its gradients g by the
angle ψ at the earth's centre are the error of the model's vertical ionosphere on L1, unknowns of mean zero: this error
is common to all satellites (south of Japan the equatorial crest makes the model metres too small), and treating it as
independent would be overconfident and hide small faults. The variance of ε is

    (noise 10^((45 − C/N0) / 20))² + (background² + troposphere²) / sin² el + satellite² + (rest I)².
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from camber.compiled.decorator import compiled
from camber.formats.observations import SPEED_OF_LIGHT_M_S, Floats, Integers, ObservationEpoch
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
    SatelliteStates,
    enu_from_ecef_rotation,
    geodetic,
    range_to,
    states_at_transmission,
)
from camber.gnss.observations.signal_pairs import (
    CARRIER_HZ,
    MOST_BANDS,
    SYSTEM_INDEX,
    SYSTEMS,
    Booleans,
)
from camber.gnss.position.robust_least_squares import (
    DEGENERATE,
    INCONSISTENT,
    OK,
    LinearModel,
    RobustFit,
    consistent_fit,
    empty_fit,
    empty_model,
)

Status = Literal["ok", "too_few", "degenerate", "inconsistent", "no_convergence"]
"""`inconsistent`: the measurements contradict one another and no consistent, testable subset is left."""
_STATUS: tuple[Status, ...] = ("ok", "too_few", "degenerate", "inconsistent", "no_convergence")
_NO_CONVERGENCE = 4  # a status after those of `robust_least_squares`
_BAND_RANK = {"G": "125", "J": "125", "E": "17586", "C": "216758", "R": "12"}  # the least ionosphere first
_CLOCKS = len(SYSTEMS)
_UNKNOWNS = (
    3 + _CLOCKS + 3
)  # x, y, z, clocks, the vertical ionosphere and its gradients to the east and north
_IONOSPHERE = 3 + _CLOCKS  # the first of these three
# Thin shell of the ionosphere at 350 km (IS-GPS-200N, 20.3.3.5.2.5).
_SHELL_RATIO = 6371.0 / (6371.0 + 350.0)
_COARSE_STEPS, _FINE_STEPS = 15, 10  # chosen: from the earth's centre six steps converge
_COARSE_M = 1000.0  # chosen: the fine steps converge from a kilometre
_FINE_M = 10.0  # derived: within it a linear step errs by 10² / 4e7 m
_LOWEST_RADIUS_M, _GREATEST_RADIUS_M = 6.3e6, 6.5e6  # below the poles, above any road

# Chosen: mask, false-alarm rate of the test and standard deviations of the error model above.
LOWEST_ELEVATION_RAD = math.radians(10.0)
_FALSE_ALARM = 1.0e-4  # chosen: one epoch in 10,000
_NOISE_M, _BACKGROUND_M, _TROPOSPHERE_M, _SATELLITE_M = 0.3, 0.3, 0.1, 0.8
_GLONASS_SATELLITE_M = 2.5
"""Chosen: 1.9 m of orbits and clocks (O. Montenbruck et al., "Broadcast versus precise ephemerides", GPS Solutions 19,
2015), and delays of the receiver that differ from channel to channel."""
_GLONASS = SYSTEMS.index("R")
_IONOSPHERE_SHARE, _LEAST_IONOSPHERE_M = 0.5, 0.5
"""Error of the model's vertical delay, a share of it (IS-GPS-200N: half of it at most, r.m.s.), and its least."""
_UNKNOWN_IONOSPHERE_M = 7.0  # chosen: replaces both where the coefficients of the model are not known
_IONOSPHERE_SCALE_RAD = math.radians(10.0)
"""Chosen: angle over which a gradient changes the vertical delay by the model's error."""
_IONOSPHERE_REST = 0.1  # chosen: share of the model's slant delay that differs from satellite to satellite


def _ranks() -> Integers:
    table = np.full((128, MOST_BANDS), -1, np.int64)
    for letter, bands in _BAND_RANK.items():
        table[ord(letter), [int(band) for band in bands]] = range(len(bands))
    return table


_RANK = _ranks()
NO_IONOSPHERE: Floats = np.zeros(0)


class Codes(NamedTuple):
    """Each satellite of an epoch once (m,): `row` of its code in the epoch; `place` (n,) by row of the epoch, or −1."""

    row: Integers
    place: Integers


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SinglePoint:
    """Single-point solution of one epoch; columns (m,) by satellite, each satellite once, in the order of the epoch.

    `position_ecef_m` (3,), `covariance_ecef_m2` (3, 3), `clock_m` (4,) by `SYSTEMS` (receiver clock minus system time,
    times c) are NaN unless the status is `ok`, a clock also where its group was not used. `approximate_ecef_m` is the
    last iterate, consistent or not, for linearisation only. `used` went into the position, `excluded` are outliers;
    neither: no ephemeris, no code, too low. `degrees` 0: ok, but untested. An elevation is NaN where it is not known.
    """

    time_ns: int
    status: Status
    position_ecef_m: Floats
    covariance_ecef_m2: Floats
    approximate_ecef_m: Floats
    clock_m: Floats
    chi_squared: float
    degrees: int
    satellite: Integers
    codes: Codes
    states: SatelliteStates
    used: Booleans
    excluded: Booleans
    elevation_rad: Floats


def single_point(
    epoch: ObservationEpoch, ephemerides: EphemerisStore, ionosphere: Floats = NO_IONOSPHERE
) -> SinglePoint:
    """Position of an epoch; `ionosphere` (8,) as in `klobuchar_m`.

    Never raises for what an epoch holds: no satellites, many, the same twice, NaN.
    """
    codes = codes_of(epoch.satellite, epoch.signal, epoch.pseudorange_m, epoch.cn0_dbhz)
    satellite, table = epoch.satellite[codes.row], ephemerides.table
    ephemeris = ephemerides.rows_at(epoch.time_ns, satellite)
    states = states_at_transmission(table, ephemeris, epoch.time_ns, epoch.pseudorange_m[codes.row])
    status, converged, at, fit, excluded, elevation_rad = _position(
        satellite,
        epoch.signal[codes.row],
        epoch.pseudorange_m[codes.row],
        epoch.cn0_dbhz[codes.row],
        position_m=states.position_m,
        clock_s=states.clock_s,
        ephemeris=ephemeris,
        group_delay_s=table.group_delay_s,
        ionosphere=ionosphere,
        of_week_s=epoch.time_ns % NS_PER_WEEK / NS_PER_SECOND,
    )
    ok = status == OK
    return SinglePoint(
        time_ns=epoch.time_ns,
        status=_STATUS[status],
        position_ecef_m=at if ok else np.full(3, np.nan),
        covariance_ecef_m2=fit.covariance[:3, :3].copy() if ok else np.full((3, 3), np.nan),
        approximate_ecef_m=at if converged else np.full(3, np.nan),
        clock_m=fit.value[3:_IONOSPHERE] if ok else np.full(_CLOCKS, np.nan),
        chi_squared=fit.chi_squared if converged else np.nan,
        degrees=fit.degrees,
        satellite=satellite,
        codes=codes,
        states=states,
        used=fit.used,
        excluded=excluded,
        elevation_rad=elevation_rad,
    )


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


class _Rows(NamedTuple):
    """Columns (m,) of the linearised model by satellite; the last three are written for each linearisation.

    `range_m`: code with satellite clock and group delay applied. `dispersion`: (f₁/f)². `measurable`: both are known.
    """

    position_m: Floats
    cn0_dbhz: Floats
    group: Integers
    range_m: Floats
    dispersion: Floats
    measurable: Booleans
    model: LinearModel
    candidate: Booleans
    elevation_rad: Floats


@compiled
def _position(
    satellite: Integers,
    signal: Integers,
    pseudorange_m: Floats,
    cn0_dbhz: Floats,
    position_m: Floats,
    clock_s: Floats,
    ephemeris: Integers,
    group_delay_s: Floats,
    ionosphere: Floats,
    of_week_s: float,
) -> tuple[int, bool, Floats, RobustFit, Booleans, Floats]:
    """`_iterate` with one code of each satellite (m,), with the excluded satellites (m,) and the elevations (m,).

    `ephemeris` (m,) is a satellite's row of the group delays, or −1. Unless the fit was tested, none is used or
    excluded. The columns cross to compiled code faster one by one than as tuples.
    """
    m = satellite.size
    measured, dispersion = np.full(m, np.nan), np.full(m, np.nan)
    group, measurable = np.empty(m, np.int64), np.zeros(m, np.bool_)
    for k in range(m):
        letter, band = satellite[k] >> 8, (signal[k] >> 8) - 48
        group[k] = SYSTEM_INDEX[letter]
        dispersion[k] = (IONOSPHERE_CARRIER_HZ / CARRIER_HZ[letter, band]) ** 2
        if ephemeris[k] >= 0:
            satellite_clock_s = clock_s[k] - group_delay_s[ephemeris[k], band]
            measured[k] = pseudorange_m[k] + SPEED_OF_LIGHT_M_S * satellite_clock_s
        measurable[k] = abs(measured[k] * dispersion[k]) < np.inf
    rows = _Rows(
        position_m=position_m,
        cn0_dbhz=cn0_dbhz,
        group=group,
        range_m=measured,
        dispersion=dispersion,
        measurable=measurable,
        model=empty_model(m, _UNKNOWNS),
        candidate=np.zeros(m, np.bool_),
        elevation_rad=np.full(m, np.nan),
    )
    status, converged, at, fit = _iterate(rows, ionosphere, of_week_s)
    excluded, tested = rows.candidate, status in (OK, INCONSISTENT)
    for k in range(m):
        fit.used[k] &= tested
        excluded[k] &= tested and not fit.used[k]
    return status, converged, at, fit, excluded, rows.elevation_rad


@compiled
def _iterate(rows: _Rows, ionosphere: Floats, of_week_s: float) -> tuple[int, bool, Floats, RobustFit]:
    """Coarse position, then Gauss-Newton steps with outlier exclusion.

    Returns status, whether the steps converged, the position (3,) and the last fit.
    """
    at = np.zeros(3)
    status = _coarse_position(rows, at)
    fit = empty_fit(OK, rows.measurable.size, _UNKNOWNS)
    converged = False
    for _ in range(_FINE_STEPS):
        if status != OK:
            break
        _linearise(rows, at, ionosphere, of_week_s)
        fit = consistent_fit(rows.model, rows.candidate, _FALSE_ALARM)
        step = math.sqrt(fit.value[0] ** 2 + fit.value[1] ** 2 + fit.value[2] ** 2)
        if fit.status != OK and fit.status != INCONSISTENT:
            status = fit.status
            break
        if not step < np.inf:
            status = DEGENERATE
            break
        at += fit.value[:3]
        radius = math.sqrt(at[0] ** 2 + at[1] ** 2 + at[2] ** 2)
        if not _LOWEST_RADIUS_M < radius < _GREATEST_RADIUS_M:
            status = _NO_CONVERGENCE
        elif step < _FINE_M:
            converged = True
            status = fit.status
            break
    if status == OK and not converged:
        status = _NO_CONVERGENCE
    return status, converged, at, fit


@compiled
def _coarse_position(rows: _Rows, at: Floats) -> int:
    """From the earth's centre to some km of the solution with equal weights and no atmosphere; `at` is moved there."""
    m, direction = rows.measurable.size, np.empty(3)
    model = empty_model(m, _IONOSPHERE)
    for _ in range(_COARSE_STEPS):
        for k in range(m):
            if rows.measurable[k]:
                model.observed[k] = rows.range_m[k] - range_to(rows.position_m[k], at, direction)
                model.design[k, :3] = -direction
                model.design[k, 3 + rows.group[k]] = 1.0
        # A false-alarm rate of zero excludes nothing: one outlier moves this by km, which the fine steps handle.
        fit = consistent_fit(model, rows.measurable, 0.0)
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
def _linearise(rows: _Rows, at: Floats, ionosphere: Floats, of_week_s: float) -> None:
    """Write the model's rows about a position `at`, and which are candidates."""
    design, prior_sigma, direction = rows.model.design, rows.model.prior_sigma, np.empty(3)
    latitude, longitude, height = geodetic(at)
    rotation = enu_from_ecef_rotation(latitude, longitude)
    air = troposphere_at(latitude, height)
    vertical_m = klobuchar_m(
        ionosphere, of_week_s, latitude, longitude, elevation_rad=0.5 * np.pi, azimuth_rad=0.0
    )
    missed_m = _UNKNOWN_IONOSPHERE_M
    if has_ionosphere(ionosphere):
        missed_m = max(_IONOSPHERE_SHARE * vertical_m, _LEAST_IONOSPHERE_M)
    prior_sigma[_IONOSPHERE] = missed_m
    prior_sigma[_IONOSPHERE + 1] = prior_sigma[_IONOSPHERE + 2] = missed_m / _IONOSPHERE_SCALE_RAD
    for k in range(rows.measurable.size):
        design[k, :] = 0.0
        rows.candidate[k] = False
        if not rows.measurable[k]:
            continue
        distance = range_to(rows.position_m[k], at, direction)
        x, y, z = direction[0], direction[1], direction[2]
        east = rotation[0, 0] * x + rotation[0, 1] * y
        north = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
        sine = min(rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z, 1.0)
        elevation, azimuth = math.asin(max(sine, -1.0)), math.atan2(east, north)
        rows.elevation_rad[k] = elevation
        if not elevation >= LOWEST_ELEVATION_RAD:
            continue
        rows.candidate[k] = True
        dispersion = rows.dispersion[k]
        modelled_m = klobuchar_m(
            ionosphere, of_week_s, latitude, longitude, elevation_rad=elevation, azimuth_rad=azimuth
        )
        troposphere_m = slant_troposphere_m(air, sine)
        rows.model.observed[k] = rows.range_m[k] - distance - troposphere_m - dispersion * modelled_m
        design[k, :3] = -direction
        design[k, 3 + rows.group[k]] = 1.0
        cosine = _SHELL_RATIO * math.cos(elevation)
        mapping = dispersion / math.sqrt(1.0 - cosine * cosine)
        earth_angle_rad = math.acos(cosine) - elevation
        design[k, _IONOSPHERE] = mapping
        design[k, _IONOSPHERE + 1] = mapping * earth_angle_rad * math.sin(azimuth)
        design[k, _IONOSPHERE + 2] = mapping * earth_angle_rad * math.cos(azimuth)
        level = rows.cn0_dbhz[k] if abs(rows.cn0_dbhz[k]) < 100.0 else 40.0
        noise = _NOISE_M * 10.0 ** ((45.0 - level) / 20.0)
        low = (_BACKGROUND_M**2 + _TROPOSPHERE_M**2) / (sine * sine)
        rest = _IONOSPHERE_REST * dispersion * modelled_m
        satellite_m = _GLONASS_SATELLITE_M if rows.group[k] == _GLONASS else _SATELLITE_M
        rows.model.sigma[k] = math.sqrt(noise * noise + low + satellite_m**2 + rest * rest)
