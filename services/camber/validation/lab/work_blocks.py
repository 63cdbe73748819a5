"""Blocks of work on several processes.

Each block has its own random streams, by its name, and results are joined in the blocks' order: how many processes
there are changes nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Any, ClassVar, Self

import numpy as np

from camber.integrity.rules import Rules
from camber.simulator.random_streams import stream


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkBlock:
    """One block: so many random skies, so many repeats of each, judged by the rules."""

    seed: int
    number: int
    skies: int = 400
    repeats: int = 1
    rules: Rules = field(default_factory=Rules)

    def stream(self, name: str) -> np.random.Generator:
        """The block's stream of this name."""
        return stream(self.seed, f"lab/{name}/{self.number}")


class AddingUp:
    """Counts of a block, to which those of the next are added."""

    __slots__: ClassVar[tuple[str, ...]] = ()

    def add(self, other: Self) -> None:
        """Add another block's counts."""
        for name in self.__slots__:
            setattr(self, name, getattr(self, name) + getattr(other, name))


Results = Callable[[Sequence[Callable[[], Any]]], Iterator[Any]]


@contextmanager
def workers(processes: int) -> Iterator[Results]:
    """Yields what calls functions (partials of a module's) and returns their results in order."""
    if processes <= 1:
        yield lambda tasks: map(_result, tasks)
        return
    # Small matrices gain nothing from more threads, and processes are what the cores are for.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        yield lambda tasks: pool.map(_result, tasks)


def _result(task: Callable[[], Any]) -> Any:
    return task()
