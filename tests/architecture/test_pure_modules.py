"""Within a service all but service, settings and __main__ are pure: no clock, no log, no wiring."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest

from camber.schemas.channels import SENSORS, SERVICES
from support.tree import ROOT, modules

WIRING = {"service", "settings", "__main__"}
PURE = [
    (name, path)
    for name, path in modules()
    if name.split(".")[1] in (*SERVICES, SENSORS) and path.stem not in WIRING
]
# What a distribution is imported as, where it is not its own name with underscores.
IMPORTED_AS = {
    "arro3_io": "arro3",
    "eclipse_zenoh": "zenoh",
    "foxglove_sdk": "foxglove",
    "griffelib": "griffe",
    "nats_py": "nats",
    "pyserial": "serial",
    "ruamel.yaml": "ruamel",
}


def imports(path: Path) -> set[str]:
    """Dotted names that a file imports, `from a import b` as both `a` and `a.b`."""
    modules: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return modules


def test_there_are_pure_modules() -> None:
    assert PURE


@pytest.mark.parametrize(("name", "path"), PURE, ids=[name for name, _ in PURE])
def test_a_pure_module_knows_no_clock_no_log_and_no_wiring(name: str, path: Path) -> None:
    service = ".".join(name.split(".")[:2])
    forbidden = {"time", "logging", "structlog", "zenoh", "camber.runtime"}
    forbidden |= {f"{service}.{wiring}" for wiring in WIRING}
    assert not imports(path) & forbidden


def test_every_import_is_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [
        line for name, lines in project["optional-dependencies"].items() if name != "dev" for line in lines
    ]
    names = {
        re.split(r"[\[>=]", line)[0].strip().replace("-", "_") for line in [*project["dependencies"], *extras]
    }
    declared = {IMPORTED_AS.get(name, name) for name in names} | {"pydantic_core", "camber"}
    for name, path in modules():
        outside = {
            top for full in imports(path) if (top := full.split(".")[0]) not in sys.stdlib_module_names
        }
        assert outside <= declared, f"{name} imports {outside - declared}, which pyproject.toml does not list"


def compiled_functions() -> list[tuple[str, ast.FunctionDef]]:
    compiled = []
    for name, path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and any(
                isinstance(mark, ast.Name) and mark.id.startswith("compiled") for mark in node.decorator_list
            ):
                compiled.append((name, node))
    return compiled


def test_compiled_code_does_without_scipy() -> None:
    """Numba takes `@`, np.dot and np.linalg from SciPy, which only the tests have."""
    functions = compiled_functions()
    assert len(functions) > 50
    for name, function in functions:
        for node in ast.walk(function):
            product = isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult)
            called = isinstance(node, ast.Attribute) and node.attr in ("linalg", "dot", "vdot", "kron")
            assert not product, f"{name}.{function.name}, line {node.lineno}"
            assert not called, f"{name}.{function.name}, line {node.lineno}"
