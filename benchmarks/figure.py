"""One line of the table of figures, and how a call is timed.

A file of this folder with a function `figures() -> list[Figure]` is an area: `run.py` finds and runs it. Ours and the
peer's are measured in the same run, on the same data, and compared before they are timed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


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


def per_call_us(call: Callable[[], object], *, seconds: float = 0.4) -> float:
    """Microseconds a call, the least of five rounds: the one that was disturbed least."""
    n = 1
    while True:
        began = time.perf_counter()
        for _ in range(n):
            call()
        took = time.perf_counter() - began
        if took > seconds / 10.0:
            break
        n *= 4
    best = took / n
    for _ in range(4):
        began = time.perf_counter()
        for _ in range(n):
            call()
        best = min(best, (time.perf_counter() - began) / n)
    return 1e6 * best
