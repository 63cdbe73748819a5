"""Tables and shares as Markdown, and the same as HTML."""

from __future__ import annotations

import html
import re
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


def sections_as_html(markdown: str) -> str:
    """Headings, tables, paragraphs and indented code of the pages made here as HTML, each heading with a section."""
    blocks = [_block_as_html(block) for block in markdown.strip("\n").split("\n\n")]
    text = "\n".join(blocks).replace("<h", "</section>\n<section>\n<h")
    return text.removeprefix("</section>\n") + "\n</section>\n"


def _block_as_html(block: str) -> str:
    block = block.strip("\n")
    if block.startswith("#"):
        return f"<h2>{_inline(block.lstrip('# '))}</h2>"
    if block.startswith("    "):
        return f"<pre>{html.escape(block.strip())}</pre>"
    if not block.startswith("|"):
        return f"<p>{_inline(block)}</p>"
    head, _, *rows = (
        [_inline(cell.strip()) for cell in line[1:-1].split(" | ")] for line in block.splitlines()
    )
    lines = ["".join(f"<td>{cell}</td>" for cell in row) for row in rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    cells = "".join(f"<th>{cell}</th>" for cell in head)
    return f'<div class="scroll"><table><thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table></div>'


def _inline(text: str) -> str:
    """Emphasis and code within a line."""
    escaped = html.escape(text)
    for pattern, name in ((r"`([^`]+)`", "code"), (r"\*\*(.+?)\*\*", "strong"), (r"\*([^* ][^*]*)\*", "em")):
        escaped = re.sub(pattern, rf"<{name}>\1</{name}>", escaped)
    return escaped
