"""History of what was published, as columns: a ring for each kind of row, read by any number of browsers."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camber.live.snapshots import Snapshots
from camber.schemas.base import Float32, Float64

HOUR_ROWS = 36_000
"""An hour at 10 Hz, the rate of the table of channels."""
_BACK_S = 5.0
"""Chosen: later than any message is; a time that went back further is another drive or a clock that was set."""
_PAD = 8  # bytes: columns of float64 begin at multiples of it
_TEXT_LENGTH = 512  # as `Text` of the messages


@dataclass(frozen=True, slots=True, kw_only=True)
class TableLayout:
    """Names of the columns of one table: `exact` are float64, the first of them the time; `rest` are float32."""

    name: str
    exact: tuple[str, ...]
    rest: tuple[str, ...]


class Table:
    """A ring of rows; row numbers count from the first one ever appended."""

    def __init__(self, layout: TableLayout, capacity: int) -> None:
        self.layout = layout
        self.capacity = capacity
        self.count = 0
        # Not touched before it is used: memory grows with the rows.
        self._exact: Float64 = np.empty((capacity, len(layout.exact)), np.float64)
        self._rest: Float32 = np.empty((capacity, len(layout.rest)), np.float32)

    @property
    def first(self) -> int:
        """Number of the oldest row that is still there."""
        return max(self.count - self.capacity, 0)

    @property
    def last_time_s(self) -> float | None:
        """Time of the newest row."""
        return float(self._exact[(self.count - 1) % self.capacity, 0]) if self.count else None

    def append(self, exact: Sequence[float], rest: Sequence[float]) -> None:
        """Append a row; the oldest one goes where the ring is full."""
        at = self.count % self.capacity
        self._exact[at] = exact
        with np.errstate(over="ignore"):  # beyond float32: drawn as infinite, which is what it is
            self._rest[at] = rest
        self.count += 1

    def clear(self) -> None:
        """Forget all rows; numbers begin at zero again."""
        self.count = 0

    def rows(self, first: int, limit: int) -> tuple[int, Float64, Float32]:
        """Up to `limit` rows from number `first` on: number of the first one, exact (n, k), rest (n, m)."""
        first = max(first, self.first)
        at = np.arange(first, min(first + limit, self.count)) % self.capacity
        return first, self._exact[at], self._rest[at]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cursor:
    """How far a browser has read: the number of the next row of each table, in one generation of the history."""

    generation: int
    rows: tuple[int, ...]


class History:
    """Tables that one thread writes and others read; use every method from any thread.

    `generation` grows when time went back by more than some seconds: then all begins anew. A row that is older than the
    newest one of its table is left out and counted in `late`. `snapshots` belong to the same generation.
    """

    def __init__(self, layouts: Sequence[TableLayout], capacity: int = HOUR_ROWS) -> None:
        self.generation = 0
        self.late = 0
        self.snapshots = Snapshots()
        self.appended = 0
        """RowWriter that were ever appended, of all tables and generations."""
        self.layouts = tuple(layouts)
        self._tables = {layout.name: Table(layout, capacity) for layout in layouts}
        self._texts: deque[str] = deque(maxlen=capacity)
        self._lock = threading.Lock()

    def append(self, table: str, exact: Sequence[float], rest: Sequence[float], text: str = "") -> None:
        """Append a row; `text` goes with rows of the table `verdict`."""
        with self._lock:
            rows = self._tables[table]
            newest_s = rows.last_time_s
            if newest_s is not None and exact[0] < newest_s:
                if newest_s - exact[0] <= _BACK_S:
                    self.late += 1
                    return
                self._begin_anew()
            rows.append(exact, rest)
            self.appended += 1
            if table == "verdict":
                self._texts.append(text[:_TEXT_LENGTH])

    def start(self) -> Cursor:
        """The cursor of a browser that has nothing."""
        return Cursor(generation=self.generation, rows=(0,) * len(self._tables))

    def cursor(self) -> Cursor:
        """The cursor of a browser that has everything."""
        with self._lock:
            return Cursor(
                generation=self.generation, rows=tuple(table.count for table in self._tables.values())
            )

    def text(self, generation: int, row: int) -> str | None:
        """The text of a verdict by its row's number; None where it is not there any more."""
        with self._lock:
            at = row - self._tables["verdict"].first
            return self._texts[at] if generation == self.generation and 0 <= at < len(self._texts) else None

    def batch(self, cursor: Cursor, limit: int) -> tuple[bytes | None, Cursor]:
        """What a browser lacks (`encoded_rows`), up to `limit` rows of each table, and its new cursor.

        None where it lacks nothing.
        """
        with self._lock:
            if cursor.generation != self.generation:
                cursor = self.start()
            rows = [
                RowBlock(table.layout.name, *table.rows(begin, limit))
                for table, begin in zip(self._tables.values(), cursor.rows, strict=True)
            ]
            generation = self.generation
        if not any(len(block.exact) for block in rows):
            return None, cursor
        ends = tuple(block.first + len(block.exact) for block in rows)
        return encoded_rows(rows, generation), Cursor(generation=generation, rows=ends)

    def _begin_anew(self) -> None:
        self.generation += 1
        self._texts.clear()
        self.snapshots.clear()
        for table in self._tables.values():
            table.clear()


class RowBlock(NamedTuple):
    """Rows of a table from number `first` on: float64 columns (n, k) and float32 columns (n, m)."""

    table: str
    first: int
    exact: Float64
    rest: Float32


def encoded_rows(blocks: Sequence[RowBlock], generation: int) -> bytes:
    """Rows as the page takes them.

    Bytes: u32 length of the header, the header as JSON (padded with blanks so that columns begin at multiples of 8),
    then for each table of the header its float64 columns and its float32 columns, one after another, padded.
    """
    blocks = [block for block in blocks if len(block.exact)]
    header = [{"name": block.table, "first": block.first, "rows": len(block.exact)} for block in blocks]
    text = json.dumps({"generation": generation, "tables": header}).encode()
    text += b" " * (-(len(text) + 4) % _PAD)
    columns = [_padded(part.T.tobytes()) for block in blocks for part in (block.exact, block.rest)]
    return b"".join((len(text).to_bytes(4, "little"), text, *columns))


def columns_of(layouts: Sequence[TableLayout]) -> Mapping[str, Mapping[str, Sequence[str]]]:
    """Names of all columns, as the page is given them."""
    return {layout.name: {"exact": layout.exact, "rest": layout.rest} for layout in layouts}


def _padded(data: bytes) -> bytes:
    return data + b"\0" * (-len(data) % _PAD)
