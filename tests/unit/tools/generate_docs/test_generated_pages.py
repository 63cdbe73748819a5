"""Generated parts of the pages are written from the code, and a page that is not current is noticed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from camber.tools.generate_docs.__main__ import DOCS, SECTIONS, main, text_of


@pytest.fixture
def docs(tmp_path: Path) -> Path:
    return Path(shutil.copytree(DOCS, tmp_path / "docs"))


def test_the_pages_of_the_repository_are_current() -> None:
    assert main(["--check"]) == 0


@pytest.mark.parametrize("page", ["data-flow.md", "services/gnss.md"])
def test_a_changed_table_is_noticed_and_written_again(
    docs: Path, page: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = docs / page
    current = path.read_text("utf-8")
    path.write_text(current.replace("| `source` |", "| `sauce` |").replace("camber/v1", "camber/v0"), "utf-8")
    assert main(["--check", "--docs", str(docs)]) == 1
    assert capsys.readouterr().err == f"{path}: not current, run `make docs`\n"
    assert main(["--docs", str(docs)]) == 0
    assert path.read_text("utf-8") == current


@pytest.mark.parametrize("page", sorted({page for page, _ in SECTIONS}))
def test_a_page_without_the_marks_of_its_section_is_refused(docs: Path, page: str) -> None:
    path = docs / page
    path.write_text(path.read_text("utf-8").replace("<!-- generated", "<!-- made"), "utf-8")
    with pytest.raises(ValueError, match="expected a section"):
        text_of(path, docs)


def test_text_around_a_generated_section_stays(docs: Path) -> None:
    path = docs / "services/gnss.md"
    path.write_text("first\n" + path.read_text("utf-8") + "last\n", "utf-8")
    assert text_of(path, docs) == path.read_text("utf-8")
