"""Messages and signals of a DBC file: the positions of a CAN bus's signals in its frames.

Supported are `BO_` (messages), `SG_` (signals: start bit, length, byte order, sign, factor, offset, range, unit) and
`SIG_VALTYPE_` (floating point; with a colon, as tools write it, or without, as the published grammar has it); all else
is skipped. A start bit is that of the lowest bit where the order is Intel's (`@1`), of the highest where it is
Motorola's (`@0`); bits are counted from the lowest of each byte.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from camber.formats.errors import FormatError

_NUMBER = r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*"
_MESSAGE = re.compile(r"BO_\s+(\d{1,10})\s+(\w{1,128})\s*:\s*(\d{1,4})\s+\w+")
_SIGNAL = re.compile(
    r"SG_\s+(\w{1,128})\s*(M|m\d+M?)?\s*:\s*(\d{1,4})\|(\d{1,4})@([01])([-+])\s*"
    rf"\({_NUMBER},{_NUMBER}\)\s*\[{_NUMBER}\|{_NUMBER}\]\s*\"([^\"]*)\""
)
_REAL = re.compile(r"SIG_VALTYPE_\s+(\d{1,10})\s+(\w{1,128})(?:\s*:\s*|\s+)([12])\s*;")
_COMMENT = re.compile(r'^CM_[^"]*"(?:[^"\\]|\\.)*"\s*;', re.M)
_EXTENDED = 0x8000_0000  # DBC: bit 31 of an identifier
_NO_MESSAGE = 0xC000_0000  # VECTOR__INDEPENDENT_SIG_MSG: signals without a message


@dataclass(frozen=True, slots=True, kw_only=True)
class DbcSignal:
    """One signal: physical value = raw × `factor` + `offset`; `least` equals `most` without a range."""

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
        """Return the bits as an integer, with its sign; None where the frame is too short."""
        if self.last_byte >= len(data):
            return None
        order, shift = self._position(len(data))
        value = int.from_bytes(data, order) >> shift & (1 << self.bits) - 1
        return value - (1 << self.bits) if self.signed and value >> (self.bits - 1) else value

    def placed(self, raw: int, data: bytes) -> bytes:
        """Return `data` with this signal in it. Raises ValueError for a number that the bits cannot hold."""
        if raw not in self.holds:
            raise ValueError(f"{self.message}.{self.name}: {raw} does not fit into {self.bits} bits")
        order, shift = self._position(len(data))
        mask = (1 << self.bits) - 1
        whole = int.from_bytes(data, order) & ~(mask << shift) | (raw & mask) << shift
        return whole.to_bytes(len(data), order)

    def _position(self, length_bytes: int) -> tuple[Literal["little", "big"], int]:
        """Return the byte order of a frame as one number, and the signal's lowest bit in it."""
        if self.intel:
            return "little", self.start_bit
        return "big", 8 * length_bytes - self._bits_before - self.bits

    @property
    def holds(self) -> range:
        """All integers that its bits can be."""
        least = -(1 << (self.bits - 1)) if self.signed else 0
        return range(least, least + (1 << self.bits))

    @property
    def _bits_before(self) -> int:
        """Bits before the highest, where the bytes are one number with the first byte highest."""
        return 8 * (self.start_bit // 8) + 7 - self.start_bit % 8

    @property
    def last_byte(self) -> int:
        """The last byte of a frame that it needs."""
        return ((self.start_bit if self.intel else self._bits_before) + self.bits - 1) // 8


@dataclass(frozen=True, slots=True, kw_only=True)
class DbcMessage:
    """One kind of frame."""

    name: str
    identifier: int
    extended: bool
    length_bytes: int
    signals: dict[str, DbcSignal]


def read_dbc(text: str, source_name: str) -> dict[str, DbcMessage]:
    """Return messages by name. Raises FormatError with the line for an invalid one: a signal beyond its message."""
    real = {(int(i) & ~_EXTENDED, name) for i, name, _ in _REAL.findall(text)}
    messages: dict[str, DbcMessage] = {}
    identifiers: set[tuple[int, bool]] = set()
    message: DbcMessage | None = None
    # Comments may contain lines that look like others; their line ends stay, so that lines are counted right.
    bare = _COMMENT.sub(lambda comment: "\n" * comment[0].count("\n"), text)
    for number, line in enumerate(bare.split("\n"), 1):
        entry = line.strip()
        fault = partial(FormatError, source_name, line_number=number)
        if entry.startswith(("BO_ ", "BO_\t")):
            message = _message(entry, fault)
            if message is None:
                continue
            if message.name in messages or (message.identifier, message.extended) in identifiers:
                raise fault("message", "each once", actual=message.name)
            messages[message.name] = message
            identifiers.add((message.identifier, message.extended))
        elif entry.startswith(("SG_ ", "SG_\t")) and message is not None:
            signal = _signal(entry, message, fault)
            if signal.name in message.signals:
                raise fault("signal", "each once", actual=signal.name)
            message.signals[signal.name] = replace(signal, real=(message.identifier, signal.name) in real)
    if not messages:
        raise FormatError(source_name, "content", "messages, BO_ … of a DBC file")
    return messages


def _message(entry: str, fault: Callable[..., FormatError]) -> DbcMessage | None:
    """Return the message without its signals; None for the entry of signals without a message."""
    match = _MESSAGE.match(entry)
    if match is None:
        raise fault("message", "BO_ identifier name: length sender", actual=entry)
    identifier, length = int(match[1]), int(match[3])
    extended, is_none = bool(identifier & _EXTENDED), identifier == _NO_MESSAGE
    largest = 0x1FFF_FFFF if extended else 0x7FF
    if identifier >> 32 or (not is_none and identifier & ~_EXTENDED > largest):
        raise fault("identifier", "11 or 29 bits", actual=match[1])
    if length > 64:
        raise fault("length", "64 bytes at most", actual=match[3])
    if is_none:
        return None
    return DbcMessage(
        name=match[2], identifier=identifier & ~_EXTENDED, extended=extended, length_bytes=length, signals={}
    )


def _signal(entry: str, message: DbcMessage, fault: Callable[..., FormatError]) -> DbcSignal:
    match = _SIGNAL.match(entry)
    if match is None:
        expected = 'SG_ name : start|length@order sign (factor,offset) [least|most] "unit" receivers'
        raise fault("signal", expected, actual=entry)
    name, multiplexed, start, bits, order, sign, *numbers, unit = match.groups()
    factor, offset, least, most = map(float, numbers)
    signal = DbcSignal(
        message=message.name, name=name, start_bit=int(start), bits=int(bits), intel=order == "1", signed=sign == "-",
        factor=factor, offset=offset, least=least, most=most, unit=unit,
        multiplexed=multiplexed is not None and multiplexed.startswith("m"),
    )  # fmt: skip
    if not 1 <= signal.bits <= 64 or signal.last_byte >= message.length_bytes:
        expected = f"1 to 64 bits within the {message.length_bytes} bytes of {message.name}"
        raise fault(f"signal {name}", expected, actual=f"{start}|{bits}")
    if factor == 0.0 or not all(map(math.isfinite, (factor, offset, least, most))):
        raise fault(f"signal {name}", "a factor, finite and not zero")
    return signal
