"""`camber map`: releases of the map, made from what people have, looked at, compared and given away."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping, Sequence

_PROG = "camber map"

SUBCOMMANDS: dict[str, tuple[str, str]] = {
    "build": ("camber.tools.maps.build", "a release from a map, a survey or clouds that people have"),
    "inspect": ("camber.tools.maps.inspect", "what a release, a store or a map not imported yet holds"),
    "diff": ("camber.tools.maps.diff", "what another release has, lacks and says otherwise"),
    "export": ("camber.tools.maps.exports", "a release as GeoTIFF, GeoJSON, or PCD cells for Autoware"),
    "picture": ("camber.tools.maps.picture", "a map from above, as PNG"),
    "releases": (
        "camber.tools.maps.releases",
        "which releases there are, whence a height is, and back to one before",
    ),
    "review": ("camber.tools.maps.review", "changes that wait for a person: list, accept, reject"),
}
"""Name → module with `main(argv) -> exit code`, and a line of help."""


def main(argv: Sequence[str]) -> int:
    """Run a subcommand; returns its exit code, 2 where there is none of that name."""
    name = dispatched(_PROG, "SUBCOMMAND", SUBCOMMANDS, argv)
    if name is None:
        return 2
    code: int = importlib.import_module(SUBCOMMANDS[name][0]).main(argv[1:])
    return code


def dispatched(prog: str, what: str, table: Mapping[str, tuple[str, str]], argv: Sequence[str]) -> str | None:
    """The name in a table that the first word is; None where it is not, having said so. Help ends as argparse's."""
    if not argv or argv[0] in ("-h", "--help"):
        lines = [f"usage: {prog} {what} [options]      {prog} {what} --help for each", ""]
        print("\n".join(lines + [f"  {name:<12} {text}" for name, (_, text) in table.items()]))
        raise SystemExit(0)
    if argv[0] not in table:
        print(f"{prog}: {argv[0]!r}, expected one of: {', '.join(table)}", file=sys.stderr)
        return None
    return argv[0]
