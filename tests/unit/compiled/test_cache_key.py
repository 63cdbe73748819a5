"""The digest changes with everything that compiling reads, and with nothing else."""

import cProfile
import importlib
import pkgutil
from collections.abc import Iterator
from itertools import pairwise
from types import ModuleType
from typing import Any

import numba
import pytest
from numba.core.dispatcher import Dispatcher

import camber
from camber.compiled.cache_key import NotKnown, inputs_digest

KERNEL = """
import enum
import math
from typing import NamedTuple
import numpy as np
import numba
LIMIT = 3.0
TABLE = np.arange(4.0)
PAIR = (1, 2.0)
class Pose(NamedTuple):
    x: float = 0.0
    y: float = 1.0
class Mode(enum.IntEnum):
    ON = 1
@numba.njit
def inner(x):
    return x * LIMIT
@numba.njit
def both(x, n):
    return other(x, n - 1) if n else inner(x)
@numba.njit
def other(x, n):
    return both(x, n)
def made(factor):
    @numba.njit
    def scaled(x):
        return x * factor
    return scaled
doubled = made(2.0)
@numba.njit
def kernel(x, scale=1.0):
    total = scale
    for value in [TABLE[k] for k in range(4)]:
        total += value
    pose = Pose(x, total)
    return both(pose.x, 3) + math.sqrt(pose.y) + PAIR[1] + Mode.ON + doubled(np.abs(x))
"""


def module_of(source: str) -> dict[str, Any]:
    module: dict[str, Any] = {"__name__": "kernels"}
    exec(compile(source, "kernels.py", "exec"), module)
    return module


def digest(source: str) -> bytes:
    return inputs_digest(module_of(source)["kernel"])


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("LIMIT = 3.0", "LIMIT = 4.0"),
        ("LIMIT = 3.0", "LIMIT = 3"),
        ("LIMIT = 3.0", "LIMIT = np.float32(3.0)"),
        ("np.arange(4.0)", "np.arange(4.0) * (np.arange(4) != 2)"),
        ("np.arange(4.0)", "np.arange(8.0)[::2]"),
        ("np.arange(4.0)", "np.arange(4, dtype=np.float32)"),
        ("(1, 2.0)", "(1, 2.5)"),
        ("x: float = 0.0\n    y: float = 1.0", "y: float = 0.0\n    x: float = 1.0"),
        ("y: float = 1.0", "y: float = 2.0"),
        ("ON = 1", "ON = 2"),
        ("x * LIMIT", "x + LIMIT"),
        ("@numba.njit\ndef inner", "@numba.njit(fastmath=True)\ndef inner"),
        ("other(x, n - 1)", "other(x, n - 2)"),
        ("return both(x, n)", "return both(x, n) + 1"),
        ("made(2.0)", "made(3.0)"),
        ("x * factor", "x - factor"),
        ("scale=1.0", "scale=2.0"),
        ("total += value", "total -= value"),
        ("math.sqrt", "math.cbrt"),
        ("np.abs", "np.sin"),
        ("np.abs", "np.sum"),
        ("np.abs", "numba.float32"),
        ("[TABLE[k]", "[2.0 * TABLE[k]"),
    ],
)
def test_it_changes_with_what_is_reached(before: str, after: str) -> None:
    assert KERNEL.count(before) == 1
    assert digest(KERNEL.replace(before, after)) != digest(KERNEL)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("total = scale", "total = scale  # what is added up"),
        ("@numba.njit\ndef kernel", "\n\n\n@numba.njit\ndef kernel"),
        ("LIMIT = 3.0", "LIMIT = 1.0 + 2.0\nANOTHER = 5.0"),
    ],
)
def test_it_does_not_change_with_comments_lines_and_what_is_not_reached(before: str, after: str) -> None:
    assert digest(KERNEL.replace(before, after)) == digest(KERNEL)


def test_it_changes_with_types_and_with_the_names_of_their_fields() -> None:
    module = module_of(KERNEL)
    kernel, pose = module["kernel"], module["Pose"]
    turned = type("Pose", (pose,), {"_fields": ("y", "x"), "__module__": pose.__module__})
    poses = [pose(1.0, 2.0), turned(1.0, 2.0)]
    arguments = [1.0, (1.0, 2.0), *poses, *((3, each) for each in poses)]
    digests = [inputs_digest(kernel, [numba.typeof(argument)]) for argument in arguments]
    assert len(set(digests)) == len(arguments)


def test_it_changes_with_each_property_of_a_type_of_rows() -> None:
    types_of_rows = [
        "np.dtype([('a', 'i8'), ('b', '?')])",
        "np.dtype([('b', 'i8'), ('a', '?')])",
        "np.dtype([('a', 'f8'), ('b', '?')])",
        "np.dtype([('a', 'i8'), ('b', '?')], align=True)",
    ]
    digests = {digest(KERNEL.replace("LIMIT = 3.0", f"LIMIT = {each}")) for each in types_of_rows}
    assert len(digests) == len(types_of_rows)


@pytest.mark.parametrize(
    "reached",
    [
        "{}",
        "np.dtype([('a', object)])",
        "[1]",
        "object()",
        "np.random.default_rng(1)",
        "__import__('camber.geodesy.angles').geodesy.angles",
    ],
)
def test_what_it_cannot_judge_is_named(reached: str) -> None:
    with pytest.raises(NotKnown, match="it reaches"):
        digest(KERNEL.replace("LIMIT = 3.0", f"LIMIT = {reached}"))


def test_a_profiler_that_listens_to_the_calls_changes_nothing() -> None:
    module = module_of(KERNEL)
    before = inputs_digest(module["kernel"])
    inner = module["inner"]
    cProfile.Profile().runcall(lambda: (inner(1.0), inner(1.0)))
    assert inputs_digest(module["kernel"]) == before


def test_functions_as_arguments_are_not_known() -> None:
    module = module_of(KERNEL)
    with pytest.raises(NotKnown, match="inner"):
        inputs_digest(module["kernel"], [numba.typeof(module["inner"])])


def modules() -> Iterator[ModuleType]:
    for module_value in pkgutil.walk_packages(camber.__path__, "camber."):
        if not module_value.name.endswith("__main__"):
            yield importlib.import_module(module_value.name)


def test_all_of_every_compiled_function_of_camber_is_known() -> None:
    module_value = {id(value): value for module in modules() for value in vars(module).values()}
    kernels = [value for value in module_value.values() if isinstance(value, Dispatcher)]
    assert len(kernels) > 100
    digests = sorted(inputs_digest(kernel) for kernel in kernels)
    assert all(one != next_one for one, next_one in pairwise(digests))
