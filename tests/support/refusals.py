"""A command that refuses: an exit code, nothing on standard output, and one line, after argparse's usage if any."""

from __future__ import annotations

from collections.abc import Callable

import pytest

Refused = Callable[..., str]
"""Called with the command's main, its arguments and, if not 2, the code: the line."""


def refusal(
    capsys: pytest.CaptureFixture[str], main: Callable[[list[str]], object], *arguments: object, code: int = 2
) -> str:
    capsys.readouterr()
    try:
        ended = main([str(argument) for argument in arguments])
    except SystemExit as stopped:
        ended = stopped.code
    out, err = capsys.readouterr()
    assert (ended, out) == (code, "")
    lines = err.splitlines()
    assert len(lines) == 1 or lines[0].startswith("usage: "), err
    return lines[-1]
