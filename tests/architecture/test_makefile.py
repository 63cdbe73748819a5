"""The Makefile's environment: whole or made anew, by the interpreter that was asked for, one pip at a time."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from support.tree import ROOT

PYTHON = """#!/bin/sh
if [ "$1" = -c ]; then echo {version}; exit; fi
[ "$1 $2" = "-m venv" ] || exit 1
[ "$3" = --clear ] && rm -rf .venv
mkdir -p .venv/bin
ln -sf "$0" .venv/bin/python
[ ! -e no-ensurepip ] || exit 1
cp stubs/pip stubs/camber .venv/bin
"""
PIP = """#!/bin/sh
echo "begin $PIP_CONSTRAINT $PIP_BUILD_CONSTRAINT $*" >>pip.log
sleep 0.3
echo end >>pip.log
"""


class Checkout:
    """The Makefile beside stubs of Python, pip and camber, which only say that they were called."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("Makefile", "pyproject.toml", "constraints.txt"):
            shutil.copy(ROOT / name, folder)
        (folder / "stubs").mkdir()
        self.python("python3", "3.11")
        self.python("python3.13", "3.13")
        self._program("pip", PIP)
        self._program("camber", "#!/bin/sh\n")

    def python(self, name: str, version: str) -> None:
        self._program(name, PYTHON.format(version=version))

    def make(self, *arguments: str) -> int:
        """Exit code; these tests themselves are run by a make, whose orders are not for this one."""
        environ = {
            name: text
            for name, text in os.environ.items()
            if not name.startswith(("MAKE", "MFLAGS", "PYTHON"))
        }
        environ["PATH"] = f"{self.folder / 'stubs'}:{environ['PATH']}"
        return subprocess.run(["make", *arguments], cwd=self.folder, env=environ, check=False).returncode

    def version(self) -> str:
        """Of the interpreter that the environment has."""
        command = [self.folder / ".venv/bin/python", "-c", ""]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    def installed(self) -> list[str]:
        """Calls of pip since the last call of this."""
        log = self.folder / "pip.log"
        calls = log.read_text().splitlines() if log.exists() else []
        log.unlink(missing_ok=True)
        return calls

    def _program(self, name: str, text: str) -> None:
        path = self.folder / "stubs" / name
        path.write_text(text)
        path.chmod(0o755)


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path)


def test_an_environment_is_made_once(checkout: Checkout) -> None:
    assert checkout.make("setup") == 0
    assert len(checkout.installed()) == 2
    assert checkout.make("setup") == 0
    assert checkout.make("demo") == 0
    assert checkout.installed() == []


def test_an_environment_that_ended_halfway_is_begun_anew(checkout: Checkout) -> None:
    """As where Debian's Python comes without python3-venv: there is an interpreter then, and no pip."""
    (checkout.folder / "no-ensurepip").touch()
    for _ in range(2):
        assert checkout.make("setup") != 0
    assert (checkout.folder / ".venv/bin/python").exists()
    (checkout.folder / "no-ensurepip").unlink()
    assert checkout.make("setup") == 0
    assert len(checkout.installed()) == 2


def test_an_environment_whose_interpreter_is_gone_is_made_anew(checkout: Checkout) -> None:
    assert checkout.make("setup") == 0
    python = checkout.folder / ".venv/bin/python"
    python.unlink()
    python.symlink_to("/nonexistent/python3.11")
    checkout.python("python3", "3.12")
    checkout.installed()
    assert checkout.make("setup") == 0
    assert checkout.version() == "3.12"
    assert len(checkout.installed()) == 2


def test_an_interpreter_that_is_asked_for_is_taken_and_stays(checkout: Checkout) -> None:
    assert checkout.make("setup") == 0
    assert checkout.version() == "3.11"
    checkout.installed()
    assert checkout.make("PYTHON=python3.13", "setup") == 0
    assert checkout.version() == "3.13"
    assert len(checkout.installed()) == 2
    assert checkout.make("setup") == 0
    assert (checkout.version(), checkout.installed()) == ("3.13", [])


@pytest.mark.parametrize("goals", [("demo", "setup"), ("setup", "demo"), ("demo",)])
def test_one_pip_works_at_a_time(checkout: Checkout, goals: tuple[str, ...]) -> None:
    assert checkout.make("--jobs", "4", *goals) == 0
    assert [line.split()[0] for line in checkout.installed()] == ["begin", "end"]


def test_what_a_build_is_made_with_is_pinned_for_every_pip(checkout: Checkout) -> None:
    """pip before 25.3 hands the first variable to the pip of a build, later ones the second."""
    assert checkout.make("demo") == 0
    assert checkout.installed()[0].startswith("begin constraints.txt constraints.txt install ")
