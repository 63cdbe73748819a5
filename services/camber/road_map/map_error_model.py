"""Height errors of a surveyed road: two correlation scales along the road, and an offset common to a survey.

    error(s) = offset + short(s) + long(s)

- `offset`: constant within a survey, N(0, common_offset_sigma_m²), independent between surveys.
- `short`: first-order Gauss–Markov, correlation exp(−d / L₁).
- `long`: second-order Gauss–Markov, critically damped, correlation (1 + d / L₂) exp(−d / L₂) (Gelb 1974, table 2.2-1).

The correlation functions are Matérn's with ν = 1/2 and 3/2, which are positive definite over the plane too (Stein 1999,
section 2.7). So distances may be along the road or between places.

Measured on `boreas-tracks`, two drives of one road a month apart whose errors are both in the difference:
docs/theory/map-errors.md. numpy only; distances and errors in metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camber.schemas.map_errors import COMMON_OFFSET_SIGMA_M, LONG_M, SHORT_M, SHORT_SHARE

Floats = NDArray[np.float64]

STATES = 3
"""Of the state-space form: the short part, the long part, and the long part's slope times L₂; from the model."""
_SERIES_BELOW = 0.1  # chosen: the closed form loses digits there; ten terms of the series are exact to 1e-16
_SERIES_TERMS = 10  # derivation: (2 · 0.1)¹⁰ / 10! < 1e-13 of the first term


@dataclass(frozen=True, slots=True, kw_only=True)
class MapErrorModel:
    """Share of the short part in the variance along the road, correlation lengths L₁ and L₂, σ of the common offset.

    The σ of a surface (`sigma_m` of a release) is that of both parts along the road; the offset is apart from it. The
    defaults fit `boreas-tracks`: lengths are the longest round ones within one unit of the largest log-likelihood (a
    longer correlation makes fewer independent observations), the offset is the one that was measured.
    """

    short_share: float = SHORT_SHARE
    short_m: float = SHORT_M
    long_m: float = LONG_M
    common_offset_sigma_m: float = COMMON_OFFSET_SIGMA_M

    def __post_init__(self) -> None:
        """Raise ValueError for values that are no model."""
        if not 0.0 <= self.short_share <= 1.0:
            raise ValueError(f"short_share: expected 0 to 1, got {self.short_share}")
        if not (0.0 < self.short_m < math.inf and 0.0 < self.long_m < math.inf):
            raise ValueError(
                f"short_m, long_m: expected positive lengths, got {self.short_m} and {self.long_m}"
            )
        if not 0.0 <= self.common_offset_sigma_m < math.inf:
            raise ValueError(f"common_offset_sigma_m: expected at least 0, got {self.common_offset_sigma_m}")

    def correlation(self, distance_m: Floats | float) -> Floats:
        """Correlation of the errors along the road at distances [m] of any shape; the common offset is not in it."""
        distance = np.abs(np.asarray(distance_m, np.float64))
        a = distance / self.long_m
        short = self.short_share * np.exp(-distance / self.short_m)
        return np.asarray(short + (1.0 - self.short_share) * (1.0 + a) * np.exp(-a), np.float64)

    def covariance_m2(self, place_m: Floats, sigma_m: Floats) -> Floats:
        """Covariance (n, n) [m²] at places (n, k) [m] of σ (n,) [m], without the common offset, which adds
        `common_offset_sigma_m`² to every element."""
        gap_m = np.linalg.norm(place_m[:, None, :] - place_m[None, :, :], axis=2)
        return np.asarray(np.outer(sigma_m, sigma_m) * self.correlation(gap_m), np.float64)

    @property
    def observation(self) -> Floats:
        """Row (3,) that makes the error of unit variance from the state."""
        return np.array([1.0, 1.0, 0.0])

    @property
    def stationary_covariance(self) -> Floats:
        """Covariance (3, 3) of the state where nothing is known, for an error of unit variance; times σ² for σ."""
        long = 1.0 - self.short_share
        return np.diag([self.short_share, long, long])

    def transition(self, step_m: float) -> Floats:
        """Transition (3, 3) of the state over `step_m` of driving, of either sign."""
        return np.asarray(state_transitions(self, np.array([abs(step_m)]))[0])

    def process_noise(self, step_m: float) -> Floats:
        """Covariance (3, 3) of what is new after `step_m`, for an error of unit variance; times σ² for σ."""
        factor = process_noise_factors(self, np.array([abs(step_m)]))[0]
        return np.asarray(factor @ factor.T)

    def simulate(self, distance_m: Floats, sigma_m: float, rng: np.random.Generator) -> Floats:
        """Errors (n,) [m] of σ `sigma_m` at ascending distances (n,) [m] along the road, without the common offset.

        Exact for any spacing: the state-space form, begun from its stationary distribution.
        """
        white = rng.standard_normal((len(distance_m), STATES))
        if not len(white):
            return np.zeros(0)
        step_m = np.diff(distance_m)
        transitions, factors = state_transitions(self, step_m), process_noise_factors(self, step_m)
        state = np.sqrt(np.diag(self.stationary_covariance)) * white[0]
        states = np.empty_like(white)
        states[0] = state
        new = np.einsum("nij,nj->ni", factors, white[1:])
        for k in range(len(step_m)):
            state = transitions[k] @ state + new[k]
            states[k + 1] = state
        return np.asarray(sigma_m * (states[:, 0] + states[:, 1]))

    def common_offset(self, rng: np.random.Generator) -> float:
        """Offset [m] of one survey."""
        return self.common_offset_sigma_m * float(rng.standard_normal())


MAP_ERRORS = MapErrorModel()
"""The defaults, for all that assume a correlation of the map's height errors."""


def process_noise_factors(model: MapErrorModel, step_m: Floats) -> Floats:
    """Lower Cholesky factors (n, 3, 3) of the process noise over steps (n,) [m] ≥ 0, for an error of unit variance.

    Of the long part with a = step / L₂, the impulse response is 2 (t, 1 − t) exp(−t) in units of L₂, so that the
    covariance is ∫₀ᵃ of its products: q₁₁ = 1 − (1 + 2a + 2a²) e⁻²ᵃ, q₁₂ = 2a² e⁻²ᵃ, q₂₂ = 1 − (1 − 2a + 2a²) e⁻²ᵃ.
    """
    a = step_m / model.long_m
    fade = np.exp(-2.0 * a)
    q11 = np.where(a < _SERIES_BELOW, _series(a), 1.0 - (1.0 + 2.0 * a + 2.0 * a**2) * fade)
    q12 = 2.0 * a**2 * fade
    q22 = -np.expm1(-2.0 * a) + (2.0 * a - 2.0 * a**2) * fade
    l11 = np.sqrt(q11)
    l21 = np.divide(q12, l11, out=np.zeros_like(a), where=l11 > 0.0)
    factors = np.zeros((len(a), STATES, STATES))
    factors[:, 0, 0] = np.sqrt(-model.short_share * np.expm1(-2.0 * step_m / model.short_m))
    long = math.sqrt(1.0 - model.short_share)
    factors[:, 1, 1] = long * l11
    factors[:, 2, 1] = long * l21
    factors[:, 2, 2] = long * np.sqrt(np.maximum(q22 - l21**2, 0.0))
    return factors


def _series(a: Floats) -> Floats:
    """∫₀ᵃ 4 t² exp(−2t) dt = Σ 4 (−2)ᵏ aᵏ⁺³ / (k! (k + 3))."""
    k = np.arange(_SERIES_TERMS)
    factorial = np.array([math.factorial(int(i)) for i in k], np.float64)
    weights = 4.0 * (-2.0) ** k / (factorial * (k + 3.0))
    return np.asarray(np.minimum(a, _SERIES_BELOW)[:, None] ** (k + 3.0) @ weights)


def state_transitions(model: MapErrorModel, step_m: Floats) -> Floats:
    """Transitions (n, 3, 3) of the state over steps (n,) [m] ≥ 0."""
    a = step_m / model.long_m
    fade = np.exp(-a)
    transitions = np.zeros((len(a), STATES, STATES))
    transitions[:, 0, 0] = np.exp(-step_m / model.short_m)
    transitions[:, 1, 1] = (1.0 + a) * fade
    transitions[:, 1, 2] = a * fade
    transitions[:, 2, 1] = -a * fade
    transitions[:, 2, 2] = (1.0 - a) * fade
    return transitions
