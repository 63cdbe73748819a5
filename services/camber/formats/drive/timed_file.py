"""A recording of timed items, read up to a time."""

from __future__ import annotations

from collections import Counter, deque
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from camber.formats.errors import FormatError

_CHUNK_BYTES = 1 << 16  # chosen: memory of a file reader
_MOST_AT_ONCE = 4096  # chosen: bounds one call
_MOST_DAMAGES = 1000  # chosen: so many in a row are another format
_BACK_NS = 1_000_000_000  # chosen: items may be out of order by so much; more is a clock that was set


class TimedItem(Protocol):
    """`time_ns`: UTC, nanoseconds since 1970."""

    @property
    def time_ns(self) -> int:
        """Time of recording."""


T = TypeVar("T", bound=TimedItem)


class Decoder(Protocol[T]):
    """Decoder of a byte stream; `skipped` counts ignored items by reason."""

    skipped: Counter[str]

    def feed(self, data: bytes) -> list[T | FormatError]:
        """Return the items that these bytes complete."""

    def finish(self) -> list[T | FormatError]:
        """Return the remaining items at the end."""


class TimedFile(Generic[T]):
    """Items in the file's order; `ended` once all were returned. Raises OSError where it cannot be read.

    After a thousand damaged items in a row, a file of another format, reading ends.
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
        """Whether all items were returned."""
        self._read_on()
        return not self._items

    def first_ns(self) -> int | None:
        """Return the time of the next item; None at the end."""
        self._read_on()
        return next((item.time_ns for item in self._items if not isinstance(item, FormatError)), None)

    @property
    def steps_back(self) -> bool:
        """Whether the next item is earlier than the returned ones; it waits for `go_on`."""
        first_ns = self.first_ns()
        return first_ns is not None and self._is_back(first_ns)

    def _is_back(self, time_ns: int) -> bool:
        return self._newest_ns is not None and time_ns < self._newest_ns - _BACK_NS

    def go_on(self) -> None:
        """Continue with the next item at any time."""
        self._newest_ns = None

    def due(self, until_ns: int) -> list[T | FormatError]:
        """Return the items up to a time, or to a step back in time; some thousands at most."""
        items: list[T | FormatError] = []
        while len(items) < _MOST_AT_ONCE and not self.ended:
            item = self._items[0]
            if not isinstance(item, FormatError):
                if item.time_ns > until_ns or self._is_back(item.time_ns):
                    break
                self._newest_ns = max(item.time_ns, self._newest_ns or item.time_ns)
            items.append(self._items.popleft())
        return items

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read_on(self) -> None:
        while not self._read_all and all(isinstance(item, FormatError) for item in self._items):
            data = self._file.read(_CHUNK_BYTES)
            self._read_all = not data
            for item in self._decoder.feed(data) if data else self._decoder.finish():
                self._items.append(item)
                self._damages = self._damages + 1 if isinstance(item, FormatError) else 0
                if self._damages == _MOST_DAMAGES:
                    limit = f"read no further after {_MOST_DAMAGES} damages together"
                    self._items.append(
                        FormatError(self.name, "content", f"a recording of this kind; {limit}")
                    )
                    self._read_all = True
                    return
