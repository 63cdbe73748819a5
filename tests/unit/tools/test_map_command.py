"""`camber map`: every row of its tables is a command with its own help; what is not a row is one line."""

from __future__ import annotations

import pytest

from camber import cli
from camber.tools.maps.build import KINDS
from camber.tools.maps.command import SUBCOMMANDS

COMMANDS = [*((name,) for name in SUBCOMMANDS), *(("build", kind) for kind in KINDS)]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_its_own_help(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["map", *words, "--help"])
    assert ended.value.code == 0
    assert f"usage: camber map {' '.join(words)}" in capsys.readouterr().out


@pytest.mark.parametrize("words", [("bild",), ("build", "shapefile")], ids=" ".join)
def test_what_is_no_command_is_one_line(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["map", *words]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert f"'{words[-1]}'" in said.err
