"""At the first run a second process compiles a part of the functions at the same time.

The second process does the same work on the same synthetic input, which gives each function the types of its arguments.
It compiles only the functions of its part; the others run there as Python, since the work is small. The first process
waits where it reaches a function of that part, and reads it from disk.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from camber.compiled.compilation_progress import CompilationProgress, watched_by

_PART_VARIABLE = "CAMBER_COMPILE_PART"
"""In the environment of the second process: names of the functions that it compiles."""
_part = frozenset(filter(None, os.environ.get(_PART_VARIABLE, "").split(",")))
_remaining = set(_part)
_other_processes: list[_OtherProcess] = []


class _OtherProcess:
    """Runs a module that compiles some functions, `module.name` below `camber`."""

    def __init__(self, module: str, functions: frozenset[str]) -> None:
        self.functions = functions
        self.module = module
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, _: int | None) -> None:
        """Start it, where there is a processor for it and it is not that process itself."""
        if _part or usable_processors() < 2:
            return
        environment = {**os.environ, _PART_VARIABLE: ",".join(sorted(self.functions))}
        nothing = subprocess.DEVNULL
        self._process = subprocess.Popen(
            [sys.executable, "-m", self.module],
            stdin=nothing,
            stdout=nothing,
            stderr=nothing,
            env=environment,
        )

    def wait(self) -> None:
        """Wait until it has ended, however that was: what is not on disk then is compiled by this process."""
        if self._process is not None:
            self._process.wait()

    def end(self) -> None:
        """End it where the work has ended before, by an error."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()


@contextmanager
def compiled_in_parallel(module: str, functions: frozenset[str]) -> Iterator[None]:
    """Within, `python -m module` compiles some `functions` where any that is called is not on disk.

    They are named as `function_name` does. The module must do the same work as what is within. Within another of the
    same module nothing is started.
    """
    if any(other.module == module for other in _other_processes):
        yield
        return
    other = _OtherProcess(module, functions)
    _other_processes.append(other)
    try:
        with watched_by(CompilationProgress(expected=None, begin=other.start, advance=lambda: None)):
            yield
    finally:
        _other_processes.remove(other)
        other.end()


def usable_processors() -> int:
    """Return how many processors this process may use; all of the machine where the system does not say."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def function_name(function: Callable[..., Any]) -> str:
    """Return module and name of a function, without `camber.`."""
    return f"{function.__module__}.{function.__qualname__}".removeprefix("camber.")


def is_interpreted(name: str) -> bool:
    """Return whether this process compiles a part of the functions that does not contain this one."""
    return bool(_part) and name not in _part


def end_with_part(name: str) -> None:
    """End this process where a function was the last of the part that it compiles."""
    _remaining.discard(name)
    if _part and not _remaining:
        raise SystemExit(0)


def wait_for_other_process(name: str) -> None:
    """Wait where another process compiles a function."""
    for other in _other_processes:
        if name in other.functions:
            other.wait()
