"""Machine code on disk: used where it is right, never where it is not, and nothing stands in the way of compiling."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import NumbaWarning

from camber.compiled.decorator import compiled, compiled_without_gil

CALLEE = """
from camber.compiled.decorator import compiled
@compiled
def scaled(x):
    return x * 2.0
"""
KERNEL = """
from camber.compiled.decorator import compiled
from callee_of_test import scaled
@compiled
def kernel(x):
    return scaled(x) + 1.0
"""
RUN = """
from kernel_of_test import kernel
print(kernel(10.0), sum(kernel.stats.cache_misses.values()), sum(kernel.stats.cache_hits.values()))
"""
MADE, CACHED = (1, 0), (0, 1)


class Place:
    """Two modules in a folder, and processes that call the one that calls the other."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.cache = folder, folder / "__pycache__"
        self.callee = folder / "callee_of_test.py"
        self.callee.write_text(CALLEE)
        (folder / "kernel_of_test.py").write_text(KERNEL)

    def start(self, **environment: str) -> subprocess.Popen[str]:
        settings = {"PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1", **environment}
        return subprocess.Popen(
            [sys.executable, "-W", "error", "-c", RUN],
            env={"PATH": os.environ["PATH"], "XDG_CACHE_HOME": "/dev/null/cache", **settings},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, **environment: str) -> tuple[float, tuple[int, int]]:
        """The result of kernel(10), and how often it was compiled and found."""
        return self.ended(self.start(**environment))

    def ended(self, process: subprocess.Popen[str]) -> tuple[float, tuple[int, int]]:
        out, errors = process.communicate(timeout=300)
        assert not errors
        value, misses, hits = out.split()
        return float(value), (int(misses), int(hits))

    def files(self) -> list[Path]:
        return sorted(self.cache.glob("*kernel*.nbc"))


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


def test_a_callee_that_changes_in_another_file_of_the_same_time_and_size_is_noticed(place: Place) -> None:
    assert place.run() == (21.0, MADE)
    assert place.run() == (21.0, CACHED)
    before = place.callee.stat()
    place.callee.write_text(CALLEE.replace("2.0", "3.0"))
    os.utime(place.callee, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert place.callee.stat().st_size == before.st_size
    assert place.run() == (31.0, MADE)
    # What is out of date is written over: nothing piles up.
    assert len(place.files()) == 1
    place.callee.write_text("# Words.\n" + CALLEE.replace("2.0", "3.0"))
    assert place.run() == (31.0, CACHED)


def test_what_is_damaged_is_compiled_anew(place: Place) -> None:
    place.run()
    (file,) = place.files()
    whole = file.read_bytes()
    for damaged in (b"", whole[:-1], whole[:1000] + bytes([whole[1000] ^ 1]) + whole[1001:]):
        file.write_bytes(damaged)
        assert place.run() == (21.0, MADE)
        assert len(file.read_bytes()) == len(whole)


def test_processes_that_compile_at_once_do_not_disturb_one_another(place: Place) -> None:
    processes = [place.start() for _ in range(2)]
    assert [place.ended(process)[0] for process in processes] == [21.0] * 2
    assert place.run() == (21.0, CACHED)
    assert not list(place.cache.glob("*.tmp"))


def test_without_a_writable_source_folder_the_users_cache_is_used(place: Place, tmp_path: Path) -> None:
    place.cache.write_text("no folder")
    assert place.run(XDG_CACHE_HOME=str(tmp_path / "user")) == (21.0, MADE)
    assert place.run(XDG_CACHE_HOME=str(tmp_path / "user")) == (21.0, CACHED)


def test_where_nothing_can_be_written_it_is_compiled_each_time_without_a_warning(place: Place) -> None:
    place.cache.write_text("no folder")
    assert place.run() == (21.0, MADE)
    assert place.run(NUMBA_CACHE_DIR="/dev/null/cache") == (21.0, MADE)


def test_the_folder_that_is_named_is_the_one(place: Place, tmp_path: Path) -> None:
    place.run()
    assert place.run(NUMBA_CACHE_DIR=str(tmp_path / "named")) == (21.0, MADE)
    assert place.run(NUMBA_CACHE_DIR=str(tmp_path / "named")) == (21.0, CACHED)


def test_without_a_compiler_it_is_the_function_itself(place: Place) -> None:
    process = place.start(NUMBA_DISABLE_JIT="1")
    assert "'function' object has no attribute 'stats'" in process.communicate(timeout=300)[1]


def test_what_cannot_be_cached_is_compiled_with_a_warning() -> None:
    @compiled
    def twice(x: float) -> float:
        return 2.0 * x

    @compiled_without_gil
    def applied(function: object, x: float) -> float:
        return function(x)  # type: ignore[operator, no-any-return]

    with pytest.warns(NumbaWarning, match="applied is compiled anew by each process: it reaches"):
        assert applied(twice, 4.0) == 8.0


def test_each_type_of_argument_has_its_code() -> None:
    @compiled
    def total(values: np.ndarray) -> float:
        return values.sum() / 2  # type: ignore[no-any-return]

    assert total(np.arange(4)) == 3.0
    assert total(np.arange(4.0)[::-1]) == 3.0
    assert total(np.arange(5, dtype=np.float32)) == 5.0
