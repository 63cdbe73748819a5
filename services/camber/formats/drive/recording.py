"""Recordings: everything that was on a vehicle's bus, in one MCAP file that other programs read as it is.

    topic             the key without vehicle: `/gnss/fix`, `/integrity/verdict`
    MCAP channel      one for each key, schema and source, which stand in its metadata with the `channel` of the table
    schema            `camber.Fix.v1`, encoding `jsonschema`; messages are JSON (`message_json.py`); a sweep is a
                      PointCloud of Foxglove; beside them stand drawings (`camber.formats.foxglove.drawings`)
    log_time          time of measurement, Unix nanoseconds (UTC); the message itself says it in GPS time
    publish_time      when the recorder received it, Unix nanoseconds by its wall clock
    sequence          the sender's, less the `sequence_base` of the channel where there is one
    metadata          `camber.drive` at the beginning: drive, versions, settings; `camber.recording` at the end: what
                      was dropped

`Recorder.tick_done` writes messages in the order of time of measurement, channel table, key and sequence:
two replays of one drive differ only in `publish_time`. Recordings of before (message encoding `msgpack`: the bytes of
the bus, `log_time` in GPS time, topics are keys) are read too. Source: MCAP 1.0 specification, mcap.dev.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel as McapChannel
from mcap.records import Message as McapMessage
from mcap.records import Metadata as McapMetadata
from mcap.records import Schema as McapSchema
from mcap.stream_reader import StreamReader

from camber.formats.drive.message_json import from_json
from camber.formats.errors import FormatError
from camber.formats.foxglove.point_clouds import sweep_from_cloud
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, CHANNELS, Channel
from camber.schemas.codec import DecodeError, Received, decode

M = TypeVar("M", bound=Message)

PROFILE = "camber"
ABOUT_DRIVE, ABOUT_END = "camber.drive", "camber.recording"
SEQUENCE_MODULUS = 1 << 32  # of MCAP
POINT_CLOUD = "foxglove.PointCloud"
MESSAGE_CLASSES: dict[str, type[Message]] = {
    cls.schema_name(): cls for c in CHANNELS for cls in (c.message, c.reply) if cls is not None
}

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


def topic_of(channel: Channel, key: str) -> str:
    """Return the topic of a key in a recording: without the prefix of all keys, and without the vehicle."""
    with contextlib.suppress(ValueError):  # a key without a vehicle, or not of this channel, is kept
        channel.vehicle_in(key)
        key = channel.key.replace("{vehicle}/", "", 1)
    return "/" + key.removeprefix("camber/v1/")


def read_about(path: Path) -> dict[str, str]:
    """Return what stands at the beginning of a recording: drive, versions, settings; empty where there is nothing.

    Raises OSError if the file cannot be opened.
    """
    with path.open("rb") as stream:
        try:
            for record in StreamReader(stream, record_size_limit=max(path.stat().st_size, 1)).records:
                if isinstance(record, McapMetadata) and record.name == ABOUT_DRIVE:
                    return dict(record.metadata)
                if isinstance(record, McapMessage):
                    break
        except _DAMAGE:
            pass
    return {}


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


class _Described(NamedTuple):
    """An MCAP channel of a recording: the table's name of it, its key, schema, source and encoding."""

    channel: str
    key: str
    schema: str
    encoding: str
    source: str
    sequence_base: int


class _Contents:
    """Schemas and channels of a file so far, and counts of messages that could not be decoded."""

    def __init__(self, wanted: frozenset[str]) -> None:
        self.read = 0
        self.failed: dict[str, tuple[int, str]] = {}
        """By schema: number of messages, and why the first was not decoded."""
        self._wanted = wanted
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, _Described] = {}

    def take(self, record: object) -> Recorded[Any] | None:
        if isinstance(record, McapSchema):
            self._schemas[record.id] = record.name
        elif isinstance(record, McapChannel):
            self._channels[record.id] = self._described(record)
        elif isinstance(record, McapMessage):
            self.read += 1
            return self._decode(record)
        return None

    def _described(self, record: McapChannel) -> _Described:
        metadata: Mapping[str, str] = record.metadata
        return _Described(
            channel=metadata.get("channel", ""),
            key=metadata.get("key", record.topic),
            schema=self._schemas.get(record.schema_id, ""),
            encoding=record.message_encoding,
            source=metadata.get("source", ""),
            sequence_base=int(metadata.get("sequence_base", "0")),
        )

    def _decode(self, record: McapMessage) -> Recorded[Any] | None:
        described = self._channels[record.channel_id]
        if described.channel not in self._wanted or described.channel not in BY_NAME:
            return None
        try:
            received = _received(record, described)
        except DecodeError as error:
            count, first = self.failed.get(described.schema, (0, str(error)))
            self.failed[described.schema] = count + 1, first
            return None
        return Recorded(
            channel=described.channel,
            key=described.key,
            message=received.message,
            source=received.source,
            sequence=received.sequence,
            arrival_ns=record.publish_time,
        )


def _received(record: McapMessage, described: _Described) -> Received[Any]:
    envelope: dict[str, Any] = {
        "source": described.source,
        "sequence": described.sequence_base + record.sequence,
    }
    if (described.schema, described.encoding) == (POINT_CLOUD, "protobuf"):
        return Received(message=sweep_from_cloud(record.data), **envelope)
    cls = MESSAGE_CLASSES.get(described.schema)
    if cls is None:
        raise DecodeError("a schema that this version does not know")
    if described.encoding == "msgpack":
        return decode(cls, record.data)
    if described.encoding != "json":
        raise DecodeError(f"encoding {described.encoding[:40]!r}, which this version does not know")
    return Received(message=from_json(cls, record.data), **envelope)
