"""The first run says how many functions it compiles, once; later runs say nothing, and a killed run breaks nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import termios
from pathlib import Path

import pytest

from support.running import environment, python

KERNELS = """
from camber.compiled.decorator import compiled
@compiled
def double(x):
    return 2.0 * x
@compiled
def quadruple(x):
    return double(double(x))
@compiled
def half(x):
    return 0.5 * x
"""
RUN = """
import sys
from camber.tools.options.compilation_bar import compilation_bar
from kernels_of_test import double, half, quadruple
kernels = {"double": double, "quadruple": quadruple, "half": half}
with compilation_bar(len(kernels), quiet="--quiet" in sys.argv):
    print(*(kernels[name](1.0) for name in sys.argv[1:] if name in kernels))
"""
ALL = ("double", "quadruple", "half")


class Place:
    def __init__(self, folder: Path) -> None:
        self.folder, self.cache = folder, folder / "cache"
        (folder / "kernels_of_test.py").write_text(KERNELS)
        self.environment = environment()
        self.environment["PYTHONPATH"] += os.pathsep + str(folder)
        self.environment["NUMBA_CACHE_DIR"] = str(self.cache)

    def run(self, *arguments: str) -> tuple[str, str]:
        """Standard output and error."""
        done = python("-c", RUN, *arguments, env=self.environment, timeout_s=300.0)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip(), done.stderr

    def start(self, *arguments: str, stderr: int) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", RUN, *arguments],
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


def test_the_first_run_says_it_in_one_line_and_the_second_nothing(place: Place) -> None:
    assert place.run(*ALL) == ("2.0 4.0 0.5", "compiling 3 functions, once after installation\n")
    assert place.run(*ALL) == ("2.0 4.0 0.5", "")


def test_what_is_on_disk_does_not_count(place: Place) -> None:
    place.run("double", "--quiet")
    assert place.run(*ALL)[1] == "compiling 2 functions, once after installation\n"


def test_quiet_says_nothing(place: Place) -> None:
    assert place.run(*ALL, "--quiet") == ("2.0 4.0 0.5", "")


def test_on_a_terminal_there_is_a_bar_to_the_end(place: Place) -> None:
    assert "3/3" in _on_terminal(place)
    assert _on_terminal(place) == ""


def test_a_run_that_is_killed_while_it_compiles_breaks_nothing(place: Place) -> None:
    with place.start(*ALL, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "compiling 3 functions, once after installation\n"
        process.kill()
    assert process.returncode != 0
    output, errors = place.run(*ALL)
    assert output == "2.0 4.0 0.5"
    assert errors == "compiling 3 functions, once after installation\n"
    assert place.run(*ALL) == ("2.0 4.0 0.5", "")


def _on_terminal(place: Place) -> str:
    """What a run shows on a terminal."""
    reader, writer = os.openpty()
    termios.tcsetwinsize(writer, (25, 100))
    with place.start(*ALL, stderr=writer) as process:
        assert process.stdout is not None
        assert process.stdout.read() == "2.0 4.0 0.5\n"
    os.close(writer)
    shown = b""
    try:
        while data := os.read(reader, 4096):
            shown += data
    except OSError:  # Linux: the other end is closed
        pass
    finally:
        os.close(reader)
    return shown.decode()
