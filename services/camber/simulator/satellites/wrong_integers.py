"""Wrong fixes: other points of the integer lattice, which the geometry at hand cannot distinguish from the right one.

With integers wrong by δ the phases' least squares move the position by Δx and leave residuals λ δ + G Δx. A δ passes
for right where those are small against the phases' errors and where the code allows Δx: that is the norm δᵀ Q_a⁻¹ δ of
the float ambiguities' covariance, minimal over x of |λ δ + G x|² / σ_φ² + xᵀ N_code x / σ_code².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.simulator.satellites.parameters import SolutionParameters
from camber.simulator.scene import Booleans, Floats, Integers

_DRAWS = 512  # chosen: enough to meet the most plausible points of the lattice
_ROUNDS = 4  # chosen: the steps do not change anything after these


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PhaseSignals:
    """Phases of one epoch: `directions` (m, 3) to the satellites; `used`, `group`, `wavelength_m` (m, 2)."""

    directions: Floats
    used: Booleans
    group: Integers
    wavelength_m: Floats


def wrong_integers(
    signals: PhaseSignals,
    code_normal: Floats,
    code_error_m: Floats,
    *,
    engine: SolutionParameters,
    rng: np.random.Generator,
) -> tuple[Floats, Floats] | None:
    """One wrong point of the lattice at one epoch, drawn by its plausibility; None where there is none.

    `code_normal` (3, 3), of unit weights, and `code_error_m` (3,) are of the float position. Returned are its integers'
    offsets (m, 2) in whole cycles, zero where right or not used, and the shift (3,) of the position.
    """
    satellite, frequency = np.nonzero(signals.used)
    wave = signals.wavelength_m[satellite, frequency]
    reference = _references(signals.group[satellite, frequency])
    g = signals.directions[satellite] - signals.directions[satellite[reference]]
    other = reference != np.arange(len(reference))
    g, wave_other = g[other], wave[other]
    if len(g) < 4 or np.linalg.matrix_rank(g) < 3:
        return None
    spread = np.linalg.cholesky(np.linalg.inv(code_normal) * engine.code_sigma_m**2)
    x = code_error_m + rng.normal(size=(_DRAWS, 3)) @ spread.T * rng.uniform(0.2, 1.5, (_DRAWS, 1))
    whole = np.zeros((_DRAWS, len(g)))
    solve = np.linalg.solve(g.T @ g, g.T)
    for _ in range(_ROUNDS):
        # Nearest integers to a position, nearest position to these: a valley's floor is reached in few steps.
        whole = np.rint(-(x @ g.T) / wave_other)
        x = -(whole * wave_other) @ solve.T
    # And those that are wrong by one on a single difference: short shifts, plausible where there are few others.
    single = np.concatenate((np.eye(len(g)), -np.eye(len(g))))
    whole = np.concatenate((whole, single))
    x = np.concatenate((x, -(single * wave_other) @ solve.T))
    # Differences to one reference are noisier than one phase by √2 each and alike: half of the square is a fair weight.
    norm = 0.5 * np.sum((whole * wave_other + x @ g.T) ** 2, axis=1) / engine.phase_sigma_m**2
    off = x - code_error_m
    norm = norm + np.einsum("ki,ij,kj->k", off, code_normal, off) / engine.code_sigma_m**2
    wrong = np.any(whole != 0.0, axis=1)
    if not bool(wrong.any()):
        return None
    _, first = np.unique(whole, axis=0, return_index=True)
    candidates = first[wrong[first]]
    # Drawn with weights exp(−norm / 2), by Gumbel's method.
    drawn = candidates[np.argmax(-0.5 * norm[candidates] + rng.gumbel(size=len(candidates)))]
    offset = np.zeros(signals.used.shape)
    offset[satellite[other], frequency[other]] = whole[drawn]
    return offset, x[drawn]


def shift_of(offset_cycles: Floats, signals: PhaseSignals) -> Floats | None:
    """What integers (m, 2) that are off move the position by with these signals: (3,), None if not solvable."""
    satellite, frequency = np.nonzero(signals.used)
    groups = signals.group[satellite, frequency]
    length: Floats = offset_cycles[satellite, frequency] * signals.wavelength_m[satellite, frequency]
    g: Floats = signals.directions[satellite].copy()
    for k in np.unique(groups):
        inside = groups == k
        g[inside] = g[inside] - g[inside].mean(axis=0)
        length[inside] = length[inside] - length[inside].mean()
    normal = np.asarray(g.T @ g, np.float64)
    if np.linalg.det(normal) < 1e-6:
        return None
    return np.asarray(-np.linalg.solve(normal, g.T @ length), np.float64)


def integers_at(shift_m: Floats, offset_cycles: Floats, known: Booleans, signals: PhaseSignals) -> Floats:
    """What a receiver that believes in `shift_m` takes for the integers of signals new to it, (m, 2).

    `known` (m, 2) are those whose integers it holds; a group it holds nothing of starts with its first
    signal as reference.
    """
    used, group = signals.used, signals.group
    expected = -(signals.directions @ shift_m)[:, None] / signals.wavelength_m
    out = np.where(known & used, offset_cycles, 0.0)
    for k in np.unique(group[used]):
        inside = used & (group == k)
        held = inside & known
        anchor = held if held.any() else inside & (np.cumsum(inside.ravel()).reshape(inside.shape) == 1)
        level = np.mean(out[anchor] - expected[anchor])
        new = inside & ~held & ~(anchor & ~held)
        out[new] = np.rint(expected[new] + level)
    return out


def _references(groups: Integers) -> Integers:
    """For each signal the first one of its group."""
    _, first, inverse = np.unique(groups, return_index=True, return_inverse=True)
    return first[inverse.ravel()]
