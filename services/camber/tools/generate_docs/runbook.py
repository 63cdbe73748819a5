"""The tables of issues in the run-book, from `runtime/health/issues.toml`."""

from __future__ import annotations

import functools
import tomllib
from importlib.resources import files

_HEAD = ("| code | means | meanwhile | check and do |", "|---|---|---|---|")


@functools.cache
def issues_by_service() -> dict[str, dict[str, dict[str, str]]]:
    """Return service (`any_service`: every one) → issue code → `means`, `meanwhile` and `remedy`."""
    return tomllib.loads(files("camber.runtime.health").joinpath("issues.toml").read_text("utf-8"))


def runbook_rows(service: str) -> str:
    """Return the Markdown table of a service's issues."""
    rows = []
    for code, row in issues_by_service()[service].items():
        name = f"`{code}`" if code.isidentifier() else code
        meanwhile = f" {row['meanwhile']}" if row["meanwhile"] else ""
        rows.append(f"| {name} | {row['means']} |{meanwhile} | {row['remedy']} |")
    return "\n".join([*_HEAD, *rows])
