"""Blocks of work on several processes.

Each block has its own random streams, by its name, and results are joined in the blocks' order: how many processes
there are changes nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any


@dataclass(frozen=True, slots=True)
class Task:
    """A function of a module, and what it is called with."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]


Results = Callable[[Sequence[Task]], Iterator[Any]]


@contextmanager
def workers(processes: int) -> Iterator[Results]:
    """What gives the results of tasks, in their order; with one process it is this one."""
    if processes <= 1:
        yield lambda tasks: map(_done, tasks)
        return
    # Small matrices gain nothing from more threads, and processes are what the cores are for.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        yield lambda tasks: pool.map(_done, tasks)


def _done(task: Task) -> Any:
    return task.function(*task.arguments)
