"""What was heard last of each sensor, and whether it still counts."""

from __future__ import annotations

from typing import Generic, TypeVar

from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME

M = TypeVar("M", bound=Message)
_NS = 1_000_000_000


class Newest(Generic[M]):
    """The newest message of a channel; of two out of order the one that was measured later."""

    def __init__(self, channel: str) -> None:
        limit_s = BY_NAME[channel].max_age_s
        assert limit_s is not None
        self._limit_ns = round(limit_s * _NS)
        self._message: M | None = None

    def hear(self, message: M) -> None:
        """A message has come."""
        held = self._message
        # One that is far in the future came of a clock that has been set back since.
        if held is None or not 0 < held.time_ns - message.time_ns <= self._limit_ns:
            self._message = message

    def at(self, now_ns: int) -> M | None:
        """The message, unless it is older, or further ahead, than the table of channels allows."""
        held = self._message
        return held if held is not None and abs(now_ns - held.time_ns) <= self._limit_ns else None

    @property
    def time_ns(self) -> int:
        """Of the message, whatever its age; zero: none was heard."""
        return 0 if self._message is None else self._message.time_ns
