"""Encode and decode the few protobuf messages of Foxglove, by their descriptors.

Source: protobuf.dev/programming-guides/encoding and descriptor.proto. What proto3 leaves out (zeros, empty texts) is
left out here too.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

_DOUBLE, _INT64, _INT32, _FIXED32, _BOOL, _STRING, _MESSAGE, _BYTES, _ENUM = 1, 3, 5, 7, 8, 9, 11, 12, 14
"""Types of FieldDescriptorProto."""
VARINT, BITS_64, LENGTH, BITS_32 = 0, 1, 2, 5
"""Wire types."""
_WIRE = {_DOUBLE: BITS_64, _FIXED32: BITS_32, _STRING: LENGTH, _MESSAGE: LENGTH, _BYTES: LENGTH}
_REPEATED = 3  # label of FieldDescriptorProto
_MASK_64 = (1 << 64) - 1  # a negative number is a varint of 64 bits
_LONGEST_VARINT = 10  # bytes, by the encoding

Values = Mapping[str, Any]


class ProtobufError(ValueError):
    """These bytes are not the message they claim to be."""


@dataclass(slots=True, kw_only=True)
class Field:
    """A field of a message; `of` is the type of a message in it."""

    name: str
    number: int
    kind: int
    repeated: bool
    of: MessageType | None = None

    @property
    def wire(self) -> int:
        """The wire type of one value."""
        return _WIRE.get(self.kind, VARINT)


@dataclass(slots=True, kw_only=True)
class MessageType:
    """A message and its fields by name."""

    name: str
    fields: dict[str, Field] = field(default_factory=dict)


@functools.cache
def descriptor_set(name: str) -> bytes:
    """Return the FileDescriptorSet of a message, `LocationFix`."""
    return files(__package__).joinpath(f"{name}.bin").read_bytes()


def encode(name: str, values: Values) -> bytes:
    """Return a message of Foxglove, `LocationFix`, with these values by field; KeyError for a field that it lacks."""
    return _encoded(_message_type(name), values)


def decode(name: str, data: bytes) -> dict[str, Any]:
    """Return the fields that are in a message; those left out are zero. Raises ProtobufError and nothing else."""
    try:
        return _decoded(_message_type(name), data)
    except (ValueError, struct.error, IndexError, RecursionError) as error:
        raise ProtobufError(f"{name}: {error}") from None


def _encoded(kind: MessageType, values: Values) -> bytes:
    parts: list[bytes] = []
    for name, value in values.items():
        described = kind.fields[name]
        if not described.repeated:
            parts += _one(described, value) if value or described.kind == _MESSAGE else []
        elif described.kind == _DOUBLE:
            packed = struct.pack(f"<{len(value)}d", *value)
            parts += [tag(described.number, LENGTH), varint(len(packed)), packed]
        else:
            for item in value:
                parts += _one(described, item)
    return b"".join(parts)


def _one(described: Field, value: Any) -> Sequence[bytes]:
    start = tag(described.number, described.wire)
    if described.kind == _DOUBLE:
        return start, struct.pack("<d", value)
    if described.kind == _FIXED32:
        return start, struct.pack("<I", value)
    if described.wire == VARINT:
        return start, varint(int(value) & _MASK_64)
    if described.of is not None:
        value = _encoded(described.of, value)
    data = value.encode() if isinstance(value, str) else value
    return start, varint(len(data)), data


def tag(number: int, wire: int) -> bytes:
    """Return what begins a field of this number and wire type."""
    return varint(number << 3 | wire)


def varint(value: int) -> bytes:
    """Return a number that is not negative in groups of seven bits, the lowest first."""
    data = bytearray()
    while value > 0x7F:
        data.append(value & 0x7F | 0x80)
        value >>= 7
    data.append(value)
    return bytes(data)


def _decoded(kind: MessageType, data: bytes) -> dict[str, Any]:
    by_number = {described.number: described for described in kind.fields.values()}
    values: dict[str, Any] = {}
    for number, wire, value in _wire_values(data):
        described = by_number.get(number)
        if described is None:
            continue
        if described.repeated and described.kind == _DOUBLE and wire == LENGTH:
            values[described.name] = list(struct.unpack(f"<{len(value) // 8}d", value))
            continue
        if wire != described.wire:
            raise ProtobufError(f"field {number} of wire type {wire}")
        read = _read(described, value)
        if described.repeated:
            values.setdefault(described.name, []).append(read)
        else:
            values[described.name] = read
    return values


def _read(described: Field, value: Any) -> Any:
    if described.of is not None:
        return _decoded(described.of, value)
    if described.kind == _DOUBLE:
        return struct.unpack("<d", value)[0]
    if described.kind == _FIXED32:
        return struct.unpack("<I", value)[0]
    if described.kind == _STRING:
        return value.decode()
    if described.kind in (_INT64, _INT32):
        return value - (1 << 64) if value >> 63 else value
    return value


def _wire_values(data: bytes) -> Iterator[tuple[int, int, Any]]:
    """Yield number, wire type and value of each field: an int of a varint, otherwise its bytes."""
    position = 0
    while position < len(data):
        start, position = _read_varint(data, position)
        number, wire = start >> 3, start & 7
        if wire == VARINT:
            value, position = _read_varint(data, position)
            yield number, wire, value
            continue
        if wire == LENGTH:
            length, position = _read_varint(data, position)
        else:
            length = {BITS_64: 8, BITS_32: 4}.get(wire, -1)
        if length < 0 or position + length > len(data):
            raise ProtobufError(f"field {number} of wire type {wire} at byte {position} of {len(data)}")
        yield number, wire, data[position : position + length]
        position += length


def _read_varint(data: bytes, position: int) -> tuple[int, int]:
    value = 0
    for nth in range(_LONGEST_VARINT):
        byte = data[position + nth]
        value |= (byte & 0x7F) << 7 * nth
        if byte < 0x80:
            return value & _MASK_64, position + nth + 1
    raise ProtobufError(f"no number at byte {position}")


@functools.cache
def _message_type(name: str) -> MessageType:
    """Return the type that `name`'s descriptors describe, with all that is in it."""
    types: dict[str, MessageType] = {}
    named: list[tuple[Field, str]] = []
    for file in _all(descriptor_set(name), 1):
        package = b"".join(_all(file, 2)).decode()
        for message in _all(file, 4):
            kind = MessageType(name=f".{package}.{_text(message, 1)}")
            types[kind.name] = kind
            for described in _all(message, 2):
                one = _field(described)
                kind.fields[one.name] = one
                named.append((one, _text(described, 6)))
    for one, type_name in named:
        if one.kind == _MESSAGE:
            one.of = types[type_name]
    return types[f".foxglove.{name}"]


def _field(described: bytes) -> Field:
    numbers = {number: value for number, wire, value in _wire_values(described) if wire == VARINT}
    return Field(
        name=_text(described, 1), number=numbers[3], kind=numbers[5], repeated=numbers[4] == _REPEATED
    )


def _all(data: bytes, number: int) -> list[bytes]:
    return [value for n, wire, value in _wire_values(data) if n == number and wire == LENGTH]


def _text(data: bytes, number: int) -> str:
    return b"".join(_all(data, number)).decode()
