"""Where a CAN bus's signals stand in its frames: the messages and signals of a DBC file.

Read are `BO_` (messages), `SG_` (signals: start bit, length, byte order, sign, factor, offset, range, unit) and
`SIG_VALTYPE_` (floating point; with a colon, as tools write it, or without, as the published grammar has it); all else
is passed over. A start bit is that of the lowest bit where the order is Intel's (`@1`), of the highest where it is
Motorola's (`@0`); bits are counted from the lowest of each byte.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from camber.formats.errors import FormatError

_NUMBER = r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*"
_MESSAGE = re.compile(r"BO_\s+(\d{1,10})\s+(\w{1,128})\s*:\s*(\d{1,4})\s+\w+")
_SIGNAL = re.compile(
    r"SG_\s+(\w{1,128})\s*(M|m\d+M?)?\s*:\s*(\d{1,4})\|(\d{1,4})@([01])([-+])\s*"
    rf"\({_NUMBER},{_NUMBER}\)\s*\[{_NUMBER}\|{_NUMBER}\]\s*\"([^\"]*)\""
)
_REAL = re.compile(r"SIG_VALTYPE_\s+(\d{1,10})\s+(\w{1,128})(?:\s*:\s*|\s+)([12])\s*;")
_COMMENT = re.compile(r'^CM_[^"]*"(?:[^"\\]|\\.)*"\s*;', re.M)
_EXTENDED = 0x8000_0000
_NO_MESSAGE = 0xC000_0000  # the place of signals that no message has


@dataclass(frozen=True, slots=True)
class DbcSignal:
    """One signal: physical value = raw × `factor` + `offset`; without a range `least` and `most` are alike."""

    message: str
    name: str
    start_bit: int
    bits: int
    intel: bool
    signed: bool
    factor: float
    offset: float
    least: float
    most: float
    unit: str
    multiplexed: bool = False
    real: bool = False

    def raw(self, data: bytes) -> int | None:
        """The bits as an integer, with its sign; None where the frame is too short for it."""
        if self.last_byte >= len(data):
            return None
        if self.intel:
            value = int.from_bytes(data, "little") >> self.start_bit
        else:
            value = int.from_bytes(data, "big") >> (8 * len(data) - self._from_the_front - self.bits)
        value &= (1 << self.bits) - 1
        return value - (1 << self.bits) if self.signed and value >> (self.bits - 1) else value

    def placed(self, raw: int, data: bytes) -> bytes:
        """`data` with this signal in it. Raises ValueError for a number that the bits cannot hold."""
        if raw not in self.holds:
            raise ValueError(f"{self.message}.{self.name}: {raw} does not fit into {self.bits} bits")
        shift = self.start_bit if self.intel else 8 * len(data) - self._from_the_front - self.bits
        order = "little" if self.intel else "big"
        mask = (1 << self.bits) - 1
        whole = int.from_bytes(data, order) & ~(mask << shift) | (raw & mask) << shift  # type: ignore[arg-type]
        return whole.to_bytes(len(data), order)  # type: ignore[arg-type]

    @property
    def holds(self) -> range:
        """All integers that its bits can be."""
        least = -(1 << (self.bits - 1)) if self.signed else 0
        return range(least, least + (1 << self.bits))

    @property
    def _from_the_front(self) -> int:
        """Bits before the highest, where the bytes are one number with the first byte highest."""
        return 8 * (self.start_bit // 8) + 7 - self.start_bit % 8

    @property
    def last_byte(self) -> int:
        """The last byte of a frame that it needs."""
        return ((self.start_bit if self.intel else self._from_the_front) + self.bits - 1) // 8


@dataclass(frozen=True, slots=True)
class DbcMessage:
    """One kind of frame."""

    name: str
    identifier: int
    extended: bool
    length_bytes: int
    signals: Mapping[str, DbcSignal]


def read_dbc(text: str, source_name: str) -> dict[str, DbcMessage]:
    """Messages by name. Raises FormatError, with its line, for one that cannot be: a signal beyond its message."""
    real = {(int(i) & ~_EXTENDED, name) for i, name, _ in _REAL.findall(text)}
    messages: dict[str, DbcMessage] = {}
    identifiers: set[tuple[int, bool]] = set()
    signals: dict[str, DbcSignal] | None = None
    # Comments may hold lines that look like others; their line ends stay, so that lines are counted right.
    bare = _COMMENT.sub(lambda comment: "\n" * comment[0].count("\n"), text)
    for number, line in enumerate(bare.split("\n"), 1):
        words = line.strip()
        if words.startswith(("BO_ ", "BO_\t")):
            message = _message(words, source_name, number)
            signals = None
            if message.identifier | (_EXTENDED if message.extended else 0) == _NO_MESSAGE:
                continue
            if message.name in messages or (message.identifier, message.extended) in identifiers:
                raise FormatError(
                    source_name, "message", "each once", actual=message.name, line_number=number
                )
            signals = {}
            messages[message.name] = replace(message, signals=signals)
            identifiers.add((message.identifier, message.extended))
            current = messages[message.name]
        elif words.startswith(("SG_ ", "SG_\t")) and signals is not None:
            signal = _signal(words, current, source_name, number)
            if signal.name in signals:
                raise FormatError(source_name, "signal", "each once", actual=signal.name, line_number=number)
            signals[signal.name] = replace(signal, real=(current.identifier, signal.name) in real)
    if not messages:
        raise FormatError(source_name, "content", "messages, BO_ … of a DBC file")
    return messages


def _message(words: str, source_name: str, number: int) -> DbcMessage:
    match = _MESSAGE.match(words)
    if match is None:
        expected = "BO_ identifier name: length sender"
        raise FormatError(source_name, "message", expected, actual=words, line_number=number)
    identifier, length = int(match[1]), int(match[3])
    extended = bool(identifier & _EXTENDED)
    no_message = identifier == _NO_MESSAGE
    if identifier >> 32 or (
        not no_message and identifier & ~_EXTENDED > (0x1FFF_FFFF if extended else 0x7FF)
    ):
        raise FormatError(source_name, "identifier", "11 or 29 bits", actual=match[1], line_number=number)
    if length > 64:
        raise FormatError(source_name, "length", "64 bytes at most", actual=match[3], line_number=number)
    return DbcMessage(match[2], identifier & ~_EXTENDED, extended, length, {})


def _signal(words: str, message: DbcMessage, source_name: str, number: int) -> DbcSignal:
    match = _SIGNAL.match(words)
    if match is None:
        expected = 'SG_ name : start|length@order sign (factor,offset) [least|most] "unit" receivers'
        raise FormatError(source_name, "signal", expected, actual=words, line_number=number)
    name, multiplexed, start, bits, order, sign, *numbers, unit = match.groups()
    factor, offset, least, most = map(float, numbers)
    signal = DbcSignal(
        message.name, name, int(start), int(bits), order == "1", sign == "-", factor, offset, least, most, unit,
        multiplexed=multiplexed is not None and multiplexed.startswith("m"),
    )  # fmt: skip
    if not 1 <= signal.bits <= 64 or signal.last_byte >= message.length_bytes:
        expected = f"1 to 64 bits within the {message.length_bytes} bytes of {message.name}"
        raise FormatError(
            source_name, f"signal {name}", expected, actual=f"{start}|{bits}", line_number=number
        )
    if factor == 0.0 or not all(map(math.isfinite, (factor, offset, least, most))):
        raise FormatError(source_name, f"signal {name}", "a factor, finite and not zero", line_number=number)
    return signal
