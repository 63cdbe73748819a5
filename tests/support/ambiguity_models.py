"""Float ambiguities of one epoch, as they are when a moving receiver has only its codes to say where it is.

The model of `Q_a = (Q_φ + G Q_x Gᵀ) / (λ λᵀ)` with satellites drawn at random, for tests, benchmarks and the thresholds
of the ratio test: n double differences of phase that are known to millimetres but for three directions in which only
the code holds them.
"""

from __future__ import annotations

import numpy as np

from camber.formats.observations import CARRIER_OF_BAND_HZ, SPEED_OF_LIGHT_M_S, Floats

_BANDS = ("1", "2", "5")
_LOWEST_RAD, _HIGHEST_RAD = np.radians(15.0), np.radians(85.0)


def float_covariance(
    random: np.random.Generator,
    satellites: int,
    bands: int,
    *,
    code_sigma_m: float = 0.5,
    phase_sigma_m: float = 0.003,
) -> Floats:
    """Covariance (n, n) in cycles², n = bands · (satellites − 1), band after band; at least five satellites.

    Sigmas are of one undifferenced observation in the zenith; they grow with 1 / sin(elevation).
    """
    if satellites < 5 or not 1 <= bands <= len(_BANDS):
        raise ValueError(
            f"{satellites} satellites on {bands} bands, expected at least 5 on 1 to {len(_BANDS)}"
        )
    azimuth_rad = random.uniform(0.0, 2.0 * np.pi, satellites)
    elevation_rad = np.sort(random.uniform(_LOWEST_RAD, _HIGHEST_RAD, satellites))[::-1]
    towards = np.column_stack(
        (
            np.cos(elevation_rad) * np.sin(azimuth_rad),
            np.cos(elevation_rad) * np.cos(azimuth_rad),
            np.sin(elevation_rad),
        )
    )
    differences = np.column_stack((-np.ones(satellites - 1), np.eye(satellites - 1)))
    geometry = -differences @ towards
    # Twice: rover and base.
    cofactor = 2.0 * differences @ np.diag(np.sin(elevation_rad) ** -2) @ differences.T
    normal = bands / code_sigma_m**2 * geometry.T @ np.linalg.solve(cofactor, geometry)
    shared = geometry @ np.linalg.solve(normal, geometry.T)
    wavelengths_m = np.array([SPEED_OF_LIGHT_M_S / CARRIER_OF_BAND_HZ["G"][band] for band in _BANDS[:bands]])
    phases = np.kron(np.diag(wavelengths_m**-2), phase_sigma_m**2 * cofactor)
    covariance = np.kron(np.outer(1.0 / wavelengths_m, 1.0 / wavelengths_m), shared) + phases
    return np.asarray(0.5 * (covariance + covariance.T))


def drawn(random: np.random.Generator, covariance: Floats, count: int) -> Floats:
    """Errors (count, n) of that covariance."""
    root = np.linalg.cholesky(covariance)
    return np.asarray(random.standard_normal((count, covariance.shape[0])) @ root.T)
