"""What ROS sensors publish, as messages of Camber: fresh ones only, since a late one would be taken for current."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import ValidationError

from camber.formats.errors import FormatError
from camber.formats.receiver.rtklib_pos import format_pos_header, format_pos_line
from camber.formats.ros.message_types import gps_time_ns, stamp_unix_ns
from camber.formats.ros.point_cloud2 import point_cloud2, point_layout, sweep_from_point_cloud2
from camber.formats.ros.sensor_messages import imu_of, motion_of, solution_of
from camber.formats.ros.static_frames import StaticFrames
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.geodesy.se3 import roll_pitch_yaw_from_rotation
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME
from camber.schemas.gnss import ReceiverBytes
from camber.schemas.refused_field import first_refused

_FUTURE_NS = NS_PER_SECOND // 2  # as consumers judge it (`camber.runtime.inbox`)


class StampError(ValueError):
    """A message's stamp is not of now by this machine's clock."""


@dataclass(slots=True, kw_only=True)
class SensorTopic:
    """A topic and the channel that its messages are published on. `frame_id` is that of the newest message."""

    name: str
    kind: str
    channel: str
    frame_id: str = ""
    counts: Counter[str] = field(default_factory=Counter)

    def message(self, content: Any, now_ns: int, sensor: str, *, ahead_ns: int = 0) -> Message | None:
        """Return what a ROS message says, None where that is nothing. `ahead_ns`: Unix time less the graph's.

        Raises StampError for a stamp that is older than the channel's age limit or in the future, FormatError for
        what cannot be read.
        """
        try:
            message = self._converted(content, sensor, ahead_ns)
        except ValidationError as error:
            field = first_refused(error, whole="message")
            raise FormatError(self.name, field.name, field.expected, actual=field.value) from None
        if message is None:
            self.counts["empty"] += 1
            return None
        self._check_age(message.time_ns, now_ns)
        self.frame_id = str(getattr(content, "child_frame_id", content.header.frame_id))[:100]
        return message

    def _converted(self, content: Any, sensor: str, ahead_ns: int) -> Message | None:
        if self.channel == "sweep":
            cloud = point_cloud2(content, self.kind)
            layout = point_layout(cloud, self.name)
            if layout.time is None:
                self.counts["without_point_times"] += 1
            return sweep_from_point_cloud2(cloud, layout, self.name, sensor, ahead_ns=ahead_ns)
        time_ns = gps_time_ns(stamp_unix_ns(content) + ahead_ns, self.name)
        if self.channel == "motion":
            return motion_of(content, time_ns)
        if self.channel == "imu":
            return imu_of(content, time_ns, self.name)
        return self._receiver_bytes(content, time_ns)

    def _receiver_bytes(self, content: Any, time_ns: int) -> ReceiverBytes | None:
        """The position as a line of RTKLIB, with its header, so that a gnss that starts later can read it too."""
        solution = solution_of(content, time_ns, self.kind, self.name)
        if solution is None:
            return None
        try:
            line = format_pos_line(solution, ambiguities=False)
        except ValueError as error:
            raise FormatError(self.name, "position", f"finite numbers: {error}") from None
        payload = np.frombuffer(format_pos_header(ambiguities=False) + line, np.uint8)
        return ReceiverBytes(time_ns=time_ns, protocol="pos", payload=payload)

    def _check_age(self, time_ns: int, now_ns: int) -> None:
        limit_s, age_ns = BY_NAME[self.channel].max_age_s, now_ns - time_ns
        if limit_s is not None and age_ns > limit_s * NS_PER_SECOND:
            self.counts["stale"] += 1
            raise StampError(f"{self.name}: {age_ns / NS_PER_SECOND:.3f} s old, at most {limit_s} s")
        if age_ns < -_FUTURE_NS:
            self.counts["future"] += 1
            raise StampError(f"{self.name}: {-age_ns / NS_PER_SECOND:.3f} s in the future")


def lever_arm_settings(frames: StaticFrames, base_frame: str, topic: SensorTopic) -> str | None:
    """Return lines of settings by the static transforms: place of LiDAR, IMU or antenna; None: not known."""
    base_from_sensor = frames.base_from(base_frame, topic.frame_id) if topic.frame_id else None
    if base_from_sensor is None or topic.channel == "motion":
        return None
    x_m, y_m, z_m = base_from_sensor[:3, 3].tolist()
    if topic.channel == "receiver_bytes":
        table = f"antenna = {{ x_m = {x_m:.3f}, y_m = {y_m:.3f}, z_m = {z_m:.3f} }}"
        return f"ros2.toml, [outputs]: {table}; antenna_height.toml: {table}"
    angles = zip(
        ("roll", "pitch", "yaw"), roll_pitch_yaw_from_rotation(base_from_sensor[:3, :3]), strict=True
    )
    sensor = "imu" if topic.channel == "imu" else "lidar"
    turns = "; ".join(f"{sensor}_{name}_deg = {math.degrees(angle_rad):.2f}" for name, angle_rad in angles)
    place = f"{sensor}_x_m = {x_m:.3f}; {sensor}_y_m = {y_m:.3f}; {sensor}_z_m = {z_m:.3f}"
    return f"localizer.toml: {place}; {turns}"
