"""`compiled`: numba's `njit` with the settings of this project, typed: a compiled function keeps its signature."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.dispatcher import Dispatcher

from camber.compiled.disk_cache import MachineCodeCache

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Compile at the first call and keep the result on disk. IEEE arithmetic: the same bytes on every run."""
    return _kept(function, nogil=False)


def compiled_without_gil(function: F) -> F:
    """As `compiled`, and other Python threads run meanwhile: for calls of milliseconds that share no result."""
    return _kept(function, nogil=True)


def _kept(function: F, *, nogil: bool) -> F:
    dispatcher = numba.njit(fastmath=False, error_model="numpy", nogil=nogil)(function)
    # With NUMBA_DISABLE_JIT it is the function itself.
    if isinstance(dispatcher, Dispatcher):
        cast(Any, dispatcher)._cache = MachineCodeCache(dispatcher)
    return cast(F, dispatcher)
