"""TOML in a plain file, with bounds on its size and its nesting that are checked before it is parsed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from camber.schemas.plain_file import read_plain_file

_MOST_BYTES = 1 << 18  # chosen: the longest file of settings here has some kB
_DEEPEST = 16  # chosen: the deepest setting here has four names
_TOKEN = re.compile(
    r'''"""(?s:\\.|[^\\])*?"{3,5}|"{3}|"(?:\\.|[^"\\\n])*"|"|'''
    r"""'''(?s:.)*?'{3,5}|'{3}|'[^'\n]*'|'|#[^\n]*|[][{}.,=\n]"""
)
"""What nesting is counted by: strings and comments as a whole, brackets, dots and what separates keys."""
_UNTERMINATED = frozenset(("'", '"', "'''", '"""'))


class NestingError(ValueError):
    """TOML that is nested deeper than any setting; the text gives the line."""


def read_toml(path: Path) -> dict[str, Any]:
    """Return the table in a plain file of at most 256 kB. Raises OSError, and ValueError for what is no TOML."""
    return parse_toml(read_plain_file(path, _MOST_BYTES).decode("utf-8"))


def parse_toml(text: str) -> dict[str, Any]:
    """Return the table in a text. Raises TOMLDecodeError, or NestingError before anything is parsed.

    tomllib itself takes memory by the square of the names in a key, and a frame for each bracket.
    """
    _check_nesting(text)
    return tomllib.loads(text)


def _check_nesting(text: str) -> None:
    depth = dots = 0
    line = 1
    for match in _TOKEN.finditer(text):
        token = match[0]
        line += token.count("\n")
        if token in _UNTERMINATED:
            return  # a string without an end, at which tomllib ends, too
        if token == ".":
            dots += 1
        elif token[0] in "[]{},=\n":
            dots = 0
            depth = max(depth + (token in "[{") - (token in "]}"), 0)
        if max(depth, dots) > _DEEPEST:
            raise NestingError(f"line {line}: nested deeper than {_DEEPEST} levels")
