"""A node in a ROS 2 graph: its tokens, publishers and subscriptions, and the publishers of others."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from camber.formats.ros.message_types import message_types
from camber.ros2.rmw_zenoh import (
    NO_TYPE_HASH,
    Attachment,
    EntityKind,
    GraphNode,
    PublisherToken,
    Topic,
    TopicQos,
    decode_attachment,
    gid_of,
    publisher_of,
    tokens_of,
)
from camber.runtime.raw_session import BoundedSubscription, RawSession

_MOST_PUBLISHERS = 4096  # chosen: of all other nodes; a graph has hundreds


@dataclass(slots=True, kw_only=True)
class RosPublisher:
    """Publishes messages of one topic."""

    topic: Topic
    gid: bytes
    put: Callable[[bytes, bytes], None]
    sequence: int = 0

    def publish(self, message: Any) -> None:
        """Serialize a message as CDR and publish it."""
        self.sequence += 1
        attachment = Attachment(sequence=self.sequence, source_unix_ns=time.time_ns(), gid=self.gid)
        data = message_types().serialize_cdr(message, self.topic.kind)
        self.put(bytes(data), attachment.encode())


@dataclass(slots=True, kw_only=True)
class RosSubscription:
    """Messages of one topic; `lost` counts gaps in the sequences of its publishers."""

    topic: Topic
    received: BoundedSubscription
    lost: int = 0
    refusal: str = ""
    refused: int = 0
    _sequences: dict[bytes, int] = field(default_factory=dict)

    def take(self) -> list[Any]:
        """Return what has arrived since this was last called; what cannot be read is counted in `refused`."""
        messages = []
        for item in self.received.take():
            try:
                attachment = decode_attachment(item.attachment)
                messages.append(message_types().deserialize_cdr(item.data, self.topic.kind))
            except Exception as error:  # the library raises nearly anything for damage
                self.refused += 1
                self.refusal = f"{self.topic.name}: {' '.join(str(error).split())[:200]}"
                continue
            last = self._sequences.get(attachment.gid, attachment.sequence - 1)
            self.lost += max(attachment.sequence - last - 1, 0)
            if len(self._sequences) < _MOST_PUBLISHERS:
                self._sequences[attachment.gid] = attachment.sequence
        return messages


class RosGraph:
    """Declares a node, and with each publisher and subscription its token."""

    def __init__(self, session: RawSession, node: GraphNode, *, hashed: bool) -> None:
        self._session, self._node, self._hashed = session, node, hashed
        self._entity_ids = count(node.node_id + 1)
        self._publishers: dict[str, PublisherToken] = {}
        self._lock = threading.Lock()
        session.declare_token(node.token())
        session.watch_tokens(tokens_of(node.domain_id), self._token_changed)

    def advertise(self, name: str, kind: str) -> RosPublisher:
        """Return a publisher of a topic: reliable, volatile, of the newest ten."""
        topic = self._topic(name, kind)
        put = self._session.declare_publisher(topic.key(self._node.domain_id))
        return RosPublisher(topic=topic, gid=gid_of(self._declare("MP", topic, TopicQos())), put=put)

    def subscribe(self, name: str, kind: str, *, limit: int, history: int = 0) -> RosSubscription:
        """Return a subscription of a topic of which `limit` messages may wait; `history`: transient local."""
        topic, qos = self._topic(name, kind), TopicQos(transient_local=history > 0, depth=history or limit)
        received = self._session.subscribe(topic.key(self._node.domain_id), limit=limit, history=history)
        self._declare("MS", topic, qos)
        return RosSubscription(topic=topic, received=received)

    def publishers_of(self, name: str) -> list[PublisherToken]:
        """Return the publishers of a topic in the graph, whatever their types."""
        with self._lock:
            return [publisher for publisher in self._publishers.values() if publisher.topic == name]

    def _topic(self, name: str, kind: str) -> Topic:
        type_hash = message_types().hash_rihs01(kind) if self._hashed else NO_TYPE_HASH
        return Topic(name=name, kind=kind, type_hash=type_hash)

    def _declare(self, kind: EntityKind, topic: Topic, qos: TopicQos) -> str:
        token = self._node.topic_token(next(self._entity_ids), kind, topic, qos)
        self._session.declare_token(token)
        return token

    def _token_changed(self, token: str, present: bool) -> None:
        publisher = publisher_of(token)
        if publisher is None:
            return
        with self._lock:
            if not present:
                self._publishers.pop(token, None)
            elif len(self._publishers) < _MOST_PUBLISHERS:
                self._publishers[token] = publisher
