"""Keys, tokens, identifiers and attachments are those that rmw_zenoh documents and computes.

Texts: ros2/rmw_zenoh, docs/design.md, "Topic and Service name mapping to Zenoh key expressions" and "Graph Cache" (its
examples say ROS_DOMAIN_ID=0 above tokens of domain 2). Identifiers: computed with rmw_zenoh's own
rmw_zenoh_cpp/src/detail/simplified_xxhash3.cpp, compiled, of the texts here, as Entity::Entity in liveliness_utils.cpp
does (low64 first). Attachment: AttachmentData::serialize_to_zbytes in attachment_helpers.cpp (int64, int64, 16 bytes).
"""

from __future__ import annotations

import struct

import pytest
import zenoh
import zenoh.ext
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from camber.ros2.rmw_zenoh import (
    NO_TYPE_HASH,
    Attachment,
    GraphNode,
    PublisherToken,
    Topic,
    TopicQos,
    decode_attachment,
    gid_of,
    publisher_of,
)

HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
CHATTER = Topic(name="/chatter", kind="std_msgs/msg/String", type_hash=HASH)
LISTENER = GraphNode(domain_id=2, session_id="aac3178e146ba6f1fc6e6a4085e77f21", name="listener")
TALKER = GraphNode(domain_id=2, session_id="8b20917502ee955ac4476e0266340d5c", name="talker")
TALKER_TOKEN = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
    f"std_msgs::msg::dds_::String_/{HASH}/::,7:,:,:,,"
)
LISTENER_TOKEN = (
    "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/"
    f"std_msgs::msg::dds_::String_/{HASH}/::,10:,:,:,,"
)
LONG_TOKEN = (
    "@ros2_lv/7/8b20917502ee955ac4476e0266340d5c/0/3/MP/%/%robot1/camber/%robot1%camber%pose_with_covariance/"
    "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_/"
    "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e/::,10:,:,:,,"
)


def test_keys_of_topics_are_those_of_the_design() -> None:
    assert CHATTER.key(0) == f"0/chatter/std_msgs::msg::dds_::String_/{HASH}"
    below = Topic(name="/robot1/chatter", kind="std_msgs/msg/String", type_hash=HASH)
    assert below.key(0) == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{HASH}"


def test_humble_has_no_hash() -> None:
    topic = Topic(name="/chatter", kind="std_msgs/msg/String", type_hash=NO_TYPE_HASH)
    assert topic.key(0) == "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported"
    expected = (
        "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
        "std_msgs::msg::dds_::String_/TypeHashNotSupported/::,10:,:,:,,"
    )
    assert TALKER.topic_token(10, "MP", topic, TopicQos()) == expected


def test_the_hash_in_the_design_is_the_one_that_rosbags_computes() -> None:
    assert get_typestore(Stores.ROS2_JAZZY).hash_rihs01("std_msgs/msg/String") == HASH


def test_tokens_are_those_of_the_design() -> None:
    assert LISTENER.token() == "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
    assert TALKER.topic_token(10, "MP", CHATTER, TopicQos(depth=7)) == TALKER_TOKEN
    assert LISTENER.topic_token(10, "MS", CHATTER, TopicQos(depth=10)) == LISTENER_TOKEN


def test_names_are_mangled() -> None:
    topic = Topic(
        name="/robot1/camber/pose_with_covariance",
        kind="geometry_msgs/msg/PoseWithCovarianceStamped",
        type_hash="RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e",
    )
    node = GraphNode(domain_id=7, session_id=TALKER.session_id, name="camber", namespace="/robot1")
    assert node.topic_token(3, "MP", topic, TopicQos()) == LONG_TOKEN


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (TopicQos(depth=42), "::,:,:,:,,"),
        (TopicQos(reliable=False, depth=5), "2::,5:,:,:,,"),
        (TopicQos(transient_local=True, depth=100), ":1:,100:,:,:,,"),
    ],
)
def test_qos_is_what_departs_from_the_defaults(qos: TopicQos, text: str) -> None:
    """qos_to_keyexpr of liveliness_utils.cpp, defaults of qos.cpp, numbers of rmw/types.h."""
    assert qos.text() == text


@pytest.mark.parametrize(
    ("token", "gid"),
    [
        (LISTENER.token(), "49877999dacb858702d11ac823785912"),  # up to 128 bytes
        (LISTENER_TOKEN, "76148a538308fe55a6c5375462ca1de6"),  # up to 240
        (TALKER_TOKEN, "ac170f31eadcd9ff0cd86d7a17907d1c"),
        (LONG_TOKEN, "7dd25ce29b1a2a4ba0d59e394d05c67e"),  # more
    ],
)
def test_identifiers_are_those_that_rmw_zenoh_computes(token: str, gid: str) -> None:
    assert gid_of(token).hex() == gid


def test_an_attachment_is_two_int64_and_sixteen_bytes_after_their_length() -> None:
    gid = bytes(range(16))
    data = Attachment(sequence=1, source_unix_ns=1_764_357_000_123_456_789, gid=gid).encode()
    assert data == struct.pack("<qq", 1, 1_764_357_000_123_456_789) + b"\x10" + gid
    serialized = (zenoh.ext.Int64(1), zenoh.ext.Int64(1_764_357_000_123_456_789), gid)
    assert data == zenoh.ext.z_serialize(serialized).to_bytes()


@given(st.integers(1, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachments_are_read_as_they_were_written(sequence: int, unix_ns: int, gid: bytes) -> None:
    attachment = Attachment(sequence=sequence, source_unix_ns=unix_ns, gid=gid)
    assert decode_attachment(attachment.encode()) == attachment


@given(st.binary(max_size=120))
def test_other_attachments_are_refused(data: bytes) -> None:
    if len(data) == 33 and data[16] == 16:
        return
    with pytest.raises(ValueError, match="rmw_zenoh"):
        decode_attachment(data)


def test_an_attachment_of_before_its_change_is_refused_with_the_versions_that_have_it() -> None:
    """Names and values in turn, as attachment_helpers.cpp wrote them up to 0.5 (Jazzy 0.2.3, Humble 0.1.1)."""
    gid = bytes(range(16))
    named = (
        b"\x0fsequence_number" + struct.pack("<q", 1)
        + b"\x10source_timestamp" + struct.pack("<q", 1_764_357_000_123_456_789)
        + b"\x0asource_gid" + b"\x10" + gid
    )  # fmt: skip
    assert len(named) == 77
    with pytest.raises(
        ValueError, match=r"old rmw_zenoh, expected 0\.6 or later \(Jazzy: 0\.2\.4, Humble: 0\.1\.2\)"
    ):
        decode_attachment(named)


def test_a_message_without_attachment_is_refused() -> None:
    with pytest.raises(ValueError, match="without attachment"):
        decode_attachment(None)


def test_only_tokens_of_publishers_are_publishers() -> None:
    expected = PublisherToken("/chatter", "std_msgs::msg::dds_::String_", HASH)
    assert publisher_of(TALKER_TOKEN) == expected
    assert publisher_of(f"{TALKER_TOKEN}/cuda") == expected, "later versions append backends"
    humble = TALKER_TOKEN.replace(HASH, NO_TYPE_HASH).replace("::,7:,:,:,,", "1:2:1,7:,:,:,,")
    assert publisher_of(humble) == expected._replace(type_hash=NO_TYPE_HASH), "QoS may be written out"
    assert publisher_of(LISTENER_TOKEN) is None
    assert publisher_of(LISTENER.token()) is None
    assert publisher_of(TALKER_TOKEN.replace("@ros2_lv", "@other")) is None
