"""Progress of compilation, to be shown. Machine code is kept on disk: it concerns the first run only."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(slots=True, kw_only=True)
class CompilationProgress:
    """Counts functions that Python calls, which are read from disk or compiled.

    `expected` are all that the work needs, None where that depends on its input. Before the first one is compiled
    `begin` is called with the number of those that remain, and `advance` after each of them. Nothing is called where
    all are on disk.
    """

    expected: int | None
    begin: Callable[[int | None], None]
    advance: Callable[[], None]
    read: int = 0
    compiled: int = 0
    _begun: bool = False

    def on_read(self) -> None:
        """Count a function that was read from disk."""
        self.read += 1
        if self._begun:
            self.advance()

    def on_missing(self) -> None:
        """Note that a function is about to be compiled."""
        if not self._begun:
            self._begun = True
            self.begin(None if self.expected is None else max(self.expected - self.read, 1))

    def on_compiled(self) -> None:
        """Count a function that was compiled."""
        self.compiled += 1
        self.advance()


_watching: list[CompilationProgress] = []


@contextmanager
def watched_by(progress: CompilationProgress) -> Iterator[None]:
    """Let `progress` count what is read or compiled within."""
    _watching.append(progress)
    try:
        yield
    finally:
        _watching.remove(progress)


def watchers() -> tuple[CompilationProgress, ...]:
    """Return those who count now."""
    return tuple(_watching)
