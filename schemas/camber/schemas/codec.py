"""Bytes ↔ message: a msgpack header with the fields, the arrays raw behind it.

    u32 length of the header | msgpack [schema, source, sequence, {field: value}] | pad | array | pad | array …

An array stands in the header as a msgpack extension of type 1: dtype in three characters, then each length as u32.
The arrays follow in the order in which they stand there, each begun at a multiple of 8 bytes behind zeros.
`schema` is name and version, `camber.Fix.v1`, so that a file says what it is; over a transport it also travels beside
the bytes, in the encoding `application/msgpack;camber.Fix.v1`.

`decode` trusts nothing: whatever a hostile peer sends, it returns a valid message or raises DecodeError. It makes no
copy of the arrays, and whatever a length field claims, it allocates no more than the header's few kilobytes deserve.
"""

from __future__ import annotations

import functools
import math
import struct
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import msgpack
import numpy as np
from pydantic import BaseModel, ValidationError

from camber.schemas.arrays import DTYPES, MAX_NDIM
from camber.schemas.base import MAX_ITEMS, Message

M = TypeVar("M", bound=Message)

_PREFIX = "application/msgpack;"
_LENGTH = struct.Struct("<I")
_ARRAY_EXT = 1  # of the wire format
_SHAPES = [struct.Struct(f"<{n}I") for n in range(MAX_NDIM + 1)]
_CODES = {code.encode(): np.dtype(code) for code in DTYPES}
_MAX_HEADER = 1 << 16  # of the wire format: larger content goes into arrays
_MAX_SOURCE = 64  # of the wire format
_MAX_BYTES = 64 << 20  # chosen: above the largest sweep and tile, bounds the memory of a decoder
_MAX_COMPLAINT = 300  # chosen: fits into an issue text
_MAX_COMPLAINTS = 100  # chosen: bounds the time spent on untrusted input
_MAX_SEQUENCE = (1 << 62) - 1  # of the wire format: as `Count`
_PARTS = [str, str, int, dict]
_WRONG_BYTES = (ValueError, TypeError, RecursionError, OverflowError, MemoryError, msgpack.UnpackException)


class DecodeError(ValueError):
    """These bytes are not the message they claim to be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Received(Generic[M]):
    """A message with the envelope it came in."""

    message: M
    source: str
    sequence: int


class Unpacked(NamedTuple):
    """What the bytes of a message hold: plain values, tuples and arrays, not yet checked against its class."""

    schema: str
    source: str
    sequence: int
    fields: dict[str, Any]


@functools.cache
def encoding_of(cls: type[Message]) -> str:
    """The encoding string that goes with messages of this class."""
    return _PREFIX + cls.schema_name()


def encode(message: Message, *, source: str = "", sequence: int = 0) -> bytes:
    """Serialise `message` with its envelope: who sent it, and its number in the sender's sequence.

    Raises ValueError for what `decode` would not take back: an envelope out of range, or too many bytes.
    """
    if len(source) > _MAX_SOURCE or not 0 <= sequence <= _MAX_SEQUENCE:
        raise ValueError(f"source of {len(source)} characters or sequence number {sequence} is out of range")
    arrays: list[np.ndarray[Any, Any]] = []

    def plain(value: object) -> Any:
        if isinstance(value, BaseModel):
            return value.__dict__
        if isinstance(value, np.ndarray):
            arrays.append(value)
            shape = _SHAPES[value.ndim].pack(*value.shape)
            return msgpack.ExtType(_ARRAY_EXT, value.dtype.str.encode() + shape)
        raise TypeError(f"{type(message).__name__}: a {type(value).__name__} cannot be sent")

    header: bytes = msgpack.packb(
        [encoding_of(type(message))[len(_PREFIX) :], source, sequence, message.__dict__], default=plain
    )
    if len(header) > _MAX_HEADER:
        raise ValueError(
            f"{type(message).__name__}: header of {len(header)} bytes; records belong into arrays"
        )
    if not arrays:
        return _LENGTH.pack(len(header)) + header
    parts: list[Any] = [_LENGTH.pack(len(header)), header]
    size = _LENGTH.size + len(header)
    for array in arrays:
        pad = -size % 8
        parts += [b"\0" * pad, np.ascontiguousarray(array)]
        size += pad + array.nbytes
    if size > _MAX_BYTES:
        raise ValueError(f"{type(message).__name__}: {size} bytes, at most {_MAX_BYTES} are allowed")
    return b"".join(parts)


def decode(cls: type[M], data: bytes, encoding: str | None = None) -> Received[M]:
    """Return the message of class `cls` in `data`; raises DecodeError and nothing else.

    `encoding`, where the transport knows it, must name the schema and version of `cls`, as the bytes must.
    """
    if encoding is not None and encoding != encoding_of(cls):
        raise DecodeError(f"expected encoding {encoding_of(cls)}, got {str(encoding)[:80]!r}")
    schema = encoding_of(cls)[len(_PREFIX) :]
    try:
        unpacked = unpack(data)
    except DecodeError as error:
        raise DecodeError(f"{cls.__name__}: {error}"[:_MAX_COMPLAINT]) from None
    if unpacked.schema != schema:
        raise DecodeError(f"expected {schema}, got {unpacked.schema[:80]!r}")
    message = validate(cls, unpacked.fields)
    return Received(message=message, source=unpacked.source, sequence=unpacked.sequence)


def unpack(data: bytes) -> Unpacked:
    """Return what any message's bytes hold, of a class that is known or not; raises DecodeError and nothing else."""
    try:
        return _open(data)
    except DecodeError:
        raise
    except _WRONG_BYTES as error:
        raise DecodeError(f"{type(error).__name__}: {error}"[:_MAX_COMPLAINT]) from None


def validate(cls: type[M], fields: dict[str, Any]) -> M:
    """Return the message of class `cls` with these fields, as `unpack` gives them; raises DecodeError."""
    try:
        return cls.model_validate(fields)
    except ValidationError as error:
        complaint = _first_complaint(error)
    except _WRONG_BYTES as error:
        complaint = f": {type(error).__name__}: {error}"
    raise DecodeError(f"{cls.__name__}{complaint}"[:_MAX_COMPLAINT])


def _first_complaint(error: ValidationError) -> str:
    if error.error_count() > _MAX_COMPLAINTS:  # to list them would cost more than to find them
        return f": {error.error_count()} values are wrong"
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    return "".join(f".{part}"[:64] for part in first["loc"]) + f": {first['msg']}"


def _open(data: bytes) -> Unpacked:
    """Return schema, source, sequence number and fields of `data`."""
    if not _LENGTH.size < len(data) <= _MAX_BYTES:
        raise DecodeError(f"{len(data)} bytes are no message")
    (length,) = _LENGTH.unpack_from(data)
    end = _LENGTH.size + length
    if length > _MAX_HEADER or end > len(data):
        raise DecodeError(f"header of {length} bytes claimed in {len(data)}")
    arrays = _Arrays(data, end)
    header = msgpack.unpackb(
        data[_LENGTH.size : end],
        use_list=False,
        raw=False,
        strict_map_key=True,
        object_pairs_hook=_without_duplicates,
        ext_hook=arrays.take,
        max_bin_len=0,
        max_array_len=MAX_ITEMS,
        max_map_len=MAX_ITEMS,
        max_ext_len=16,
    )
    arrays.finish()
    if not isinstance(header, tuple) or [type(part) for part in header] != _PARTS:
        raise DecodeError("expected a header of schema, source, sequence and fields")
    schema, source, sequence, fields = header
    if len(source) > _MAX_SOURCE or not 0 <= sequence <= _MAX_SEQUENCE:
        raise DecodeError("source or sequence number out of range")
    return Unpacked(schema, source, sequence, fields)


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs):
        raise DecodeError("a field stands there twice")
    return fields


class _Arrays:
    """Hands out the arrays behind the header one after the other, as read-only views of the bytes."""

    def __init__(self, data: bytes, start: int) -> None:
        self._data = data
        self._offset = start

    def take(self, code: int, description: bytes) -> np.ndarray[Any, Any]:
        ndim, rest = divmod(len(description) - 3, 4)
        dtype = _CODES.get(description[:3])
        if code != _ARRAY_EXT or dtype is None or rest or not 1 <= ndim <= MAX_NDIM:
            raise DecodeError("an array of an unknown kind")
        shape = _SHAPES[ndim].unpack_from(description, 3)
        count = math.prod(shape)
        start = self._offset + -self._offset % 8
        end = start + count * dtype.itemsize
        if end > len(self._data):
            raise DecodeError(f"an array of {dtype} {shape} claimed beyond the end")
        if any(self._data[self._offset : start]):
            raise DecodeError("something hidden between the arrays")
        self._offset = end
        return np.frombuffer(self._data, dtype, count, start).reshape(shape)

    def finish(self) -> None:
        """Raise DecodeError unless everything was handed out."""
        if self._offset != len(self._data):
            raise DecodeError(f"{len(self._data) - self._offset} bytes behind the last array")
