"""Times of the last messages, and whether a new one is due: consumers always have a current status."""

from __future__ import annotations

from camber.integrity.rules import SAME_EPOCH_S

_REPEAT_NS = 100_000_000  # period of repetition where there is no epoch to publish for
_SAME_EPOCH_NS = round(SAME_EPOCH_S * 1e9)


class PublishSchedule:
    """Times of the last messages; 0: none yet."""

    def __init__(self) -> None:
        self._verdict_at_ns = 0  # when it was published
        self._none_at_ns = 0  # when the absence of a position was published
        self._position_ns = 0  # of which time the newest position is
        self._rtk_ns = 0  # of which time the newest confirmed position is

    def verdict(self, now_ns: int) -> None:
        """A verdict has been published."""
        self._verdict_at_ns = now_ns

    def rtk(self, time_ns: int) -> None:
        """A confirmed position has been published."""
        self._rtk_ns = max(self._rtk_ns, time_ns)
        self._position_ns = max(self._position_ns, time_ns)

    def position(self, time_ns: int) -> None:
        """Another position, or its absence, has been published for the time of a pose."""
        self._position_ns = max(self._position_ns, time_ns)

    def unavailable_position(self, now_ns: int) -> None:
        """The absence of a position has been published."""
        self._none_at_ns = now_ns

    def pose_is_due(self, pose_ns: int) -> bool:
        """Is this pose newer than what was published, and not of an epoch that has a confirmed position?"""
        return pose_ns > self._position_ns and pose_ns > self._rtk_ns + _SAME_EPOCH_NS

    def verdict_is_due(self, now_ns: int) -> bool:
        """Has there been no verdict for a while?"""
        return not 0 <= now_ns - self._verdict_at_ns < _REPEAT_NS

    def position_is_due(self, now_ns: int, max_age_s: float) -> bool:
        """Is the newest position too old, and was that not just published?"""
        fresh = now_ns - self._position_ns <= max_age_s * 1e9
        return not fresh and not 0 <= now_ns - self._none_at_ns < _REPEAT_NS

    def forget_after(self, limit_ns: int) -> None:
        """The clock was set back: no message can be of a later time."""
        if max(self._position_ns, self._rtk_ns) > limit_ns:
            self._position_ns = self._rtk_ns = 0
