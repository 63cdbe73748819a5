"""What code and phase say of a position when clocks are differenced away, at all epochs at once.

A clock for each system and frequency is eliminated by taking directions and errors about their mean in the group; that
is the same as double differences with their correlations (Teunissen and Montenbruck, Springer Handbook of GNSS, 21.3).
The float ambiguities of a single epoch have Q_a = (Q_φ + G Q_x Gᵀ) / (λ λᵀ), Q_x from code, so that
ln|Q_a| = Σ [(k − 1) ln(σ_φ² / λ²) + ln k] + ln|N_code + N_phase| − ln|N_code| over groups of k satellites, and
ADOP = |Q_a|^(1 / 2n) (Teunissen, "A canonical theory for short GPS baselines", Journal of Geodesy 71 (1997)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.simulator.satellites.orbits import SPEED_OF_LIGHT_M_S
from camber.simulator.satellites.signals import SimulatedSignals

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

_FEWEST_IN_GROUP = 2


@dataclass(frozen=True, slots=True, eq=False)
class DifferencedGeometry:
    """Of n epochs, m satellites, two frequencies.

    `code_used`, `phase_used` (n, m, 2): in a group with another one. `code_normal`, `phase_normal` (n, 3, 3): Σ (g − ḡ)
    (g − ḡ)ᵀ of unit weights, east, north, up. `code_solution_m`, `phase_solution_m` (n, 3): the position errors that
    the signals' errors make (phase: with the right integers), zero where not solvable. `ambiguities` (n,) double
    differences; `success` (n,) the ADOP's approximation of the probability that rounding finds them.
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
    code_satellites: Integers
    phase_satellites: Integers


def differenced_geometry(
    rover: SimulatedSignals,
    base: SimulatedSignals | None,
    code_sigma_m: float,
    phase_sigma_m: float,
    elevation_mask_rad: float,
    code_outlier_m: float = np.inf,
    phase_outlier_m: float = np.inf,
) -> DifferencedGeometry:
    """Of what a rover tracks above the mask; errors are the rover's own, `base` only limits what can be differenced.

    Signals whose error is beyond the outlier limits are not used: a receiver leaves out what does not fit the rest.
    """
    high = (rover.geometry.elevation_rad >= elevation_mask_rad)[..., None]
    code_used = rover.levels.code_tracked & high
    code_used &= np.abs(rover.levels.code_error_m) <= code_outlier_m
    phase_used = rover.levels.phase_tracked & high & code_used
    phase_used &= np.abs(rover.levels.phase_error_m) <= phase_outlier_m
    if base is not None:
        at_base = _seen_at(base, rover)
        code_used = code_used & at_base
        phase_used = phase_used & at_base
    wavelength = SPEED_OF_LIGHT_M_S / rover.carrier_hz
    group = (rover.satellite >> 8)[:, None] * 2 + np.arange(2)
    group = np.unique(group, return_inverse=True)[1].reshape(group.shape)
    code_used = _grouped(code_used, group)
    phase_used = _grouped(phase_used, group)
    n_code, x_code, _, _ = _normal(rover, code_used, group, rover.levels.code_error_m, wavelength, 1.0)
    n_phase, x_phase, count, log_det = _normal(
        rover, phase_used, group, rover.levels.phase_error_m, wavelength, phase_sigma_m
    )
    solvable = (np.linalg.det(n_code) > 1e-6) & (count >= 3)
    eye = np.eye(3)
    a = np.where(solvable[:, None, None], n_code / code_sigma_m**2, eye)
    b = np.where(solvable[:, None, None], n_phase / phase_sigma_m**2, 0.0)
    log_det = log_det + np.log(np.linalg.det(a + b)) - np.log(np.linalg.det(a))
    adop = np.exp(log_det / (2.0 * np.maximum(count, 1)))
    success = np.where(solvable, _between(0.5 / adop) ** np.maximum(count, 1), 0.0)
    return DifferencedGeometry(
        code_used, phase_used, group, wavelength, n_code, n_phase, x_code, x_phase, count, success,
        np.sum(code_used[..., 0], axis=1), np.sum(phase_used[..., 0], axis=1),
    )  # fmt: skip


def centred(direction: Floats, used: Booleans, group: Integers) -> Floats:
    """Directions (n, m, 3) about the mean of those used in their group: (n, m, 2, 3), zero where not used."""
    out = np.zeros((*used.shape, 3))
    for g in range(int(group.max()) + 1 if group.size else 0):
        rows, frequency = np.nonzero(group == g)
        w = used[:, rows, frequency]
        total = np.maximum(w.sum(axis=1), 1)
        mean = np.einsum("nm,nmk->nk", w, direction[:, rows]) / total[:, None]
        out[:, rows, frequency] = w[..., None] * (direction[:, rows] - mean[:, None])
    return out


def _normal(
    rover: SimulatedSignals,
    used: Booleans,
    group: Integers,
    error_m: Floats,
    wavelength_m: Floats,
    sigma_m: float,
) -> tuple[Floats, Floats, Integers, Floats]:
    n = len(rover.time_ns)
    directions = centred(rover.geometry.direction, used, group).reshape(n, -1, 3)
    normal = np.einsum("nmi,nmj->nij", directions, directions)
    # A range grows against the direction to the satellite: δx = −N⁻¹ Gᵀ δρ.
    right = -np.einsum("nmi,nm->ni", directions, np.where(used, error_m, 0.0).reshape(n, -1))
    good = np.linalg.det(normal) > 1e-6
    solution = np.zeros((n, 3))
    solution[good] = np.linalg.solve(normal[good], right[good][..., None])[..., 0]
    count = np.zeros(n, np.int64)
    log_det = np.zeros(n)
    for g in range(int(group.max()) + 1 if group.size else 0):
        rows, frequency = np.nonzero(group == g)
        k = used[:, rows, frequency].sum(axis=1)
        some = k >= _FEWEST_IN_GROUP
        count += np.where(some, k - 1, 0)
        ratio = 2.0 * np.log(sigma_m / wavelength_m[rows[0], frequency[0]])
        log_det += np.where(some, (k - 1) * ratio + np.log(np.maximum(k, 1)), 0.0)
    return normal, solution, count, log_det


def _grouped(used: Booleans, group: Integers) -> Booleans:
    """Without those that are alone in their group: they say nothing once its clock is estimated."""
    out = used.copy()
    for g in range(int(group.max()) + 1 if group.size else 0):
        rows, frequency = np.nonzero(group == g)
        enough = used[:, rows, frequency].sum(axis=1) >= _FEWEST_IN_GROUP
        out[:, rows, frequency] &= enough[:, None]
    return out


def _seen_at(base: SimulatedSignals, rover: SimulatedSignals) -> Booleans:
    """Which of the rover's signals the base tracks at the same time tag."""
    at = np.searchsorted(base.time_ns, rover.time_ns)
    at = np.minimum(at, len(base.time_ns) - 1)
    same = base.time_ns[at] == rover.time_ns
    column = {int(s): k for k, s in enumerate(base.satellite)}
    seen = np.zeros(rover.levels.code_tracked.shape, np.bool_)
    for k, number in enumerate(rover.satellite):
        j = column.get(int(number))
        if j is not None:
            seen[:, k] = base.levels.phase_tracked[at, j] & same[:, None]
    return seen


def _between(bound: Floats) -> Floats:
    """2 Φ(b) − 1 by Abramowitz and Stegun 7.1.26, to 1.5e-7."""
    x = bound / np.sqrt(2.0)
    t = 1.0 / (1.0 + 0.3275911 * x)
    poly = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    inside: Floats = 1.0 - poly * np.exp(-x * x)
    return inside
