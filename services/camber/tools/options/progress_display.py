"""How far a long command is, on standard error: a bar on a terminal, else a line now and then."""

from __future__ import annotations

import sys
import time
from typing import Any, Self

from tqdm import tqdm

_LINE_EVERY_S = 10.0  # chosen: a log stays short, and nobody waits longer for a sign of life


class ProgressDisplay:
    """Use as a context and call `advance` after each step; nothing is shown where `quiet`.

    `total`: number of steps, None where it is not known; `unit`: of one step; `label`: what is done.
    """

    def __init__(self, total: int | None, unit: str, *, label: str = "", quiet: bool = False) -> None:
        self._total, self._unit, self._label = total, unit, label
        self._done, self._began_s = 0, time.monotonic()
        self._next_line_s = self._began_s + _LINE_EVERY_S
        self._quiet = quiet
        self._bar: Any = None
        if not quiet and sys.stderr.isatty():
            self._bar = tqdm(total=total, unit=unit, desc=label or None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def advance(self) -> None:
        """Count a step."""
        self._done += 1
        if self._bar is not None:
            self._bar.update()
        elif not self._quiet and time.monotonic() >= self._next_line_s:
            self._print_line()

    def describe(self, label: str) -> None:
        """Say what is done next."""
        self._label = label
        if self._bar is not None:
            self._bar.set_description(label, refresh=False)

    def _print_line(self) -> None:
        now_s = time.monotonic()
        self._next_line_s = now_s + _LINE_EVERY_S
        label = f"{self._label}: " if self._label else ""
        of_total = "" if self._total is None else f" of {self._total:,}"
        line = f"{label}{self._done:,}{of_total} {self._unit}s, {now_s - self._began_s:.0f} s"
        print(line, file=sys.stderr, flush=True)
