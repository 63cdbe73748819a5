"""Names, texts, interfaces, constants and citations keep the rules of the glossary and of CONTRIBUTING.

Folders that do not keep a rule yet are listed in `unfinished.txt`. A folder that keeps it must not be listed, so the
list only becomes shorter.
"""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from support.source_rules import (
    checked_files,
    citation_violations,
    class_violations,
    constant_violations,
    interface_violations,
    product_files,
    violations,
    word_violations,
    words,
)
from support.tree import ROOT

UNFINISHED = ROOT / "tests" / "architecture" / "unfinished.txt"
SOURCES = (ROOT / "docs" / "sources.md").read_text("utf-8")
DOCUMENTS = ("JP7707657B2", "JP2016-109650A", "CN101360971", "Kikuchi (TUMSAT)")
MOST_FILES = 20
"""Architecture page: a folder has at most about twenty files."""


def kind_of(rule: str) -> str:
    return re.sub(r"'.*' |\d+ ", "", rule).replace(" ", "_")


@cache
def counts() -> Counter[str]:
    """Rule and folder → number of violations."""
    listed = [violation for path in checked_files() for violation in violations(path)]
    listed += class_violations(product_files())
    return Counter(
        f"{kind_of(violation.rule)} {violation.path.parent.relative_to(ROOT).as_posix()}"
        for violation in listed
    )


def unfinished() -> set[str]:
    return {line for line in UNFINISHED.read_text("utf-8").splitlines() if line and not line.startswith("#")}


def test_every_folder_keeps_the_rules_but_those_that_are_listed() -> None:
    broken = sorted(counts().keys() - unfinished())
    assert broken == [], "PYTHONPATH=tests:schemas:services python -m support.source_rules FOLDER lists them"


def test_a_folder_that_keeps_a_rule_is_not_listed() -> None:
    assert sorted(unfinished() - counts().keys()) == []


def test_the_glossary_is_read() -> None:
    assert {"told", "whence", "found"} <= {word.word for word in words()}


@pytest.mark.parametrize(
    "text", ["def told() -> int: ...\n", "x = 1  # what it was told\n", "def f(said): ...\n"]
)
def test_a_term_not_to_use_is_noticed(text: str) -> None:
    assert len(list(word_violations(Path("planted.py"), text))) == 1


def test_a_term_in_a_page_is_noticed_but_not_in_code() -> None:
    page = "It is told once.\nThe field `told` is old.\n"
    assert [violation.line for violation in word_violations(Path("planted.md"), page)] == [1]


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("class_violations(1, 2, 3, 4, 5)\n", None),  # not a name of the product
        ("encode(1, 2, 3, 4, 5)\n", "5 positional arguments"),
        ("np.encode(1, 2, 3, 4, 5)\n", None),
        ("encode(1, 2, 3, 4, last=5)\n", None),
        (
            "@dataclass(frozen=True)\nclass A:\n    a: int\n    b: int\n    c: int\n",
            "dataclass without kw_only",
        ),
        ("@dataclass(kw_only=True)\nclass A:\n    a: int\n    b: int\n    c: int\n", None),
    ],
)
def test_positional_interfaces_are_noticed(text: str, rule: str | None) -> None:
    rules = [violation.rule for violation in interface_violations(Path("planted.py"), text)]
    assert rules == ([] if rule is None else [rule])


@pytest.mark.parametrize(
    ("text", "planted"),
    [
        ("LIMIT = 3\n", 1),
        ("LIMIT = 3  # RTCM 10403.3\n", 0),
        ("# RTCM 10403.3\nLIMIT = 3\nOTHER = 4\n", 0),
        ('LIMIT = 3\n"""Chosen: three tries."""\n', 0),
        ("# RTCM 10403.3\nLIMIT = 3\n\nOTHER = -4.5\n", 1),
    ],
)
def test_a_number_without_source_is_noticed(text: str, planted: int) -> None:
    assert len(list(constant_violations(Path("planted.py"), text))) == planted


@pytest.mark.parametrize(
    ("text", "planted"), [("by H (3)", 1), ("(M, step 10)", 1), ("JP7707657B2 eq. (3)", 0)]
)
def test_a_citation_by_letter_is_noticed(text: str, planted: int) -> None:
    assert len(list(citation_violations(Path("planted.md"), text))) == planted


def test_a_class_name_with_two_meanings_is_noticed(tmp_path: Path) -> None:
    files = [tmp_path / "one.py", tmp_path / "other.py"]
    for path in files:
        path.write_text("class Gate: ...\n")
    assert [violation.text for violation in class_violations(files)] == [
        f"Gate: {files[1].as_posix()}",
        f"Gate: {files[0].as_posix()}",
    ]


def test_every_cited_document_is_a_source() -> None:
    assert [document for document in DOCUMENTS if document not in SOURCES] == []
    cited = {
        number
        for path in product_files()
        for number in re.findall(r"\b(?:JP|CN|US|EP|WO)\d[\d-]{5,}\w*", path.read_text("utf-8"))
    }
    assert cited
    assert sorted(number for number in cited if number not in SOURCES) == []


def test_no_folder_of_the_product_has_more_files_than_a_reader_can_survey() -> None:
    files = Counter(path.parent.relative_to(ROOT).as_posix() for path in product_files())
    assert {folder: count for folder, count in files.items() if count > MOST_FILES} == {}
