"""`camber map`: its subcommands and kinds of maps, each with its help; a name that is none of them is one line."""

from __future__ import annotations

import pytest

from camber import cli
from camber.tools.maps.build import KINDS
from camber.tools.maps.command import SUBCOMMANDS
from support.refusals import Refused

COMMANDS = [*((name,) for name in SUBCOMMANDS), *(("build", kind) for kind in KINDS)]


def test_the_subcommands_and_the_kinds_of_maps() -> None:
    assert set(SUBCOMMANDS) == {"build", "inspect", "diff", "export", "picture", "releases", "review"}
    assert set(KINDS) == {"lanelet2", "opendrive", "argoverse", "clouds", "drive", "geojson", "geotiff"}


@pytest.mark.parametrize("arguments", COMMANDS, ids=" ".join)
def test_every_command_prints_its_help(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["map", *arguments, "--help"])
    assert ended.value.code == 0
    assert f"usage: camber map {' '.join(arguments)}" in capsys.readouterr().out


@pytest.mark.parametrize("arguments", [("bild",), ("build", "shapefile")], ids=" ".join)
def test_an_unknown_command_is_one_line(arguments: tuple[str, ...], refused: Refused) -> None:
    assert f"'{arguments[-1]}'" in refused(cli.main, "map", *arguments)
