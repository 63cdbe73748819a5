"""What is compiled at the first run, on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

from camber.compiled.compilation_progress import CompilationProgress, watched_by


@contextmanager
def compilation_bar(functions: int | None, *, quiet: bool = False) -> Iterator[None]:
    """Show what is compiled within: a progress bar on a terminal, else one line; nothing where all is on disk.

    `functions`: how many the work needs, None where that depends on its input.
    """
    if quiet:
        yield
        return
    bars: list[Any] = []

    def begin(remaining: int | None) -> None:
        if sys.stderr.isatty():
            bars.append(tqdm(total=remaining, unit="function", desc="compiling, once after installation"))
        else:
            count = "" if remaining is None else f"{remaining} "
            print(f"compiling {count}functions, once after installation", file=sys.stderr, flush=True)

    def advance() -> None:
        for bar in bars:
            bar.update()

    try:
        with watched_by(CompilationProgress(expected=functions, begin=begin, advance=advance)):
            yield
    finally:
        for bar in bars:
            bar.close()
