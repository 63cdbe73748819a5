"""Compiled functions as Python calls them, and as compiled functions call them.

numba makes each function ready to be called from Python and from C: it optimises the function with all that it calls,
generates machine code and wraps it, at every level anew. Most functions of this project are called by compiled ones
alone. Of these only the intermediate code is kept, and linked into the function that Python calls; this one is
optimised as a whole, once. That halves the processor time of the first run, with the same arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher

from camber.compiled.disk_cache import MachineCodeCache
from camber.compiled.parallel_compilation import (
    end_with_part,
    function_name,
    is_interpreted,
    wait_for_other_process,
)

_core: Any = numba.core  # only parts of numba are typed


class EntryDispatcher(CPUDispatcher):
    """A function that Python calls, with its machine code on disk. Compiled functions link another form of it."""

    def __init__(self, function: Callable[..., Any], options: Mapping[str, Any]) -> None:
        # Nothing calls compiled functions from C.
        shared = {"nopython": True, "boundscheck": None, "no_cfunc_wrapper": True, **options}
        super().__init__(function, targetoptions=shared)
        self._linked = _LinkedDispatcher(
            function,
            targetoptions={**shared, "no_cpython_wrapper": True},
            pipeline_class=_LinkedCompiler,
        )
        self._cache = MachineCodeCache(self)

    def _compile_for_args(self, *args: Any, **named: Any) -> Any:
        """Return what is to be called: numba asks for it where there is no machine code in memory."""
        name = function_name(self.py_func)
        if is_interpreted(name):
            return self.py_func
        wait_for_other_process(name)
        compiled = super()._compile_for_args(*args, **named)  # type: ignore[misc]
        end_with_part(name)
        return compiled

    @property
    def _numba_type_(self) -> Any:
        return _core.types.Dispatcher(self._linked)

    def add_overload(self, cres: Any) -> None:
        """Register what was compiled or read; fill in the environments of the functions linked into it."""
        for variable in cres.library._final_module.global_variables:
            environment = _core.environment.lookup_environment(variable.name)
            if environment is not None:
                cres.codegen.set_env(variable.name, environment)
        super().add_overload(cres)


class _LinkedDispatcher(CPUDispatcher):
    """A function that compiled functions call."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Compile for integers, and not again for each constant that is passed."""
        unliteral = _core.types.unliteral
        args = [unliteral(each) for each in args]
        return super().get_call_template(args, {name: unliteral(each) for name, each in kws.items()})


class _LinkedCompiler(Compiler):
    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *others: Any) -> None:
        library = _LinkedLibrary(targetctx.codegen(), "linked")  # type: ignore[no-untyped-call]
        super().__init__(typingctx, targetctx, library, *others)  # type: ignore[no-untyped-call]


class _LinkedLibrary(JITCodeLibrary):
    """Intermediate code that is only linked: no optimisation and no machine code before that."""

    @property
    def codegen(self) -> Any:
        return _NoEnvironments

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


class _NoEnvironments:
    """Stands for the code generator: a function that is only linked has no environment in memory."""

    @staticmethod
    def set_env(env_name: str, env: Any) -> None:
        pass
