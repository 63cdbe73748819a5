"""Tables of subcommands: the choice of one, with a suggestion for a mistyped name, and their help text."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from typing import NamedTuple


class Command(NamedTuple):
    """A subcommand: the module with its `main(argv) -> exit code`, and one line of help."""

    module: str
    help: str


def choose_command(prog: str, commands: Mapping[str, Command], argv: Sequence[str]) -> str | None:
    """Return the name of the command that the first argument gives.

    Without one, or with `--help`, the commands are printed and SystemExit(0) is raised. A mistyped name is one line on
    standard error with the nearest name, and None. During shell completion the name is completed.
    """
    if "_ARGCOMPLETE" in os.environ:
        from camber.tools.options.completion import complete_command

        complete_command(commands, argv)
    if not argv or argv[0] in ("-h", "--help"):
        print(help_text(prog, {"commands": commands}))
        raise SystemExit(0)
    name = argv[0].replace("-", "_")
    if name in commands:
        return name
    from difflib import get_close_matches  # 3 ms that only a mistyped name pays

    near = get_close_matches(name, commands, n=1)
    suggestion = f"did you mean {near[0]!r}? " if near else ""
    print(f"{prog}: no command {argv[0]!r}; {suggestion}`{prog} --help` lists them", file=sys.stderr)
    return None


def help_text(prog: str, groups: Mapping[str, Mapping[str, Command]]) -> str:
    """Return usage and all commands by group."""
    lines = [f"usage: {prog} COMMAND [options]      {prog} COMMAND --help for each"]
    for title, commands in groups.items():
        lines += ["", f"{title}:", *(f"  {name:<16} {command.help}" for name, command in commands.items())]
    return "\n".join(lines)
