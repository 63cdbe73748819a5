"""A node's keys and tokens in a graph, and what it counts of messages that come, without a network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest
from rosbags.typesys import Stores, get_typestore

from camber.formats.ros.message_types import VERDICT_TYPE, message_types, new_message
from camber.ros2.graph import RosGraph
from camber.ros2.rmw_zenoh import Attachment, GraphNode, decode_attachment, gid_of
from camber.runtime.raw_session import AttachedBytes, BoundedSubscription, RawSession

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
KINDS = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/NavSatFix",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "diagnostic_msgs/msg/DiagnosticArray",
    "tf2_msgs/msg/TFMessage",
)
NODE = GraphNode(domain_id=3, session_id="abc", name="camber")


class Session:
    """Notes what is declared."""

    def __init__(self) -> None:
        self.tokens: list[str] = []
        self.keys: list[str] = []
        self.history: list[int] = []
        self.put: list[tuple[bytes, bytes]] = []
        self.changed: Callable[[str, bool], None] = lambda token, present: None

    def declare_token(self, key: str) -> None:
        self.tokens.append(key)

    def watch_tokens(self, key: str, changed: Callable[[str, bool], None]) -> None:
        assert key == "@ros2_lv/3/**"
        self.changed = changed

    def declare_publisher(self, key: str) -> Callable[[bytes, bytes], None]:
        self.keys.append(key)
        return lambda data, attachment: self.put.append((data, attachment))

    def subscribe(self, key: str, *, limit: int, history: int = 0) -> BoundedSubscription:
        self.keys.append(key)
        self.history.append(history)
        return BoundedSubscription(limit=limit)


def graph_of(*, hashed: bool = True) -> tuple[RosGraph, Session]:
    session = Session()
    return RosGraph(cast(RawSession, session), NODE, hashed=hashed), session


def text(data: str) -> bytes:
    return bytes(
        message_types().serialize_cdr(new_message("std_msgs/msg/String", data=data), "std_msgs/msg/String")
    )


def attached(sequence: int, gid: int = 1, data: bytes | None = None) -> AttachedBytes:
    attachment = Attachment(sequence=sequence, source_unix_ns=1, gid=bytes([gid] * 16)).encode()
    return AttachedBytes(data=text("a") if data is None else data, attachment=attachment)


def test_publishers_and_subscriptions_have_tokens_of_different_numbers() -> None:
    graph, session = graph_of()
    graph.advertise("/a/b", "std_msgs/msg/String")
    graph.subscribe("/c", "std_msgs/msg/String", limit=5)
    graph.subscribe("/d", "std_msgs/msg/String", limit=5, history=7)
    kind = f"std_msgs::msg::dds_::String_/{STRING_HASH}"
    assert session.tokens == [
        "@ros2_lv/3/abc/0/0/NN/%/%/camber",
        f"@ros2_lv/3/abc/0/1/MP/%/%/camber/%a%b/{kind}/::,10:,:,:,,",
        f"@ros2_lv/3/abc/0/2/MS/%/%/camber/%c/{kind}/::,5:,:,:,,",
        f"@ros2_lv/3/abc/0/3/MS/%/%/camber/%d/{kind}/:1:,7:,:,:,,",
    ]
    assert session.keys == [f"3/a/b/{kind}", f"3/c/{kind}", f"3/d/{kind}"]
    assert session.history == [0, 7]


def test_humble_has_keys_and_tokens_without_hashes() -> None:
    graph, session = graph_of(hashed=False)
    graph.advertise("/a", "std_msgs/msg/String")
    assert session.keys == ["3/a/std_msgs::msg::dds_::String_/TypeHashNotSupported"]
    assert "/std_msgs::msg::dds_::String_/TypeHashNotSupported/" in session.tokens[1]


def test_messages_are_cdr_with_a_sequence_from_one_and_the_tokens_identifier() -> None:
    graph, session = graph_of()
    publisher = graph.advertise("/a", "std_msgs/msg/String")
    for data in ("one", "two"):
        publisher.publish(new_message("std_msgs/msg/String", data=data))
    assert session.put[0][0] == b"\x00\x01\x00\x00\x04\x00\x00\x00one\x00"
    attachments = [decode_attachment(attachment) for _, attachment in session.put]
    assert [one.sequence for one in attachments] == [1, 2]
    assert {one.gid for one in attachments} == {gid_of(session.tokens[1])}


def test_gaps_are_counted_for_each_publisher() -> None:
    graph, _ = graph_of()
    subscription = graph.subscribe("/a", "std_msgs/msg/String", limit=20)
    for item in (attached(5), attached(6), attached(1, gid=2), attached(9), attached(2, gid=2)):
        subscription.received.put(item)
    assert len(subscription.take()) == 5
    assert subscription.lost == 2
    subscription.received.put(attached(1))  # it began anew
    subscription.received.put(attached(2))
    assert len(subscription.take()) == 2
    assert subscription.lost == 2


@pytest.mark.parametrize(
    "item",
    [
        AttachedBytes(data=text("a"), attachment=None),
        AttachedBytes(data=text("a"), attachment=b"short"),
        attached(1, data=b""),
        attached(1, data=b"\x00\x01\x00\x00\xff\xff\xff\xff"),
    ],
)
def test_what_cannot_be_read_is_counted_and_the_next_is_read(item: AttachedBytes) -> None:
    graph, _ = graph_of()
    subscription = graph.subscribe("/a", "std_msgs/msg/String", limit=20)
    subscription.received.put(item)
    subscription.received.put(attached(2))
    assert [message.data for message in subscription.take()] == ["a"]
    assert subscription.refused == 1
    assert subscription.refusal.startswith("/a: ")
    assert "\n" not in subscription.refusal


def test_the_oldest_is_dropped_where_more_come_than_may_wait() -> None:
    subscription = BoundedSubscription(limit=2)
    for sequence in (1, 2, 3):
        subscription.put(attached(sequence))
    assert [decode_attachment(item.attachment).sequence for item in subscription.take()] == [2, 3]
    assert subscription.dropped == 1
    assert subscription.take() == []


def test_publishers_of_others_come_and_go() -> None:
    graph, session = graph_of()
    token = f"@ros2_lv/3/def/0/9/MP/%/%/driver/%points/a::msg::dds_::B_/{STRING_HASH}/::,5:,:,:,,"
    session.changed(token, True)
    session.changed("@ros2_lv/3/def/0/0/NN/%/%/driver", True)
    (publisher,) = graph.publishers_of("/points")
    assert (publisher.dds_type, publisher.type_hash) == ("a::msg::dds_::B_", STRING_HASH)
    assert graph.publishers_of("/other") == []
    session.changed(token, False)
    assert graph.publishers_of("/points") == []


@pytest.mark.parametrize("kind", KINDS)
def test_hashes_are_the_same_in_all_distributions(kind: str) -> None:
    """Camber has Humble's definitions; keys need the hashes of the others."""
    stores = (Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL)
    assert {get_typestore(store).hash_rihs01(kind) for store in stores} == {message_types().hash_rihs01(kind)}


def test_the_message_of_verdicts_has_a_hash() -> None:
    assert message_types().hash_rihs01(VERDICT_TYPE).startswith("RIHS01_")


def test_messages_of_others_are_read_as_they_were_written() -> None:
    other: Any = get_typestore(Stores.ROS2_LYRICAL)
    cls = other.types["std_msgs/msg/String"]
    assert bytes(other.serialize_cdr(cls(data="a"), "std_msgs/msg/String")) == text("a")
