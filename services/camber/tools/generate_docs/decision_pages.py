"""The list of decision pages, by their titles."""

from __future__ import annotations

from pathlib import Path


def decision_list(folder: Path) -> str:
    """Return the Markdown list of the decisions in a folder, each linked by the title of its page."""
    pages = sorted(folder.glob("[0-9]*.md"))
    titles = (page.read_text("utf-8").partition("\n")[0].removeprefix("# ") for page in pages)
    rows = [
        f"| {title.partition('. ')[0]} | [{title.partition('. ')[2]}]({page.name}) |"
        for page, title in zip(pages, titles, strict=True)
    ]
    return "\n".join(["| number | decision |", "|---|---|", *rows])
