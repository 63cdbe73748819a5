"""Tables and shares as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

R = TypeVar("R")


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines) + "\n"


def columns(rows: Iterable[R], cells: Mapping[str, Callable[[R], object]]) -> str:
    """A table with a line for each row; `cells` has each column's heading and what makes its cell of a row."""
    return table(list(cells), [[cell(row) for cell in cells.values()] for row in rows])


def percent(share: float | None, digits: int = 2) -> str:
    """A share in percent; *none* where there was nothing to count. 99.996 % is not rounded to 100 %."""
    if share is None:
        return "none"
    if share < 1.0:
        share = min(share, 1.0 - 0.01 * 10.0**-digits)
    return f"{100.0 * share:.{digits}f} %"
