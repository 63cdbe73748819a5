"""What the judge has published, as ROS messages that no consumer can take for more, or for newer, than it is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from camber.formats.ros.judged_messages import (
    ANTENNA_FRAME,
    diagnostics_message,
    fix_message,
    is_trusted,
    no_fix_message,
    pose_message,
    usable_place,
)
from camber.formats.ros.message_types import header_at, new_message, stamp_unix_ns
from camber.geodesy.gps_time import NS_PER_SECOND
from camber.geodesy.local_frame import LocalFrame
from camber.geodesy.se3 import lever_arm_enu
from camber.schemas.base import Float64
from camber.schemas.integrity import CONFIRMED_VERDICTS, Position, Verdict
from camber.schemas.motion import LeverArm

_UNKNOWN_VARIANCE = 1e6
"""Of a velocity that is not known, in (m/s)² and (rad/s)². Chosen: a thousand times any vehicle's, and no NaN."""
_OK, _WARN, _ERROR = 0, 1, 2  # DiagnosticStatus


class FixOutput:
    """NavSatFix of each fix: with a position only where its verdict confirms it and the position is usable.

    A confirmed verdict waits for the position of the same fix; `due` gives NO_FIX where there is none for too long.
    """

    def __init__(self, silence_ns: int) -> None:
        self._silence_ns = silence_ns
        self._confirmed: Verdict | None = None
        self._published_ns = 0

    def of_verdict(self, verdict: Verdict, now_ns: int) -> Any | None:
        """Return NO_FIX for a verdict that does not confirm; None for one that does."""
        if verdict.verdict in CONFIRMED_VERDICTS:
            self._confirmed = verdict
            return None
        self._confirmed, self._published_ns = None, now_ns
        return fix_message(verdict)

    def of_position(self, position: Position, now_ns: int) -> tuple[Any | None, bool]:
        """Return the NavSatFix of the fix that a position is, and whether it may be trusted."""
        verdict = self._confirmed
        if verdict is None or position.source != "rtk" or position.fix_id != verdict.fix_id:
            return None, False
        self._confirmed, self._published_ns = None, now_ns
        trusted = is_trusted(verdict, position)
        return fix_message(verdict) if trusted else no_fix_message(verdict.time_ns), trusted

    def due(self, now_ns: int) -> Any | None:
        """Return NO_FIX of now where nothing was published for the silence, or the clock was set back."""
        if 0 <= now_ns - self._published_ns < self._silence_ns:
            return None
        self._published_ns = now_ns
        return no_fix_message(now_ns)


def base_pose(position: Position, frame: LocalFrame, antenna: LeverArm | None, map_frame: str) -> Any | None:
    """Return PoseWithCovarianceStamped of the base frame, of the antenna where that is unset; None: not usable.

    The vehicle is taken for level: the position contains yaw alone. Without yaw only a pose of the antenna is known.
    """
    place = usable_place(position)
    if place is None or (antenna is not None and position.yaw_rad is None):
        return None
    message = pose_message(position, place, frame)
    message = replace(message, header=replace(message.header, frame_id=map_frame))
    if antenna is None or position.yaw_rad is None:
        return message
    arm_m = lever_arm_enu(0.0, 0.0, position.yaw_rad, (antenna.x_m, antenna.y_m, antenna.z_m))
    at = message.pose.pose.position
    moved = replace(at, x=at.x - arm_m[0], y=at.y - arm_m[1], z=at.z - arm_m[2])
    pose = replace(message.pose, pose=replace(message.pose.pose, position=moved))
    return replace(message, pose=pose)


def odometry_message(pose: Any, child_frame: str) -> Any:
    """Return Odometry of a pose; its velocity is not known."""
    zero = new_message("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    covariance: Float64 = np.eye(6) * _UNKNOWN_VARIANCE
    twist = new_message(
        "geometry_msgs/msg/TwistWithCovariance",
        twist=new_message("geometry_msgs/msg/Twist", linear=zero, angular=zero),
        covariance=covariance.reshape(-1),
    )
    return new_message(
        "nav_msgs/msg/Odometry", header=pose.header, child_frame_id=child_frame, pose=pose.pose, twist=twist
    )


def transform_message(pose: Any, child_frame: str) -> Any:
    """Return a TFMessage with the transform from a pose's frame to the frame whose pose it is."""
    at, turn = pose.pose.pose.position, pose.pose.pose.orientation
    transform = new_message(
        "geometry_msgs/msg/Transform",
        translation=new_message("geometry_msgs/msg/Vector3", x=at.x, y=at.y, z=at.z),
        rotation=turn,
    )
    stamped = new_message(
        "geometry_msgs/msg/TransformStamped",
        header=pose.header,
        child_frame_id=child_frame,
        transform=transform,
    )
    return new_message("tf2_msgs/msg/TFMessage", transforms=[stamped])


def diagnostics(
    position: Position | None,
    services: Mapping[str, bool],
    facts: Mapping[str, str],
    *,
    now_ns: int,
    vehicle: str,
) -> Any:
    """Return a DiagnosticArray of now: the newest fresh position, each service, and what this node works with."""
    status = [] if position is None else diagnostics_message(position, vehicle).status
    if position is None:
        status.append(_status("position", _ERROR, "no position from integrity", vehicle))
    for name, alive in services.items():
        status.append(_status(name, _OK if alive else _ERROR, "running" if alive else "absent", vehicle))
    node = _status("ros2", _OK, "running", vehicle)
    values = [new_message("diagnostic_msgs/msg/KeyValue", key=key, value=text) for key, text in facts.items()]
    status.append(replace(node, values=values))
    return new_message("diagnostic_msgs/msg/DiagnosticArray", header=header_at(now_ns, ""), status=status)


def with_stamps_before(message: Any, ahead_ns: int) -> Any:
    """Return a message, one that `transform_message` or a function above gives, with its stamps so much earlier."""
    if hasattr(message, "transforms"):
        return replace(message, transforms=[with_stamps_before(one, ahead_ns) for one in message.transforms])
    seconds, nanoseconds = divmod(stamp_unix_ns(message) - ahead_ns, NS_PER_SECOND)
    stamp = new_message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return replace(message, header=replace(message.header, stamp=stamp))


def child_frame(antenna: LeverArm | None, base_frame: str) -> str:
    """Return the frame whose pose is published."""
    return ANTENNA_FRAME if antenna is None else base_frame


def origin_text(frame: LocalFrame) -> str:
    """Return the origin of `map` as a setting."""
    degrees = math.degrees(frame.latitude_rad), math.degrees(frame.longitude_rad)
    return (
        f"latitude_deg = {degrees[0]:.9f}, longitude_deg = {degrees[1]:.9f}, height_m = {frame.height_m:.3f}"
    )


def _status(name: str, level: int, text: str, vehicle: str) -> Any:
    return new_message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=f"camber: {name}",
        message=text,
        hardware_id=vehicle,
        values=[],
    )
