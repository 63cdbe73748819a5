"""Files of the live page and of the report: nothing from elsewhere, no text becomes HTML, licences beside libraries."""

from __future__ import annotations

import re

import pytest

from camber.live.runbook import runbook_entries
from camber.live.web_server import STATIC
from camber.validation.report import bundle

PAGE_FILES = sorted(
    path
    for folder in (STATIC, bundle.HERE)
    for path in folder.iterdir()
    if path.suffix in {".js", ".html", ".css", ".svg"}
)
AS_HTML = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|createContextualFragment|DOMParser|srcdoc"
AS_PROGRAM = r"\beval\(|new Function|setTimeout\([\"']"


@pytest.mark.parametrize("path", PAGE_FILES, ids=lambda path: path.name)
def test_no_text_becomes_html_or_a_program(path) -> None:  # type: ignore[no-untyped-def]
    assert re.findall(f"{AS_HTML}|{AS_PROGRAM}", path.read_text("utf-8")) == []


@pytest.mark.parametrize("path", PAGE_FILES, ids=lambda path: path.name)
def test_nothing_is_loaded_from_elsewhere(path) -> None:  # type: ignore[no-untyped-def]
    addresses = re.findall(r"(?:https?:)?//[a-z][\w.-]*\.[a-z]{2,}[^\"'\s]*", path.read_text("utf-8"))
    assert [address for address in addresses if "www.w3.org" not in address] == []


def test_every_library_has_its_licence() -> None:
    folders = [path for path in (STATIC / "vendor").iterdir() if path.is_dir()]
    assert {path.name for path in folders} == {"maplibre-gl", "uplot"}
    for folder in folders:
        assert any(path.name.startswith("LICENSE") for path in folder.iterdir())


def test_what_is_imported_is_there() -> None:
    for path in PAGE_FILES:
        for name in re.findall(r"(?:from|import) \"(\.\.?/[^\"]+)\"", path.read_text("utf-8")):
            assert (path.parent / name).is_file(), f"{path.name}: {name}"


def test_entries_of_the_run_book_are_read() -> None:
    entries = runbook_entries()
    assert len(entries) > 60
    assert all(len(entry) == 3 for entry in entries.values())
