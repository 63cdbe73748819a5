"""The parts of many mixtures from arrays of matrices: an implementation beside that of `integrity.bounds`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.integrity.protection.protection_level import TailComponent

Floats = NDArray[np.float64]


def horizontal(weight: Floats, mean_m: Floats, covariance_m2: Floats) -> list[TailComponent]:
    """Of horizontal errors: means (n, k, 2), covariances (n, k, 2, 2) east and north."""
    ee, en, nn = covariance_m2[..., 0, 0], covariance_m2[..., 0, 1], covariance_m2[..., 1, 1]
    with np.errstate(invalid="ignore"):  # of infinite ones: seen by `levels_m`
        middle, spread = 0.5 * (ee + nn), np.hypot(0.5 * (ee - nn), en)
        tilt = 0.5 * np.arctan2(2.0 * en, ee - nn)
        c, s = np.cos(tilt), np.sin(tilt)
        along, across = c * mean_m[..., 0] + s * mean_m[..., 1], c * mean_m[..., 1] - s * mean_m[..., 0]
        return in_parts(weight, along, across, middle + spread, middle - spread)


def in_parts(*columns: Floats) -> list[TailComponent]:
    """Of columns (n, k) k parts of arrays (n,)."""
    weight, along, across, larger, smaller = (np.ascontiguousarray(column.T) for column in columns)
    return list(zip(weight, along, across, larger, smaller, strict=True))


def whitened(mean_m: Floats, covariance_m2: Floats) -> tuple[Floats, Floats]:
    """Means and covariances in standard deviations of the first part; not numbers where that has no ellipse."""
    # By the inverse of the lower Cholesky factor [[p, 0], [q, r]] of the first part.
    ee, en, nn = covariance_m2[:, 0, 0, 0], covariance_m2[:, 0, 0, 1], covariance_m2[:, 0, 1, 1]
    good = (ee > 0.0) & (ee * nn > en * en)
    p = np.sqrt(np.where(good, ee, 1.0))
    q = np.where(good, en, np.nan) / p
    r = np.sqrt(np.where(good, nn - q * q, 1.0))
    whitening = np.zeros((len(p), 1, 2, 2))
    whitening[:, 0, 0, 0], whitening[:, 0, 1, 0], whitening[:, 0, 1, 1] = 1.0 / p, -q / (p * r), 1.0 / r
    mean: Floats = (whitening @ mean_m[..., None])[..., 0]
    return mean, whitening @ covariance_m2 @ whitening.swapaxes(-1, -2)
