"""Does a test notice when the judge is changed? `PYTHONPATH=tests python -m mutation.run` (`make mutation`).

Every pure module of `camber.integrity` is changed in thousands of small ways by mutmut, each of which a test must
notice. mutmut wants one source root and writes beside what it changes: so all is laid out anew in a folder of its own.
What no test can notice stands in `survivors.toml`, each with why; what neither a test nor that file explains is listed.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGE = "integrity"
_PROCESS = frozenset({"__init__.py", "__main__.py", "service.py", "settings.py"})
_NOTICED = frozenset({"killed", "timeout", "segfault", "caught by type check"})
_LEAST_SHARE = 0.95
_PAGES = "test_integrity_page.py"
"""Compares with a page of the repository, which is not there where mutants live."""


def main() -> int:
    """Exit code 1 where fewer than 95 % were noticed, or one that was not has no explanation."""
    parser = argparse.ArgumentParser(prog="python -m mutation.run", description=__doc__)
    parser.add_argument("--only", action="append", default=[], help="module, such as learning; repeatable")
    parser.add_argument("--out", type=Path, default=Path("out/mutation"), help="folder, made anew")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    modules = sorted(
        path.stem
        for path in (_ROOT / "services/camber" / _PACKAGE).glob("*.py")
        if path.name not in _PROCESS and (not args.only or path.stem in args.only)
    )
    folder = args.out.resolve()
    _lay_out(folder, modules)
    command = [str(Path(sys.executable).parent / "mutmut")]
    # Without a check of its own tests first mutmut stops and says so.
    ran = subprocess.run(
        [*command, "run", "--max-children", str(args.processes)],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=(folder / "mutmut.log").open("wb"),
        stderr=subprocess.STDOUT,
        check=False,
    )
    if ran.returncode != 0:
        print((folder / "mutmut.log").read_text(errors="replace")[-4000:])
        return 1
    return _report(_results(command, folder), command, folder)


def _lay_out(folder: Path, modules: list[str]) -> None:
    """Sources under one root, the package's tests, and mutmut's settings."""
    shutil.rmtree(folder, ignore_errors=True)
    without = shutil.ignore_patterns("__pycache__")
    for root in ("services/camber", "schemas/camber"):
        shutil.copytree(_ROOT / root, folder / "src/camber", ignore=without, dirs_exist_ok=True)
    for part in (f"unit/{_PACKAGE}", "support"):
        shutil.copytree(_ROOT / "tests" / part, folder / "tests" / part, ignore=without)
    (folder / "tests/unit" / _PACKAGE / _PAGES).unlink(missing_ok=True)
    names = ", ".join(f'"src/camber/{_PACKAGE}/{module}.py"' for module in modules)
    (folder / "pyproject.toml").write_text(
        f"""\
[tool.pytest.ini_options]
pythonpath = ["tests"]
addopts = ["--import-mode=importlib", "--strict-markers", "--strict-config"]
filterwarnings = ["error"]
markers = ["slow: takes more than a few seconds"]
[tool.mutmut]
source_paths = ["src"]
only_mutate = [{names}]
pytest_add_cli_args_test_selection = ["tests/unit/{_PACKAGE}"]
pytest_add_cli_args = ["-p", "no:cacheprovider", "-m", "not slow"]
track_dependencies = false
use_git_change_detection = false
"""
    )


def _results(command: list[str], folder: Path) -> dict[str, str]:
    """What became of each mutant, by its name."""
    told = subprocess.run(
        [*command, "results", "--all", "true"], cwd=folder, capture_output=True, text=True, check=True
    )
    rows = (line.strip().rsplit(": ", 1) for line in told.stdout.splitlines())
    return {row[0]: row[1] for row in rows if len(row) == 2}


def _report(results: dict[str, str], command: list[str], folder: Path) -> int:
    if not results:
        print("mutation: nothing was changed")
        return 1
    survivors = tomllib.loads((Path(__file__).parent / "survivors.toml").read_text())["survivor"]
    explained = {(entry["in"], entry["was"], entry["becomes"]): entry["why"] for entry in survivors}
    noticed = sum(outcome in _NOTICED for outcome in results.values())
    unexplained = 0
    for name in (name for name, outcome in results.items() if outcome not in _NOTICED):
        place, was, becomes = _change(name, command, folder)
        why = explained.get((place, was, becomes))
        unexplained += why is None
        print(f"{place}: {was or '(nothing)'}  ->  {becomes or '(nothing)'}: {why or 'NOT EXPLAINED'}")
    share = noticed / len(results)
    counts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(Counter(results.values()).items()))
    print(
        f"mutation: {len(results)} mutants, {counts}: {100.0 * share:.1f} % noticed, {unexplained} unexplained"
    )
    return int(share < _LEAST_SHARE or unexplained > 0)


def _change(name: str, command: list[str], folder: Path) -> tuple[str, str, str]:
    """Module and function, what stood there, and what stands there instead, each as one line."""
    shown = subprocess.run([*command, "show", name], cwd=folder, capture_output=True, text=True, check=True)
    lines = [line for line in shown.stdout.splitlines() if not line.startswith(("---", "+++", "#"))]
    was = " ".join(line[1:].strip() for line in lines if line.startswith("-"))
    becomes = " ".join(line[1:].strip() for line in lines if line.startswith("+"))
    found = re.fullmatch(r"camber\.(.+)\.x(.+)__mutmut_\d+", name)
    place = name if found is None else f"{found[1]} {found[2].replace('ǁ', '.').strip('._')}"
    return place, was, becomes


if __name__ == "__main__":
    raise SystemExit(main())
