"""How likely are all fixes off by one vector: a base coordinate, signals that lead them away, a captured pose?

No fix shows it, for all of them and all that they anchor are alike. Only the independent position does, which no fix's
east or north has entered. Let d be candidate − independent position and S its covariance if nothing is at fault.

**Only the candidate is at fault.** Then d has a covariance Λ that nobody knows, at least S. The ratio of likelihoods is
taken for the one that fits best along S, λ S (generalised likelihood ratio: Kay 1998, Detection Theory, 6.4.2). With
m² = dᵀ S⁻¹ d it is, in two dimensions,

    max over λ ≥ 1 of N(d; 0, λ S) / N(d; 0, S) = exp(m²/2 − 1) / (m²/2)    at λ = m²/2, where m² > 2, and 1 elsewhere

so agreement never argues against a common fault: one that has just begun, or is smaller than the independent position
can see, is as likely as before any test.

**The independent position is at fault too**, by a vector N(0, M) that has another cause: a match at the wrong place,
for matches are not searched around the fixes. Two faults of different causes rarely agree. Whatever the distribution of
the candidate's vector, that of d is that one convolved with N(0, S + M), nowhere higher than the peak of the latter:

    p(d | both) / N(d; 0, S) ≤ √(det S / det (S + M)) · exp(m²/2)

**A wrong fix has passed and taken the pose along** (`latent_fault`). Its error g has a distribution, N(0, G) with the
position's own error. Here agreement is evidence, by the ratio N(d; 0, G + C) / N(d; 0, S), C being that of the
independent position; if that is at fault too, by N(d; 0, G + C + M) / N(d; 0, S).

Odds = odds before any test × these ratios. Metres; east, north.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from camber.integrity.checks.consistency_tests import horizontal_distance2
from camber.integrity.scalar_or_array import FloatOrArray, exp, positive_or_nan, sqrt, where

MOST_LOG_ODDS = 30.0
"""Chosen: odds of 1e13 are certainty in floats, and exp does not overflow."""

Horizontal = tuple[float, float, float]
HorizontalColumns = tuple[FloatOrArray, FloatOrArray, FloatOrArray]
"""Covariances (ee, en, nn) of one position or of several."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonFaultRules:
    """Probabilities, each epoch, of what puts all fixes off by one vector; all are assumed.

    `base_prior`: the base station's coordinate is wrong, or is in another frame than the map. `drift_prior`: signals or
    a filter lead the fixes away along a growing vector. `captured_prior`: wrong fixes have taken the pose along and
    hold it. None of them bounds the vector. `map_shift_prior`: the map is shifted where the vehicle is, by
    `map_shift_sigma_m` along each horizontal axis, and with it whatever position the map gives. `independent_prior`:
    the independent position is off by `independent_sigma_m` along each axis, beyond its covariance, and no test has
    shown it: the last scan match, or the given pose, was at a wrong place.
    """

    base_prior: float = 1e-3
    drift_prior: float = 1e-4
    captured_prior: float = 1e-4
    map_shift_prior: float = 1e-6
    map_shift_sigma_m: float = 0.3
    independent_prior: float = 1e-3
    independent_sigma_m: float = 1.0

    @property
    def prior(self) -> float:
        """That any of the three is there; never more than one half, where nothing is known of the fixes."""
        return min(self.base_prior + self.drift_prior + self.captured_prior, 0.5)

    @property
    def prior_odds(self) -> float:
        """Odds of that."""
        return self.prior / (1.0 - self.prior)


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonFaultOdds:
    """Odds against that nothing is at fault: of the candidate alone, and of the independent position too."""

    alone: float
    with_independent: float


def common_fault_odds(
    difference_m: tuple[float, float], covariance_m2: Horizontal, rules: CommonFaultRules
) -> CommonFaultOdds:
    """Odds after the independent position was found this far off, S being `covariance_m2` (ee, en, nn).

    A difference or covariance that is not finite is a fault.
    """
    half = 0.5 * horizontal_distance2(*difference_m, covariance_m2)
    if not half < MOST_LOG_ODDS:
        half = MOST_LOG_ODDS
    log_alone = half - 1.0 - math.log(half) if half > 1.0 else 0.0
    ee, en, nn = covariance_m2
    fault_m2 = rules.independent_sigma_m**2
    usual, wider = determinant(covariance_m2), determinant((ee + fault_m2, en, nn + fault_m2))
    peak = math.sqrt(usual / wider) if 0.0 < usual < wider < math.inf else 1.0
    return CommonFaultOdds(
        alone=rules.prior_odds * math.exp(log_alone),
        with_independent=rules.prior_odds * rules.independent_prior * peak * math.exp(half),
    )


def likelihood_ratio(
    wrong_m: tuple[FloatOrArray, FloatOrArray],
    if_wrong_m2: HorizontalColumns,
    right_m: tuple[float, float],
    if_right_m2: Horizontal,
) -> FloatOrArray:
    """N(d of wrong; 0, wrong) / N(d of right; 0, right), covariances (ee, en, nn); the most where one is none."""
    against = 0.5 * (
        horizontal_distance2(*right_m, if_right_m2) - horizontal_distance2(*wrong_m, if_wrong_m2)
    )
    ratio = positive_or_nan(determinant(if_right_m2)) / positive_or_nan(determinant(if_wrong_m2))
    known = (ratio > 0.0) & (against < MOST_LOG_ODDS)
    return sqrt(where(known, ratio, 1.0)) * exp(where(known, against, MOST_LOG_ODDS))


def determinant(covariance_m2: HorizontalColumns) -> FloatOrArray:
    """Of a covariance (ee, en, nn)."""
    ee, en, nn = covariance_m2
    return ee * nn - en * en
