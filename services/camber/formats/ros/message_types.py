"""The message types that Camber reads and writes, by `rosbags`: standard ones, those of `msg/`, and our Verdict."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from camber.formats.errors import FormatError
from camber.geodesy.gps_time import NS_PER_SECOND, gps_ns_from_unix_ns, unix_ns_from_gps_ns
from camber.schemas.base import EARLIEST_NS, LATEST_NS

VERDICT_TYPE = "camber_msgs/msg/Verdict"
_SHIPPED = (
    *("gps_msgs/msg/GPSStatus", "gps_msgs/msg/GPSFix", "rtcm_msgs/msg/Message", "mavros_msgs/msg/RTCM"),
    *("livox_ros_driver2/msg/CustomPoint", "livox_ros_driver2/msg/CustomMsg"),
    VERDICT_TYPE,
)


@cache
def message_types() -> Typestore:
    """Return Humble's messages with those of `msg/`."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name in _SHIPPED:
        store.register(get_types_from_msg(definition_text(name), name))
    return store


def definition_text(name: str) -> str:
    """Return the definition of a type that Camber ships, such as `camber_msgs/msg/Verdict`."""
    return (files(__package__) / "msg" / f"{name}.msg").read_text("utf-8")


def new_message(kind: str, /, **values: Any) -> Any:
    """Return a message of a type with all its fields."""
    cls: Any = message_types().types[kind]
    return cls(**values)


def header_at(time_ns: int, frame_id: str) -> Any:
    """Return a Header of a GPS time: ROS stamps are Unix time."""
    seconds, nanoseconds = divmod(unix_ns_from_gps_ns(time_ns), NS_PER_SECOND)
    stamp = new_message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return new_message("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def stamp_unix_ns(message: Any) -> int:
    """Return the stamp of a message's header, Unix nanoseconds."""
    return int(message.header.stamp.sec) * NS_PER_SECOND + int(message.header.stamp.nanosec)


def gps_time_ns(unix_ns: int, topic: str) -> int:
    """Return the GPS time of a stamp. Raises FormatError before 2000 and after 2080, as messages of Camber do."""
    time_ns = gps_ns_from_unix_ns(unix_ns) if unix_ns > EARLIEST_NS else 0
    if not EARLIEST_NS <= time_ns <= LATEST_NS:
        seconds, nanoseconds = divmod(unix_ns, NS_PER_SECOND)
        actual = f"{seconds}.{nanoseconds:09d}"
        raise FormatError(topic, "header.stamp", "Unix time from 2000 to 2080", actual=actual)
    return time_ns
