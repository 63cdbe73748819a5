"""Errors that remember: first-order Gauss-Markov processes and switches made of them, a column each."""

from __future__ import annotations

import numpy as np

from camber.compiled.decorator import compiled
from camber.simulator.scene import Booleans, Floats


def gauss_markov(white: Floats, memory: Floats) -> Floats:
    """Standard Gauss-Markov of standard normal `white` (n, m): x[k] = φ[k] x[k−1] + √(1 − φ²) w[k].

    `memory` (n,) is φ, the correlation with the row before; its first value is not used.
    """
    return _gauss_markov(np.ascontiguousarray(white), np.ascontiguousarray(memory))


@compiled
def _gauss_markov(white: Floats, memory: Floats) -> Floats:
    out = np.empty_like(white)
    out[0] = white[0]
    for k in range(1, white.shape[0]):
        phi = memory[k]
        gain = np.sqrt(1.0 - phi * phi)
        for j in range(white.shape[1]):
            out[k, j] = phi * out[k - 1, j] + gain * white[k, j]
    return out


def memory_of(step: Floats, scale: float) -> Floats:
    """exp(−step / scale): of steps in time or distance (n,)."""
    return np.exp(-np.abs(step) / scale)


def switched(keep: Floats, draw: Floats, memory: Floats, share: Floats) -> Booleans:
    """States (n, m) that are on for a share (n,) of the time and are drawn anew once a correlation length on average.

    `keep`, `draw` (n, m) are uniform in [0, 1); `memory` (n,) is the probability that a state is kept from
    the row before.
    """
    return _switched(keep, draw, np.ascontiguousarray(memory), np.ascontiguousarray(share))


@compiled
def _switched(keep: Floats, draw: Floats, memory: Floats, share: Floats) -> Booleans:
    out = np.empty(keep.shape, np.bool_)
    for j in range(keep.shape[1]):
        out[0, j] = draw[0, j] < share[0]
    for k in range(1, keep.shape[0]):
        for j in range(keep.shape[1]):
            out[k, j] = out[k - 1, j] if keep[k, j] < memory[k] else draw[k, j] < share[k]
    return out
