"""Covariances that a receiver reports in single precision, checked."""

from __future__ import annotations

import numpy as np

from camber.geodesy.covariance import EnuCovariance


def reported_covariance(covariance: EnuCovariance) -> EnuCovariance | None:
    """Return (ee, en, eu, nn, nu, uu); None for all zeros.

    ValueError for no covariance, beyond the rounding of single precision.
    """
    ee, en, eu, nn, nu, uu = covariance
    matrix = np.array([[ee, en, eu], [en, nn, nu], [eu, nu, uu]])
    trace = ee + nn + uu
    if not (np.isfinite(matrix).all() and min(ee, nn, uu) >= 0.0 and trace < 1e18):
        raise ValueError(f"covariance {covariance}")
    if trace == 0.0:
        return None
    if np.linalg.eigvalsh(matrix)[0] < -1e-6 * trace:
        raise ValueError(f"covariance {covariance} is not positive semidefinite")
    return covariance
