"""Shares and rates with their uncertainty: block bootstrap and Clopper-Pearson bounds.

Neighbouring epochs share their causes, so they are no independent trials. The block bootstrap draws whole blocks of
epochs with replacement; the spread of the share over the draws is its uncertainty (H. Künsch, Annals of Statistics 17
(1989), with blocks that do not overlap). Bounds of counted rates: C. Clopper and E. Pearson, Biometrika 26 (1934); the
incomplete beta function by its continued fraction, NIST DLMF 8.17.22.
"""

from __future__ import annotations

import math

import numpy as np

from camber.schemas.base import Float64

CONFIDENCE = 0.95
"""Of intervals and bounds; chosen: as is usual."""
DRAWS = 2000
"""Of the bootstrap; chosen: the 2.5 % quantile then rests on 50 draws."""
_TINY = 1e-300
"""In place of zero in Lentz's algorithm: far below any term, far above underflow."""


def share_of(hits: Float64, trials: Float64) -> float | None:
    """Hits by trials over all blocks (b,); None without a trial."""
    total = float(trials.sum())
    return float(hits.sum()) / total if total else None


def share_interval(hits: Float64, trials: Float64, *, seed: int) -> tuple[float, float] | None:
    """Bootstrap interval (95 %) of the share of `hits` among `trials`, given by block (b,); None without a trial.

    With a single block, or with hits only, it has no width: then 3/n bounds the rate of failures.
    """
    counted = trials > 0
    hits, trials = hits[counted], trials[counted]
    if not len(trials):
        return None
    chosen = np.random.default_rng(seed).integers(0, len(trials), (DRAWS, len(trials)))
    shares = hits[chosen].sum(axis=1) / trials[chosen].sum(axis=1)
    low, high = np.quantile(shares, (0.5 * (1.0 - CONFIDENCE), 0.5 * (1.0 + CONFIDENCE)))
    return float(low), float(high)


def clopper_pearson(events: float, trials: float, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """One-sided lower and upper bound of a probability, each of 95 %; numbers need not be integers.

    Raises ValueError where there are more events than trials, or either is negative.
    """
    if not 0.0 <= events <= trials:
        raise ValueError(f"{events} events of {trials} trials")
    if trials == 0.0:
        return 0.0, 1.0
    low = 0.0 if events == 0.0 else _beta_quantile(1.0 - confidence, events, trials - events + 1.0)
    high = 1.0 if events == trials else _beta_quantile(confidence, events + 1.0, trials - events)
    return low, high


def rate_interval(events: float, trials: float) -> tuple[float, float]:
    """Interval (95 %) of a probability: between two bounds of 97.5 %, or below or above one of 95 %.

    The latter where no trial or every trial had the event; it is the rule of three there.
    """
    one_sided = events in (0.0, trials)
    return clopper_pearson(events, trials, CONFIDENCE if one_sided else 0.5 * (1.0 + CONFIDENCE))


def incomplete_beta(x: float, a: float, b: float) -> float:
    """I_x(a, b), the distribution function of the beta distribution at x in [0, 1]; a, b > 0."""
    if x <= 0.0 or x >= 1.0:
        return 0.0 if x <= 0.0 else 1.0
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - incomplete_beta(1.0 - x, b, a)
    front = math.exp(
        math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x)
    )
    return front * _continued_fraction(x, a, b) / a


def _continued_fraction(x: float, a: float, b: float) -> float:
    """By W. J. Lentz's algorithm."""
    c, d = 1.0, 1.0 / _not_zero(1.0 - (a + b) * x / (a + 1.0))
    total = d
    for m in range(1, 100_000):
        for factor in (
            m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0)),
        ):
            d = 1.0 / _not_zero(1.0 + factor * d)
            c = _not_zero(1.0 + factor / c)
            total *= c * d
        if abs(c * d - 1.0) < 1e-14:
            break
    return total


def _not_zero(value: float) -> float:
    return value if abs(value) > _TINY else _TINY


def _beta_quantile(probability: float, a: float, b: float) -> float:
    """By bisection of the logarithm: rates are small."""
    low, high = math.log(1e-18), 0.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        if incomplete_beta(math.exp(middle), a, b) < probability:
            low = middle
        else:
            high = middle
    return math.exp(high)
