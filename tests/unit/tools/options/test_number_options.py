"""Numbers as options: bounds of their own, one line beyond them, and none without."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Callable
from pathlib import Path

import pytest

import camber
from camber import cli
from camber.tools.options.number_options import each_of, number_from, whole_from
from support.refusals import Refused


def error_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    parser = argparse.ArgumentParser(prog="camber tool")
    parser.add_argument("--width-m", type=number_from(0.5, 20.0, "m"))
    parser.add_argument("--band", type=whole_from(1, 12))
    parser.add_argument(
        "--place", nargs=2, action=each_of(number_from(-90.0, 90.0), number_from(-180.0, 180.0))
    )
    with pytest.raises(SystemExit) as ended:
        parser.parse_args(arguments)
    assert ended.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("text", ["0.49", "20.001", "nan", "inf", "-inf", "wide", "", "0x1"])
def test_a_number_beyond_its_bounds_is_named_with_its_option_and_what_was_expected(text, capsys) -> None:
    expected = f"camber tool: error: argument --width-m: {text!r}, expected a number from 0.5 to 20 m"
    assert error_of([f"--width-m={text}"], capsys) == expected


@pytest.mark.parametrize("text", ["0", "13", "1.0", "nan", "first", "", "9" * 5000])
def test_a_whole_number_beyond_its_bounds_is_too(text, capsys) -> None:
    expected = f"camber tool: error: argument --band: {text!r}, expected a whole number from 1 to 12"
    assert error_of([f"--band={text}"], capsys) == expected


@pytest.mark.parametrize("place", [("90.1", "0"), ("0", "180.1"), ("nan", "0"), ("0", "east")])
def test_of_several_numbers_each_has_its_bounds(place, capsys) -> None:
    bad = place[0] if place[1] == "0" else place[1]
    assert f"argument --place: {bad!r}, expected a number from " in error_of(["--place", *place], capsys)


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (number_from(0.5, 20.0), "0.5", 0.5),
        (number_from(0.5, 20.0), "2e1", 20.0),
        (whole_from(-3, 12), "-3", -3),
        (whole_from(-3, 12), "12", 12),
    ],
)
def test_bounds_are_within(read: Callable[[str], float], text: str, value: float) -> None:
    assert read(text) == value


def test_several_numbers_keep_their_order() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument(
        "--place", nargs=2, action=each_of(number_from(-90.0, 90.0), number_from(-180.0, 180.0))
    )
    assert parser.parse_args(["--place", "-35.5", "179"]).place == (-35.5, 179.0)


SECONDS = "a number from 0.001 to 3600 s"


@pytest.mark.parametrize(
    ("command", "bounds", "numbers"),
    [
        ("access check vehicle.json5 --timeout-s", SECONDS, "nan inf -1"),
        ("doctor . --seconds", SECONDS, "nan inf -1 0"),
        ("gnss solve drive.toml --elevation-deg", "a number from 0 to 89", "x"),
        ("gnss solve drive.toml --ratio", "a number from 1 to 1000", "nan 0.5"),
        ("health gnss --timeout", "a number from 0.001 to 60 s", "0"),
        ("log_level gnss debug --timeout", SECONDS, "nan inf -1"),
        ("map export map --to geotiff --out tif --cell-m", "a number from 0.01 to 10000 m", "0.001"),
        ("map picture map --out map.png --pixels", "a whole number from 16 to 20000", "1"),
        ("play x.mcap --speed", "a number from 0.001 to 1000", "nan 1e-300"),
        ("play x.mcap --timeout", SECONDS, "nan inf 0"),
        ("record --out x --duration", "a number from 0.001 to 1e+08", "nan inf -1 x"),
        ("record --out x --keep-mb", "a number from 1 to 1e+08", "nan inf -1 x"),
        ("record --out x --leave-mb", "a number from 0 to 1e+08", "nan inf -1 x"),
        ("record --out x --max-mb", "a number from 1 to 1e+08", "nan inf -1 x 0"),
        ("record --out x --max-minutes", "a number from 0.001 to 1e+08", "nan inf -1 x"),
        ("record --out x --timeout", SECONDS, "nan inf -1 x"),
    ],
)
def test_an_option_of_a_tool_has_its_bounds(
    command: str, bounds: str, numbers: str, refused: Refused
) -> None:
    *arguments, option = command.split()
    for number in numbers.split():
        line = refused(cli.main, *arguments, f"{option}={number}")
        assert line.endswith(f"argument {option}: {number!r}, expected {bounds}")


def test_no_option_of_a_tool_takes_a_number_without_bounds() -> None:
    folders = [folder for part in camber.__path__ if (folder := Path(part, "tools")).is_dir()]
    unbounded = [
        f"{file.relative_to(folder)}:{node.value.lineno}"
        for folder in folders
        for file in sorted(folder.rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.keyword) and node.arg == "type" and _is_bare_number(node.value)
    ]
    assert folders
    assert not unbounded


def _is_bare_number(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id in {"int", "float"}
