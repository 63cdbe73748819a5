"""`camber map`: build, inspect, compare and export releases of the map."""

from __future__ import annotations

import importlib
from collections.abc import Sequence

from camber.tools.options.subcommands import Command, choose_command

_PROG = "camber map"

SUBCOMMANDS = {
    "build": Command(
        "camber.tools.maps.build", "build a release from other map formats, a survey or point clouds"
    ),
    "inspect": Command(
        "camber.tools.maps.inspect", "contents of a release, a store or a map that can be imported"
    ),
    "diff": Command("camber.tools.maps.diff", "differences between two releases"),
    "export": Command(
        "camber.tools.maps.exports", "a release as GeoTIFF, GeoJSON, GeoParquet, PMTiles, or PCD cells"
    ),
    "picture": Command("camber.tools.maps.picture", "the map from above, as PNG"),
    "releases": Command(
        "camber.tools.maps.releases", "list releases, show where a height came from, roll back"
    ),
    "review": Command("camber.tools.maps.review", "list, accept and reject changes that wait for a decision"),
}


def main(argv: Sequence[str]) -> int:
    """Run a subcommand; returns its exit code, 2 where there is none of that name."""
    name = choose_command(_PROG, SUBCOMMANDS, argv)
    if name is None:
        return 2
    code: int = importlib.import_module(SUBCOMMANDS[name].module).main(argv[1:])
    return code
