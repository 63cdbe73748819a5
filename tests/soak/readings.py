"""What a process holds, and whether it holds more and more: memory, file descriptors, threads; from /proc."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """Of one process at one time. USS is what would be free if it ended; PSS counts shared pages by share."""

    at_s: float
    uss_mb: float
    pss_mb: float
    descriptors: int
    threads: int
    cpu_s: float


def read(pid: int, at_s: float) -> Reading:
    """Raises OSError where the process has ended."""
    proc = Path("/proc") / str(pid)
    kb = dict.fromkeys(("Pss", "Private_Clean", "Private_Dirty"), 0)
    for line in (proc / "smaps_rollup").read_text().splitlines()[1:]:
        name, _, rest = line.partition(":")
        if name in kb:
            kb[name] = int(rest.split()[0])
    words = (proc / "stat").read_text().rpartition(")")[2].split()
    return Reading(
        at_s,
        (kb["Private_Clean"] + kb["Private_Dirty"]) / 1024,
        kb["Pss"] / 1024,
        len(list((proc / "fd").iterdir())),
        int(words[17]),
        (int(words[11]) + int(words[12])) / 100.0,
    )


def busy_s() -> float:
    """Processor time that this machine has spent on anything, all processors together."""
    words = Path("/proc/stat").read_text().splitlines()[0].split()[1:]
    user, nice, system, _idle, _waiting, irq, soft, *_ = (int(word) for word in words)
    return (user + nice + system + irq + soft) / 100.0


def growth(at_s: Sequence[float], values: Sequence[float]) -> float:
    """How much a quantity grows from the first time to the last, by the median of the slopes of all pairs (Theil, Sen).

    One step, or a third of the readings astray, moves it little: what grows all the time does.
    """
    x, y = np.asarray(at_s, np.float64), np.asarray(values, np.float64)
    if len(x) < 2:
        return 0.0
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])) * (x[-1] - x[0]))


def lasting_growth(values: Sequence[int]) -> int:
    """By how much the smallest of the last third exceeds the largest of the first: what comes and goes is none."""
    third = len(values) // 3
    if third == 0:
        return 0
    return max(min(values[-third:]) - max(values[:third]), 0)
