"""`python -m support.compiled_calls SERVICE`: compiled functions that a service calls and its warm-up does not.

Whatever is called from Python for the first time while a vehicle drives is compiled then, for seconds, and in a
read-only container after every start. Also one that compiled functions call: what they link is not made for Python.
The number of functions that is shown at the first start must be right, too.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType

from numba.core.dispatcher import Dispatcher

from camber.compiled.compilation_progress import CompilationProgress, watched_by

NOT_WHILE_DRIVING = {
    "_read_epochs": "RINEX comes from files: a pause harms nobody",
    "_biweights": "asked in analyses, not by the service",
    "_heights": "of map_update, and warmed up there",
}


def main(service: str) -> int:
    """1 where there is one; each is a line of the output."""
    package = importlib.import_module(f"camber.{service}")
    warm_up = importlib.import_module(f"camber.{service}.warm_up")
    importlib.import_module(f"camber.{service}.service")
    of_service = [
        importlib.import_module(module.name)
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
        if not module.name.endswith("__main__")
    ]
    shared_folders = ("camber.formats.", "camber.road_map.", "camber.geodesy.")
    shared = [module for name, module in sys.modules.items() if name.startswith(shared_folders)]
    progress = CompilationProgress(expected=None, begin=lambda functions: None, advance=lambda: None)
    with watched_by(progress):
        warm_up.warm_up(**({"carried": True} if service == "gnss" else {}))
        if hasattr(warm_up, "compile_readers"):
            warm_up.compile_readers()
    called = {each: by for module in (*of_service, *shared) for each, by in _calls(module)}
    missing = [
        f"{each.py_func.__module__}.{each.py_func.__name__}, called by {by}"
        for each, by in called.items()
        if not each.signatures and each.py_func.__name__ not in NOT_WHILE_DRIVING
    ]
    count = progress.read + progress.compiled
    if count != warm_up.FUNCTIONS:
        missing.append(f"{warm_up.__name__}.FUNCTIONS is {warm_up.FUNCTIONS}, expected {count}")
    print("\n".join(missing) or f"{len(called)} compiled functions are called")
    return 1 if missing or not called else 0


def _calls(module: ModuleType) -> Iterator[tuple[Dispatcher, str]]:
    """Compiled functions whose names stand in the functions of Python of a module."""
    for function in _functions(module):
        for code in _codes(function.__code__):
            for name in code.co_names:
                value = function.__globals__.get(name)
                if isinstance(value, Dispatcher):
                    yield value, f"{module.__name__}.{function.__qualname__}"


def _functions(module: ModuleType) -> Iterator[FunctionType]:
    for value in vars(module).values():
        if getattr(value, "__module__", "") != module.__name__:
            continue
        if isinstance(value, FunctionType):
            yield value
        elif isinstance(value, type):
            for member in vars(value).values():
                plain = getattr(member, "__func__", getattr(member, "fget", member))
                if isinstance(plain, FunctionType):
                    yield plain


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1]))
