"""Height and horizontal position together: does a fix agree with road, antenna and pose? For one fix or n at once.

The difference d of fix and model is three numbers: the fix less the pose to the east and to the north, and the fix's
height less that of road + antenna + correction *at the fix's place*. If the fix is right, d has the covariance S made
here, dᵀ S⁻¹ d is χ² with three degrees of freedom, and each part of it alone with one or two. There are two limits:
beyond that of the false-alarm rate a fix *contradicts*; only below the tighter one of the hold-back rate it *agrees*;
between them nobody can say, and the verdict is *unknown*.

numpy only; metres; east, north, up; parts are floats or arrays (n,), see `scalar_or_array`. Distributions:
Abramowitz and Stegun, Handbook of Mathematical Functions, 26.4 (χ² with 1, 2, 3 degrees of freedom in closed form).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from camber.integrity.scalar_or_array import FloatOrArray, finite_or_inf, positive_or_nan, sqrt, where

Floats = NDArray[np.float64]
TestOutcomes = NDArray[np.int8]

AGREES, UNVERIFIED, CONTRADICTS = 0, 1, 2


UpperTriangle: TypeAlias = tuple[
    FloatOrArray, FloatOrArray, FloatOrArray, FloatOrArray, FloatOrArray, FloatOrArray
]
"""(ee, en, eu, nn, nu, uu) of symmetric matrices, each a float or (n,)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Distances:
    """Squared distances in standard deviations: of the height, the horizontal position, and both together.

    `height_sigma_m`: of the height difference. Each is a float or (n,). Anything not finite, and a covariance that is
    none, is infinitely far off.
    """

    height: FloatOrArray
    position: FloatOrArray
    joint: FloatOrArray
    height_sigma_m: FloatOrArray


def difference_covariance(
    fix_covariance_m2: Floats, pose_covariance_m2: Floats, height_variance_m2: Floats, slope: Floats
) -> Floats:
    """S (n, 3, 3) of the difference, if the fix is right; see `covariance_of_difference`.

    `fix_covariance_m2` (n, 3, 3), `pose_covariance_m2` (n, 2, 2), `height_variance_m2` (n,), `slope` (n, 2).
    """
    pose = pose_covariance_m2[:, 0, 0], pose_covariance_m2[:, 0, 1], pose_covariance_m2[:, 1, 1]
    result = covariance_of_difference(
        upper_triangle(fix_covariance_m2), pose, height_variance_m2, (slope[:, 0], slope[:, 1])
    )
    ee, en, eu, nn, nu, uu = np.broadcast_arrays(*result)
    return np.stack([ee, en, eu, en, nn, nu, eu, nu, uu], axis=-1).reshape(-1, 3, 3)


def covariance_of_difference(
    fix_m2: UpperTriangle,
    pose_m2: tuple[FloatOrArray, FloatOrArray, FloatOrArray],
    height_variance_m2: FloatOrArray,
    slope: tuple[FloatOrArray, FloatOrArray],
) -> UpperTriangle:
    """S of the difference, if the fix is right, each part a float or (n,).

    `fix_m2` and `pose_m2` (ee, en, nn) are their covariances, `height_variance_m2` is that of road and antenna
    together, `slope` of the road to the east and north. The road is taken at the fix's place: its horizontal error
    moves the height difference by the slope, the pose's does not. So with J = [[1, 0, 0], [0, 1, 0], [−s_e, −s_n, 1]]
    it is J F Jᵀ of the fix's F, and what pose and height add.
    """
    (ee, en, eu, nn, nu, uu), (pose_ee, pose_en, pose_nn), (se, sn) = fix_m2, pose_m2, slope
    level_eu, level_nu = eu - se * ee - sn * en, nu - se * en - sn * nn
    level_uu = uu - se * eu - sn * nu - se * level_eu - sn * level_nu
    return ee + pose_ee, en + pose_en, level_eu, nn + pose_nn, level_nu, level_uu + height_variance_m2


def upper_triangle(matrices: Floats) -> UpperTriangle:
    """The upper triangles of matrices (n, 3, 3)."""
    m = matrices
    return m[:, 0, 0], m[:, 0, 1], m[:, 0, 2], m[:, 1, 1], m[:, 1, 2], m[:, 2, 2]


def distances(
    difference_m: tuple[FloatOrArray, FloatOrArray, FloatOrArray], covariance_m2: UpperTriangle
) -> Distances:
    """How far differences east, north and up are from nothing, by their covariances; each part a float or (n,)."""
    horizontal, joint, _ = mahalanobis_terms(difference_m, covariance_m2)
    up, upright = difference_m[2], positive_or_nan(covariance_m2[5])
    return Distances(
        height=finite_or_inf(up * up / upright),
        position=finite_or_inf(horizontal),
        joint=finite_or_inf(joint),
        height_sigma_m=sqrt(finite_or_inf(upright)),
    )


def mahalanobis_terms(
    difference_m: tuple[FloatOrArray, FloatOrArray, FloatOrArray], covariance_m2: UpperTriangle
) -> tuple[FloatOrArray, FloatOrArray, tuple[FloatOrArray, FloatOrArray, FloatOrArray]]:
    """dᵀ S⁻¹ d of the horizontal position alone and of all, and the three pivots of S, whose product is det S.

    Golub and Van Loan, Matrix Computations, 4.1.2: S = L D Lᵀ with the horizontal axes first, so that the first two
    terms of dᵀ S⁻¹ d are those of the horizontal position alone. No pivot of a covariance is zero or negative: not
    numbers where it is none.
    """
    (east, north, up), (ee, en, eu, nn, nu, uu) = difference_m, covariance_m2
    pivot_east, upright = positive_or_nan(ee), positive_or_nan(uu)
    l_north, l_up = en / pivot_east, eu / pivot_east
    pivot_north = positive_or_nan(nn - l_north * en)
    coupled = nu - l_up * en
    pivot_up = positive_or_nan(upright - l_up * eu - coupled * coupled / pivot_north)
    off_north = north - l_north * east
    off_up = up - l_up * east - coupled / pivot_north * off_north
    horizontal = east * east / pivot_east + off_north * off_north / pivot_north
    return horizontal, horizontal + off_up * off_up / pivot_up, (pivot_east, pivot_north, pivot_up)


def outcome_of(squared: FloatOrArray, hold_back_limit: float, false_alarm_limit: float) -> FloatOrArray:
    """AGREES, UNVERIFIED or CONTRADICTS of squared distances; what is not a number contradicts."""
    return where(
        squared <= hold_back_limit, AGREES, where(squared <= false_alarm_limit, UNVERIFIED, CONTRADICTS)
    )


def chi2_limit(probability: float, degrees: int) -> float:
    """The limit that a χ² variable of 1, 2 or 3 degrees of freedom exceeds with this probability.

    Raises ValueError for any other number of degrees, or a probability that is not between 0 and 1.
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability {probability}, expected between 0 and 1")
    if degrees == 2:
        return -2.0 * math.log(probability)
    low, high = 0.0, 1.0
    while chi2_survival(high, degrees) > probability:
        high *= 2.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        if chi2_survival(middle, degrees) > probability:
            low = middle
        else:
            high = middle
    return high


def chi2_survival(squared: float, degrees: int) -> float:
    """P(χ² > squared) for 1, 2 or 3 degrees of freedom. Raises ValueError for any other number."""
    if degrees == 2:
        return math.exp(-0.5 * squared)
    half_sigma = math.sqrt(0.5 * squared)
    if degrees == 1:
        return math.erfc(half_sigma)
    if degrees == 3:
        return math.erfc(half_sigma) + 2.0 / math.sqrt(math.pi) * half_sigma * math.exp(-0.5 * squared)
    raise ValueError(f"{degrees} degrees of freedom, expected 1, 2 or 3")
