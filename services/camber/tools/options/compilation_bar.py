"""What is compiled at the first run, on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

from camber.compiled.compilation_progress import CompilationProgress, watched_by


@contextmanager
def compilation_bar(
    functions: int | None, *, quiet: bool = False, begin: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Show what is compiled within: a progress bar on a terminal, else one line; nothing where all is on disk.

    `functions`: how many the work needs, None where that depends on its input. `begin` is called before the first one
    is compiled.
    """
    bars: list[Any] = []

    def show(remaining: int | None) -> None:
        if not quiet and sys.stderr.isatty():
            bars.append(tqdm(total=remaining, unit="function", desc="compiling, once after installation"))
        elif not quiet:
            count = "" if remaining is None else f"{remaining} "
            print(f"compiling {count}functions, once after installation", file=sys.stderr, flush=True)
        begin()

    def advance() -> None:
        for bar in bars:
            bar.update()

    try:
        with watched_by(CompilationProgress(expected=functions, begin=show, advance=advance)):
            yield
    finally:
        for bar in bars:
            bar.close()
