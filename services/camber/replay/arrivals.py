"""When the parts of a file arrived, where somebody noted it down: `arrival_time_ns,end_byte`, a row for each part.

A file alone says when things were measured, by a clock that may have been wrong, and not when they came. A recorder
knows that, and so does a simulator: up to `end_byte` the (unpacked) file had come by that GPS time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from camber.formats.errors import FormatError
from camber.schemas.base import EARLIEST_NS, LATEST_NS

_HEADER = b"arrival_time_ns,end_byte"


@dataclass(frozen=True, slots=True)
class TimedBytes:
    """Bytes and a GPS time: of the measurement that they carry, or of their arrival."""

    time_ns: int
    payload: bytes


def write_arrivals(path: Path, parts: Iterable[tuple[int, int]]) -> None:
    """Write what `read_arrivals` reads: for each part of a file when it arrived, and its length in bytes."""
    end, lines = 0, [_HEADER]
    for arrival_ns, length in parts:
        end += length
        lines.append(b"%d,%d" % (arrival_ns, end))
    path.write_bytes(b"\n".join(lines) + b"\n")


def read_arrivals(path: Path, header_bytes: int, data: bytes) -> list[TimedBytes]:
    """The parts of a file's bytes by time of arrival, without the file's header.

    Raises FormatError for rows that are out of order or do not fit the file, OSError if it cannot be read.
    """
    lines = path.read_bytes().splitlines()
    if lines[:1] != [_HEADER]:
        raise FormatError(path.name, "header", _HEADER.decode(), actual=b"".join(lines[:1]), line_number=1)
    parts: list[TimedBytes] = []
    time_ns, end = EARLIEST_NS, 0
    for number, line in enumerate(lines[1:], start=2):
        arrival_ns, end_byte = _row(path.name, number, line)
        if not time_ns <= arrival_ns <= LATEST_NS:
            expected = "a GPS time in ns, not before the row above"
            raise FormatError(path.name, "arrival_time_ns", expected, actual=line, line_number=number)
        if not end < end_byte <= len(data):
            expected = f"more than the row above and at most the file's {len(data)} bytes"
            raise FormatError(path.name, "end_byte", expected, actual=line, line_number=number)
        if end_byte > header_bytes:
            parts.append(TimedBytes(arrival_ns, data[max(end, header_bytes) : end_byte]))
        time_ns, end = arrival_ns, end_byte
    if end != len(data):
        raise FormatError(
            path.name, "end_byte", f"the file's {len(data)} bytes in the last row", actual=str(end)
        )
    return parts


def _row(name: str, number: int, line: bytes) -> Sequence[int]:
    fields = line.split(b",")
    if len(fields) != 2 or not all(field.isdigit() and len(field) < 20 for field in fields):
        raise FormatError(name, "row", "two whole numbers", actual=line, line_number=number)
    return [int(field) for field in fields]
