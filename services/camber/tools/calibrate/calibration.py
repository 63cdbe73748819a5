"""Lever arm, antenna height and base offset from fixes beside poses that owe nothing to them.

The pose is that of the antenna where the settings put it. Fix less pose is then

    d = R(yaw) (lever arm − lever arm set) + base + errors

and the height of a fix above the road at its place is antenna height + base, up. Only turns tell a lever arm, which
turns with the vehicle, from a base, which does not; nothing on board tells an antenna's height from a base's.

Errors of scan matches are alike for seconds: σ are those of stretches of ten seconds as clusters (Liang and Zeger,
Biometrika 73, 1986), not of single fixes. Wrong fixes are left out by Tukey's weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.formats.observations import Floats, Integers

CLUSTER_S = 10.0
LEAST_FIXES = 50
LEAST_CLUSTERS = 4
LEAST_SPREAD = 0.05
"""1 − |mean of exp(i yaw)|: below it, less than some 18° to either side, lever arm and base are one."""
_TUKEY = 4.685
_LEAST_SCALE_M = 0.02
_LEAST_SIGMA_M = 0.005  # a few stretches do not tell their own scatter well
_ROUNDS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """n fixes beside poses: time, difference (n, 2) east and north, yaw, σ (n,) of it in its worst direction."""

    time_ns: Integers
    east_north_m: Floats
    yaw_rad: Floats
    sigma_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Horizontal:
    """Forward and left of what the lever arm is off, east and north of the base, each with its σ; `used` of all pairs.

    Where `separable` is false there were no turns: `lever_m` is what it would be with a base that is right, `base_m`
    with a lever arm that is.
    """

    lever_m: Floats
    lever_sigma_m: Floats
    base_m: Floats
    base_sigma_m: Floats
    separable: bool
    used: float


def horizontal_of(pairs: Pairs) -> Horizontal | None:
    """The two offsets; None where there are too few pairs to tell anything and its σ."""
    clusters = clusters_of(pairs.time_ns)
    if len(pairs.time_ns) < LEAST_FIXES or len(np.unique(clusters)) < LEAST_CLUSTERS:
        return None
    turned, fixed = _lever_columns(pairs.yaw_rad), _base_columns(len(pairs.yaw_rad))
    if spread_of(pairs.yaw_rad) >= LEAST_SPREAD:
        values, sigma, used = _fit(np.concatenate((turned, fixed), axis=2), pairs, clusters)
        return Horizontal(values[:2], sigma[:2], values[2:], sigma[2:], True, used)
    lever, lever_sigma, used = _fit(turned, pairs, clusters)
    base, base_sigma, _ = _fit(fixed, pairs, clusters)
    return Horizontal(lever, lever_sigma, base, base_sigma, False, used)


def spread_of(yaw_rad: Floats) -> float:
    """0 where all directions are one, up to 1 where there are as many one way as the other."""
    return 1.0 - float(np.abs(np.exp(1j * yaw_rad).mean()))


def clusters_of(time_ns: Integers) -> Integers:
    """Number (n,) of the stretch of time that each belongs to."""
    clusters: Integers = (time_ns - time_ns.min(initial=0)) // round(CLUSTER_S * 1e9)
    return clusters


def _lever_columns(yaw_rad: Floats) -> Floats:
    """(n, 2, 2): how forward and left move east and north."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack((np.stack((cos, -sin), axis=1), np.stack((sin, cos), axis=1)), axis=1)


def _base_columns(n: int) -> Floats:
    return np.broadcast_to(np.eye(2), (n, 2, 2)).copy()


def _fit(columns: Floats, pairs: Pairs, clusters: Integers) -> tuple[Floats, Floats, float]:
    """Values (k,), their σ, and the share of the pairs that agree with them. `columns` (n, 2, k).

    Begins at the medians, so that a minority of wrong fixes, however far off, has no part in it.
    """
    n, _, k = columns.shape
    weight = 1.0 / pairs.sigma_m**2
    agreed = np.ones(n)
    values = _from_medians(columns, pairs)
    for _ in range(_ROUNDS):
        left_m = pairs.east_north_m - columns @ values
        off = np.linalg.norm(left_m, axis=1) / pairs.sigma_m
        scale = max(1.4826 * float(np.median(off)) / 1.2, _LEAST_SCALE_M / float(np.median(pairs.sigma_m)))
        agreed = np.clip(1.0 - (off / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        before, values = values, _solve(columns, pairs.east_north_m, weight * agreed)[0]
        if np.allclose(before, values, rtol=0.0, atol=1e-6):
            break
    values, normal = _solve(columns, pairs.east_north_m, weight * agreed)
    left_m = pairs.east_north_m - columns @ values
    scores = np.einsum("nij,ni,n->nj", columns, left_m, weight * agreed)
    numbers, inverse = np.unique(clusters, return_inverse=True)
    summed = np.zeros((len(numbers), k))
    np.add.at(summed, inverse, scores)
    few = len(numbers) / (len(numbers) - 1.0)
    covariance = few * normal @ (summed.T @ summed) @ normal
    return values, np.sqrt(np.diag(covariance) + _LEAST_SIGMA_M**2), float(np.mean(agreed > 0.0))


def _from_medians(columns: Floats, pairs: Pairs) -> Floats:
    """Least absolute deviations, nearly: squares weighed by the inverse of what they were off before."""
    n, _, k = columns.shape
    weight, values = np.ones(n), np.zeros(k)
    for _ in range(_ROUNDS):
        values = _solve(columns, pairs.east_north_m, weight)[0]
        off_m = np.linalg.norm(pairs.east_north_m - columns @ values, axis=1)
        weight = 1.0 / np.maximum(off_m, _LEAST_SCALE_M)
    return values


def _solve(columns: Floats, seen_m: Floats, weight: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """Values, and the inverse of the normal matrix."""
    normal = np.linalg.inv(np.einsum("nij,nik,n->jk", columns, columns, weight))
    return normal @ np.einsum("nij,ni,n->j", columns, seen_m, weight), normal
