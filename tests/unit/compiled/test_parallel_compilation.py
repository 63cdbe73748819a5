"""A second process compiles some functions at the first run; whatever it does, the results are the same."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

WORK = """
import math
import os
import sys
from camber.compiled.compilation_progress import CompilationProgress, watched_by
from camber.compiled.decorator import compiled
from camber.compiled.parallel_compilation import compiled_in_parallel

@compiled
def halved(x):
    return 0.5 * x

@compiled
def root(x):
    return math.sqrt(x)

def work():
    return root(halved(32.0))

if __name__ == "__main__":
    with open("started", "a") as file:
        file.write(os.environ.get("CAMBER_COMPILE_PART", "whole") + "\\n")
    if "FAILS" in os.environ and "CAMBER_COMPILE_PART" in os.environ:
        sys.exit(1)
    import work_in_parallel
    progress = CompilationProgress(expected=None, begin=lambda functions: None, advance=lambda: None)
    with watched_by(progress), compiled_in_parallel("work_in_parallel", frozenset({"work_in_parallel.root"})):
        result = work_in_parallel.work()
    print(result, progress.compiled, progress.read)
"""


two_processors = pytest.mark.skipif(
    len(os.sched_getaffinity(0)) < 2, reason="one processor: nothing is compiled in parallel"
)


def run(folder: Path, *command: str, **environment: str) -> str:
    (folder / "work_in_parallel.py").write_text(WORK)
    set_here = {
        "NUMBA_CACHE_DIR": str(folder / "cache"),
        "PYTHONPATH": os.pathsep.join([str(folder), *sys.path]),
    }
    done = subprocess.run(
        [*command, sys.executable, "-m", "work_in_parallel"],
        cwd=folder,
        env={**os.environ, **set_here, **environment},
        capture_output=True,
        text=True,
        timeout=300.0,
        check=True,
    )
    return done.stdout.strip()


@two_processors
def test_a_function_of_the_part_is_compiled_by_the_other_process_and_read_here(tmp_path: Path) -> None:
    assert run(tmp_path) == "4.0 1 1"
    assert (tmp_path / "started").read_text() == "whole\nwork_in_parallel.root\n"


@two_processors
def test_what_the_other_process_fails_to_compile_is_compiled_here(tmp_path: Path) -> None:
    assert run(tmp_path, FAILS="1") == "4.0 2 0"


def test_nothing_is_started_where_all_is_on_disk_or_there_is_one_processor(tmp_path: Path) -> None:
    one_processor = ("taskset", "--cpu-list", str(min(os.sched_getaffinity(0))))
    assert run(tmp_path, *one_processor) == "4.0 2 0"
    assert run(tmp_path) == "4.0 0 2"
    assert (tmp_path / "started").read_text() == "whole\nwhole\n"
