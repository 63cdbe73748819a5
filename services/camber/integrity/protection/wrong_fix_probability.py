"""How likely is it that a fix that has passed all tests is wrong all the same? For n fixes at once.

Of the tentative fixes in a street a share is wrong (the prior), of those of few satellites nearly all. A wrong fix's
error owes nothing to road and pose, so its difference d from them (`chi2_test`) is spread widely: a mixture of two
normal distributions, one of metres, one far off. A right fix's d is N(0, S). By Bayes' theorem, in odds:

    wrong : right = trials · prior / (1 − prior) · p(d | wrong) / p(d | right)

`trials` are the estimates from which this fix was chosen because it agrees: each had a chance of its own to agree by
accident. numpy only. Arrays (n, …); metres; east, north, up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camber.integrity.checks.chi2_test import UpperTriangle, chi2_survival, mahalanobis_terms, upper_triangle
from camber.integrity.scalar_or_array import FloatOrArray, finite_or_inf, log, log_sum_exp, where

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongFixRules:
    """What is assumed of wrong fixes.

    `prior`: the share of tentative fixes that are wrong, where many satellites were used; `of_few`: with up to so many
    satellites it is at least so large, and with an unknown number of them as with the fewest. Their errors have the
    standard deviations `near_…` each axis, but for `far_share` of them, which have `far_m`. An episode of wrong fixes
    lasts `episode_s` in the mean.
    """

    prior: float = 0.1
    near_horizontal_m: float = 1.0
    near_vertical_m: float = 1.5
    far_m: float = 10.0
    far_share: float = 0.3
    episode_s: float = 10.0
    of_few: tuple[tuple[int, float], ...] = ((7, 0.95), (12, 0.3))

    def prior_of(self, satellites: int | None) -> float:
        """The share of tentative fixes with so many satellites that are wrong; None: their number is not known."""
        few = [share for most, share in self.of_few if satellites is None or satellites <= most]
        return max(self.prior, *few) if few else self.prior

    def prior_log_odds(self, satellites: int | None) -> float:
        """ln of wrong : right before anything is tested."""
        return log_odds_of_share(self.prior_of(satellites))

    @property
    def parts(self) -> tuple[tuple[float, tuple[float, float, float]], ...]:
        """Share and variances (east, north, up) of the two parts of the mixture."""
        near = (self.near_horizontal_m**2, self.near_horizontal_m**2, self.near_vertical_m**2)
        return (1.0 - self.far_share, near), (self.far_share, (self.far_m**2,) * 3)

    @property
    def second_moment_m2(self) -> tuple[float, float]:
        """Mean square of a wrong fix's error: each horizontal axis, upwards."""
        (near, v), (far, w) = self.parts
        return near * v[0] + far * w[0], near * v[2] + far * w[2]


def log_odds_of_share(share: float) -> float:
    """ln of share : rest."""
    return math.log(share) - math.log1p(-share)


def log_odds(
    difference_m: Floats,
    covariance_m2: Floats,
    rules: WrongFixRules,
    prior_log_odds: float | Floats,
    trials: int | Floats = 1,
) -> Floats:
    """ln of wrong : right (n,) of fixes with differences (n, 3) and their covariances S (n, 3, 3) if they are right.

    `prior_log_odds` (n,) are those before any test.
    +∞ where anything is not finite, or S is no covariance. Grows with the difference along any direction, with the
    trials and with the prior.
    """
    with np.errstate(all="ignore"):  # what is not finite is replaced
        return np.asarray(
            log_odds_of(
                tuple(difference_m.T),
                upper_triangle(covariance_m2),
                rules=rules,
                prior_log_odds=prior_log_odds,
                trials=trials,
            )
        )


def log_odds_of(
    difference_m: tuple[FloatOrArray, FloatOrArray, FloatOrArray],
    covariance_m2: UpperTriangle,
    rules: WrongFixRules,
    prior_log_odds: FloatOrArray,
    trials: FloatOrArray,
) -> FloatOrArray:
    """The same of differences east, north, up; each part a float or (n,)."""
    ee, en, eu, nn, nu, uu = covariance_m2
    near, far = (
        log_share + _log_density(difference_m, (ee + east_m2, en, eu, nn + north_m2, nu, uu + up_m2))
        for log_share, (east_m2, north_m2, up_m2) in _if_wrong(rules)
    )
    ratio = log_sum_exp(near, far) - _log_density(difference_m, covariance_m2)
    return finite_or_inf(prior_log_odds + log(where(trials > 1, trials, 1)) + ratio)


@lru_cache(maxsize=64)
def _if_wrong(rules: WrongFixRules) -> tuple[tuple[float, tuple[float, float, float]], ...]:
    """ln of the shares of the two parts, and what they add to S."""
    return tuple((math.log(max(share, 1e-300)), variance_m2) for share, variance_m2 in rules.parts)


def probability(log_odds: Floats) -> Floats:
    """P(wrong) of ln of wrong : right; what is not a number counts as wrong."""
    odds = np.exp(np.fmin(log_odds, 700.0))  # of which NaN is none
    return np.asarray(odds / (1.0 + odds))


def missed_detection_probability(
    covariance_m2: Floats, limit: float, rules: WrongFixRules, trials: int | Floats = 1
) -> Floats:
    """P (n,) that a wrong fix agrees by accident: dᵀ S⁻¹ d ≤ `limit`, in one of `trials`; never too small.

    With the eigenvalues λ of S⁻¹ W, d's covariance W if it is wrong, and the largest one λ₁: at most
    λ₁^(3/2) / √(λ₁ λ₂ λ₃) · P(χ²(3) ≤ limit / λ₁), equal where the three are; the union over trials. 1 where S is none.
    """
    usable, s = _usable(covariance_m2)
    whitening = np.linalg.inv(np.linalg.cholesky(s))
    total = np.zeros(len(s))
    for share, variance in rules.parts:
        widening = np.linalg.eigvalsh(whitening @ np.diag(variance) @ whitening.transpose(0, 2, 1))
        values = 1.0 + np.maximum(widening, 0.0)
        largest = values[:, 2]
        inside = np.array([_chi2_inside(limit / value) for value in largest.tolist()])
        total += share * np.minimum(largest**1.5 / np.sqrt(values.prod(axis=1)) * inside, 1.0)
    return np.where(usable, np.minimum(np.maximum(trials, 1) * total, 1.0), 1.0)


def _chi2_inside(squared: float) -> float:
    """P(χ²(3) ≤ squared): near zero by its series' first term, (2/9π)^½ x^(3/2), an upper bound."""
    if squared < 1e-4:
        return math.sqrt(2.0 / (9.0 * math.pi)) * squared * math.sqrt(squared)
    return 1.0 - chi2_survival(squared, 3)


def _usable(covariance_m2: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Which are covariances, and with the unit matrix in place of those that are none."""
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(covariance_m2).all(axis=(1, 2)))
    safe = np.where(usable[:, None, None], covariance_m2, np.eye(3))
    usable &= np.linalg.eigvalsh(safe)[:, 0] > 0.0
    return usable, np.where(usable[:, None, None], safe, np.eye(3))


def _log_density(d: tuple[FloatOrArray, FloatOrArray, FloatOrArray], s: UpperTriangle) -> FloatOrArray:
    """ln N(d; 0, S) but for the constant that all of three dimensions share; not a number where S is no covariance."""
    _, squared, (east, north, up) = mahalanobis_terms(d, s)
    return -0.5 * (squared + log(east) + log(north) + log(up))
