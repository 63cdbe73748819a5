"""One distribution from two source roots, installed or built; what it needs is pinned."""

from __future__ import annotations

import ast
import os
import re
import tomllib
import zipfile
from pathlib import Path

import hatchling.build
import pytest

import camber
from support.running import python
from support.tree import ROOT, SOURCE_ROOTS

PACKAGES = sorted({path.parent for root in SOURCE_ROOTS for path in root.rglob("*.py")} - set(SOURCE_ROOTS))


def test_the_package_begins_in_one_of_its_roots_and_extends_over_the_other() -> None:
    begins = [root for root in SOURCE_ROOTS if (root / "__init__.py").exists()]
    assert begins == [ROOT / "services" / "camber"], "another would hide a source root"
    assert {str(root) for root in SOURCE_ROOTS} <= set(camber.__path__)


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_every_package_says_in_a_line_what_it_is(package: Path) -> None:
    text = ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8")))
    assert text, f"{package.name}/__init__.py needs a docstring"
    assert "\n" not in text.split("\n\n")[0]


def test_both_roots_are_installed(tmp_path: Path) -> None:
    environ = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    code = "import camber.schemas.codec, camber.runtime; print('both')"
    done = python("-c", code, cwd=tmp_path, env=environ)
    assert done.stdout == "both\n", f"make setup installs them\n{done.stderr}"


def test_a_wheel_holds_both_roots_and_says_that_it_is_typed(tmp_path: Path) -> None:
    python("-m", "hatchling", "build", "--target", "wheel", "--directory", tmp_path, cwd=ROOT)
    (wheel,) = tmp_path.glob("camber-*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {"camber/__init__.py", "camber/py.typed"} <= names
    assert not [name for name in names if name.startswith(("schemas/", "services/", "tests/"))]
    for root in SOURCE_ROOTS:
        built = {str(path.relative_to(root.parent)) for path in root.rglob("*.py")}
        assert built <= names
    messages = "camber/formats/ros/msg/camber_msgs"
    assert {f"{messages}/{name}" for name in ("CMakeLists.txt", "package.xml", "msg/Verdict.msg")} <= names


def test_the_extra_all_is_what_a_user_may_want_of_all_others() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    (line,) = extras["all"]
    assert set(line.removeprefix("camber[").removesuffix("]").split(",")) == set(extras) - {
        "all", "docs", "dev", "mutation"
    }  # fmt: skip


def test_every_dependency_is_pinned_and_nothing_says_from_where(monkeypatch: pytest.MonkeyPatch) -> None:
    """What wheel and editable installation are made with, too: pip fetches that for each of them."""
    monkeypatch.chdir(ROOT)
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = table["project"]["optional-dependencies"].values()
    of_extras = (line for extra in extras for line in extra if not line.startswith("camber["))
    wanted = [*table["project"]["dependencies"], *of_extras]
    wanted += table["build-system"]["requires"]
    wanted += hatchling.build.get_requires_for_build_wheel()
    wanted += hatchling.build.get_requires_for_build_editable()
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+==[0-9][0-9a-z.]*", pin) for pin in pins)
    pinned = {pin.split("==")[0].lower().replace("_", "-") for pin in pins}
    assert {re.split(r"[<>=~! \[]", line)[0].lower().replace("_", "-") for line in wanted} <= pinned
