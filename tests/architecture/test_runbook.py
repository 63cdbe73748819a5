"""Every problem that a service can report has an entry in the run-book, and every entry is of such a problem."""

from __future__ import annotations

import re
from collections import Counter

from support.issue_codes import ELSEWHERE, issue_codes
from support.tree import ROOT

TEXT = (ROOT / "docs" / "runbook.md").read_text("utf-8")
ROWS = [line for line in TEXT.splitlines() if re.match(r"\| [`*]", line)]
ENTRIES = [match[1] for row in ROWS if (match := re.match(r"\| `(\w+)` \|", row))]


def test_the_codes_of_every_place_in_the_source_are_known() -> None:
    codes, unknown = issue_codes()
    assert unknown == set(), "tests/support/issue_codes.py must say what codes these can be"
    assert len(codes) > 60
    assert {"source_lost", "sweep_half_sweep", "upload_lost", "base_wrong", "store_full"} <= codes


def test_every_code_has_an_entry_and_every_entry_a_code() -> None:
    codes, _ = issue_codes()
    assert sorted(codes - set(ENTRIES)) == [], "docs/runbook.md lacks these"
    assert sorted(set(ENTRIES) - codes) == [], "docs/runbook.md has these, and no service says them"


def test_no_code_has_two_entries() -> None:
    assert [code for code, count in Counter(ENTRIES).items() if count > 1] == []


def test_every_entry_says_what_it_means_what_is_seen_and_what_to_do() -> None:
    for row in ROWS:
        cells = [cell.strip() for cell in row.strip().strip("|").split("|")]
        assert len(cells) == 4, row
        assert cells[1], row
        assert cells[3], row
        if cells[0] != "`others`":
            assert cells[2], row


def test_commands_named_in_the_runbook_exist() -> None:
    for file, code in ELSEWHERE:
        path = ROOT / "services" / "camber" / file
        assert path.is_file(), file
        assert code.split("{")[0].strip("f'\"") in path.read_text("utf-8"), (file, code)


def test_what_the_pages_call_by_name_is_there() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (ROOT / "docs" / link).is_file(), link
