"""Order of the epochs of one receiver: late ones are refused, unless the receiver's clock was set back."""

from __future__ import annotations

from typing import Literal

Order = Literal["next", "late", "restarted"]
_RESTARTED_AFTER = 3  # late epochs in a row; chosen: stray packets are single


class EpochOrder:
    """Distinguishes late or repeated epochs from a receiver whose clock was set back.

    Stray packets are single; after a clock was set back (or one time tag lay in the future) all epochs are late: the
    third late epoch in a row that is in order with those before it restarts the sequence.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._late_ns: list[int] = []

    def admit(self, time_ns: int) -> Order:
        """`next`: to be used; `late`: to be dropped; `restarted`: to be used, unrelated to the epochs before."""
        if self._last_ns is None or time_ns > self._last_ns:
            self._last_ns = time_ns
            self._late_ns.clear()
            return "next"
        if self._late_ns and time_ns <= self._late_ns[-1]:
            self._late_ns.clear()
        self._late_ns.append(time_ns)
        if len(self._late_ns) < _RESTARTED_AFTER:
            return "late"
        self._last_ns = time_ns
        self._late_ns.clear()
        return "restarted"
