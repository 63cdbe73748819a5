"""One line of the table of figures, and how a call is timed.

A file of this folder with a function `figures() -> list[Figure]` is an area: `run.py` finds and runs it. Ours and the
peer's are measured in the same run, on the same data, and compared before they are timed. After this import the helpers
of the tests can be imported too.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))


@dataclass(frozen=True)
class Figure:
    """One line of the table; ratio > 1: Camber is better."""

    name: str
    unit: str
    ours: float
    peer: float
    peer_name: str
    ratio: float


def lower(name: str, unit: str, ours: float, peer: float, peer_name: str) -> Figure:
    """A figure of which less is better."""
    return Figure(name, unit, ours, peer, peer_name, peer / ours)


def higher(name: str, unit: str, ours: float, peer: float, peer_name: str) -> Figure:
    """A figure of which more is better."""
    return Figure(name, unit, ours, peer, peer_name, ours / peer)


def percentiles(
    name: str, unit: str, ours: Sequence[float], peer: Sequence[float] | float, peer_name: str
) -> list[Figure]:
    """Median and 99th percentile of times, of both; a goal is one number."""
    return [
        lower(f"{name}, p{q}", unit, float(np.percentile(ours, q)), float(np.percentile(peer, q)), peer_name)
        for q in (50, 99)
    ]


def least_s(
    call: Callable[[], object], *, rounds: int = 5, clock: Callable[[], float] = time.process_time
) -> float:
    """Seconds of a call, by default of the processor, the least of some rounds: the one that was disturbed least."""
    spent = []
    for _ in range(rounds):
        began = clock()
        call()
        spent.append(clock() - began)
    return min(spent)


def per_call_us(call: Callable[[], object], *, seconds: float = 0.4) -> float:
    """Microseconds a call, the least of five rounds, each of so many calls that it takes a tenth of `seconds`."""
    n = 1

    def calls() -> None:
        for _ in range(n):
            call()

    while (first := least_s(calls, rounds=1, clock=time.perf_counter)) <= seconds / 10.0:
        n *= 4
    return 1e6 * min(first, least_s(calls, rounds=4, clock=time.perf_counter)) / n


def camber(*arguments: object, timeout_s: float) -> None:
    """`camber …`, to its end. Raises CalledProcessError where it fails."""
    command = [sys.executable, "-m", "camber.cli", *map(str, arguments)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL, timeout=timeout_s)
