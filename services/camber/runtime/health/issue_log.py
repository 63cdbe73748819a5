"""What a service keeps of itself for health and metrics: issues, counters, and what went over each channel."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from camber.runtime.clock import SystemClock
from camber.schemas.base import EARLIEST_NS, LATEST_NS
from camber.schemas.health import ChannelUse, Issue

Direction = Literal["in", "out", "asked"]

# What health can carry; a service that met more must still be able to say how it is. Of 256 counters the rest is for
# those of its inboxes, two for each channel.
MAX_ISSUES, MAX_COUNTERS, MAX_TEXT = 64, 144, 512
_ALL_TEXTS_BYTES = 20_000  # chosen: below the codec's header limit of 64 kB
_OTHERS = "others"
_NO_NAME = re.compile(r"[^A-Za-z0-9_.:@+-]")
_CLOCK = SystemClock()


@dataclass(slots=True)
class _Use:
    messages: int = 0
    last_s: float = 0.0


@dataclass(slots=True, kw_only=True)
class _Met:
    text: str
    count: int
    last_ns: int


class IssueLog:
    """Used from the work loop only."""

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self._issues: dict[str, _Met] = {}
        self._uses: dict[tuple[Direction, str], _Use] = {}

    def issue(self, code: str, text: str) -> tuple[str, str, int]:
        """Count an issue; returns its code and text as health shows them, and how often it was met."""
        code = _bounded(code, self._issues, MAX_ISSUES)
        text = text.encode("utf-8", "backslashreplace").decode()[:MAX_TEXT]  # a file's name may be no UTF-8
        met = self._issues.setdefault(code, _Met(text=text, count=0, last_ns=0))
        met.text, met.count, met.last_ns = text, met.count + 1, _CLOCK.now_ns()
        return code, text, met.count

    def count(self, name: str, n: int) -> None:
        """Add to a counter."""
        self.counters[_bounded(name, self.counters, MAX_COUNTERS)] += max(n, 0)

    def declare(self, direction: Direction, name: str) -> None:
        """This channel is there, though nothing has come or gone yet."""
        self._uses.setdefault((direction, name), _Use())

    def used(self, direction: Direction, name: str, n: int = 1) -> None:
        """Something came or went over a channel."""
        use = self._uses.get((direction, name))
        if use is None:
            use = self._uses[direction, name] = _Use()
        use.messages += n
        use.last_s = time.monotonic()

    def issues(self) -> tuple[Issue, ...]:
        """All issues so far; many of them with their texts cut, so that one message holds them all."""
        limit = _ALL_TEXTS_BYTES // max(len(self._issues), 1)
        return tuple(
            Issue(
                code=code,
                text=met.text.encode()[:limit].decode("utf-8", "ignore"),
                count=met.count,
                last_time_ns=met.last_ns if EARLIEST_NS <= met.last_ns <= LATEST_NS else None,
            )
            for code, met in sorted(self._issues.items())
        )

    def channels(self, waiting: Mapping[str, int]) -> tuple[ChannelUse, ...]:
        """What went over each channel; `waiting` has the lengths of queues of subscribed and queried channels."""
        now_s = time.monotonic()
        return tuple(
            ChannelUse(
                channel=name,
                direction=direction,
                messages=use.messages,
                age_s=max(now_s - use.last_s, 0.0) if use.messages else None,
                waiting=0 if direction == "out" else waiting.get(name, 0),
            )
            for (direction, name), use in sorted(self._uses.items())
        )


def _bounded(name: str, known: Mapping[str, object], limit: int) -> str:
    """`name` as health can carry it; the one of all others where there are too many, so that none goes uncounted."""
    name = _NO_NAME.sub("_", name)[:64]
    name = name if name[:1].isalnum() else f"x{name}"[:64]
    return name if name in known or len(known) < limit - 1 else _OTHERS
