"""What stands in the repository: nothing of one machine, tests where their sources are, pages that are fresh."""

from __future__ import annotations

import re
from collections import Counter

import pytest

from support.tree import ROOT, SOURCE_ROOTS, tracked_files

# Written so that this file does not match itself.
PLACES = {
    "an address of a package registry": r"(?:index|find|extra-index)-(?:url|links)[ =]+\S"
    r"|py[p]i\.org|python[h]osted\.org|[r]egistry\.[a-z]+\.|docker\.[i]o/",
    "a path of one machine": r"(?<![\w./$}{-])/(?:[w]ork|[r]oot|[h]ome/\w+|[U]sers/\w+)/",
}


def texts() -> list[tuple[str, str]]:
    matches = []
    for path in tracked_files():
        if path.suffix not in {".bin", ".png", ".mcap", ".whl"}:
            matches.append((str(path.relative_to(ROOT)), path.read_text(encoding="utf-8", errors="replace")))
    return matches


@pytest.mark.parametrize("place", PLACES)
def test_no_file_names(place: str) -> None:
    pattern = re.compile(PLACES[place])
    assert [(name, matches[0]) for name, text in texts() if (matches := pattern.search(text))] == []


def test_the_patterns_find_what_they_are_for() -> None:
    slash = "/"
    for place, example in [
        ("a path of one machine", f"open('{slash}home/someone/x')"),
        ("an address of a package registry", "--index-" + "url https://example.org"),
    ]:
        assert re.search(PLACES[place], example)


VENDOR = ROOT / "services/camber/live/static/vendor"
"""Libraries of the live page, unchanged as their makers ship them: the page loads nothing from elsewhere."""


def test_no_file_is_large() -> None:
    files = [path for path in tracked_files() if not path.is_relative_to(VENDOR)]
    sizes = {path.relative_to(ROOT): path.stat().st_size for path in files}
    assert {path for path, size in sizes.items() if size > 500_000} == set()


def test_names_of_test_files_are_unique() -> None:
    counts = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in counts.items() if count > 1] == []


def packages() -> set[str]:
    """The packages of the sources, as paths below `camber`."""
    matches = {path.parent.relative_to(root) for root in SOURCE_ROOTS for path in root.rglob("*.py")}
    return {path.as_posix() for path in matches} - {"."}


def folders_of_unit_tests() -> set[str]:
    """The folders of unit tests, as paths below `tests/unit`."""
    unit = ROOT / "tests" / "unit"
    return {path.parent.relative_to(unit).as_posix() for path in unit.rglob("test_*.py")}


def test_unit_tests_stand_where_their_sources_do() -> None:
    assert folders_of_unit_tests() - packages() - {"."} == set()  # cli.py stands in no package


def test_every_package_has_unit_tests() -> None:
    assert packages() - folders_of_unit_tests() == set()
