"""Parsers of tools, and the arguments that several of them have."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def tool_parser(
    prog: str, description: str | None, epilog: str | None = None, *, allow_abbrev: bool = True
) -> argparse.ArgumentParser:
    """Return a parser whose help keeps the line breaks of description and epilog."""
    form = argparse.RawDescriptionHelpFormatter
    return argparse.ArgumentParser(
        prog=prog, description=description, epilog=epilog, formatter_class=form, allow_abbrev=allow_abbrev
    )


def add_with_default(
    parser: argparse.ArgumentParser, name: str, default: Any, help: str, **more: Any
) -> None:
    """Add an option whose help ends in its default."""
    parser.add_argument(name, default=default, help=f"{help} (default %(default)s)", **more)


def add_drive(parser: argparse.ArgumentParser, help: str, *, out: str | None = None) -> None:
    """Add the manifest of a drive, `--set` that overrides it, and `--out` where it has a default folder."""
    parser.add_argument("drive", type=Path, metavar="drive.toml", help=help)
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override the manifest"
    )
    if out is not None:
        add_with_default(parser, "--out", Path(out), "output folder", type=Path, metavar="DIR")
