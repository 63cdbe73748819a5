"""Compile what several services need, by several processes that share the machine code on disk."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from types import ModuleType

from camber.compiled.parallel_compilation import usable_processors
from camber.tools.options.compilation_bar import compilation_bar


def warm_up_all(modules: Sequence[ModuleType], functions: int, *, quiet: bool = False) -> None:
    """Call the `warm_up` of each module, with a bar over all their `functions`.

    Before the first function is compiled a process is started for each module that comes later. Its functions are
    then read from disk here. The module that takes longest should come first.
    """
    later = list(modules)
    processes: dict[ModuleType, subprocess.Popen[bytes]] = {}

    def begin() -> None:
        if usable_processors() > 1:
            processes.update((module, _started(module)) for module in later)

    try:
        with compilation_bar(functions, quiet=quiet, begin=begin):
            for module in modules:
                later.remove(module)
                if module in processes:
                    processes[module].wait()
                module.warm_up()
    finally:
        for process in processes.values():
            process.kill()
            process.wait()


def _started(module: ModuleType) -> subprocess.Popen[bytes]:
    """Whatever fails there is compiled here, with its message."""
    nothing = subprocess.DEVNULL
    command = [sys.executable, "-m", module.__name__]
    return subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing)
