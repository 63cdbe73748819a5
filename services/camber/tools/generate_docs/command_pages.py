"""The page of all commands: what each prints with `--help`."""

from __future__ import annotations

import importlib
import io
import os
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from unittest import mock

_COLUMNS = "100"  # chosen: a line of help that a page shows beside the navigation without scrolling
_SUBCOMMAND = re.compile(r"^ {2,4}([a-z][a-z0-9_]*) {2,}\S", re.M)
_HEAD = "# Command line\n\nWhat each command prints with `--help`."


def commands_page() -> str:
    """Return the page with the help of `camber` and of each of its commands, in the order in which these are listed."""
    parts = [_HEAD]
    with mock.patch.dict(os.environ, COLUMNS=_COLUMNS):
        for name, text in _commands(()):
            parts += [f"{'##' if name.count(' ') < 2 else '###'} {name}", f"```text\n{text.rstrip()}\n```"]
    return "\n\n".join(parts) + "\n"


def _commands(path: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield name and help of a command and of all below it: those that its help lists."""
    text = help_of(path)
    yield " ".join(["camber", *path]), text
    if " COMMAND" in text.partition("\n\n")[0]:
        for name in dict.fromkeys(_SUBCOMMAND.findall(text)):
            yield from _commands((*path, name))


def help_of(path: tuple[str, ...]) -> str:
    """Return what a command prints with `--help`; ValueError where it takes that for an error."""
    cli = importlib.import_module("camber.cli")  # by name: the command line imports the tools, not they it
    printed = io.StringIO()
    with redirect_stdout(printed):
        try:
            code = cli.main([*path, "--help"])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
    if code != 0:
        raise ValueError(f"camber {' '.join(path)} --help: exit code {code}, expected 0")
    return printed.getvalue()
