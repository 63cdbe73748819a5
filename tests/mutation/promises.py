"""Does a test fail when a promise is broken? `PYTHONPATH=tests python -m mutation.promises [NAME …]` (`make promises`).

Each promise of `docs/safety/promises.toml` names a change that breaks it. The change is planted in a copy of the
sources, and the first test of the promise must fail there with a failed assertion or error of its own (exit code 1),
having passed before. The working tree is not touched.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from camber.tools.generate_docs.promises import Promise, read_promises, source_file

_ROOT = Path(__file__).resolve().parents[2]
PROMISES = read_promises(_ROOT / "docs/safety/promises.toml")
_PASSED, _FAILED = 0, 1  # exit codes of pytest
_LONGEST_S = 600.0  # chosen: a change may make a test hang, which is noticed too


def copy_sources(folder: Path) -> Path:
    """Copy both source roots, with their compiled code, into a folder; return the folder."""
    for part in ("services", "schemas"):
        shutil.copytree(_ROOT / part, folder / part)
    return folder


@contextmanager
def planted(promise: Promise, copy: Path) -> Iterator[None]:
    """Break a promise in a copy of the sources; it is whole again afterwards."""
    path = source_file(promise.code[0], copy)
    whole = path.read_bytes()
    text = whole.decode("utf-8")
    if text.count(promise.find) != 1:
        raise ValueError(
            f"{promise.name}: `find` is in {path.name} {text.count(promise.find)} times, expected once"
        )
    path.write_text(text.replace(promise.find, promise.replace), encoding="utf-8")
    stamp = time.time_ns() + 2_000_000_000  # byte code is kept by whole seconds
    os.utime(path, ns=(stamp, stamp))
    try:
        yield
    finally:
        path.write_bytes(whole)


def outcome_of(test: str, copy: Path) -> int:
    """Exit code of pytest for a test (`file::name` below `tests`) with the sources of the copy."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(str(copy / part) for part in ("schemas", "services")),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", f"tests/{test}"]
    try:
        ran = subprocess.run(
            command, cwd=_ROOT, env=environment, capture_output=True, timeout=_LONGEST_S, check=False
        )
    except subprocess.TimeoutExpired:
        return _FAILED
    return ran.returncode


def notices(promise: Promise, copy: Path) -> str:
    """Return "noticed", or what went wrong: the test failed before, or did not fail after the change."""
    before = outcome_of(promise.tests[0], copy)
    if before != _PASSED:
        return f"exit code {before} without the change"
    with planted(promise, copy):
        after = outcome_of(promise.tests[0], copy)
    return "noticed" if after == _FAILED else f"NOT NOTICED: exit code {after} with the change"


def main() -> int:
    """Exit code 1 where a change was not noticed."""
    parser = argparse.ArgumentParser(prog="python -m mutation.promises", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of promises; default: all")
    names = parser.parse_args().names
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = copy_sources(Path(folder))
        for promise in PROMISES:
            if names and promise.name not in names:
                continue
            began_s = time.monotonic()
            result = notices(promise, copy)
            failed += result != "noticed"
            seconds = time.monotonic() - began_s
            print(f"{promise.name:4} {result}, {promise.tests[0]} ({seconds:.0f} s)", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    raise SystemExit(main())
