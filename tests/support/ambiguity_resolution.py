"""Integer ambiguity resolution with acceptance tests that are off unless a test asks for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.gnss.ambiguity.ambiguity_resolution import FixCriteria, Resolution, resolve

_OFF = FixCriteria(
    least_ratio=0.0, least_success_rate=0.0, least_fixed=1, partial=False, failure_rate=0.0, most_nodes=10_000
)


def resolved(
    floats: NDArray[np.float64], covariance: NDArray[np.float64], **criteria: float | bool
) -> Resolution:
    """`resolve` of float ambiguities (n,) with covariance (n, n)."""
    return resolve(floats, covariance, _OFF._replace(**criteria))
