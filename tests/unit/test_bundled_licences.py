"""Libraries and programs inside packages have licences that were reviewed."""

from __future__ import annotations

import importlib.util
import re
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any

import pytest

from support.tree import ROOT

spec = importlib.util.spec_from_file_location("bundled_licences", ROOT / "deploy" / "bundled_licences.py")
assert spec is not None
assert spec.loader is not None
licences: Any = importlib.util.module_from_spec(spec)
spec.loader.exec_module(licences)

PINS = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.M))
INSTALLERS = {"camber", "pip", "setuptools", "wheel"}
RECORD = {
    "wheel/__init__.py": b"",
    "wheel/module.cpython-311-x86_64-linux-gnu.so": b"\x7fELF",
    "wheel/tool": b"\x7fELF",
    "wheel.libs/libgeos-3a2b1c0d.so.3.13": b"\x7fELF",
    "wheel.libs/libglib-2-040039e1-0352e75f.so.0": b"\x7fELF",
    "wheel/data.so": b"text",
    "wheel/missing": None,
}


@pytest.fixture
def wheel(tmp_path: Path) -> Distribution:
    """An installed package with modules, two libraries, a program, a data file and a file that is missing."""
    for name, content in RECORD.items():
        if content is not None:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(content)
    info = tmp_path / "wheel-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.4\nName: wheel\nVersion: 1.0\n")
    (info / "RECORD").write_text("".join(f"{name},,\n" for name in RECORD))
    return Distribution.at(info)


def test_bundled_files_are_libraries_and_programs_but_not_imported_modules(wheel: Distribution) -> None:
    assert [(file.name, file.licence) for file in licences.bundled_files(wheel)] == [
        ("libgeos", "LGPL-2.1-only"),
        ("libglib-2", None),
        ("tool", None),
    ]


def test_a_file_without_reviewed_licence_fails_and_is_named(
    wheel: Distribution, capsys: pytest.CaptureFixture[str]
) -> None:
    assert licences.main([wheel]) == 1
    printed = capsys.readouterr()
    assert re.search("libgeos +LGPL-2.1-only: unchanged", printed.out)
    assert [line.split(": ")[2] for line in printed.err.splitlines()] == [
        "wheel.libs/libglib-2-040039e1-0352e75f.so.0",
        "wheel/tool",
    ]


def test_every_bundled_file_of_this_environment_has_a_reviewed_licence(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert licences.main() == 0, capsys.readouterr().err


def test_copyleft_licences_have_a_condition_under_which_they_are_shipped() -> None:
    copyleft = {name for name in licences.BUNDLED.values() if "GPL" in name and " OR " not in name}
    assert copyleft <= licences.CONDITIONS.keys()


def test_everything_that_is_installed_is_pinned_to_its_version() -> None:
    pins = {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in PINS.items()}
    installed = {re.sub(r"[-_.]+", "-", each.name).lower(): each.version for each in distributions()}
    assert len(installed) > 60
    assert {name: version for name, version in installed.items() if name not in INSTALLERS} == {
        name: pins.get(name) for name in installed if name not in INSTALLERS
    }
