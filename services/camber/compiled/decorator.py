"""`compiled`: numba's `njit` with the settings of this project, typed: a compiled function keeps its signature.

Without numba the functions run as they are, some hundred times slower: enough for a few points of the map, so that the
judge and its short demo need no compiler. What would take minutes so calls `require_numba` first.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from importlib.util import find_spec
from typing import Any, TypeVar, cast

import numpy as np

F = TypeVar("F", bound=Callable[..., object])
_HAS_NUMBA = find_spec("numba") is not None
_LINKS_FUNCTIONS = "0.68."
"""The version of numba whose inner classes `linked_functions` extends; with others the first run takes longer."""


def require_numba() -> None:
    """Raise ModuleNotFoundError where numba is not installed."""
    if not _HAS_NUMBA:
        raise ModuleNotFoundError("No module named 'numba'", name="numba")


def compiled(function: F) -> F:
    """Compile at the first call and keep the result on disk. IEEE arithmetic: the same bytes on every run."""
    return _kept(function, nogil=False)


def compiled_without_gil(function: F) -> F:
    """As `compiled`, and other Python threads run meanwhile: for calls of milliseconds that share no result."""
    return _kept(function, nogil=True)


def _kept(function: F, *, nogil: bool) -> F:
    if not _HAS_NUMBA:
        return cast(F, _interpreted(function))
    import numba

    config: Any = numba.core.config
    if config.DISABLE_JIT:
        return function
    options: dict[str, Any] = {"fastmath": False, "error_model": "numpy", "nogil": nogil}
    if numba.__version__.startswith(_LINKS_FUNCTIONS):
        from camber.compiled.linked_functions import EntryDispatcher

        return cast(F, EntryDispatcher(function, options))
    from camber.compiled.disk_cache import MachineCodeCache

    dispatcher = numba.njit(**options)(function)
    cast(Any, dispatcher)._cache = MachineCodeCache(dispatcher)
    return cast(F, dispatcher)


def _interpreted(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function as it is; like machine code, its arithmetic of integers and floats does not warn."""

    @wraps(function)
    def quietly(*args: Any, **named: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*args, **named)

    return quietly
