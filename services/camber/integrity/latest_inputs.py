"""The latest inputs besides fixes: poses, antenna height, wheel speed, receiver integrity."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

from camber.integrity.checks.receiver_integrity import ReceiverIntegrityMonitor
from camber.integrity.epoch_inputs import EpochInputs, age_s
from camber.schemas.antenna import AntennaHeight
from camber.schemas.pose import Pose

_POSES = 64  # a second or more at any rate of the pose
_NEAR_S = 0.5  # largest age of a pose that gives a displacement; chosen: a car's motion is known so long


class LatestInputs:
    """The newest inputs besides the fixes."""

    def __init__(self) -> None:
        self.receiver = ReceiverIntegrityMonitor()
        self.poses: deque[Pose] = deque(maxlen=_POSES)
        self.antenna: AntennaHeight | None = None
        self._speed: tuple[int, float] | None = None

    @property
    def pose(self) -> Pose | None:
        """The newest pose."""
        return self.poses[-1] if self.poses else None

    def add_pose(self, pose: Pose) -> None:
        """A new pose; one that is older than the last is ignored."""
        if not self.poses or pose.time_ns > self.poses[-1].time_ns:
            self.poses.append(pose)

    def set_antenna_height(self, antenna: AntennaHeight) -> None:
        """A new antenna height."""
        self.antenna = antenna

    def add_wheel_speed(self, time_ns: int, speed_m_s: float | None) -> None:
        """A new wheel speed; None does not overwrite a known one, its age does."""
        if speed_m_s is not None:
            self._speed = (time_ns, speed_m_s)

    def forget_after(self, limit_ns: int) -> None:
        """Drop what is dated later than this."""
        while self.poses and self.poses[-1].time_ns > limit_ns:
            self.poses.pop()
        if self.antenna is not None and self.antenna.time_ns > limit_ns:
            self.antenna = None
        self.receiver.forget_after(limit_ns)

    def inputs(self, at_ns: int, alive: frozenset[str]) -> EpochInputs:
        """What is known for a judgement at this time: the pose nearest to it."""
        return EpochInputs(pose=self._nearest_pose(at_ns), antenna=self.antenna, alive=alive)

    def speed_at(self, time_ns: int, max_age_s: float) -> float | None:
        """The wheels' speed, None where it is too far from this time."""
        if self._speed is None or not abs(age_s(self._speed[0], time_ns)) <= max_age_s:
            return None
        return self._speed[1]

    def pose_near(self, time_ns: int) -> Pose | None:
        """The nearest pose that has a place, if it is near enough for a displacement."""
        pose = self._nearest_pose(time_ns)
        if pose is None or pose.latitude_rad is None or not abs(age_s(pose.time_ns, time_ns)) <= _NEAR_S:
            return None
        return pose

    def _nearest_pose(self, time_ns: int) -> Pose | None:
        """Of two as near the earlier; they are in the order of their times."""
        poses = self.poses
        if not poses or time_ns >= poses[-1].time_ns:
            return self.pose
        after = bisect_left(poses, time_ns, key=lambda pose: pose.time_ns)
        before = max(after - 1, 0)
        nearer = time_ns - poses[before].time_ns <= poses[after].time_ns - time_ns
        return poses[before if nearer else after]
