"""What is compiled at the first run, on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from camber.compiled.compilation_progress import CompilationProgress, watched_by
from camber.tools.options.progress_display import ProgressDisplay


@contextmanager
def compilation_bar(
    functions: int | None, *, quiet: bool = False, begin: Callable[[], None] = lambda: None
) -> Iterator[None]:
    """Show what is compiled within: a progress bar on a terminal, else lines; nothing where all is on disk.

    `functions`: how many the work needs, None where that depends on its input. `begin` is called before the first one
    is compiled.
    """
    with ExitStack() as stack:
        displays: list[ProgressDisplay] = []

        def show(remaining: int | None) -> None:
            if not quiet and not sys.stderr.isatty():
                count = "" if remaining is None else f"{remaining} "
                print(f"compiling {count}functions, once after installation", file=sys.stderr, flush=True)
            display = ProgressDisplay(
                remaining, "function", label="compiling, once after installation", quiet=quiet
            )
            displays.append(stack.enter_context(display))
            begin()

        def advance() -> None:
            for display in displays:
                display.advance()

        with watched_by(CompilationProgress(expected=functions, begin=show, advance=advance)):
            yield
