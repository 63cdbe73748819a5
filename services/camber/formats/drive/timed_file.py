"""A recording of timed items, read as far as its time has come."""

from __future__ import annotations

from collections import Counter, deque
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from camber.formats.errors import FormatError

_CHUNK_BYTES = 1 << 16
_MOST_AT_ONCE = 4096
_MOST_DAMAGES = 1000  # one after the other
_BACK_NS = 1_000_000_000  # by so much items may be out of order; more is a clock that was set


class Timed(Protocol):
    """`time_ns`: UTC, nanoseconds since 1970."""

    @property
    def time_ns(self) -> int:
        """When it was recorded."""


T = TypeVar("T", bound=Timed)


class Decoder(Protocol[T]):
    """Of a stream of bytes; `skipped` counts what is passed over, by reason."""

    skipped: Counter[str]

    def feed(self, data: bytes) -> list[T | FormatError]:
        """What is complete with these bytes."""

    def finish(self) -> list[T | FormatError]:
        """What is left at the end."""


class TimedFile(Generic[T]):
    """Items in the file's order; `ended` once all were handed out. Raises OSError where it cannot be read.

    A file with a thousand damages one after the other is none of this kind, and is read no further.
    """

    def __init__(self, path: Path, decoder: Decoder[T]) -> None:
        self.name = path.name
        self.skipped = decoder.skipped
        self._file = path.open("rb")
        self._decoder = decoder
        self._items: deque[T | FormatError] = deque()
        self._read_all = False
        self._damages = 0
        self._newest_ns: int | None = None

    @property
    def ended(self) -> bool:
        """Nothing more comes."""
        self._read_on()
        return not self._items

    def first_ns(self) -> int | None:
        """The time of the next item; None where there is none."""
        self._read_on()
        return next((item.time_ns for item in self._items if not isinstance(item, FormatError)), None)

    @property
    def steps_back(self) -> bool:
        """Is the next item from before those that were handed out? It waits for `go_on`."""
        first_ns = self.first_ns()
        return first_ns is not None and self._is_back(first_ns)

    def _is_back(self, time_ns: int) -> bool:
        return self._newest_ns is not None and time_ns < self._newest_ns - _BACK_NS

    def go_on(self) -> None:
        """With the next item, whatever its time."""
        self._newest_ns = None

    def due(self, until_ns: int) -> list[T | FormatError]:
        """All items up to one that is later than this, or before which the time steps back; some thousands at most."""
        found: list[T | FormatError] = []
        while len(found) < _MOST_AT_ONCE and not self.ended:
            item = self._items[0]
            if not isinstance(item, FormatError):
                if item.time_ns > until_ns or self._is_back(item.time_ns):
                    break
                self._newest_ns = max(item.time_ns, self._newest_ns or item.time_ns)
            found.append(self._items.popleft())
        return found

    def close(self) -> None:
        """Close it."""
        self._file.close()

    def _read_on(self) -> None:
        while not self._read_all and all(isinstance(item, FormatError) for item in self._items):
            data = self._file.read(_CHUNK_BYTES)
            self._read_all = not data
            for item in self._decoder.feed(data) if data else self._decoder.finish():
                self._items.append(item)
                self._damages = self._damages + 1 if isinstance(item, FormatError) else 0
                if self._damages == _MOST_DAMAGES:
                    expected = (
                        f"a recording of this kind; read no further after {_MOST_DAMAGES} damages together"
                    )
                    self._items.append(FormatError(self.name, "content", expected))
                    self._read_all = True
                    return
