"""Who may import whom: the contracts of import-linter hold, and each of them notices when it is broken."""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest

from support.running import python
from support.tree import ROOT


def lint(root: Path) -> subprocess.CompletedProcess[str]:
    """Run import-linter on the sources under `root`; -S keeps an editable install of this checkout out of it.

    `import camber` before it: the package has two roots, and import-linter looks where the imported one does.
    """
    installed = (sysconfig.get_path("purelib"), sysconfig.get_path("platlib"))
    paths = os.pathsep.join(map(str, (root / "schemas", root / "services", *installed)))
    code = "import camber; from importlinter.cli import lint_imports_command as run; run()"
    options = ("--no-cache", "--config", ROOT / "pyproject.toml")
    return python(
        "-S", "-c", code, *options, env=os.environ | {"PYTHONPATH": paths, "COLUMNS": "300"}, cwd=root
    )


def test_the_sources_keep_the_contracts() -> None:
    done = lint(ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Contracts: 3 kept, 0 broken" in done.stdout


@pytest.mark.parametrize(
    ("package", "imported", "contract"),
    [
        ("integrity", "camber.gnss.planted", "independent of one another"),
        ("gnss", "camber.tools", "tools, validation, replay"),
        ("runtime", "camber.integrity.planted", "tools, validation, replay"),
        ("geodesy", "camber.formats", "tools, validation, replay"),
        ("formats", "camber.runtime", "tools, validation, replay"),
        ("integrity", "zenoh", "only the runtime knows zenoh"),
        ("tools", "zenoh", "only the runtime knows zenoh"),
        ("integrity", "camber.runtime.bus", "only service, settings and __main__ know the runtime"),
        ("new_package", "numpy", "tools, validation, replay"),
    ],
)
def test_a_forbidden_import_is_noticed(tmp_path: Path, package: str, imported: str, contract: str) -> None:
    for root in ("schemas", "services"):
        shutil.copytree(ROOT / root, tmp_path / root, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("gnss", "integrity", "tools", package):
        folder = tmp_path / "services" / "camber" / name
        folder.mkdir(exist_ok=True)
        (folder / "__init__.py").touch()
        (folder / "planted.py").write_text("")
    (tmp_path / "services" / "camber" / package / "planted.py").write_text(f"import {imported}\n")
    done = lint(tmp_path)
    assert done.returncode != 0
    broken = [line for line in done.stdout.splitlines() if "BROKEN" in line]
    assert any(contract in line for line in broken), done.stdout + done.stderr
