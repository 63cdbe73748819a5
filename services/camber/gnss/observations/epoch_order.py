"""Epochs of one receiver come in the order of their time; what does not is refused, unless time itself went back."""

from __future__ import annotations

from typing import Literal

Order = Literal["next", "late", "anew"]
_ANEW_AFTER = 3


class EpochOrder:
    """Tells epochs that come late, or twice, from a receiver whose clock was set back.

    Stray packets are single; after a clock was set back (or one time tag lay in the future) all that follows is late:
    the third late epoch in a row that is in order with those before it begins anew.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._late_ns: list[int] = []

    def admit(self, time_ns: int) -> Order:
        """`next`: to be used; `late`: not to be; `anew`: to be used, and nothing goes on from what was before."""
        if self._last_ns is None or time_ns > self._last_ns:
            self._last_ns = time_ns
            self._late_ns.clear()
            return "next"
        if self._late_ns and time_ns <= self._late_ns[-1]:
            self._late_ns.clear()
        self._late_ns.append(time_ns)
        if len(self._late_ns) < _ANEW_AFTER:
            return "late"
        self._last_ns = time_ns
        self._late_ns.clear()
        return "anew"
