"""Writes recordings, whose contents `camber.formats.drive.recording` describes."""

from __future__ import annotations

import contextlib
import struct
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import msgpack
from mcap.writer import CompressionType, Writer

from camber.formats.drive.recording import (
    ABOUT_DRIVE,
    ABOUT_END,
    MESSAGE_CLASSES,
    PROFILE,
)
from camber.formats.drive.viewer_messages import ViewerChannel, ViewerMessage, ViewerMessages, viewer_message
from camber.formats.foxglove.drawings import Drawing
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.schemas.channels import CHANNELS
from camber.schemas.codec import DecodeError

_ORDER = {channel.name: place for place, channel in enumerate(CHANNELS)}
# Small enough that a killed recorder loses little, large enough to compress.
_CHUNK_BYTES = 256 << 10
_FLUSH_AFTER_NS = 10_000_000_000
_MAX_HEADER = 1 << 16  # `schemas/codec.py`
_MOST_UNKNOWN_SCHEMAS = 256  # chosen: MCAP numbers 65,535
_MOST_CHANNELS = 32_768  # chosen: half of what MCAP numbers
_LENGTH = struct.Struct("<I")
_TIME_NOTE = "log_time and publish_time: Unix time (UTC) of measurement and of arrival; time_ns: GPS time"
_LATEST_NS = (1 << 63) - 1  # beyond any date; MCAP has times as 64 bits without a sign


# Time, place of the channel in the table, key, sequence, payload: the order in the file.
# Then arrival, schema, channel.
_Pending = tuple[int, int, str, int, bytes, int, str, str]


class Recorder:
    """Writes a recording. `add` may be called from any thread, the rest from one.

    A full or broken disk ends the recording, not the program: `problem` is then the reason, `dropped` counts later
    messages and those of the chunk that did not reach the disk, and what is `written` can be read. Beyond `limit_bytes`
    within one tick messages are dropped too. `malformed` counts payloads that are no message, and those of unknown
    schemas where a file has many such already. Raises OSError where the file cannot be created; with `anew`
    FileExistsError where it exists. `about` stands at the beginning of the file: drive, versions, settings.
    """

    def __init__(
        self,
        path: Path,
        *,
        limit_bytes: int = 64 << 20,
        anew: bool = False,
        about: Mapping[str, str] | None = None,
    ) -> None:
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
        self._messages = ViewerMessages()
        self._channels: dict[ViewerChannel, int] = {}
        self._schemas: dict[str, int] = {}
        self._unknown_schemas: set[str] = set()
        self._chunk_began_ns: int | None = None
        self._stream = path.open("xb" if anew else "wb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(PROFILE, library="camber")
        self._writer.add_metadata(ABOUT_DRIVE, {"time": _TIME_NOTE, **(about or {})})
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

    def draw(self, drawing: Drawing, *, time_ns: int, arrival_ns: int) -> None:
        """Write a drawing of something that is no message: roads, an issue."""
        if self.problem is not None:
            return
        try:
            self._add(viewer_message(drawing, unix_ns_from_gps_ns(time_ns)), arrival_ns)
        except OSError as error:
            self._stop(error)

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
                ABOUT_END, {"dropped": str(self.dropped), "malformed": str(self.malformed), "complete": "yes"}
            )
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.close()
        except OSError as error:
            self._stop(error)

    def _has_room_for(self, schema: str) -> bool:
        """Whether a schema has a number: unknown ones are kept too, but must not use up the numbers of MCAP."""
        if schema not in MESSAGE_CLASSES and len(self._unknown_schemas) < _MOST_UNKNOWN_SCHEMAS:
            self._unknown_schemas.add(schema)
        return schema in MESSAGE_CLASSES or schema in self._unknown_schemas

    def _write(self, item: _Pending) -> None:
        _, _, key, _, payload, arrival_ns, _, channel = item
        try:
            messages = list(self._messages.of(channel, key, payload))
        except (DecodeError, ValueError, RecursionError):
            self.malformed += 1
            return
        if messages[0].channel not in self._channels and len(self._channels) >= _MOST_CHANNELS:
            self.malformed += 1
            return
        for message in messages:
            self._add(message, arrival_ns)

    def _add(self, message: ViewerMessage, arrival_ns: int) -> None:
        number = self._channels.get(message.channel) or self._register(message.channel)
        times = {"log_time": message.log_ns, "publish_time": arrival_ns}
        self._settle()
        self._writer.add_message(number, data=message.data, sequence=message.sequence, **times)
        if message.channel.channel:
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

    def _register(self, channel: ViewerChannel) -> int:
        schema = self._schemas.get(channel.schema)
        if schema is None:
            schema = self._writer.register_schema(channel.schema, *channel.described_by())
            self._schemas[channel.schema] = schema
        number: int = self._writer.register_channel(
            channel.topic, channel.encoding, schema, channel.metadata()
        )
        self._channels[channel] = number
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
    return (schema, time_ns, sequence) if 0 <= time_ns <= _LATEST_NS and sequence >= 0 else None
