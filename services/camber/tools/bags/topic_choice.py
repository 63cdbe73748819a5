"""Which topics of a bag a drive is made of: one of each kind, chosen by name where there are several."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from camber.formats.errors import FormatError
from camber.formats.ros.bag_reader import BagTopic
from camber.formats.ros.point_cloud2 import CLOUD_TYPES
from camber.formats.ros.sensor_messages import IMU_TYPE, MOTION_TYPES, RECEIVER_TYPES

BYTES_TYPES = {
    "rtcm_msgs/msg/Message": "message",
    "mavros_msgs/msg/RTCM": "data",
    "std_msgs/msg/UInt8MultiArray": "data",
}
"""Types of raw bytes, and the field with them. All topics of them are searched for frames of UBX and RTCM 3."""
TF_STATIC = "/tf_static"


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicNames:
    """Topics that the user names; None: there is one at most."""

    lidar: str | None = None
    receiver: str | None = None
    odometry: str | None = None
    imu: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveTopics:
    """What a drive is made of; `rest` is not read."""

    lidar: BagTopic | None
    receiver: BagTopic | None
    odometry: BagTopic | None
    imu: BagTopic | None
    raw: tuple[BagTopic, ...]
    rest: tuple[BagTopic, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The topics to read."""
        single = (self.lidar, self.receiver, self.odometry, self.imu)
        return tuple(topic.name for topic in (*single, *self.raw) if topic is not None)


def choose_topics(topics: Mapping[str, BagTopic], names: TopicNames, bag: str) -> DriveTopics:
    """Choose among the topics of a bag. Raises FormatError where a name is missing or needed, or nothing is usable."""
    lidar = _choose(topics, "lidar", set(CLOUD_TYPES), names.lidar)
    receiver = _choose(topics, "receiver", set(RECEIVER_TYPES), names.receiver)
    odometry = _choose(topics, "odometry", set(MOTION_TYPES), names.odometry)
    imu = _choose(topics, "imu", {IMU_TYPE}, names.imu)
    raw = tuple(topic for topic in topics.values() if topic.kind in BYTES_TYPES)
    single = (lidar, receiver, odometry, imu)
    if not (any(single) or raw):
        kinds = (
            "PointCloud2",
            "Livox's CustomMsg",
            "NavSatFix",
            "GPSFix",
            "Odometry",
            "TwistStamped",
            "Imu",
            "bytes of a receiver",
        )
        expected = f"one of {', '.join(kinds)}; it has {_listed(topics.values())}"
        raise FormatError(bag, "topics", expected)
    taken = {topic.name for topic in (*single, *raw) if topic is not None} | {TF_STATIC}
    rest = tuple(topic for name, topic in topics.items() if name not in taken)
    return DriveTopics(lidar=lidar, receiver=receiver, odometry=odometry, imu=imu, raw=raw, rest=rest)


def _choose(
    topics: Mapping[str, BagTopic], option: str, kinds: Collection[str], name: str | None
) -> BagTopic | None:
    candidates = {topic.name: topic for topic in topics.values() if topic.kind in kinds}
    if name is not None and name not in candidates:
        expected = f"a topic for it; the bag has {_listed(candidates.values())}"
        raise FormatError(f"--{option}", "topic", expected, actual=name)
    if name is None and len(candidates) > 1:
        expected = f"one of {_listed(candidates.values())}: choose with --{option} TOPIC"
        raise FormatError(f"--{option}", "topic", expected)
    return candidates[name] if name is not None else next(iter(candidates.values()), None)


def _listed(topics: Collection[BagTopic]) -> str:
    shown = [f"{topic.name} ({topic.kind}, {topic.messages})" for topic in topics]
    return ", ".join(shown) or "none"
