"""How likely are all fixes off by one vector: a base coordinate, signals that lead them away, a captured pose?

No fix shows it, for all of them and all that they anchor are alike. Only the independent position does, which no fix's
east or north has entered. Let d be candidate − independent position and S its covariance if nothing is at fault. If
there is a common fault d has a covariance Λ that nobody knows, at least S. The ratio of likelihoods is taken for the
one that fits best along S, λ S (generalised likelihood ratio: Kay 1998, Detection Theory, 6.4.2). With m² =
dᵀ S⁻¹ d it is, in two dimensions,

    max over λ ≥ 1 of N(d; 0, λ S) / N(d; 0, S) = exp(m²/2 − 1) / (m²/2)    at λ = m²/2, where m² > 2, and 1 elsewhere

so agreement never argues against a common fault: one that has just begun, or is smaller than the independent position
can see, is as likely as before any test. Odds = prior / (1 − prior) × this ratio. Pure floats; metres; east, north.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

MOST_LOG_ODDS = 30.0
"""Chosen: odds of 1e13 are certainty in floats, and exp does not overflow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonFaultRules:
    """Probabilities, each epoch, of what puts all fixes off by one vector; all are assumed.

    `base_prior`: the base station's coordinate is wrong, or is in another frame than the map. `drift_prior`: signals or
    a filter lead the fixes away along a growing vector. `captured_prior`: wrong fixes have taken the pose along and
    hold it. None of them bounds the vector. `map_shift_prior`: the map is shifted where the vehicle is, by
    `map_shift_sigma_m` along each horizontal axis, and with it whatever position the map gives.
    """

    base_prior: float = 1e-3
    drift_prior: float = 1e-4
    captured_prior: float = 1e-4
    map_shift_prior: float = 1e-6
    map_shift_sigma_m: float = 0.3

    @property
    def prior(self) -> float:
        """That any of the three is there; never more than one half, where nothing is known of the fixes."""
        return min(self.base_prior + self.drift_prior + self.captured_prior, 0.5)


def common_fault_odds(squared: float, rules: CommonFaultRules) -> float:
    """Odds of a common fault after the independent position was found at this squared distance."""
    half = 0.5 * squared
    if half <= 1.0:
        return rules.prior / (1.0 - rules.prior)
    gain = half - 1.0 - math.log(half) if half < math.inf else MOST_LOG_ODDS
    return rules.prior / (1.0 - rules.prior) * math.exp(min(gain, MOST_LOG_ODDS))
