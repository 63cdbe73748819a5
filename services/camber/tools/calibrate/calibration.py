"""Estimate lever arm and base-station offset from fixes and poses that are independent of them.

The pose is that of the antenna at the lever arm set. Fix minus pose is then

    d = R(yaw) (lever arm − lever arm set) + base offset + errors

and a fix's height above the road is antenna height + vertical base offset. A lever arm turns with the vehicle and a
base offset does not, so the two are separable only with turns; antenna height and vertical base offset are not
separable on board.

Errors of scan matches are correlated over seconds: σ are cluster-robust, with stretches of ten seconds as clusters
(Liang and Zeger, Biometrika 73, 1986). Wrong fixes are rejected by Tukey's biweight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from camber.formats.observations import Floats, Integers

CLUSTER_S = 10.0  # chosen: longer than the seconds over which errors of scan matches are correlated
LEAST_FIXES = 50  # chosen: ten seconds of fixes at 5 Hz
LEAST_CLUSTERS = 4  # chosen: as many as there are parameters, fewer give no covariance
LEAST_SPREAD = 0.05
"""Chosen: 1 − |mean of exp(i yaw)|; below it (headings within some 18°) lever arm and base are not separable."""
_TUKEY = 4.685  # 95 % efficiency for normal errors (Beaton and Tukey, Technometrics 16, 1974)
_LEAST_SCALE_M = 0.02  # chosen: noise of an RTK fix, keeps the scale above zero for noiseless data
_LEAST_SIGMA_M = 0.005  # chosen: a few clusters estimate their scatter poorly
_ITERATIONS = 50  # chosen: bound; iterations end once the values change by less than 1 µm


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FixPosePairs:
    """n pairs of fix and pose: time, fix minus pose (n, 2) east and north, yaw, σ (n,) in the worst direction."""

    time_ns: Integers
    east_north_m: Floats
    yaw_rad: Floats
    sigma_m: Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HorizontalCalibration:
    """Lever arm error (forward, left), base offset (east, north), their σ, and the share of pairs `used`.

    Where `separable` is false there were no turns: `lever_m` assumes a correct base, `base_m` a correct lever arm.
    """

    lever_m: Floats
    lever_sigma_m: Floats
    base_m: Floats
    base_sigma_m: Floats
    separable: bool
    used: float


def calibrate_horizontal(pairs: FixPosePairs) -> HorizontalCalibration | None:
    """Estimate lever arm error and base offset; None where there are too few pairs for values and σ."""
    clusters = clusters_of(pairs.time_ns)
    if len(pairs.time_ns) < LEAST_FIXES or len(np.unique(clusters)) < LEAST_CLUSTERS:
        return None
    of_lever = _lever_columns(pairs.yaw_rad)
    of_base = np.broadcast_to(np.eye(2), of_lever.shape)
    separable = circular_variance(pairs.yaw_rad) >= LEAST_SPREAD
    if separable:
        values, sigma, used = _fit(np.concatenate((of_lever, of_base), axis=2), pairs, clusters)
        lever, base, lever_sigma, base_sigma = values[:2], values[2:], sigma[:2], sigma[2:]
    else:
        lever, lever_sigma, used = _fit(of_lever, pairs, clusters)
        base, base_sigma, _ = _fit(of_base, pairs, clusters)
    return HorizontalCalibration(
        lever_m=lever,
        lever_sigma_m=lever_sigma,
        base_m=base,
        base_sigma_m=base_sigma,
        separable=separable,
        used=used,
    )


def circular_variance(yaw_rad: Floats) -> float:
    """Return 1 − |mean of exp(i yaw)|: 0 where all headings agree, 1 where they cancel."""
    return 1.0 - float(np.abs(np.exp(1j * yaw_rad).mean()))


def clusters_of(time_ns: Integers) -> Integers:
    """Return the number (n,) of the stretch of time that each epoch belongs to."""
    clusters: Integers = (time_ns - time_ns.min(initial=0)) // round(CLUSTER_S * 1e9)
    return clusters


def _lever_columns(yaw_rad: Floats) -> Floats:
    """Return the partial derivatives (n, 2, 2) of east and north by forward and left."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack((np.stack((cos, -sin), axis=1), np.stack((sin, cos), axis=1)), axis=1)


def _fit(columns: Floats, pairs: FixPosePairs, clusters: Integers) -> tuple[Floats, Floats, float]:
    """Fit values (k,) by Tukey's biweight; returns them, their σ, and the share of pairs used. `columns` (n, 2, k).

    Starts from least absolute deviations, so that a minority of wrong fixes, however large, has no influence.
    """
    n, _, k = columns.shape
    weight = 1.0 / pairs.sigma_m**2
    agreed = np.ones(n)
    values = _least_absolute_deviations(columns, pairs)
    for _ in range(_ITERATIONS):
        residual_m = pairs.east_north_m - columns @ values
        ratio = np.linalg.norm(residual_m, axis=1) / pairs.sigma_m
        scale = max(1.4826 * float(np.median(ratio)) / 1.2, _LEAST_SCALE_M / float(np.median(pairs.sigma_m)))
        agreed = np.clip(1.0 - (ratio / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        before, values = values, _solve(columns, pairs.east_north_m, weight * agreed)[0]
        if np.allclose(before, values, rtol=0.0, atol=1e-6):
            break
    values, normal = _solve(columns, pairs.east_north_m, weight * agreed)
    residual_m = pairs.east_north_m - columns @ values
    scores = np.einsum("nij,ni,n->nj", columns, residual_m, weight * agreed)
    numbers, inverse = np.unique(clusters, return_inverse=True)
    summed = np.zeros((len(numbers), k))
    np.add.at(summed, inverse, scores)
    few_clusters = len(numbers) / (len(numbers) - 1.0)
    covariance = few_clusters * normal @ (summed.T @ summed) @ normal
    return values, np.sqrt(np.diag(covariance) + _LEAST_SIGMA_M**2), float(np.mean(agreed > 0.0))


def _least_absolute_deviations(columns: Floats, pairs: FixPosePairs) -> Floats:
    """Approximate least absolute deviations by iteratively reweighted least squares."""
    n, _, k = columns.shape
    weight, values = np.ones(n), np.zeros(k)
    for _ in range(_ITERATIONS):
        values = _solve(columns, pairs.east_north_m, weight)[0]
        distance_m = np.linalg.norm(pairs.east_north_m - columns @ values, axis=1)
        weight = 1.0 / np.maximum(distance_m, _LEAST_SCALE_M)
    return values


def _solve(columns: Floats, observed_m: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return the weighted least-squares values and the inverse of the normal matrix."""
    normal = np.linalg.inv(np.einsum("nij,nik,n->jk", columns, columns, weight))
    return normal @ np.einsum("nij,ni,n->j", columns, observed_m, weight), normal
