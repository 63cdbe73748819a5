"""Processor time of the first run, with no machine code on disk, beside the same functions compiled by numba's `njit`.

In separate processes with an empty cache. Both print what they computed, which must be the same to the last bit.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile

from figure import Figure, lower

WORK = {
    "engine": "from camber.gnss.warm_up import warm_up; print(warm_up().position_ecef_m.tolist())",
    "scan matching": "from camber.localizer.warm_up import warm_up; print([o.pose for o in warm_up()])",
}
BY_NUMBA = """
import numba
from camber.compiled import linked_functions
linked_functions.EntryDispatcher = lambda function, options: numba.njit(**options)(function)
"""


def measured(script: str) -> tuple[str, float]:
    """Output and processor time in seconds of a process, with those that it starts."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            check=True,
            capture_output=True,
            text=True,
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def figures() -> list[Figure]:
    """For the engine and for scan matching."""
    lines = []
    for name, script in WORK.items():
        output, ours_s = measured(script)
        peer_output, peer_s = measured(BY_NUMBA + script)
        assert output == peer_output
        lines.append(lower(f"first run, {name}", "s", ours_s, peer_s, "numba's njit"))
    return lines
