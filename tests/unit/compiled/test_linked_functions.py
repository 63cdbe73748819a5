"""Compiled functions that compiled functions call: linked in, compiled once, and the same results and errors."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from camber.compiled.decorator import compiled

RAISES = """
from camber.compiled.decorator import compiled
@compiled
def root(x, number):
    if x < 0.0:
        raise ValueError("no root", number)
    return x ** 0.5
@compiled
def sum_of_roots(values):
    total = 0.0
    for i in range(values.size):
        total += root(values[i], i)
    return total
"""
RUN = """
import numpy as np
from raises_in_test import sum_of_roots
print(sum_of_roots(np.array([4.0, 9.0])))
try:
    sum_of_roots(np.array([4.0, -9.0]))
except ValueError as error:
    print(error.args)
"""


@compiled
def power(x: float, exponent: int) -> float:
    result = 1.0
    for _ in range(exponent):
        result *= x
    return result


@compiled
def polynomial(x: float) -> float:
    return power(x, 1) + power(x, 2) + power(x, 3)


def test_a_function_gives_the_same_from_python_and_within_another() -> None:
    x = 0.1 + 0.2
    assert polynomial(x) == power(x, 1) + power(x, 2) + power(x, 3)
    assert polynomial(x) == x + x * x + x * x * x


def test_constants_as_arguments_are_no_reason_to_compile_again() -> None:
    assert polynomial(2.0) == 14.0
    assert len(polynomial._linked.overloads) == 0  # type: ignore[attr-defined]
    assert len(power._linked.overloads) == 1  # type: ignore[attr-defined]


def test_arrays_that_a_linked_function_makes_outlive_it() -> None:
    @compiled
    def doubled(values: np.ndarray) -> np.ndarray:
        return 2.0 * values

    @compiled
    def last_of_doubled(values: np.ndarray) -> np.ndarray:
        return doubled(doubled(values))[-2:]

    for size in (3, 30_000):
        np.testing.assert_array_equal(
            last_of_doubled(np.arange(float(size))), [4.0 * (size - 2), 4.0 * (size - 1)]
        )


@pytest.mark.parametrize("run", ["compiled", "read from disk"])
def test_an_error_within_a_linked_function_says_what_it_says_in_python(run: str, tmp_path: Path) -> None:
    (tmp_path / "raises_in_test.py").write_text(RAISES)
    outputs = [
        subprocess.run(
            [sys.executable, "-c", RUN], cwd=tmp_path, env={}, capture_output=True, text=True, timeout=300
        )
        for _ in range(1 if run == "compiled" else 2)
    ]
    assert outputs[-1].stdout == "5.0\n('no root', 1)\n", outputs[-1].stderr


def test_with_another_version_of_numba_functions_are_compiled_as_numba_does(tmp_path: Path) -> None:
    (tmp_path / "raises_in_test.py").write_text(RAISES, "utf-8")
    other = "import numba; numba.__version__ = '0.99.0'\n" + RUN + "print(type(sum_of_roots).__name__)\n"
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "PYTHONPATH": str(tmp_path)}
    ran = subprocess.run(
        [sys.executable, "-c", other],
        capture_output=True,
        text=True,
        env=environment,
        check=True,
        timeout=120,
    )
    assert ran.stdout.splitlines() == ["5.0", "('no root', 1)", "CPUDispatcher"]
