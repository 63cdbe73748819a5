"""Keys, liveliness tokens, identifiers and attachments as rmw_zenoh writes them, from version 0.6 on.

Source: ros2/rmw_zenoh, docs/design.md ("Topic and Service name mapping", "Graph Cache"), rmw_zenoh_cpp/src/detail/
liveliness_utils.cpp, attachment_helpers.cpp, qos.cpp and rmw_publisher_data.cpp. Jazzy has had this format since 0.2.4,
Humble since 0.1.2 (CHANGELOG.rst, pull requests 601, 605 and 606); before, each value of an attachment came after its
name. Humble's messages have no hashes: its keys and tokens have `TypeHashNotSupported` in their place, the rest is the
same, 16 bytes of identifier too (pull request 388).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal, NamedTuple

import xxhash

EntityKind = Literal["NN", "MP", "MS", "SS", "SC"]
"""Node, publisher, subscription, service, client."""
NO_TYPE_HASH = "TypeHashNotSupported"
_ADMIN_SPACE = "@ros2_lv"
_GID_BYTES = 16  # rmw/types.h, RMW_GID_STORAGE_SIZE
_ATTACHMENT = struct.Struct(f"<qqB{_GID_BYTES}s")
"""By Zenoh's serialization: two int64, then a sequence of bytes after its length."""
_NAMED_VALUES = b"\x0fsequence_number"
"""Begin of an attachment before pull request 601: its first name, after its length."""
_DEFAULT_DEPTH = 42  # qos.cpp, RMW_ZENOH_DEFAULT_HISTORY_DEPTH


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic's name with its namespace (`/camber/fix`), type (`sensor_msgs/msg/NavSatFix`) and RIHS01 hash."""

    name: str
    kind: str
    type_hash: str

    @property
    def dds_type(self) -> str:
        """The type as DDS names it, `sensor_msgs::msg::dds_::NavSatFix_`."""
        package, folder, name = self.kind.split("/")
        return f"{package}::{folder}::dds_::{name}_"

    def key(self, domain_id: int) -> str:
        """Return the key of the topic's messages."""
        return f"{domain_id}/{self.name.strip('/')}/{self.dds_type}/{self.type_hash}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicQos:
    """What is not rmw_zenoh's default of a publisher or subscription: best effort, transient local, depth."""

    reliable: bool = True
    transient_local: bool = False
    depth: int = 10

    def text(self) -> str:
        """Return the last part of a token: reliability, durability, history; the rest is the default.

        Defaults are left out; numbers are those of rmw/types.h (best effort 2, transient local 1).
        """
        reliability = "" if self.reliable else "2"
        durability = "1" if self.transient_local else ""
        depth = "" if self.depth == _DEFAULT_DEPTH else str(self.depth)
        return f"{reliability}:{durability}:,{depth}:,:,:,,"


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphNode:
    """A node of a session; `session_id` is Zenoh's."""

    domain_id: int
    session_id: str
    name: str
    node_id: int = 0
    namespace: str = "/"
    enclave: str = "/"

    def token(self) -> str:
        """Return the node's liveliness token."""
        return self._token(self.node_id, "NN")

    def topic_token(self, entity_id: int, kind: EntityKind, topic: Topic, qos: TopicQos) -> str:
        """Return the liveliness token of a publisher or subscription."""
        parts = (mangled(topic.name), topic.dds_type, topic.type_hash, qos.text())
        return "/".join((self._token(entity_id, kind), *parts))

    def _token(self, entity_id: int, kind: EntityKind) -> str:
        parts = (self.domain_id, self.session_id, self.node_id, entity_id, kind)
        names = (mangled(self.enclave), mangled(self.namespace), mangled(self.name))
        return "/".join((_ADMIN_SPACE, *map(str, parts), *names))


class PublisherToken(NamedTuple):
    """What the token of a publisher says: topic with namespace, its type as DDS names it, hash."""

    topic: str
    dds_type: str
    type_hash: str


def mangled(name: str) -> str:
    """Return a name as one part of a key."""
    return name.replace("/", "%")


def tokens_of(domain_id: int) -> str:
    """Return the key expression of all tokens of a domain."""
    return f"{_ADMIN_SPACE}/{domain_id}/**"


def publisher_of(token: str) -> PublisherToken | None:
    """Return the publisher that a token is of; None for all others."""
    parts = token.split("/")
    if len(parts) < 13 or parts[0] != _ADMIN_SPACE or parts[5] != "MP":
        return None
    return PublisherToken(parts[9].replace("%", "/"), parts[10], parts[11])


def gid_of(token: str) -> bytes:
    """Return the 16 bytes that identify the publisher or subscription of a token: XXH3-128, low half first."""
    return xxhash.xxh3_128_digest(token.encode())[::-1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attachment:
    """What goes with each message; sequences begin at 1, times are Unix nanoseconds."""

    sequence: int
    source_unix_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """Return the 33 bytes."""
        return _ATTACHMENT.pack(self.sequence, self.source_unix_ns, _GID_BYTES, self.gid)


def decode_attachment(data: bytes | None) -> Attachment:
    """Return what an attachment says. Raises ValueError for none and for one of another format."""
    if data is None:
        raise ValueError("a message without attachment: its publisher is not of rmw_zenoh")
    if data.startswith(_NAMED_VALUES):
        raise ValueError(
            "its publisher has an old rmw_zenoh, expected 0.6 or later (Jazzy: 0.2.4, Humble: 0.1.2)"
        )
    if len(data) != _ATTACHMENT.size or data[16] != _GID_BYTES:
        raise ValueError(f"an attachment of {len(data)} bytes, expected the {_ATTACHMENT.size} of rmw_zenoh")
    sequence, source_unix_ns, _, gid = _ATTACHMENT.unpack(data)
    return Attachment(sequence=sequence, source_unix_ns=source_unix_ns, gid=gid)
