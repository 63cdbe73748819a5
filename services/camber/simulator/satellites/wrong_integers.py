"""Wrong fixes: other points of the integer lattice, which the geometry at hand cannot tell from the right one.

With integers wrong by δ the phases' least squares move the position by Δx and leave residuals λ δ + G Δx. A δ passes
for right where those are small against the phases' errors and where the code allows Δx: that is the norm δᵀ Q_a⁻¹ δ of
the float ambiguities' covariance, minimal over x of |λ δ + G x|² / σ_φ² + xᵀ N_code x / σ_code².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

_DRAWS = 512
_ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class WrongIntegers:
    """`offset_cycles` (m, 2), whole numbers, zero where right or not used; `shift_m` (3,) of the position."""

    offset_cycles: Floats
    shift_m: Floats
    norm: float


def wrong_integers(
    directions: Floats,
    used: Booleans,
    group: Integers,
    wavelength_m: Floats,
    code_normal: Floats,
    code_error_m: Floats,
    code_sigma_m: float,
    phase_sigma_m: float,
    rng: np.random.Generator,
) -> WrongIntegers | None:
    """One wrong point of the lattice at one epoch, drawn by its plausibility; None where there is none.

    `directions` (m, 3) to the satellites, `used` and `group` (m, 2), `code_normal` (3, 3) of unit weights,
    `code_error_m` (3,): the float position's error, about which the lattice is searched.
    """
    satellite, frequency = np.nonzero(used)
    wave = wavelength_m[satellite, frequency]
    reference = _references(group[satellite, frequency])
    g = directions[satellite] - directions[satellite[reference]]
    other = reference != np.arange(len(reference))
    g, wave_other = g[other], wave[other]
    if len(g) < 4 or np.linalg.matrix_rank(g) < 3:
        return None
    spread = np.linalg.cholesky(np.linalg.inv(code_normal) * code_sigma_m**2)
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
    norm = _norm(whole * wave_other, g, x, code_normal, code_error_m, code_sigma_m, phase_sigma_m)
    wrong = np.any(whole != 0.0, axis=1)
    if not bool(wrong.any()):
        return None
    _, first = np.unique(whole, axis=0, return_index=True)
    candidates = first[wrong[first]]
    # Drawn with weights exp(−norm / 2), by Gumbel's way.
    drawn = candidates[np.argmax(-0.5 * norm[candidates] + rng.gumbel(size=len(candidates)))]
    offset = np.zeros(used.shape)
    offset[satellite[other], frequency[other]] = whole[drawn]
    return WrongIntegers(offset, x[drawn], float(norm[drawn]))


def shift_of(
    offset_cycles: Floats, directions: Floats, used: Booleans, group: Integers, wavelength_m: Floats
) -> Floats | None:
    """What integers (m, 2) that are off move the position by with these signals: (3,), None if not solvable."""
    satellite, frequency = np.nonzero(used)
    groups = group[satellite, frequency]
    length: Floats = offset_cycles[satellite, frequency] * wavelength_m[satellite, frequency]
    g: Floats = directions[satellite].copy()
    for k in np.unique(groups):
        inside = groups == k
        g[inside] = g[inside] - g[inside].mean(axis=0)
        length[inside] = length[inside] - length[inside].mean()
    normal = np.asarray(g.T @ g, np.float64)
    if np.linalg.det(normal) < 1e-6:
        return None
    return np.asarray(-np.linalg.solve(normal, g.T @ length), np.float64)


def integers_at(
    shift_m: Floats,
    offset_cycles: Floats,
    known: Booleans,
    directions: Floats,
    used: Booleans,
    group: Integers,
    wavelength_m: Floats,
) -> Floats:
    """What a receiver that believes in `shift_m` takes for the integers of signals new to it, (m, 2).

    `known` (m, 2) are those whose integers it holds; a group it holds nothing of starts with its first
    signal as reference.
    """
    out = np.where(known & used, offset_cycles, 0.0)
    for k in np.unique(group[used]):
        inside = used & (group == k)
        held = inside & known
        expected = -(directions @ shift_m)[:, None] / wavelength_m
        anchor = held if held.any() else inside & (np.cumsum(inside.ravel()).reshape(inside.shape) == 1)
        level = np.mean(out[anchor] - expected[anchor])
        new = inside & ~held & ~(anchor & ~held)
        out[new] = np.rint(expected[new] + level)
    return out


def _references(groups: Integers) -> Integers:
    """For each signal the first one of its group."""
    _, first, inverse = np.unique(groups, return_index=True, return_inverse=True)
    reference: Integers = first[inverse.ravel()]
    return reference


def _norm(
    length: Floats,
    g: Floats,
    x: Floats,
    code_normal: Floats,
    code_error: Floats,
    code_sigma: float,
    phase_sigma: float,
) -> Floats:
    left = length + x @ g.T
    # Differences to one reference are noisier than one phase by √2 each and alike: half of the square is a fair weight.
    off = x - code_error
    norm: Floats = 0.5 * np.sum(left**2, axis=1) / phase_sigma**2
    norm = norm + np.einsum("ki,ij,kj->k", off, code_normal, off) / code_sigma**2
    return norm
