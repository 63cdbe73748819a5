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
    fields = (proc / "stat").read_text().rpartition(")")[2].split()
    return Reading(
        at_s,
        (kb["Private_Clean"] + kb["Private_Dirty"]) / 1024,
        kb["Pss"] / 1024,
        len(list((proc / "fd").iterdir())),
        int(fields[17]),
        (int(fields[11]) + int(fields[12])) / 100.0,
    )


def busy_s() -> float:
    """Processor time that this machine has spent on anything, all processors together."""
    fields = Path("/proc/stat").read_text().splitlines()[0].split()[1:]
    user, nice, system, _idle, _waiting, irq, soft, *_ = (int(field) for field in fields)
    return (user + nice + system + irq + soft) / 100.0


def growth(at_s: Sequence[float], values: Sequence[float]) -> float:
    """How much a quantity grows from the first time to the last: the larger of two answers.

    By the median of the slopes of all pairs (Theil, Sen), which sees what grows all the time; by the medians of the
    first and the last quarter, which see a step that stays and what has begun to grow late. Neither sees a peak.
    """
    x, y = np.asarray(at_s, np.float64), np.asarray(values, np.float64)
    if len(x) < 2:
        return 0.0
    i, j = np.triu_indices(len(x), 1)
    slope = float(np.median((y[j] - y[i]) / (x[j] - x[i])) * (x[-1] - x[0]))
    quarter = max(len(y) // 4, 1)
    return max(slope, float(np.median(y[-quarter:]) - np.median(y[:quarter])))


def lasting_growth(values: Sequence[int]) -> int:
    """By how much what is nearly always held at the end exceeds that of the begin: what comes and goes is none.

    The tenth part of a third that holds least is left out, so that neither one peak nor one dip hides a leak.
    """
    third = len(values) // 3
    if third == 0:
        return 0
    first, last = (int(np.percentile(of, 10, method="lower")) for of in (values[:third], values[-third:]))
    return max(last - first, 0)
