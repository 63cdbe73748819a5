"""Digest of everything that the machine code of a compiled function depends on.

numba freezes into the code what a function reaches by name: constants, tables, other compiled functions with all
that they reach. Its own cache looks at the function's own file alone, and goes on with the old code where a function
in another file has changed (numba manual, "Notes on Caching"). Here the digest is of the things themselves, not of
files: an edited comment compiles nothing, a constant that comes out differently does.
"""

from __future__ import annotations

import dis
import hashlib
import platform
from collections.abc import Iterable
from enum import Enum
from functools import cache
from importlib.metadata import version
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher

_core: Any = numba.core  # only parts of numba are typed
config, types = _core.config, _core.types
_PLAIN = (type(None), bool, int, float, complex, str, bytes, type(Ellipsis))
# What comes from these is what their version says it is.
_VERSIONED = {"builtins", "math", "cmath", "operator", "_operator", "numpy", "numba"}
_VERSIONS = (platform.python_version(), *(version(name) for name in ("numba", "llvmlite", "numpy")))

_first_flags: dict[int, tuple[CodeType, int]] = {}


class NotKnown(Exception):  # noqa: N818 (the name is the reason)
    """The function reaches a value whose changes this module cannot detect."""


def inputs_digest(dispatcher: Dispatcher[Any], arguments: Iterable[Any] = ()) -> bytes:
    """SHA-256 of everything that compiling `dispatcher` for these argument types reads, but for the processor.

    Those are byte code, constants, defaults, what is reached by global names or from an enclosing function, all of
    that again of each compiled function among it, the options, the fields of named tuples and the versions of Python,
    numba, LLVM and NumPy. Raises NotKnown.
    """
    reached = _Reached()
    tokens = [reached.value(dispatcher), [_type(argument) for argument in arguments]]
    # The list grows while it is walked.
    tokens += [reached.function(function) for function in reached.functions]
    settings = (config.OPT, config.BOUNDSCHECK, config.DEBUGINFO_DEFAULT)
    return hashlib.sha256(repr((_VERSIONS, repr(settings), tokens)).encode()).digest()


class _Reached:
    """Functions by number in the order in which they are met, so that recursion ends."""

    def __init__(self) -> None:
        self.functions: list[FunctionType] = []
        self._number: dict[FunctionType, int] = {}

    def function(self, function: FunctionType) -> list[object]:
        code = function.__code__
        named = function.__globals__
        builtins = vars(__builtins__) if isinstance(__builtins__, ModuleType) else __builtins__
        names = _global_names(code)
        return [
            f"{function.__module__}.{function.__qualname__}",
            self.value(code),
            [
                (n, self.value(named[n] if n in named else builtins[n]))
                for n in names
                if n in named or n in builtins
            ],
            self.value(function.__defaults__),
            self.value(tuple((function.__kwdefaults__ or {}).items())),
            [self.value(cell.cell_contents) for cell in function.__closure__ or ()],
        ]

    def value(self, value: Any) -> object:
        if type(value) in _PLAIN:
            return type(value).__name__, repr(value)
        if isinstance(value, Dispatcher):
            return "compiled", sorted(value.targetoptions.items()), self._numbered(value.py_func)
        if isinstance(value, CodeType):
            return self._code(value)
        if isinstance(value, tuple | frozenset):
            items = [self.value(item) for item in value]
            return _class(type(value)), items if isinstance(value, tuple) else sorted(map(repr, items))
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            content = hashlib.sha256(value.tobytes()).hexdigest()
            return str(value.dtype.descr), value.shape, value.strides, value.flags.writeable, content
        if isinstance(value, np.dtype) and not value.hasobject:
            return "dtype", repr(value)
        if isinstance(value, Enum):
            return _class(type(value)), value.name
        if _is_versioned(value):
            return _without_address(value)
        if isinstance(value, FunctionType):
            return self._numbered(value)
        if isinstance(value, type):
            return _class(value)
        raise NotKnown(f"it reaches {value!r}")

    def _numbered(self, function: FunctionType) -> int:
        if function not in self._number:
            self._number[function] = len(self.functions)
            self.functions.append(function)
        return self._number[function]

    def _code(self, code: CodeType) -> object:
        """Without names of files and numbers of lines."""
        return (
            code.co_code.hex(),
            code.co_exceptiontable.hex(),
            (_flags(code), code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount),
            (code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars),
            [self.value(constant) for constant in code.co_consts],
        )


def _flags(code: CodeType) -> int:
    """As they were before the first call: where a profiler listens, numba then writes others into the code."""
    return _first_flags.setdefault(id(code), (code, code.co_flags))[1]


@cache
def _global_names(code: CodeType) -> tuple[str, ...]:
    """Also of the functions within it."""
    loads = (
        step.argval for step in dis.get_instructions(code) if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")
    )
    within = (_global_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return tuple(sorted({*loads, *(name for names in within for name in names)}))


def _type(of: Any) -> object:
    """numba's name of a type identifies it, apart from the fields of a named tuple."""
    if isinstance(of, types.BaseTuple):
        name_of_type = (
            _class(of.instance_class) if isinstance(of, types.BaseNamedTuple) else type(of).__name__
        )
        return name_of_type, [_type(item) for item in of.types]
    return _without_address(of)


def _class(of: type) -> object:
    name = f"{of.__module__}.{of.__qualname__}"
    if issubclass(of, tuple):
        return name, getattr(of, "_fields", ()), repr(getattr(of, "_field_defaults", {}))
    if issubclass(of, Enum):
        return name, [(member.name, repr(member.value)) for member in of]
    if _is_versioned(of):
        return name
    raise NotKnown(f"it reaches the class {name}")


def _is_versioned(value: Any) -> bool:
    """A module, class, function or type of numba; not what is made of them, like a list."""
    if isinstance(value, types.Type | np.ufunc):
        return True
    name = getattr(value, "__name__", None)
    module = name if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    return name is not None and str(module).partition(".")[0] in _VERSIONED


def _without_address(value: Any) -> str:
    """A name that is the same in the next process."""
    if isinstance(value, ModuleType | np.ufunc):
        return value.__name__
    name_of_type = (
        repr(value) if isinstance(value, types.Type) else f"{value.__module__}.{value.__qualname__}"
    )
    if " at 0x" in name_of_type:
        raise NotKnown(f"it reaches {name_of_type}")
    return name_of_type
