"""CAN frames in the format of `candump -l` of Linux' can-utils, one per line:

    (1700000000.123456) can0 1A0#0102030405060708

The identifier has three hexadecimal digits, or eight where it is extended; `##` and a digit of flags precede the bytes
of CAN FD, `#R` is a remote frame. Times are those of the recording machine's clock, UTC in seconds since 1970.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from camber.formats.errors import FormatError
from camber.formats.line_buffer import LineBuffer
from camber.geodesy.gps_time import NS_PER_SECOND

_LINE = re.compile(
    r"\((\d{1,11})\.(\d{1,9})\) +(\S{1,32}) +([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(R[0-8]?|#[0-9A-Fa-f])?"
    r"((?:[0-9A-Fa-f]{2}){0,64})(?: [RT])?\s*"
)
ERROR_FLAG = 0x2000_0000  # linux/can.h: CAN_ERR_FLAG
_EXTENDED, _STANDARD = 0x1FFF_FFFF, 0x7FF  # ISO 11898-1: greatest identifiers of 29 and 11 bits
_CLASSIC_BYTES = 8  # ISO 11898-1


@dataclass(frozen=True, slots=True, kw_only=True)
class CanFrame:
    """`time_ns`: UTC of reception, nanoseconds since 1970."""

    time_ns: int
    bus: str
    identifier: int
    extended: bool
    data: bytes


class CandumpDecoder:
    """Frames in the file's order; a malformed line is one FormatError. `skipped`: remote and error frames."""

    def __init__(self, source_name: str) -> None:
        self.skipped: Counter[str] = Counter()
        self._name = source_name
        self._lines = LineBuffer()

    def feed(self, data: bytes) -> list[CanFrame | FormatError]:
        """Return the frames of the lines that these bytes complete."""
        items = (self._read(number, line) for number, line in self._lines.feed(data))
        return [item for item in items if item is not None]

    def finish(self) -> list[CanFrame | FormatError]:
        """Return the frame after the last newline."""
        item = self._read(self._lines.line_number, self._lines.take_rest())
        return [] if item is None else [item]

    def _read(self, number: int, line: bytes | None) -> CanFrame | FormatError | None:
        if line is not None and not line.strip():
            return None
        text = "" if line is None else line.decode("ascii", "replace")
        match = _LINE.fullmatch(text)
        if match is None:
            expected = "(seconds) bus identifier#bytes, as candump -l writes"
            return FormatError(self._name, "line", expected, actual=text, line_number=number)
        seconds, fraction, bus, identifier, flag, digits = match.groups()
        value, extended = int(identifier, 16), len(identifier) == 8
        if flag is not None and flag.startswith("R"):
            self.skipped["remote"] += 1
            return None
        if extended and value & ERROR_FLAG:
            self.skipped["error"] += 1
            return None
        too_long = flag is None and len(digits) > 2 * _CLASSIC_BYTES
        if too_long or value > (_EXTENDED if extended else _STANDARD):
            expected = "an identifier of 11 or 29 bits and 8 bytes at most (64 of CAN FD)"
            return FormatError(self._name, "frame", expected, actual=text, line_number=number)
        time_ns = int(seconds) * NS_PER_SECOND + int(fraction.ljust(9, "0"))
        data = bytes.fromhex(digits)
        return CanFrame(time_ns=time_ns, bus=bus, identifier=value, extended=extended, data=data)


def candump_text(frames: Sequence[CanFrame]) -> str:
    """Return the lines of frames; times to the microsecond below."""
    return "".join(map(_line, frames))


def _line(frame: CanFrame) -> str:
    seconds, fraction = divmod(frame.time_ns // 1000, 1_000_000)
    identifier = f"{frame.identifier:08X}" if frame.extended else f"{frame.identifier:03X}"
    fd = "" if len(frame.data) <= _CLASSIC_BYTES else "#0"
    return f"({seconds:010d}.{fraction:06d}) {frame.bus} {identifier}#{fd}{frame.data.hex().upper()}\n"
