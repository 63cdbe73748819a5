"""Array types of the localizer, and checks of arguments that name the one at fault."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]


def require_finite(**values: float | None) -> None:
    """ValueError naming the first value that is neither finite nor None."""
    for name, value in values.items():
        if value is not None and not math.isfinite(value):
            raise ValueError(f"{name}: must be finite; got {value}")


def require_array(name: str, value: Floats, shape: tuple[int, ...]) -> None:
    """ValueError naming the argument unless it has this shape and every element is finite."""
    if np.shape(value) != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {np.shape(value)}")
    if not np.isfinite(value).all():
        raise ValueError(f"{name}: every element must be finite")


def require_covariance(name: str, value: Floats, size: int) -> None:
    """ValueError naming the argument unless it is a finite, symmetric, positive definite matrix."""
    require_array(name, value, (size, size))
    if np.abs(value - value.T).max() > 1e-6 * np.abs(value).max():
        raise ValueError(f"{name}: must be symmetric")
    if not np.linalg.eigvalsh(value)[0] > 0.0:
        raise ValueError(f"{name}: must be positive definite")
