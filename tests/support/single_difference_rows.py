"""Rows of one epoch with a known position, clocks and integers, and a second way to estimate from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.gnss.observations.differenced_observations import SingleDifferences
from camber.gnss.observations.signal_pairs import WAVELENGTH_M, group_of

SIGNALS = {"G": ("1C", "2L", "5Q"), "E": ("1C", "5Q", "7Q"), "C": ("1P", "2I", "7I"), "R": ("1C", "2C")}


@dataclass(frozen=True)
class MadeUp:
    """Rows and what they were made from: `dx_m` (3,), single-difference integers (n,)."""

    rows: SingleDifferences
    dx_m: NDArray[np.float64]
    integer: NDArray[np.int64]


def made_up_rows(
    rng: np.random.Generator,
    *,
    satellites: int = 8,
    systems: str = "GE",
    bands: int = 2,
    noise: float = 1.0,
    dx_m: tuple[float, float, float] = (1.2, -0.7, 2.1),
) -> MadeUp:
    """So many satellites of each system, each in so many bands; errors are `noise` times their variances' roots."""
    parts = []
    for system in systems:
        for number in range(1, satellites + 1):
            away = rng.normal(size=3)
            away[2] = abs(away[2]) + 0.3
            away /= np.linalg.norm(away)
            for signal in SIGNALS[system][:bands]:
                name = ord(signal[0]) * 256 + ord(signal[1])
                parts.append((ord(system) * 256 + number, group_of(ord(system) * 256 + number, name), -away))
    n = len(parts)
    group = np.array([g for _, g, _ in parts], np.int64)
    direction = np.array([d for _, _, d in parts]).reshape(n, 3)
    wavelength = WAVELENGTH_M[group]
    elevation = np.arcsin(-direction[:, 2])
    code_sigma = 0.4 * rng.uniform(0.7, 1.5, n)
    phase_sigma = 0.004 * rng.uniform(0.7, 1.5, n)
    clock = {g: rng.uniform(-1e5, 1e5) for g in np.unique(group)}
    integer = rng.integers(-1_000_000, 1_000_000, n)
    truth = direction @ np.array(dx_m) + np.array([clock[g] for g in group])
    code = truth + noise * code_sigma * rng.normal(size=n)
    phase = truth + integer * wavelength + noise * phase_sigma * rng.normal(size=n)
    places = np.arange(n)
    rows = SingleDifferences(
        rover=places,
        base=places,
        satellite=np.array([s for s, _, _ in parts], np.int64),
        group=group,
        wavelength_m=wavelength,
        direction=direction,
        code_m=code,
        phase_m=phase,
        code_variance_m2=code_sigma**2,
        phase_variance_m2=phase_sigma**2,
        elevation_rad=elevation,
        cn0_dbhz=rng.uniform(30.0, 50.0, n),
        atmosphere_m2=np.zeros((3, 3)),
    )
    return MadeUp(rows, np.array(dx_m), integer)


def double_differences(
    rows: SingleDifferences,
    values: NDArray[np.float64],
    variances: NDArray[np.float64],
    used: NDArray[np.bool_],
    last: bool,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], list[tuple[int, int]]]:
    """Design (m, 3), values (m,), full covariance (m, m) and pairs of rows, against the first or last of each group."""
    pairs = []
    for g in np.unique(rows.group[used]):
        members = np.flatnonzero(used & (rows.group == g)).tolist()
        reference = members[-1] if last else members[0]
        pairs += [(i, reference) for i in members if i != reference]
    operator = np.zeros((len(pairs), values.size))
    for k, (i, j) in enumerate(pairs):
        operator[k, i], operator[k, j] = 1.0, -1.0
    finite = np.where(used, values, 0.0)
    return (
        operator @ rows.direction,
        operator @ finite,
        operator @ np.diag(variances) @ operator.T,
        pairs,
    )


def slow_float(
    rows: SingleDifferences, used: NDArray[np.bool_], last: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, int]:
    """Position, covariance, χ² and degrees of freedom by double differences with their full covariance."""
    design, value, covariance, _ = double_differences(rows, rows.code_m, rows.code_variance_m2, used, last)
    weight = np.linalg.inv(covariance)
    position_covariance = np.linalg.inv(design.T @ weight @ design)
    dx = position_covariance @ design.T @ weight @ value
    left = value - design @ dx
    return dx, position_covariance, float(left @ weight @ left), len(value) - 3
