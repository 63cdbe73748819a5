"""The run-book's entries by code: what an issue means, its effect, and what to do."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

_ENTRY = re.compile(r"^\| `(\w+)` \|(.*)\|$", re.M)


@cache
def runbook_entries() -> dict[str, tuple[str, ...]]:
    """Code → meaning, effect, remedy, as plain text with Markdown's backquotes; empty where the page is not there."""
    for path in _places():
        if path.is_file():
            text = path.read_text("utf-8")
            return {
                code: tuple(cell.strip() for cell in rest.split("|")) for code, rest in _ENTRY.findall(text)
            }
    return {}


def _places() -> tuple[Path, Path]:
    """In a wheel beside this module, in a checkout among the pages."""
    here = Path(__file__).resolve()
    return here.with_name("runbook.md"), here.parents[3] / "docs" / "runbook.md"
