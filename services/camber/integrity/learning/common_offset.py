"""What the height differences of many stretches of road have in common, and whether that drifts.

The map's errors at two places are correlated (`camber.road_map.map_error_model`): driving the same street twice adds
nothing, and a survey's common offset is part of the value. So the estimate is generalised least squares with the full
covariance of the differences. Those far from the rest (a changed road, a wrong fix that lasted) are left out: the
median finds the rest while they are fewer.

numpy only. Arrays (n,), metres and seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from camber.road_map.map_error_model import MapErrorModel

Floats = NDArray[np.float64]

_OUTLIER = 3.0  # σ; chosen: the usual three-sigma rejection
_ROUNDS = 3  # chosen: of estimate and rejection in turn
_LEAST_SCATTER = 0.1  # of the variance given; chosen: few residuals that fit by chance make no drift certain
_ENOUGH_FOR_SCATTER = 8  # chosen: from here the median absolute deviation replaces the σ given
_NORMAL_MAD = 1.4826  # σ of a normal distribution by its median absolute deviation


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HeightDifferences:
    """n stretches: difference, variance of fix and antenna, σ of the map, place (n, 2) in metres, time."""

    up_m: Floats
    variance_m2: Floats
    map_sigma_m: Floats
    place_m: Floats
    time_s: Floats

    def only(self, kept: NDArray[np.bool_]) -> HeightDifferences:
        """Some of them."""
        return HeightDifferences(**{each.name: getattr(self, each.name)[kept] for each in fields(self)})

    def covariance_m2(self, map_errors: MapErrorModel) -> Floats:
        """(n, n) of the differences, if they have one value in common."""
        return map_errors.covariance_m2(self.place_m, self.map_sigma_m) + np.diag(self.variance_m2)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CommonOffset:
    """Value by data and prior; σ of what the data's errors put into it; what it changes by in a second.

    `drift_sigmas` is the slope over time by its own σ, `drift_m` the slope times the time it was seen over.
    """

    value_m: float
    sigma_m: float
    used: int
    drift_sigmas: float
    drift_m: float


def estimate_common_offset(
    differences: HeightDifferences, map_errors: MapErrorModel, prior_m: float, prior_sigma_m: float
) -> CommonOffset:
    """The common part of at least one difference."""
    kept = differences.only(_rest(differences, map_errors, prior_m, prior_sigma_m))
    value_m, precision, information = _estimate(kept, map_errors, prior_m, prior_sigma_m)
    slope, slope_sigma, span_s = _slope(kept, map_errors)
    return CommonOffset(
        value_m=value_m,
        sigma_m=float(np.sqrt(information)) / precision,
        used=len(kept.up_m),
        drift_sigmas=abs(slope) / slope_sigma if slope_sigma > 0.0 else 0.0,
        drift_m=abs(slope) * span_s,
    )


def _rest(
    differences: HeightDifferences, map_errors: MapErrorModel, prior_m: float, prior_sigma_m: float
) -> NDArray[np.bool_]:
    """Which agree with one another; the prior has a voice, so that it takes two to outvote it.

    A fix's σ is that of an error which is mostly the same in all of them (reference point, frame, a sky that changes
    slowly): it says little of how far they may lie apart. Where there are enough, what scatter is seen says more.
    """
    sigma_m = np.sqrt(differences.variance_m2 + differences.map_sigma_m**2)
    centre_m = float(np.median(np.append(differences.up_m, prior_m)))
    if len(sigma_m) < _ENOUGH_FOR_SCATTER:
        spread_m = _OUTLIER * np.hypot(sigma_m, prior_sigma_m if len(sigma_m) < 3 else 0.0)
    else:
        seen = _NORMAL_MAD * float(np.median(np.abs(differences.up_m - centre_m) / sigma_m))
        spread_m = _OUTLIER * np.clip(seen * sigma_m, differences.map_sigma_m, sigma_m)
    kept = np.abs(differences.up_m - centre_m) <= spread_m
    for _ in range(_ROUNDS):
        centre_m = _estimate(differences.only(kept), map_errors, prior_m, prior_sigma_m)[0]
        kept = np.abs(differences.up_m - centre_m) <= spread_m
    return kept


def _estimate(
    differences: HeightDifferences, map_errors: MapErrorModel, prior_m: float, prior_sigma_m: float
) -> tuple[float, float, float]:
    """Value, its inverse variance, and the part of that which is the data's."""
    ones = np.ones(len(differences.up_m))
    weights = np.linalg.solve(differences.covariance_m2(map_errors), ones)
    information = float(weights.sum())
    precision = information + prior_sigma_m**-2
    value_m = (float(weights @ differences.up_m) + prior_m * prior_sigma_m**-2) / precision
    return value_m, precision, information


def _slope(differences: HeightDifferences, map_errors: MapErrorModel) -> tuple[float, float, float]:
    """Change a second, its σ (0: not known), and the time between first and last."""
    n = len(differences.up_m)
    span_s = float(np.ptp(differences.time_s)) if n else 0.0
    if n < 4 or not span_s > 0.0:
        return 0.0, 0.0, span_s
    design = np.column_stack((np.ones(n), (differences.time_s - differences.time_s.mean()) / span_s))
    covariance_m2 = differences.covariance_m2(map_errors)
    whitened = np.linalg.solve(covariance_m2, design)
    normal = np.linalg.inv(design.T @ whitened)
    level, slope = normal @ (whitened.T @ differences.up_m)
    left_m = differences.up_m - design @ (level, slope)
    # The σ of fixes are rather too large, and a drift must not hide in what they leave room for. The map's errors are
    # as large as stated, and where they are alike over hundreds of metres the scatter about a line does not show them.
    scatter = float(left_m @ np.linalg.solve(covariance_m2, left_m)) / (n - 2)
    excess = 1.0 - min(max(scatter, _LEAST_SCATTER), 1.0)
    weights = whitened @ normal[:, 1]
    slope_m2 = normal[1, 1] - excess * float(weights**2 @ differences.variance_m2)
    return float(slope) / span_s, math.sqrt(slope_m2) / span_s, span_s
