"""Covariances of positions: the horizontal error ellipse and the radius that holds a given probability.

For a two-dimensional normal error with covariance eigenvalues α₁ ≥ α₂, the ellipse with semi-axes √(C α₁),
√(C α₂) holds the probability P = 1 − exp(−C/2), that is C = −2 ln(1 − P): 9.21 for 99 %, 13.82 for 99.9 %.
Source: R. Kikuchi, reliability index (TUMSAT), section "Reliability index".

Everything here is closed-form on plain floats. Covariances in east, north, up are six numbers in the order
(ee, en, eu, nn, nu, uu), horizontal ones three, (ee, en, nn).
"""

import math
from dataclasses import dataclass

EnuCovariance = tuple[float, float, float, float, float, float]
HorizontalCovariance = tuple[float, float, float]

# A smaller eigenvalue below −1e-9 of the larger is more than rounding in the filters or files it came from.
_ROUNDING = 1.0e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorEllipse:
    """An ellipse around a horizontal position.

    `orientation_rad` is the direction of the major axis, counter-clockwise from east, in (−π/2, π/2]; zero
    for a circle.
    """

    semi_major_m: float
    semi_minor_m: float
    orientation_rad: float


def horizontal_from_enu(covariance_enu_m2: EnuCovariance) -> HorizontalCovariance:
    """The (ee, en, nn) part of a covariance in east, north, up."""
    ee, en, _, nn, _, _ = covariance_enu_m2
    return ee, en, nn


def eigenvalues_m2(covariance_m2: HorizontalCovariance) -> tuple[float, float]:
    """The larger and the smaller eigenvalue α₁ ≥ α₂ ≥ 0 of [[ee, en], [en, nn]].

    A smaller eigenvalue that is negative by rounding only is given as zero. Raises ValueError if the matrix
    is not positive semidefinite beyond that, or not finite: no error ellipse is known then.
    """
    ee, en, nn = covariance_m2
    middle = 0.5 * (ee + nn)
    half_spread = math.hypot(0.5 * (ee - nn), en)
    larger = middle + half_spread
    # From the determinant: the difference of the two terms above would lose a small axis beside a large one.
    smaller = min((ee * nn - en * en) / larger, larger) if larger else 0.0
    # Written so that NaN fails too.
    if not (larger < math.inf and smaller >= -_ROUNDING * larger):
        raise ValueError(f"horizontal covariance {covariance_m2} m² is not positive semidefinite")
    return larger, max(smaller, 0.0)


def confidence_scale(probability: float) -> float:
    """C = −2 ln(1 − P) for a probability in [0, 1)."""
    if not 0.0 <= probability < 1.0:
        raise ValueError(f"probability is {probability}, expected at least 0 and less than 1")
    return -2.0 * math.log1p(-probability)


def error_ellipse(covariance_m2: HorizontalCovariance, probability: float) -> ErrorEllipse:
    """The ellipse that holds a normal error of this covariance with this probability."""
    larger, smaller = eigenvalues_m2(covariance_m2)
    scale = confidence_scale(probability)
    ee, en, nn = covariance_m2
    return ErrorEllipse(
        semi_major_m=math.sqrt(scale * larger),
        semi_minor_m=math.sqrt(scale * smaller),
        orientation_rad=0.5 * math.atan2(2.0 * en, ee - nn),
    )


def radius_m(covariance_m2: HorizontalCovariance, probability: float) -> float:
    """Semi-major axis [m] of `error_ellipse`: a circle of this radius holds at least this probability."""
    larger, _ = eigenvalues_m2(covariance_m2)
    return math.sqrt(confidence_scale(probability) * larger)
