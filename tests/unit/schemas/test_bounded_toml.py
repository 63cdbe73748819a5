"""TOML is bounded before it is parsed: neither a pipe nor nesting takes time or memory."""

from __future__ import annotations

import os
import tomllib
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.runtime.settings import ConfigError, ServiceSettings, load
from camber.schemas.bounded_toml import NestingError, parse_toml, read_toml
from camber.schemas.drive import ManifestError, load_manifest

DEEP = {
    "dotted": "a." * 50_000 + "a = 1",
    "spaced": "a . " * 25_000 + "a = 1",
    "quoted": '"a".' * 25_000 + "a = 1",
    "literal": "'a'." * 25_000 + "a = 1",
    "header": "[" + "a." * 50_000 + "a]",
    "arrays": "a = " + "[" * 100_000,
    "tables": "a = " + "{a = " * 20_000,
    "in a table": "a = {" + "a." * 50_000 + "a = 1}",
    "after four quotes": 'a = """a""""\nb = 1\n' + "a." * 50_000 + "a = 1",
    "after five quotes": "a = '''a'''''\nb = 1\n" + "a." * 50_000 + "a = 1",
    "after a comment": "# it's\n" + "a." * 50_000 + "a = 1",
    "after an escape": 'a = "\\""\n' + "a." * 50_000 + "a = 1",
}


@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP.keys())
def test_deep_nesting_is_refused_before_it_takes_memory(text: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(NestingError, match="nested deeper than 16 levels"):
            parse_toml(text)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "text",
    [
        "a.b.c.d = [[1.5, 2.5], [3.5]]",
        "x = [" + "1.5, " * 1000 + "]",
        "# " + "a." * 100,
        "x = '" + "a." * 100 + "'",
        'x = """\n' + "[" * 100 + '"' + "a." * 100 + '"""',
        "x = '''" + "{" * 100 + "'''",
        "[[a]]\nb = {c = {d = 1}}\n" * 100,
        'x = "\\\\" # "',
    ],
)
def test_settings_as_people_write_them_are_read_as_ever(text: str) -> None:
    assert parse_toml(text) == tomllib.loads(text)


@settings(derandomize=True, max_examples=500)
@given(st.text("a.=[]{}\"'\\#\n, 1", max_size=60))
def test_whatever_the_text_it_is_parsed_as_by_tomllib_or_refused(text: str) -> None:
    try:
        expected = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        with pytest.raises(ValueError, match=r"\w"):
            parse_toml(text)
        return
    try:
        assert parse_toml(text) == expected
    except NestingError:
        assert text.count(".") + text.count("[") + text.count("{") > 16


def test_a_pipe_a_folder_and_a_file_without_an_end_are_one_line(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "folder.toml").mkdir()
    with (tmp_path / "endless.toml").open("wb") as file:
        file.truncate(1 << 40)
    for name, reason in (
        ("pipe", "not a plain file"),
        ("folder", "not a plain file"),
        ("endless", "larger than 262144 bytes"),
    ):
        path = tmp_path / f"{name}.toml"
        with pytest.raises(ConfigError, match=f"^{path}: {reason}$"):
            load(ServiceSettings, ["--config", str(path)], prog="camber")
        with pytest.raises(ManifestError, match=f"^{path}: {reason}, expected a drive manifest$"):
            load_manifest(path)
        with pytest.raises(OSError, match=reason):
            read_toml(path)


def test_deep_settings_and_manifests_are_one_line_that_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "deep.toml"
    path.write_text("name = 1\n" + DEEP["dotted"])
    with pytest.raises(ConfigError, match=f"^{path}: not TOML: line 2: nested deeper than 16 levels$"):
        load(ServiceSettings, ["--config", str(path)], prog="camber")
    with pytest.raises(ManifestError, match=f"^{path}: not TOML: line 2: nested deeper than 16 levels$"):
        load_manifest(path)
