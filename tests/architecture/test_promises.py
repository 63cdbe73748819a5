"""Every promise of the safety argument names code and tests that exist, and its test fails where it is broken."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from camber.tools.generate_docs.promises import SUBJECTS, Promise, source_file
from mutation.promises import PROMISES, copy_sources, notices
from support.tree import ROOT

SAFETY = ROOT / "docs" / "safety"
PAGES = [
    *sorted(SAFETY.glob("*.md")),
    *(ROOT / name for name in ("README.md", "docs/security.md", "docs/operations.md")),
]
NAME = re.compile(rf"(?<![\w./-])[{''.join(SUBJECTS)}]\d{{1,2}}(?!\w)")
"""An identifier of a promise on a page."""
EXAMPLES = ("V4", "V17", "P11")
"""Promises that are broken in every run of the tests; `make promises` breaks all of them."""


@cache
def names_in(path: Path) -> frozenset[str]:
    """Functions, classes, methods and module-level values that a file defines."""
    names: set[str] = set()
    for node in ast.parse(path.read_text("utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{part.name}" for part in node.body if isinstance(part, ast.FunctionDef)}
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        names |= {target.id for target in targets if isinstance(target, ast.Name)}
    return frozenset(names)


def problems(promises: list[Promise]) -> Iterator[str]:
    """Yield what is missing, a line each."""
    for promise in promises:
        if promise.name[:1] not in SUBJECTS or not promise.name[1:].isdigit():
            yield f"{promise.name}: expected one of {', '.join(SUBJECTS)} and a number"
        for kind, places in (("code", promise.code), ("tests", promise.tests)):
            if not places:
                yield f"{promise.name}: no {kind}"
        for place in (*promise.code, *promise.tests):
            path = (
                source_file(place, ROOT) if place in promise.code else ROOT / "tests" / place.split("::")[0]
            )
            if not path.is_file() or place.split("::")[1] not in names_in(path):
                yield f"{promise.name}: there is no {place}"
        for test in promise.tests:
            if not test.split("::")[1].startswith("test_"):
                yield f"{promise.name}: {test} is no test"
        if promise.code and source_file(promise.code[0], ROOT).is_file():
            times = source_file(promise.code[0], ROOT).read_text("utf-8").count(promise.find)
            if times != 1 or promise.find == promise.replace:
                yield f"{promise.name}: `find` occurs {times} times in the first file, expected once, and a change"


def test_every_promise_names_code_and_tests_that_exist_and_a_change_that_breaks_it() -> None:
    assert list(problems(PROMISES)) == []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"tests": ()}, "no tests"),
        ({"code": ()}, "no code"),
        ({"tests": ("unit/integrity/test_judge.py::test_that_nobody_wrote",)}, "there is no unit"),
        ({"tests": ("unit/integrity/test_judge.py::by",)}, "is no test"),
        ({"code": ("integrity/judge.py::Judge.guess",)}, "there is no integrity"),
        ({"find": "what stands nowhere"}, "occurs 0 times"),
        ({"name": "X1"}, "expected one of"),
    ],
)
def test_a_promise_without_one_of_them_is_noticed(change: dict[str, object], problem: str) -> None:
    (first, *_) = problems([replace(PROMISES[0], **change)])
    assert problem in first


def test_every_promise_that_a_page_names_is_in_the_table() -> None:
    known = {promise.name for promise in PROMISES}
    for page in PAGES:
        ranges = re.sub(r"([A-Z]\d+)–([A-Z]\d+)", r"\1, \2", page.read_text("utf-8"))
        named = set(NAME.findall(ranges))
        assert named - known == set(), page
        assert named or page.parent != SAFETY or page.name == "README.md", page


def test_what_the_safety_pages_link_to_is_there() -> None:
    for page in SAFETY.glob("*.md"):
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
            assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_tests_that_the_safety_pages_name_exist() -> None:
    for page in SAFETY.glob("*.md"):
        for file, name in re.findall(
            r"`((?:unit|integration|replay)/[\w/]+\.py)(?:::(\w+))?`", page.read_text("utf-8")
        ):
            path = ROOT / "tests" / file
            assert path.is_file(), f"{page.name}: {file}"
            assert not name or name in names_in(path), f"{page.name}: {file}::{name}"


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copy_sources(tmp_path_factory.mktemp("sources"))


@pytest.mark.slow
@pytest.mark.parametrize("promise", [p for p in PROMISES if p.name in EXAMPLES], ids=lambda p: p.name)
def test_a_broken_promise_makes_its_test_fail(promise: Promise, copy: Path) -> None:
    assert notices(promise, copy) == "noticed"


@pytest.mark.slow
def test_a_change_that_breaks_nothing_is_not_taken_for_noticed(copy: Path) -> None:
    (promise,) = (p for p in PROMISES if p.name == "V17")
    harmless = replace(promise, replace=f"{promise.find}  # unchanged")
    assert notices(harmless, copy).startswith("NOT NOTICED")
