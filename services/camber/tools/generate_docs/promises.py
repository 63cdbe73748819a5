"""What Camber promises: each promise with the code that keeps it and the tests that show it, from `promises.toml`."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SUBJECTS = {
    "V": "Verdicts",
    "P": "Positions and protection levels",
    "L": "Localizer",
    "A": "Antenna height",
    "G": "Satellites and base station",
    "M": "Map",
    "F": "Fleet",
    "B": "Bus and access",
    "O": "Faults of machine and link",
    "D": "Whole drives and consumers",
}
"""First letter of a promise's identifier → heading."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Promise:
    """A promise; `code` and `tests` are places `file::name`, relative to `services/camber` (or
    `schemas/camber/schemas`, as `schemas/…`) and to `tests`.

    The first of the tests fails where `find` in the first file of the code is replaced by `replace`.
    """

    name: str
    promise: str
    code: tuple[str, ...]
    tests: tuple[str, ...]
    find: str
    replace: str


def read_promises(path: Path) -> list[Promise]:
    """Return all promises of a file in its order; a wrong or missing key raises TypeError."""
    tables: dict[str, dict[str, Any]] = tomllib.loads(path.read_text("utf-8"))
    lists = ("code", "tests")
    return [
        Promise(name=name, **table | {key: tuple(table[key]) for key in lists if key in table})
        for name, table in tables.items()
    ]


def source_file(place: str, root: Path) -> Path:
    """Return the file of a place in the code; `root` is that of the repository."""
    return (
        root
        / ("schemas/camber" if place.startswith("schemas/") else "services/camber")
        / place.split("::")[0]
    )


def promise_tables(path: Path) -> str:
    """Return a heading and a Markdown table for each subject, with the first code and first test of each promise."""
    promises = read_promises(path)
    tables = []
    for letter, heading in SUBJECTS.items():
        rows = [_row(promise) for promise in promises if promise.name.startswith(letter)]
        head = ["| | promise | kept by | test_… |", "|---|---|---|---|"]
        tables.append("\n".join([f"## {heading}", "", *head, *rows]))
    return "\n\n".join(tables)


def _row(promise: Promise) -> str:
    """The first places only, in short: all stand in the file."""
    code, test = (places[0].split("::")[1] for places in (promise.code, promise.tests))
    return f"| {promise.name} | {promise.promise} | `{code.split('.')[-1]}` | {test.removeprefix('test_')} |"
