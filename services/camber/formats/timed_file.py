"""A recording of timed items, read as far as its time has come."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from camber.formats.errors import FormatError

_CHUNK_BYTES = 1 << 16


class Timed(Protocol):
    """`time_ns`: UTC, nanoseconds since 1970."""

    @property
    def time_ns(self) -> int:
        """When it was recorded."""


T = TypeVar("T", bound=Timed)


class Decoder(Protocol[T]):
    """Of a stream of bytes."""

    def feed(self, data: bytes) -> list[T | FormatError]:
        """What is complete with these bytes."""

    def finish(self) -> list[T | FormatError]:
        """What is left at the end."""


class TimedFile(Generic[T]):
    """Items in the file's order; `ended` once all were handed out. Raises OSError where it cannot be read."""

    def __init__(self, path: Path, decoder: Decoder[T]) -> None:
        self._file = path.open("rb")
        self._decoder = decoder
        self._items: deque[T | FormatError] = deque()
        self._read_all = False

    @property
    def ended(self) -> bool:
        """Nothing more comes."""
        self._read_on()
        return not self._items

    def first_ns(self) -> int | None:
        """The time of the next item; None where there is none."""
        self._read_on()
        return next((item.time_ns for item in self._items if not isinstance(item, FormatError)), None)

    def due(self, until_ns: int) -> list[T | FormatError]:
        """All items up to one that is later than this."""
        found: list[T | FormatError] = []
        while not self.ended:
            item = self._items[0]
            if not isinstance(item, FormatError) and item.time_ns > until_ns:
                break
            found.append(self._items.popleft())
        return found

    def close(self) -> None:
        """Close it."""
        self._file.close()

    def _read_on(self) -> None:
        while not self._read_all and all(isinstance(item, FormatError) for item in self._items):
            data = self._file.read(_CHUNK_BYTES)
            self._items += self._decoder.feed(data) if data else self._decoder.finish()
            self._read_all = not data
