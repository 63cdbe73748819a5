"""Several warm-ups are compiled by several processes at once, each function once, and are there at the end."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from support.running import environment, python

KERNEL = """
from camber.compiled.decorator import compiled
@compiled
def kernel(x):
    return 2.0 * x
"""
MODULE = """
from kernel_of_{name} import kernel
def warm_up():
    {fault}
    with open("{name}.calls", "a") as file:
        file.write(str(kernel(1.0) and sum(kernel.stats.cache_misses.values())))
if __name__ == "__main__":
    warm_up()
"""
RUN = """
import first, second, third
from camber.tools.options.shared_warm_up import warm_up_all
warm_up_all([first, second, third], 3)
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    for name in ("first", "second", "third"):
        (tmp_path / f"kernel_of_{name}.py").write_text(KERNEL)
        (tmp_path / f"{name}.py").write_text(MODULE.format(name=name, fault="pass"))
    return tmp_path


def _run(place: Path) -> str:
    """Standard error."""
    variables = environment()
    variables["PYTHONPATH"] += os.pathsep + str(place)
    variables["NUMBA_CACHE_DIR"] = str(place / "cache")
    done = python("-c", RUN, env=variables, cwd=place, timeout_s=300.0)
    assert done.returncode == 0, done.stderr
    return done.stderr


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one processor compiles one after another")
def test_each_function_is_compiled_once_and_then_read(place: Path) -> None:
    assert _run(place) == "compiling 3 functions, once after installation\n"
    # Compiled here; compiled by another process (1), then read here (0).
    assert [(place / f"{name}.calls").read_text() for name in ("first", "second", "third")] == [
        "1",
        "10",
        "10",
    ]


def test_with_all_on_disk_no_process_is_started(place: Path) -> None:
    _run(place)
    for calls in place.glob("*.calls"):
        calls.unlink()
    assert _run(place) == ""
    assert [(place / f"{name}.calls").read_text() for name in ("first", "second", "third")] == ["0", "0", "0"]


def test_what_another_process_fails_at_is_compiled_here(place: Path) -> None:
    fault = 'assert __name__ != "__main__"'
    (place / "second.py").write_text(MODULE.format(name="second", fault=fault))
    assert _run(place) == "compiling 3 functions, once after installation\n"
    assert (place / "second.calls").read_text() == "1"
