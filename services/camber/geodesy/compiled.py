"""`compiled`: numba's `njit` with the settings of this project, typed: a compiled function keeps its signature."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile at the first call and keep the result on disk. IEEE arithmetic: the same bytes on every run."""
    return cast(F, numba.njit(cache=True, fastmath=False, error_model="numpy")(function))


def compiled_without_gil(function: F) -> F:
    """As `compiled`, and other Python threads run meanwhile: for calls of milliseconds that share no result."""
    return cast(F, numba.njit(cache=True, fastmath=False, error_model="numpy", nogil=True)(function))
