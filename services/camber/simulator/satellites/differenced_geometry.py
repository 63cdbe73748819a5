"""What code and phase say of a position when clocks are differenced away, at all epochs at once.

A clock for each system and frequency is eliminated by taking directions and errors about their mean in the group; that
is the same as double differences with their correlations (Teunissen and Montenbruck, Springer Handbook of GNSS, 21.3).
The float ambiguities of a single epoch have Q_a = (Q_φ + G Q_x Gᵀ) / (λ λᵀ), Q_x from code, so that
ln|Q_a| = Σ [(k − 1) ln(σ_φ² / λ²) + ln k] + ln|N_code + N_phase| − ln|N_code| over groups of k satellites, and
ADOP = |Q_a|^(1 / 2n) (Teunissen, "A canonical theory for short GPS baselines", Journal of Geodesy 71 (1997)).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from camber.simulator.satellites.observations import SimulatedSignals
from camber.simulator.satellites.orbits import SPEED_OF_LIGHT_M_S
from camber.simulator.satellites.parameters import SolutionParameters
from camber.simulator.scene import Booleans, Floats, Integers

_FEWEST_IN_GROUP = 2  # one is used up by the clock
_SINGULAR = 1e-6  # chosen: of a determinant in units of squared direction cosines
_MOST_LEFT_OUT = 12  # chosen: then too little is left to trust
_LEAST_REDUNDANCY = 0.02  # chosen: with less nothing checks a signal


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DifferencedGeometry:
    """Of n epochs, m satellites, two frequencies.

    `code_used`, `phase_used` (n, m, 2): in a group with another one. `code_normal`, `phase_normal` (n, 3, 3): Σ (g − ḡ)
    (g − ḡ)ᵀ of unit weights, east, north, up. `code_solution_m`, `phase_solution_m` (n, 3): the position errors that
    the signals' errors make (phase: with the integers nearest to the true position), zero where not solvable.
    `ambiguities` (n,) double differences; `success` (n,) the ADOP's approximation of the probability that rounding
    finds them. `phase_fits` (n,): no phase that is used stands out.
    """

    code_used: Booleans
    phase_used: Booleans
    group: Integers
    wavelength_m: Floats
    code_normal: Floats
    phase_normal: Floats
    code_solution_m: Floats
    phase_solution_m: Floats
    ambiguities: Integers
    success: Floats
    phase_fits: Booleans
    code_satellites: Integers
    phase_satellites: Integers


def differenced_geometry(
    rover: SimulatedSignals, base: SimulatedSignals, parameters: SolutionParameters
) -> DifferencedGeometry:
    """Of what a rover tracks and a base too, with the errors of both.

    The air is taken to be the same for both: over some kilometres it differs by millimetres.
    """
    p = parameters
    high = (rover.geometry.elevation_rad >= float(np.deg2rad(p.elevation_mask_deg)))[..., None]
    high = high & (rover.levels.cn0_dbhz >= p.cn0_mask_dbhz)
    wavelength = SPEED_OF_LIGHT_M_S / rover.carrier_hz
    seen, code_at_base, phase_at_base = _at_base(base, rover)
    code_used = rover.levels.code_tracked & high & seen
    phase_used = rover.levels.phase_tracked & high & ~rover.locks.half_cycle & seen
    code_error = rover.levels.code_error_m - code_at_base
    phase_error = _phase_error_m(rover) - phase_at_base
    # Whole cycles of an error go into the integers, which are what fits best.
    phase_error = phase_error - wavelength * np.rint(phase_error / wavelength)
    group = (rover.satellite >> 8)[:, None] * 2 + np.arange(2)
    group = np.unique(group, return_inverse=True)[1].reshape(group.shape)
    direction, sigmas = rover.geometry.direction, p.sigmas_left_out
    code_used, _ = fitting(direction, code_used, group, error_m=code_error, limit_m=sigmas * p.code_sigma_m)
    phase_used, phase_fits = fitting(
        direction, phase_used & code_used, group, error_m=phase_error, limit_m=sigmas * p.phase_sigma_m
    )
    n_code, x_code = _solved(direction, code_used, group, code_error)
    n_phase, x_phase = _solved(direction, phase_used, group, phase_error)
    count, log_det = _ambiguities(phase_used, group, wavelength, p.phase_sigma_m)
    solvable = (np.linalg.det(n_code) > _SINGULAR) & (count >= 3)
    a = np.where(solvable[:, None, None], n_code / p.code_sigma_m**2, np.eye(3))
    b = np.where(solvable[:, None, None], n_phase / p.phase_sigma_m**2, 0.0)
    log_det = log_det + np.log(np.linalg.det(a + b)) - np.log(np.linalg.det(a))
    adop = np.exp(log_det / (2.0 * np.maximum(count, 1)))
    return DifferencedGeometry(
        code_used=code_used,
        phase_used=phase_used,
        group=group,
        wavelength_m=wavelength,
        code_normal=n_code,
        phase_normal=n_phase,
        code_solution_m=x_code,
        phase_solution_m=x_phase,
        ambiguities=count,
        success=np.where(solvable, _between(0.5 / adop) ** np.maximum(count, 1), 0.0),
        phase_fits=phase_fits,
        code_satellites=np.sum(code_used[..., 0], axis=1),
        phase_satellites=np.sum(phase_used[..., 0], axis=1),
    )


def fitting(
    direction: Floats, used: Booleans, group: Integers, *, error_m: Floats, limit_m: float
) -> tuple[Booleans, Booleans]:
    """Signals (n, m, 2) whose residuals fit the rest, and at which epochs (n,) that was reached.

    The residual that stands out most, against what its redundancy leaves of it, is left out and the rest solved again
    (W. Baarda, "A testing procedure for use in geodetic networks" (1968)), as long as it is beyond the limit.
    """
    used = _grouped(used, group)
    fits = np.ones(len(used), np.bool_)
    if not np.isfinite(limit_m):
        return used, fits
    rows = np.arange(len(used))
    for _ in range(_MOST_LEFT_OUT):
        stands_out = _standing_out(direction[rows], used[rows], group, error_m[rows]).reshape(len(rows), -1)
        worst = np.argmax(stands_out, axis=1)
        beyond = stands_out[np.arange(len(rows)), worst] > limit_m
        rows, worst = rows[beyond], worst[beyond]
        if not len(rows):
            return used, fits
        used.reshape(len(used), -1)[rows, worst] = False
        used[rows] = _grouped(used[rows], group)
    fits[rows] = False
    return used, fits


def _standing_out(direction: Floats, used: Booleans, group: Integers, error_m: Floats) -> Floats:
    """|residual| / √redundancy (n, m, 2), zero where not used or nothing checks it."""
    g = centred(direction, used, group)
    e = centred(np.broadcast_to(error_m[..., None], (*used.shape, 1)), used, group)[..., 0]
    normal, solution = _solved(direction, used, group, error_m)
    residual = e + np.einsum("nmfk,nk->nmf", g, solution)
    solvable = np.linalg.det(normal) > _SINGULAR
    inverse = np.linalg.inv(np.where(solvable[:, None, None], normal, np.eye(3)))
    leverage = np.einsum("nmfi,nij,nmfj->nmf", g, inverse, g)
    redundancy = 1.0 - 1.0 / np.maximum(_number_in_group(used, group), 1.0) - leverage
    checked = used & solvable[:, None, None] & (redundancy > _LEAST_REDUNDANCY)
    return np.where(checked, np.abs(residual) / np.sqrt(np.where(checked, redundancy, 1.0)), 0.0)


def _groups(group: Integers) -> Iterator[tuple[Integers, Integers]]:
    """Row and frequency of the signals of each group."""
    for g in range(int(group.max(initial=-1)) + 1):
        rows, frequency = np.nonzero(group == g)
        yield rows, frequency


def _number_in_group(used: Booleans, group: Integers) -> Integers:
    """How many are used (n, m, 2) in each signal's group."""
    number = np.zeros(used.shape, np.int64)
    for rows, frequency in _groups(group):
        number[:, rows, frequency] = used[:, rows, frequency].sum(axis=1)[:, None]
    return number


def centred(values: Floats, used: Booleans, group: Integers) -> Floats:
    """Values (n, m, k) or (n, m, 2, k) about the mean of those used in their group: (n, m, 2, k), zero elsewhere."""
    out = np.zeros((*used.shape, values.shape[-1]))
    for rows, frequency in _groups(group):
        w = used[:, rows, frequency]
        inside = values[:, rows] if values.ndim == 3 else values[:, rows, frequency]
        total = np.maximum(w.sum(axis=1), 1)
        mean = np.einsum("nm,nmk->nk", w, inside) / total[:, None]
        out[:, rows, frequency] = w[..., None] * (inside - mean[:, None])
    return out


def _solved(direction: Floats, used: Booleans, group: Integers, error_m: Floats) -> tuple[Floats, Floats]:
    """Normal matrices (n, 3, 3) and position errors (n, 3) that errors (n, m, 2) make, zero where not solvable."""
    n = len(used)
    directions = centred(direction, used, group).reshape(n, -1, 3)
    normal = np.einsum("nmi,nmj->nij", directions, directions)
    # A range grows against the direction to the satellite: δx = −N⁻¹ Gᵀ δρ.
    right = -np.einsum("nmi,nm->ni", directions, np.where(used, error_m, 0.0).reshape(n, -1))
    good = np.linalg.det(normal) > _SINGULAR
    solution = np.zeros((n, 3))
    solution[good] = np.linalg.solve(normal[good], right[good][..., None])[..., 0]
    return normal, solution


def _ambiguities(
    used: Booleans, group: Integers, wavelength_m: Floats, sigma_m: float
) -> tuple[Integers, Floats]:
    """Double differences (n,), and Σ [(k − 1) ln(σ² / λ²) + ln k] over groups."""
    count = np.zeros(len(used), np.int64)
    log_det = np.zeros(len(used))
    for rows, frequency in _groups(group):
        k = used[:, rows, frequency].sum(axis=1)
        some = k >= _FEWEST_IN_GROUP
        count += np.where(some, k - 1, 0)
        ratio = 2.0 * np.log(sigma_m / wavelength_m[rows[0], frequency[0]])
        log_det += np.where(some, (k - 1) * ratio + np.log(np.maximum(k, 1)), 0.0)
    return count, log_det


def _grouped(used: Booleans, group: Integers) -> Booleans:
    """Without those that are alone in their group: they say nothing once its clock is estimated."""
    return used & (_number_in_group(used, group) >= _FEWEST_IN_GROUP)


def _phase_error_m(signals: SimulatedSignals) -> Floats:
    """With the half cycle that is off, if any: whole cycles belong to the integers."""
    cycles = signals.locks.ambiguity_cycles
    off = cycles - np.floor(cycles)
    return signals.levels.phase_error_m + off * SPEED_OF_LIGHT_M_S / signals.carrier_hz


def _at_base(base: SimulatedSignals, rover: SimulatedSignals) -> tuple[Booleans, Floats, Floats]:
    """Which of the rover's signals (n, m, 2) the base tracks soundly at the same time; its code and phase errors."""
    at = np.minimum(np.searchsorted(base.time_ns, rover.time_ns), len(base.time_ns) - 1)
    same = base.time_ns[at] == rover.time_ns
    column = {int(s): k for k, s in enumerate(base.satellite)}
    of_base = np.array([column.get(int(s), -1) for s in rover.satellite], np.int64)
    sound = base.levels.phase_tracked & ~base.locks.half_cycle
    seen = sound[at][:, of_base] & (same[:, None] & (of_base >= 0))[..., None]
    code, phase = base.levels.code_error_m[at][:, of_base], _phase_error_m(base)[at][:, of_base]
    return seen, np.where(seen, code, 0.0), np.where(seen, phase, 0.0)


def _between(bound: Floats) -> Floats:
    """2 Φ(b) − 1 by Abramowitz and Stegun 7.1.26, to 1.5e-7."""
    x = bound / np.sqrt(2.0)
    t = 1.0 / (1.0 + 0.3275911 * x)
    poly = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    inside: Floats = 1.0 - poly * np.exp(-x * x)
    return inside
