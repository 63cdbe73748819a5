"""Does a test notice when the judge is changed? `PYTHONPATH=tests python -m mutation.run` (`make mutation`).

Every function of the pure modules of `camber.integrity` is changed in thousands of small ways by mutmut, each of which
a test must notice. mutmut wants one source root and writes beside what it changes: so all is laid out anew in a folder
of its own, and mutmut changes only: the tests run in forks of one collection (`forked.py`). What no test can notice
stands in `survivors.toml`, each with why. The rest is tried in a new process each, which imports all modules with the
change: only there does a change of what builds a table show. What is left then is listed. mutmut leaves alone what is
not within a function (defaults of dataclasses, constants) and what has a decorator (properties).
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
import tokenize
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGE = "integrity"
_PROCESS = frozenset({"__init__.py", "__main__.py", "service.py", "settings.py"})
_OF_PROCESSES = ("camber.runtime", f"camber.{_PACKAGE}.service", f"camber.{_PACKAGE}.settings")
"""Tests that import these are left out: they are slow, and the pure modules have tests of their own."""
_NOTICED = frozenset({"killed", "timeout"})
_LONGEST_S = 1800.0  # chosen: twenty times what the tests take without a change
_LEAST_SHARE = 0.95
_NEARLY_THE_SAME = 1e-6
_OPTIONS = ("-p", "no:cacheprovider", "-m", "not slow", "--rootdir", ".")
_STRICT = re.compile(r",\s*(strict=\w+)?\s*\)")


def main() -> int:
    """Exit code 1 where fewer than 95 % were noticed, or one that was not has no explanation."""
    parser = argparse.ArgumentParser(prog="python -m mutation.run", description=__doc__)
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        help="module, such as residuals or learning.residuals; repeatable",
    )
    parser.add_argument("--out", type=Path, default=Path("out/mutation"), help="folder, made anew")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    modules = sorted(
        ".".join(path.relative_to(_ROOT / "services/camber" / _PACKAGE).with_suffix("").parts)
        for path in (_ROOT / "services/camber" / _PACKAGE).rglob("*.py")
        if path.name not in _PROCESS
    )
    if args.only:
        modules = [module for module in modules if {module, module.rpartition(".")[2]} & set(args.only)]
    if not modules:
        parser.error(f"--only: no module of camber.{_PACKAGE} is called {' or '.join(args.only)}")
    folder, began_s = args.out.resolve(), time.monotonic()
    _lay_out(folder, modules)
    command = [str(Path(sys.executable).parent / "mutmut")]
    # The first change of each function of one module: mutmut changes all, and asks what calls what.
    if not _mutmut(command, [f"camber.{_PACKAGE}.{modules[0]}.*__mutmut_1"], folder, args.processes):
        return 1
    tests = _tests_of(_names(command, folder), folder)
    results = dict.fromkeys(tests, "survived") | _forked(tests, folder, args.processes)
    results |= _in_new_processes(_unexplained(results, folder), folder, args.processes)
    code = _report(results, modules, folder)
    print(f"mutation: {(time.monotonic() - began_s) / 60.0:.0f} minutes")
    return code


def _lay_out(folder: Path, modules: list[str]) -> None:
    """Sources under one root, the package's tests, and mutmut's settings."""
    shutil.rmtree(folder, ignore_errors=True)
    without = shutil.ignore_patterns("__pycache__")
    for root in ("services/camber", "schemas/camber"):
        shutil.copytree(_ROOT / root, folder / "src/camber", ignore=without, dirs_exist_ok=True)
    for part in (f"unit/{_PACKAGE}", "support"):
        shutil.copytree(_ROOT / "tests" / part, folder / "tests" / part, ignore=without)
    for test in (folder / "tests/unit" / _PACKAGE).rglob("*.py"):
        if any(module in test.read_text() for module in _OF_PROCESSES):
            test.unlink()
    shutil.copy(Path(__file__).parent / "for_mutants.py", folder / "tests/conftest.py")
    names = ", ".join(f'"{_path_of(module)}"' for module in modules)
    (folder / "pyproject.toml").write_text(
        f"""\
[tool.pytest.ini_options]
pythonpath = ["tests"]
addopts = ["-p", "no:dash", "--import-mode=importlib", "--strict-markers", "--strict-config"]
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


def _mutmut(command: list[str], names: list[str], folder: Path, processes: int) -> bool:
    """Tries these; False where mutmut failed, with its log printed. It runs the unchanged tests before."""
    with (folder / "mutmut.log").open("wb") as log:
        ran = subprocess.run(
            [*command, "run", "--max-children", str(processes), *names],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            check=False,
        )
    if ran.returncode != 0:
        print((folder / "mutmut.log").read_text(errors="replace")[-4000:])
    return ran.returncode == 0


def _tests_of(names: list[str], folder: Path) -> dict[str, list[str]]:
    """Of each mutant the tests that call the function, the quickest first."""
    from mutmut.utils.format_utils import mangled_name_from_mutant_name

    stats = json.loads((folder / "mutants/mutmut-stats.json").read_text())
    calling, lasts_s = stats["tests_by_mangled_function_name"], stats["duration_by_test"]
    return {
        name: sorted(
            calling.get(mangled_name_from_mutant_name(name), ()), key=lambda test: lasts_s.get(test, 0.0)
        )
        for name in names
    }


def _forked(tests: dict[str, list[str]], folder: Path, processes: int) -> dict[str, str]:
    """What became of each mutant that a test calls, by forks of one collection."""
    inside, asked, verdict_file = folder / "mutants", folder / "tests_of.json", folder / "noticed.jsonl"
    asked.write_text(json.dumps({name: names for name, names in tests.items() if names}))
    options = [
        "-q",
        "-p",
        "forked",
        *_OPTIONS,
        "--mutants",
        str(asked),
        "--verdicts",
        str(verdict_file),
        "--at-once",
        str(processes),
    ]
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", *options, f"tests/unit/{_PACKAGE}"],
        cwd=inside,
        env=_environment(folder),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if ran.returncode != 0:
        raise SystemExit(
            f"mutation: pytest ended with {ran.returncode}:\n{ran.stdout[-4000:]}{ran.stderr[-4000:]}"
        )
    verdicts = map(json.loads, verdict_file.read_text().splitlines())
    return {name: "killed" if noticed else "survived" for name, noticed in verdicts}


def _unexplained(results: dict[str, str], folder: Path) -> list[str]:
    """The mutants that nobody noticed or explained."""
    explained = _explained()
    changes = {name: _change(name, folder) for name, outcome in results.items() if outcome not in _NOTICED}
    return [
        name for name, change in changes.items() if change not in explained and not _is_slight(*change[1:])
    ]


def _in_new_processes(names: list[str], folder: Path, processes: int) -> dict[str, str]:
    """What became of each in a process of its own: what is called while modules are imported is called anew."""

    def outcome(name: str) -> str:
        try:
            ran = subprocess.run(
                [sys.executable, "-m", "pytest", "-q", "-x", *_OPTIONS, f"tests/unit/{_PACKAGE}"],
                cwd=folder / "mutants",
                env=_environment(folder) | {"MUTANT_UNDER_TEST": name},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                check=False,
                timeout=_LONGEST_S,
            )
        except subprocess.TimeoutExpired:
            return "timeout"
        failed = ran.returncode in (pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.INTERRUPTED)
        return "killed" if failed else "survived"

    with ThreadPoolExecutor(processes) as pool:
        return dict(zip(names, pool.map(outcome, names), strict=True))


def _environment(folder: Path) -> dict[str, str]:
    paths = f"{folder / 'mutants/src'}:{Path(__file__).parent}"
    return os.environ | {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1"}


def _names(command: list[str], folder: Path) -> list[str]:
    """All mutants."""
    listed = subprocess.run(
        [*command, "results", "--all", "true"], cwd=folder, capture_output=True, text=True, check=True
    )
    rows = (line.strip().rsplit(": ", 1) for line in listed.stdout.splitlines())
    return [row[0] for row in rows if len(row) == 2]


def _report(results: dict[str, str], modules: list[str], folder: Path) -> int:
    if not results:
        print("mutation: nothing was changed")
        return 1
    explained, seen, unexplained, slight = _explained(), set(), 0, 0
    for name, outcome in results.items():
        if outcome in _NOTICED and outcome != "timeout":
            continue
        change = place, was, becomes = _change(name, folder)
        if outcome == "timeout":
            why = "timeout"
        elif _is_slight(was, becomes):
            slight += 1
            continue
        else:
            seen.add(change)
            why = explained.get(change, "NOT EXPLAINED")
            unexplained += change not in explained
        print(f"{place}: {was or '(nothing)'}  ->  {becomes or '(nothing)'}: {why}")
    for place, was, becomes in sorted(explained.keys() - seen):
        if place.split(" ")[0].partition(".")[2] in modules:
            print(f"{place}: {was}  ->  {becomes}: explained, and noticed or gone")
    for module in modules:
        of = [outcome for name, outcome in results.items() if _module_of(name) == module]
        if of:
            print(f"{module:34} {len(of):5} {100.0 * _share(of):6.1f} %")
    counts = ", ".join(f"{count} {outcome}" for outcome, count in sorted(Counter(results.values()).items()))
    share = _share(list(results.values()))
    print(
        f"mutation: {len(results)} mutants, {counts}: {100.0 * share:.1f} % noticed, {unexplained} unexplained, "
        f"{slight} negligible"
    )
    return int(share < _LEAST_SHARE or unexplained > 0)


def _module_of(mutant: str) -> str:
    """The module below the package, as in `checks.fix_comparison`, of a mutant's name."""
    return ".".join(mutant.split(".")[2:-1])


def _path_of(module: str) -> str:
    return f"src/camber/{_PACKAGE}/{module.replace('.', '/')}.py"


def _share(outcomes: list[str]) -> float:
    return sum(outcome in _NOTICED for outcome in outcomes) / len(outcomes)


def _explained() -> dict[tuple[str, str, str], str]:
    """Why, by place and change."""
    entries = tomllib.loads((Path(__file__).parent / "survivors.toml").read_text())["survivor"]
    return {
        (entry["in"], was, becomes): entry["why"] for entry in entries for was, becomes in entry["changes"]
    }


def _is_slight(was: str, becomes: str) -> bool:
    """Is all that differs one number, by less than a millionth, or the `strict` of a zip of lists that are as long?

    mutmut adds 1 to each number: that makes a second of 1e9 + 1 ns. `strict` changes nothing for equal lengths.
    """
    if _STRICT.sub(")", was) == _STRICT.sub(")", becomes):
        return True
    differ = [pair for pair in zip(_tokens(was), _tokens(becomes), strict=False) if pair[0] != pair[1]]
    if len(differ) != 1:
        return False
    try:
        one, other = map(float, differ[0])
    except ValueError:
        return False
    return abs(other - one) <= _NEARLY_THE_SAME * abs(one)


def _tokens(line: str) -> list[str]:
    with contextlib.suppress(tokenize.TokenError):
        return [token.string for token in tokenize.generate_tokens(io.StringIO(line).readline)]
    return line.split()


def _change(name: str, folder: Path) -> tuple[str, str, str]:
    """Module and function, what stood there, and what stands there instead, each as one line."""
    with contextlib.chdir(folder):
        from mutmut.mutation.diff_apply import get_diff_for_mutant  # reads its settings when it is imported

        shown = get_diff_for_mutant(name, path=_path_of(_module_of(name)))
    lines = [line for line in shown.splitlines() if not line.startswith(("---", "+++", "#"))]
    was = " ".join(line[1:].strip() for line in lines if line.startswith("-"))
    becomes = " ".join(line[1:].strip() for line in lines if line.startswith("+"))
    result = re.fullmatch(r"camber\.(.+)\.x(.+)__mutmut_\d+", name)
    place = name if result is None else f"{result[1]} {result[2].replace('ǁ', '.').strip('._')}"
    return place, was, becomes


if __name__ == "__main__":
    raise SystemExit(main())
