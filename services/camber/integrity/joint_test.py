"""Height and horizontal position together: does a fix agree with road, antenna and pose? For n fixes at once.

The difference d of fix and model is three numbers: the fix less the pose to the east and to the north, and the fix's
height less that of road + antenna + correction *at the fix's place*. If the fix is right, d has the covariance S made
here, dᵀ S⁻¹ d is χ² with three degrees of freedom, and each part of it alone with one or two. There are two limits:
beyond that of the false-alarm rate a fix *contradicts*; only below the tighter one of the hold-back rate it *agrees*;
between them nobody can say, and the verdict is *unknown*.

numpy only. Arrays (n, …); metres; east, north, up. Source of the distributions: Abramowitz and Stegun, Handbook of
Mathematical Functions, 26.4 (χ² with 1, 2, 3 degrees of freedom in closed form).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Words = NDArray[np.int8]

AGREES, UNVERIFIED, CONTRADICTS = 0, 1, 2


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Squared distances (n,) in standard deviations: of the height, the horizontal position, and both together.

    `height_sigma_m` (n,): of the height difference. Anything not finite, and a covariance that is none, is infinitely
    far off.
    """

    height: Floats
    position: Floats
    joint: Floats
    height_sigma_m: Floats


def difference_covariance(
    fix_covariance_m2: Floats, pose_covariance_m2: Floats, height_variance_m2: Floats, slope: Floats
) -> Floats:
    """S (n, 3, 3) of the difference, if the fix is right.

    `fix_covariance_m2` (n, 3, 3), `pose_covariance_m2` (n, 2, 2) east and north, `height_variance_m2` (n,) of road and
    antenna together, `slope` (n, 2) of the road to the east and north. The road is taken at the fix's place: its
    horizontal error moves the height difference by the slope, the pose's does not.
    """
    n = len(height_variance_m2)
    j = np.zeros((n, 3, 3))
    j[:, [0, 1, 2], [0, 1, 2]] = 1.0
    j[:, 2, :2] = -slope
    s: Floats = j @ fix_covariance_m2 @ j.transpose(0, 2, 1)
    s[:, :2, :2] += pose_covariance_m2
    s[:, 2, 2] += height_variance_m2
    return s


def distances(difference_m: Floats, covariance_m2: Floats) -> Distances:
    """How far differences (n, 3) are from nothing, by covariances (n, 3, 3), of which the upper triangle counts.

    Golub and Van Loan, Matrix Computations, 4.1.2: S = L D Lᵀ with the horizontal axes first, so that the first two
    terms of dᵀ S⁻¹ d are those of the horizontal position alone. No pivot of a covariance is nought or less.
    """
    east, north, up = difference_m[:, 0], difference_m[:, 1], difference_m[:, 2]
    s = covariance_m2
    with np.errstate(all="ignore"):
        pivot_east = s[:, 0, 0]
        l_north, l_up = s[:, 0, 1] / pivot_east, s[:, 0, 2] / pivot_east
        pivot_north = s[:, 1, 1] - l_north * s[:, 0, 1]
        coupled = s[:, 1, 2] - l_up * s[:, 0, 1]
        pivot_up = s[:, 2, 2] - l_up * s[:, 0, 2] - coupled * coupled / pivot_north
        off_north = north - l_north * east
        off_up = up - l_up * east - coupled / pivot_north * off_north
        horizontal = east * east / pivot_east + off_north * off_north / pivot_north
        both = horizontal + off_up * off_up / pivot_up
        alone = up * up / s[:, 2, 2]
        flat = (pivot_east > 0.0) & (pivot_north > 0.0) & np.isfinite(pivot_east) & np.isfinite(pivot_north)
        upright = (s[:, 2, 2] > 0.0) & np.isfinite(s[:, 2, 2])
        whole = flat & upright & (pivot_up > 0.0)
        return Distances(
            height=_known(alone, upright),
            position=_known(horizontal, flat),
            joint=_known(both, whole),
            height_sigma_m=np.sqrt(np.where(upright, s[:, 2, 2], np.inf)),
        )


def words(squared: Floats, hold_back_limit: float, false_alarm_limit: float) -> Words:
    """AGREES, UNVERIFIED or CONTRADICTS (n,) of squared distances (n,); what is not a number contradicts."""
    return np.where(
        squared <= hold_back_limit, AGREES, np.where(squared <= false_alarm_limit, UNVERIFIED, CONTRADICTS)
    ).astype(np.int8)


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
    root = math.sqrt(0.5 * squared)
    if degrees == 1:
        return math.erfc(root)
    if degrees == 3:
        return math.erfc(root) + 2.0 / math.sqrt(math.pi) * root * math.exp(-0.5 * squared)
    raise ValueError(f"{degrees} degrees of freedom, expected 1, 2 or 3")


def _known(squared: Floats, good: NDArray[np.bool_]) -> Floats:
    """Infinite where the covariance is none or the distance is not a number."""
    return np.where(good & np.isfinite(squared), squared, np.inf)
