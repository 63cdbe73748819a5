"""Integer ambiguity resolution with acceptance tests that are off unless a test asks for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.gnss.ambiguity.resolution import FixCriteria, Resolution, resolve


def resolved(
    floats: NDArray[np.float64],
    covariance: NDArray[np.float64],
    *,
    least_ratio: float = 0.0,
    least_success_rate: float = 0.0,
    least_fixed: int = 1,
    partial: bool = False,
    failure_rate: float = 0.0,
    most_nodes: int = 10_000,
) -> Resolution:
    """`resolve` of float ambiguities (n,) with covariance (n, n)."""
    criteria = FixCriteria(
        least_ratio=least_ratio,
        least_success_rate=least_success_rate,
        least_fixed=least_fixed,
        partial=partial,
        failure_rate=failure_rate,
        most_nodes=most_nodes,
    )
    return resolve(floats, covariance, criteria)
