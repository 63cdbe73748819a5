"""The newest message of each sensor, while it is not stale."""

from __future__ import annotations

from typing import Generic, TypeVar

from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME
from camber.schemas.motion import Motion, Ranging, Suspension
from camber.schemas.pose import Pose, ScanMatch

M = TypeVar("M", bound=Message)


class Newest(Generic[M]):
    """The newest message of a channel; of two out of order the one that was measured later."""

    def __init__(self, channel: str) -> None:
        limit_s = BY_NAME[channel].max_age_s
        assert limit_s is not None
        self._limit_ns = round(limit_s * 1e9)
        self._message: M | None = None

    def update(self, message: M) -> None:
        """Replace the message, unless this one is older. One far in the future came of a clock that was set back."""
        held = self._message
        if held is None or not 0 < held.time_ns - message.time_ns <= self._limit_ns:
            self._message = message

    def at(self, now_ns: int) -> M | None:
        """Return the message, unless it is older, or further ahead, than the table of channels allows."""
        held = self._message
        return held if held is not None and abs(now_ns - held.time_ns) <= self._limit_ns else None

    @property
    def time_ns(self) -> int:
        """Time of the message, whatever its age; zero without one."""
        return 0 if self._message is None else self._message.time_ns


class HeightInputs:
    """The newest message of each input."""

    def __init__(self) -> None:
        self.motion: Newest[Motion] = Newest("motion")
        self.pose: Newest[Pose] = Newest("pose")
        self.suspension: Newest[Suspension] = Newest("suspension")
        self.ranging: Newest[Ranging] = Newest("ranging")
        self.match: Newest[ScanMatch] = Newest("scan_match")

    def speed_m_s(self, now_ns: int) -> float | None:
        """Return the speed by the wheels, or else by the pose; None: not known."""
        motion, pose = self.motion.at(now_ns), self.pose.at(now_ns)
        if motion is not None and motion.wheel_speed_m_s is not None:
            return motion.wheel_speed_m_s
        return None if pose is None else pose.speed_m_s
