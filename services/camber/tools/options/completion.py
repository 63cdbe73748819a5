"""`camber --completion SHELL`: shell completion of commands and options, by argcomplete."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Sequence
from typing import Any

import argcomplete
from argcomplete.lexers import split_line
from argcomplete.shell_integration import shellcode


def main(argv: list[str]) -> int:
    """Print the completion script of a shell: `eval "$(camber --completion bash)"`."""
    parser = argparse.ArgumentParser(prog="camber --completion", description=main.__doc__)
    parser.add_argument("shell", choices=("bash", "zsh", "fish"))
    print(shellcode(["camber"], shell=parser.parse_args(argv).shell))
    return 0


def arguments_before_cursor() -> list[str]:
    """Return the complete words of the line that the shell completes, after `camber`.

    From here on a parser completes its options in place of parsing them. The shell passes the line in COMP_LINE and
    the number of the first word that is the parser's in _ARGCOMPLETE.
    """
    argparse.ArgumentParser.parse_args = _autocomplete  # type: ignore[assignment,method-assign]
    _, _, _, line_parts, _ = split_line(os.environ["COMP_LINE"], int(os.environ["COMP_POINT"]))
    return line_parts[1:]


def complete_command(commands: Iterable[str], arguments: Sequence[str]) -> None:
    """Complete a command's name and end the process, or leave the rest to that command's own parser."""
    if not arguments:
        parser = argparse.ArgumentParser()
        parser.add_argument("command", choices=sorted(commands))
        argcomplete.autocomplete(parser)
    os.environ["_ARGCOMPLETE"] = str(int(os.environ["_ARGCOMPLETE"]) + 1)


def _autocomplete(parser: argparse.ArgumentParser, *_args: Any, **_named: Any) -> argparse.Namespace:
    argcomplete.autocomplete(parser)
    raise SystemExit(0)
