"""What goes into a recording, or to a viewer, of one message of the bus: itself, and what is drawn of it.

A message is JSON, a sweep is a PointCloud; drawings are Foxglove's own messages (`camber.formats.foxglove.drawings`).
"""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

from camber.formats.drive.message_json import json_schema, to_json
from camber.formats.drive.recording import MESSAGE_CLASSES, POINT_CLOUD, SEQUENCE_MODULUS, topic_of
from camber.formats.foxglove.drawings import Drawing, Drawings
from camber.formats.foxglove.point_clouds import cloud_from_sweep
from camber.formats.foxglove.protobuf import descriptor_set
from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.schemas.base import LATEST_NS, Message
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import DecodeError, unpack, validate
from camber.schemas.lidar import Sweep

_FOXGLOVE = "foxglove."


class ViewerChannel(NamedTuple):
    """A topic, how its messages are encoded and described, and of ours: channel, key, source, base of sequences."""

    topic: str
    encoding: Literal["json", "protobuf"]
    schema: str
    channel: str = ""
    key: str = ""
    source: str = ""
    sequence_base: int = 0

    def metadata(self) -> dict[str, str]:
        """Return what a reader of ours needs; empty for a drawing."""
        texts = {"channel": self.channel, "key": self.key, "source": self.source}
        if self.sequence_base:
            texts["sequence_base"] = str(self.sequence_base)
        return texts if self.channel else {}

    def described_by(self) -> tuple[str, bytes]:
        """Return encoding and text of the schema."""
        return _description(self.schema)


class ViewerMessage(NamedTuple):
    """One message for viewers, at a Unix time of measurement."""

    channel: ViewerChannel
    data: bytes
    log_ns: int
    sequence: int = 0


class ViewerMessages:
    """Makes messages for viewers of those of a bus; of the vehicle that comes first something is drawn."""

    def __init__(self) -> None:
        self._drawings = Drawings()
        self._drawn_vehicle: str | None = None

    def of(self, channel: str, key: str, payload: bytes) -> Iterator[ViewerMessage]:
        """Yield the message of a payload, then its drawings. Raises DecodeError or ValueError where there is none."""
        schema, source, sequence, fields = unpack(payload)
        cls = MESSAGE_CLASSES.get(schema)
        base = sequence - sequence % SEQUENCE_MODULUS
        time_ns = fields.get("time_ns")
        if type(time_ns) is not int or not 0 <= time_ns <= LATEST_NS:
            raise DecodeError("a message without a time")
        log_ns = unix_ns_from_gps_ns(time_ns)
        topic = topic_of(BY_NAME[channel], key)
        ours: dict[str, Any] = {"channel": channel, "key": key, "source": source, "sequence_base": base}
        if cls is Sweep:
            described = ViewerChannel(topic, "protobuf", POINT_CLOUD, **ours)
            data = cloud_from_sweep(validate(Sweep, fields))
        else:
            described = ViewerChannel(topic, "json", schema, **ours)
            data = to_json(fields, cls)
        yield ViewerMessage(described, data, log_ns, sequence - base)
        if (
            schema in self._drawings.schemas
            and cls is BY_NAME[channel].message
            and self._is_drawn(channel, key)
        ):
            # What is no message of its class, or at no place on the Earth, is recorded and not drawn.
            with contextlib.suppress(ValueError):
                for drawing in self._drawings.of(validate(cls, fields)):
                    yield viewer_message(drawing, log_ns)

    def _is_drawn(self, channel: str, key: str) -> bool:
        try:
            vehicle = BY_NAME[channel].vehicle_in(key)
        except ValueError:
            return False
        self._drawn_vehicle = self._drawn_vehicle or vehicle
        return vehicle == self._drawn_vehicle


def viewer_message(drawing: Drawing, log_ns: int) -> ViewerMessage:
    """Return a drawing as a message at a Unix time."""
    channel = ViewerChannel(drawing.topic, "protobuf", _FOXGLOVE + drawing.schema)
    return ViewerMessage(channel, drawing.data, log_ns)


@functools.cache
def _description(schema: str) -> tuple[str, bytes]:
    if schema.startswith(_FOXGLOVE):
        return "protobuf", descriptor_set(schema.removeprefix(_FOXGLOVE))
    cls: type[Message] | None = MESSAGE_CLASSES.get(schema)
    described = {"title": schema, "type": "object", "properties": {}} if cls is None else json_schema(cls)
    return "jsonschema", json.dumps(described).encode()
