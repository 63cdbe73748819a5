"""Residuals of a vehicle that drives straight over links of 200 m, surfaces of 50 m, ten a second, at 10 m/s."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.integrity.learning.height_correction import Learning
from camber.integrity.learning.residuals import FixResidual, ReferenceKey
from camber.road_map.map_error_model import MAP_ERRORS, MapErrorModel

START_NS = 1_400_000_000 * 1_000_000_000
SPEED_M_S, RATE_HZ, SURFACE_M, LINK_M = 10.0, 10, 50.0, 200.0
EARTH_M = 6_350_000.0
"""Of the meridian there, a little too small: twenty metres are a little more."""
KEY = ReferenceKey(antenna="stroke", base="engine:WGS84", map_version=3)


def residual(epoch: float = 0, **changes: Any) -> FixResidual:
    """A right fix of an epoch; the pose is that of a scan match."""
    driven_m = SPEED_M_S * epoch / RATE_HZ
    fields: dict[str, Any] = {
        "time_ns": START_NS + round(epoch / RATE_HZ * 1e9),
        "verdict": "confirmed",
        "latitude_rad": 0.6 + driven_m / EARTH_M,
        "longitude_rad": 2.4,
        "up_m": 0.0,
        "fix_sigma_m": 0.05,
        "map_sigma_m": 0.05,
        "east_m": 0.0,
        "north_m": 0.0,
        "horizontal_sigma_m": 0.1,
        "surface_id": int(driven_m // SURFACE_M),
        "link_id": int(driven_m // LINK_M),
        "speed_m_s": SPEED_M_S,
        "key": KEY,
    }
    return FixResidual(**fields | changes)


def gauss_markov(rng: np.random.Generator, n: int, sigma: float, memory: float) -> np.ndarray:
    """(n,) of standard deviation sigma, each the one before times `memory` and something new."""
    values = rng.normal(0.0, sigma, n)
    values[1:] *= np.sqrt(1.0 - memory**2)
    for i in range(1, n):
        values[i] += memory * values[i - 1]
    return values


@dataclass(frozen=True)
class Noise:
    """What a drive's differences are made of besides its offset."""

    map_sigma_m: float = 0.05
    map_errors: MapErrorModel = MAP_ERRORS
    wrong: float = 0.05
    wrong_s: float = 1.0
    gate_m: float = 0.3


def drive(
    learning: Learning, seed: int, seconds: float, offset_m: float, noise: Noise, drift_m_s: float = 0.0
) -> Iterator[float]:
    """Give a noisy drive to a learning; returns the correction in force after each fix.

    Wrong fixes come in episodes and lie anywhere; what is within the gate is confirmed, wrong ones too.
    """
    rng, n = np.random.default_rng(seed), int(seconds * RATE_HZ)
    driven_m = SPEED_M_S / RATE_HZ * np.arange(n)
    up_m = offset_m + drift_m_s * np.arange(n) / RATE_HZ
    up_m -= noise.map_errors.simulate(driven_m, noise.map_sigma_m, rng)
    up_m += rng.normal(0.0, 0.01, n)
    for begin, length in _episodes(rng, n, noise):
        up_m[begin : begin + length] += rng.normal(0.0, 0.5)
    for epoch, up in enumerate(up_m.tolist()):
        before_m = learning.correction(KEY).correction_m
        word = "confirmed" if abs(up - before_m) <= noise.gate_m else "erroneous"
        learning.update(residual(epoch, up_m=up, verdict=word, map_sigma_m=noise.map_sigma_m))
        yield learning.correction(KEY).correction_m


def _episodes(rng: np.random.Generator, n: int, noise: Noise) -> Iterator[tuple[int, int]]:
    length = noise.wrong_s * RATE_HZ
    for _ in range(int(rng.poisson(noise.wrong * n / length))):
        yield int(rng.integers(0, n)), 1 + int(rng.exponential(length))
