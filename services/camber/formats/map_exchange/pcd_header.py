"""The header of a point cloud file: ten entries in a fixed order, PCD version 0.7."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from camber.formats.errors import FormatError

_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_TYPES = {f"{kind}{size}": f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)} | {
    "F4": "<f4",
    "F8": "<f8",
}
# Chosen: bounds that no real cloud reaches, so that a damaged header is refused before it fills the memory.
_MAX_HEADER_BYTES = 65_536
_MAX_POINTS = 200_000_000
_MAX_COUNT = 65_536
USED = ("x", "y", "z", "intensity", "t")
"""The fields that are read; each has one number per point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PcdHeader:
    """`kinds` are numpy's codes, `counts` the numbers per point of each field; the data begin at byte `begin`, after
    `lines` lines."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    counts: tuple[int, ...]
    points: int
    data: str
    begin: int
    lines: int

    def row(self) -> np.dtype[Any]:
        """Return the layout of one point in a binary file."""
        fields = enumerate(zip(self.kinds, self.counts, strict=True))
        return np.dtype([(f"{k}", kind, (count,)) for k, (kind, count) in fields])


def read_header(data: bytes, source_name: str) -> PcdHeader:
    """Parse the ten entries, each once, in the format's order; ignores comments and empty lines.

    Raises FormatError for the first invalid entry.
    """
    entries: dict[str, list[str]] = {}
    begin = line_number = 0
    while "DATA" not in entries:
        line_number += 1
        end = data.find(b"\n", begin, begin + _MAX_HEADER_BYTES)
        if end < 0:
            expected = f"the header to continue with {_KEYS[len(entries)]}"
            actual = data[begin : begin + 40]
            raise FormatError(source_name, "header", expected, actual=actual, line_number=line_number)
        line, begin = data[begin:end], end + 1
        words = line.decode("latin-1").split()
        if not words or words[0].startswith("#"):
            continue
        key = _KEYS[len(entries)]
        if key == "VIEWPOINT" and words[0] == "POINTS":
            entries[key], key = [], "POINTS"  # files before 0.7 have none
        if words[0] != key:
            raise FormatError(source_name, "header", key, actual=words[0], line_number=line_number)
        entries[key] = words[1:]
        _check(entries, key, line_number, source_name)
    counts = tuple(int(word) for word in entries["COUNT"])
    kinds = tuple(_TYPES[kind + size] for kind, size in zip(entries["TYPE"], entries["SIZE"], strict=True))
    return PcdHeader(
        names=tuple(entries["FIELDS"]),
        kinds=kinds,
        counts=counts,
        points=int(entries["POINTS"][0]),
        data=entries["DATA"][0],
        begin=begin,
        lines=line_number,
    )


def _check(entries: dict[str, list[str]], key: str, line_number: int, source_name: str) -> None:
    """Raise FormatError for an entry that the format or the entries before do not allow."""
    words = entries[key]
    expected = ""
    if key == "VERSION" and words not in (["0.7"], [".7"]):
        expected = "0.7"
    elif key == "FIELDS":
        wanted = [name for name in words if name in USED]
        if not {"x", "y", "z"} <= set(words) or len(set(wanted)) != len(wanted):
            expected = "x, y and z, each once"
    elif key in ("SIZE", "TYPE", "COUNT") and len(words) != len(entries["FIELDS"]):
        expected = f"{len(entries['FIELDS'])} entries, one per field"
    elif key == "SIZE" and not set(words) <= {"1", "2", "4", "8"}:
        expected = "1, 2, 4 or 8"
    elif key == "TYPE" and not all(
        kind + size in _TYPES for kind, size in zip(words, entries["SIZE"], strict=True)
    ):
        expected = "I, U or F of a valid size"
    elif key == "COUNT":
        if not all(_whole(word, _MAX_COUNT) for word in words) or any(
            int(word) != 1 for name, word in zip(entries["FIELDS"], words, strict=True) if name in USED
        ):
            expected = "integers, 1 for x y z intensity t"
        elif sum(int(word) for word in words) > _MAX_COUNT:
            expected = f"no more than {_MAX_COUNT} values per point"
    elif key in ("WIDTH", "HEIGHT") and not (len(words) == 1 and _whole(words[0], _MAX_POINTS)):
        expected = "an integer"
    elif key == "VIEWPOINT" and not (len(words) == 7 and all(_is_number(word) for word in words)):
        expected = "seven numbers"
    elif key == "POINTS":
        points = int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
        if not (len(words) == 1 and _whole(words[0], _MAX_POINTS) and int(words[0]) == points):
            expected = f"WIDTH × HEIGHT, {points}"
    elif key == "DATA" and words not in (["ascii"], ["binary"], ["binary_compressed"]):
        expected = "ascii, binary or binary_compressed"
    if expected:
        raise FormatError(source_name, key, expected, actual=" ".join(words), line_number=line_number)


def _whole(word: str, most: int) -> bool:
    return word.isascii() and word.isdecimal() and len(word) < 10 and int(word) <= most


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
