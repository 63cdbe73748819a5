"""The road's texture under the wheels: what shakes a vehicle on a surface that a map calls smooth.

ISO 8608 gives the one-sided spectrum of a track's height as G(n) = G₀ (n / n₀)⁻² with n₀ = 0.1 cycles a metre; class A
(very good) has G₀ = 16e-6 m³, class B 64e-6 m³. Waves longer than some 10 m belong to the surface itself. A process of
first order with length ℓ and deviation σ has 4 σ² ℓ / (1 + (2π n ℓ)²): the same for short waves if σ² = π² ℓ G₀ n₀²,
and level for long ones. Each track is averaged over the tyre's contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from camber.replay.surrogates import correlated_noise
from camber.simulator.random_streams import stream
from camber.simulator.scene import Floats

_LENGTH_M = 1.6  # 10 m / 2π
_STEP_M = 0.05
_CONTACT_STEPS = 5
_REFERENCE_CYCLES_M = 0.1
_MARGIN_M = 10.0


@dataclass(frozen=True, slots=True)
class Roughness:
    """`spectrum_m3` is G₀ of ISO 8608; the left and the right track are drawn apart."""

    seed: int
    spectrum_m3: float = 16.0e-6

    @property
    def sigma_m(self) -> float:
        """Of a track's height before the contact's average."""
        return math.pi * math.sqrt(_LENGTH_M * self.spectrum_m3) * _REFERENCE_CYCLES_M

    def height_m(self, side: str, distance_m: Floats) -> Floats:
        """Height (n,) of a track, `left` or `right`, above the smooth road after distances (n,)."""
        count = int((float(distance_m.max()) + 2.0 * _MARGIN_M) / _STEP_M) + _CONTACT_STEPS
        at_m: Floats = _STEP_M * np.arange(count, dtype=np.float64) - _MARGIN_M
        rng = stream(self.seed, f"road roughness {side}")
        track = correlated_noise(at_m, self.sigma_m, _LENGTH_M, rng)
        smooth = np.convolve(track, np.full(_CONTACT_STEPS, 1.0 / _CONTACT_STEPS), mode="same")
        return np.interp(distance_m, at_m, smooth)
