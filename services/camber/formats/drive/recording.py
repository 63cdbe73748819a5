"""Recordings: everything that was on the bus, in one MCAP file, byte for byte.

    MCAP channel      one for each key and schema; topic = the Zenoh key, metadata `channel` its name
    schema            `camber.Fix.v1`, with the JSON Schema of its fields; arrays are described as raw
    message encoding  `msgpack`: the payload is exactly what was on the bus (`schemas/codec.py`: a length, a
                      msgpack header, raw arrays); other programs take the four bytes of length off first
    log_time          time of measurement, GPS nanoseconds
    publish_time      when the recorder received it, wall clock, Unix nanoseconds
    sequence          the sender's, modulo 2**32

`Recorder.tick_done` writes messages in the order of time of measurement, channel table, key and sequence:
two replays of one drive differ only in `publish_time`. Source: MCAP 1.0 specification, mcap.dev.
"""

from __future__ import annotations

import contextlib
import json
import struct
import threading
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import msgpack
import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel as McapChannel
from mcap.records import Message as McapMessage
from mcap.records import Schema as McapSchema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from camber.formats.errors import FormatError
from camber.schemas.base import ArrayOf, Message
from camber.schemas.channels import BY_NAME, CHANNELS
from camber.schemas.codec import DecodeError, decode

M = TypeVar("M", bound=Message)

PROFILE = "camber"
_METADATA = "camber.recording"
_ORDER = {channel.name: place for place, channel in enumerate(CHANNELS)}
_SCHEMAS: dict[str, type[Message]] = {
    cls.schema_name(): cls for c in CHANNELS for cls in (c.message, c.reply) if cls is not None
}
# Small enough that a killed recorder loses little, large enough to compress. LZ4 is twice as fast as zstd.
_CHUNK_BYTES = 256 << 10
_FLUSH_AFTER_NS = 10_000_000_000
_MAX_HEADER = 1 << 16  # `schemas/codec.py`
_MOST_UNKNOWN_SCHEMAS = 256  # chosen: MCAP numbers 65,535
_LENGTH = struct.Struct("<I")
_UINT64_MAX = (1 << 64) - 1  # MCAP 1.0: type of log_time

# Everything that a damaged file makes the MCAP library and its decompressors raise.
_DAMAGE = (
    *(McapError, EOFError, MemoryError, OverflowError, RuntimeError, ValueError, KeyError),
    *(struct.error, zstandard.ZstdError),
)


class RecordingError(FormatError):
    """A recording is damaged, truncated, or contains messages that this version cannot read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recorded(Generic[M]):
    """A message as the recorder received it; `arrival_ns` is its wall clock, Unix nanoseconds."""

    channel: str
    key: str
    message: M
    source: str
    sequence: int
    arrival_ns: int


# Place of the channel in the table, key, sequence, time, payload: the order in the file.
# Then arrival, schema, channel.
_Pending = tuple[int, int, str, int, bytes, int, str, str]


class Recorder:
    """Writes a recording. `add` may be called from any thread, the rest from one.

    A full or broken disk ends the recording, not the program: `problem` is then the reason, `dropped` counts later
    messages and those of the chunk that did not reach the disk, and what is `written` can be read. Beyond `limit_bytes`
    within one tick messages are dropped too. `malformed` counts payloads that are no message, and those of unknown
    schemas where a file has many such already. Raises OSError where the file cannot be created; with `anew`
    FileExistsError where it exists.
    """

    def __init__(self, path: Path, *, limit_bytes: int = 64 << 20, anew: bool = False) -> None:
        self.problem: str | None = None
        self.written = 0
        self.dropped = 0
        self.malformed = 0
        self._in_chunk = 0  # messages of the open chunk, in memory
        self._path = path
        self._limit_bytes = limit_bytes
        self._lock = threading.Lock()
        self._pending: list[_Pending] = []
        self._pending_bytes = 0
        self._mcap_channels: dict[tuple[str, str], int] = {}
        self._unknown_schemas: set[str] = set()
        self._chunk_began_ns: int | None = None
        self._stream = path.open("xb" if anew else "wb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.LZ4)
        self._writer.start(PROFILE, library="camber")
        self._end = self._stream.tell()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, channel: str, payload: bytes, *, key: str, arrival_ns: int) -> None:
        """Add one message of a channel of the table, as it was on the bus under `key`."""
        envelope = _envelope(payload)
        with self._lock:
            if self.problem is not None:
                self.dropped += 1
            elif envelope is None or not self._has_room_for(envelope[0]):
                self.malformed += 1
            elif self._pending_bytes + len(payload) > self._limit_bytes:
                self.dropped += 1
            else:
                schema, time_ns, sequence = envelope
                self._pending_bytes += len(payload)
                self._pending.append(
                    (time_ns, _ORDER[channel], key, sequence, payload, arrival_ns, schema, channel)
                )

    def tick_done(self, up_to_ns: int | None = None) -> None:
        """Write what was measured up to a time (None: all), in an order that does not depend on arrival."""
        with self._lock:
            pending, self._pending = self._pending, []
            if up_to_ns is not None:
                self._pending = [item for item in pending if item[0] > up_to_ns]
                pending = [item for item in pending if item[0] <= up_to_ns]
            self._pending_bytes = sum(len(item[4]) for item in self._pending)
        if self.problem is not None:
            self.dropped += len(pending)
            return
        pending.sort()
        written_before = self.written
        try:
            for item in pending:
                self._write(item)
            self._flush_now_and_then(pending)
        except OSError as error:
            self.dropped += len(pending) - (self.written - written_before)
            self._stop(error)

    def flush(self) -> None:
        """Flush to the file, so that it can be read after a kill."""
        if self.problem is not None:
            return
        try:
            self._flush()
        except OSError as error:
            self._stop(error)

    def close(self) -> None:
        """Write what is pending and end the file."""
        self.tick_done()
        if self._stream.closed:
            return
        try:
            self._writer.add_metadata(
                _METADATA, {"dropped": str(self.dropped), "malformed": str(self.malformed), "complete": "yes"}
            )
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.close()
        except OSError as error:
            self._stop(error)

    def _has_room_for(self, schema: str) -> bool:
        """Whether a schema has a number: unknown ones are kept too, but must not use up the numbers of MCAP."""
        if schema not in _SCHEMAS and len(self._unknown_schemas) < _MOST_UNKNOWN_SCHEMAS:
            self._unknown_schemas.add(schema)
        return schema in _SCHEMAS or schema in self._unknown_schemas

    def _write(self, item: _Pending) -> None:
        time_ns, _, key, sequence, payload, arrival_ns, schema, channel = item
        number = self._mcap_channels.get((key, schema)) or self._register(channel, key, schema)
        self._settle()
        times = {"log_time": time_ns, "publish_time": arrival_ns}
        self._writer.add_message(number, data=payload, sequence=sequence & 0xFFFFFFFF, **times)
        self.written += 1
        self._in_chunk += 1
        self._settle()

    def _settle(self) -> None:
        """Flush the file where the library has ended a chunk by itself."""
        if self._stream.tell() != self._end:
            self._stream.flush()
            self._end, self._in_chunk = self._stream.tell(), 0

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._end, self._in_chunk = self._stream.tell(), 0

    def _register(self, channel: str, key: str, schema: str) -> int:
        cls = _SCHEMAS.get(schema)
        data = b"" if cls is None else json.dumps(json_schema(cls), sort_keys=True).encode()
        schema_number = self._writer.register_schema(schema, "jsonschema" if data else "", data)
        number = self._writer.register_channel(key, "msgpack", schema_number, {"channel": channel})
        self._mcap_channels[key, schema] = number
        return number

    def _flush_now_and_then(self, pending: list[_Pending]) -> None:
        # By measured time, so that the file's chunks do not depend on the machine's speed; live recorders call `flush`.
        newest_ns = max((item[0] for item in pending), default=None)
        if newest_ns is None:
            return
        if self._chunk_began_ns is None:
            self._chunk_began_ns = newest_ns
        elif newest_ns - self._chunk_began_ns >= _FLUSH_AFTER_NS:
            self._flush()
            self._chunk_began_ns = newest_ns

    def _stop(self, error: OSError) -> None:
        self.problem = f"{self._path.name}: recording stopped: {error.strerror or error}"
        self.written -= self._in_chunk
        self.dropped += self._in_chunk
        self._in_chunk = 0
        with contextlib.suppress(OSError):
            self._stream.close()


def _envelope(payload: bytes) -> tuple[str, int, int] | None:
    """Return schema, time and sequence number without decoding the rest; None for a malformed message."""
    try:
        (length,) = _LENGTH.unpack_from(payload)
        if length > _MAX_HEADER:
            return None
        unpacker = msgpack.Unpacker(max_buffer_size=_MAX_HEADER, use_list=False)
        unpacker.feed(payload[_LENGTH.size : _LENGTH.size + length])
        unpacker.read_array_header()
        schema = unpacker.unpack()
        unpacker.skip()
        sequence = unpacker.unpack()
        for _ in range(unpacker.read_map_header()):
            if unpacker.unpack() == "time_ns":
                time_ns = unpacker.unpack()
                break
            unpacker.skip()
        else:
            return None
    except (struct.error, ValueError, TypeError, msgpack.UnpackException):
        return None
    if type(schema) is not str or type(sequence) is not int or type(time_ns) is not int:
        return None
    return (schema, time_ns, sequence) if 0 <= time_ns <= _UINT64_MAX and sequence >= 0 else None


class _JsonSchema(GenerateJsonSchema):
    def function_plain_schema(self, schema: core_schema.PlainValidatorFunctionSchema) -> JsonSchemaValue:
        kind = getattr(schema["function"]["function"], "__self__", None)
        if not isinstance(kind, ArrayOf):
            return super().function_plain_schema(schema)
        shape = " × ".join(str(length) for length in kind.shape)
        description = f"raw array of {kind.dtype}, {shape}"
        return {"type": "string", "contentEncoding": "raw", "description": description}


def json_schema(cls: type[Message]) -> dict[str, Any]:
    """Return the JSON Schema of a message's fields; an array is a `raw` string with its dtype and shape."""
    return cls.model_json_schema(schema_generator=_JsonSchema)


def read_recording(
    path: Path, channels: Collection[str] | None = None
) -> Iterator[Recorded[Any] | RecordingError]:
    """Yield the messages of these channels (all by default) in the order of the file.

    A damaged file yields the messages before the damage, then one RecordingError; messages that cannot be decoded are
    one RecordingError per schema, at the end. Raises OSError if the file cannot be opened.
    """
    contents = _Contents(frozenset(BY_NAME if channels is None else channels))
    with path.open("rb") as stream:
        # A damaged length then asks for no more memory than the file has bytes.
        limit = max(path.stat().st_size, 1)
        try:
            for record in StreamReader(stream, validate_crcs=True, record_size_limit=limit).records:
                recorded = contents.take(record)
                if recorded is not None:
                    yield recorded
        except _DAMAGE as error:
            kind = str(error).splitlines()[0] if str(error) else type(error).__name__
            expected = f"a whole MCAP recording; {contents.read} messages before the damage were read"
            yield RecordingError(path.name, "data", expected, actual=kind, byte_offset=stream.tell())
    for schema, (count, first) in sorted(contents.failed.items()):
        expected = f"messages of this version, but {count} are not: {first[:200]}"
        yield RecordingError(path.name, "schema", expected, actual=schema)


def load_recording(
    path: Path, channels: Collection[str] | None = None
) -> tuple[dict[str, list[Recorded[Any]]], list[RecordingError]]:
    """Return `read_recording` as lists by channel (empty where nothing was recorded), and the errors."""
    lists: dict[str, list[Recorded[Any]]] = {name: [] for name in (BY_NAME if channels is None else channels)}
    errors: list[RecordingError] = []
    for item in read_recording(path, channels):
        if isinstance(item, RecordingError):
            errors.append(item)
        else:
            lists[item.channel].append(item)
    return lists, errors


class _Contents:
    """Schemas and channels of a file so far, and counts of messages that could not be decoded."""

    def __init__(self, wanted: frozenset[str]) -> None:
        self.read = 0
        self.failed: dict[str, tuple[int, str]] = {}
        """By schema: number of messages, and why the first was not decoded."""
        self._wanted = wanted
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str, str]] = {}

    def take(self, record: object) -> Recorded[Any] | None:
        if isinstance(record, McapSchema):
            self._schemas[record.id] = record.name
        elif isinstance(record, McapChannel):
            name = record.metadata.get("channel", "")
            self._channels[record.id] = (name, record.topic, self._schemas.get(record.schema_id, ""))
        elif isinstance(record, McapMessage):
            self.read += 1
            return self._decode(record)
        return None

    def _decode(self, record: McapMessage) -> Recorded[Any] | None:
        name, key, schema = self._channels[record.channel_id]
        if name not in self._wanted or name not in BY_NAME:
            return None
        try:
            if schema not in _SCHEMAS:
                raise DecodeError("a schema that this version does not know")
            received = decode(_SCHEMAS[schema], record.data)
        except DecodeError as error:
            count, first = self.failed.get(schema, (0, str(error)))
            self.failed[schema] = count + 1, first
            return None
        return Recorded(
            channel=name,
            key=key,
            message=received.message,
            source=received.source,
            sequence=received.sequence,
            arrival_ns=record.publish_time,
        )
