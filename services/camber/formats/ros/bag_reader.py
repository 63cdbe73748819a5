"""Bags of ROS 1 and 2 (MCAP and sqlite3), read message by message, and whether a message's stamp can be right."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from camber.formats.errors import FormatError
from camber.formats.ros.message_types import gps_time_ns, message_types, stamp_unix_ns
from camber.geodesy.gps_time import NS_PER_DAY, NS_PER_SECOND

SUFFIXES = (".bag", ".mcap", ".db3")
_JUMP_NS = 60 * NS_PER_SECOND
"""As a replay takes a receiver's time for a fault of its clock (`camber.replay.receiver_file`)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagTopic:
    """A topic of a bag: type (`sensor_msgs/msg/Imu`, in ROS 1 too) and number of messages."""

    name: str
    kind: str
    messages: int


@dataclass(frozen=True, slots=True, kw_only=True)
class BagMessage:
    """A message, not yet decoded; `receive_unix_ns` is when it was recorded."""

    topic: str
    kind: str
    receive_unix_ns: int
    data: bytes


class Bag:
    """An open bag; messages come in the order of recording."""

    def __init__(self, reader: AnyReader, name: str) -> None:
        self._reader, self._name = reader, name
        self.topics = {
            topic: BagTopic(name=topic, kind=info.msgtype or "", messages=info.msgcount)
            for topic, info in reader.topics.items()
            if info.msgcount and f"{topic}{info.msgtype}".isprintable()  # what ROS calls a name
        }

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Yield the messages of some topics. Raises FormatError at damage."""
        connections = [one for one in self._reader.connections if one.topic in topics]
        if not connections:
            return
        try:
            for one, receive_ns, data in self._reader.messages(connections):
                yield BagMessage(topic=one.topic, kind=one.msgtype, receive_unix_ns=receive_ns, data=data)
        except Exception as error:  # library and decompressors raise nearly anything for damage
            raise _damaged(self._name, error) from None

    def decode(self, message: BagMessage) -> Any:
        """Return the message's contents by its own type's definition. Raises FormatError."""
        try:
            return self._reader.deserialize(message.data, message.kind)
        except Exception as error:  # library and decompressors raise nearly anything for damage
            raise FormatError(message.topic, "message", f"a {message.kind}: {_text(error)}") from None


@contextmanager
def open_bag(paths: Sequence[Path]) -> Iterator[Bag]:
    """Open a ROS 2 bag (folder or file) or ROS 1 bags that were recorded together.

    Raises FormatError for what is no bag or a damaged one, OSError where it cannot be read.
    """
    for path in paths:
        path.stat()  # an OSError that names the path
        if path.is_file() and path.suffix not in SUFFIXES:
            raise FormatError(path.name, "name", f"a folder or a file {', '.join(SUFFIXES)}")
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            expected = "metadata.yaml in it (`ros2 bag reindex` makes one), or one of its files"
            raise FormatError(path.name, "folder", expected)
    name = paths[0].name
    try:
        reader = AnyReader(list(paths), default_typestore=message_types())
        reader.open()
    except Exception as error:  # library and decompressors raise nearly anything for damage
        raise _damaged(name, error) from None
    try:
        yield Bag(reader, name)
    finally:
        reader.close()


def _damaged(name: str, error: Exception) -> FormatError:
    expected = "a whole bag: `ros2 bag reindex`, `mcap recover` or `rosbag reindex` may save what is left"
    return FormatError(name, "data", f"{expected} ({_text(error)})")


def _text(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__


class StampCheck:
    """Whether the stamps of one topic can be right, by the times of recording."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._delay_ns: int | None = None

    def gps_time_ns(self, message: Any, receive_unix_ns: int) -> int:
        """Return the GPS time of a message's stamp, which is Unix time.

        Raises FormatError for a stamp of zero or in no possible year, one more than a day off the time of recording,
        and one that jumps by more than a minute against it.
        """
        stamp_ns = stamp_unix_ns(message)
        time_ns = gps_time_ns(stamp_ns, self._topic)
        delay_ns = receive_unix_ns - stamp_ns
        if abs(delay_ns) > NS_PER_DAY:
            days = f"{delay_ns / NS_PER_DAY:+.1f} days"
            raise self._fault(f"a time within a day of the recording, which is {days} later", stamp_ns)
        if self._delay_ns is not None and abs(delay_ns - self._delay_ns) > _JUMP_NS:
            jump_s = (self._delay_ns - delay_ns) / NS_PER_SECOND
            raise self._fault(f"no jump against the times of recording, but it is {jump_s:+.1f} s", stamp_ns)
        self._delay_ns = delay_ns
        return time_ns

    def _fault(self, expected: str, stamp_ns: int) -> FormatError:
        return FormatError(self._topic, "header.stamp", expected, actual=f"{stamp_ns / NS_PER_SECOND:.3f}")
