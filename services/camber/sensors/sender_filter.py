"""Packets of one sender among several: two sensors of one model cannot be distinguished by their packets."""

from __future__ import annotations

from collections.abc import Sequence

_GONE_NS = 2_000_000_000  # chosen: a sender that was silent for so long may have another address now


class SenderFilter:
    """Keeps the packets of the first sender; `others` are the other senders of the last call."""

    def __init__(self) -> None:
        self.sender: str | None = None
        self.others: frozenset[str] = frozenset()
        self._used_ns = 0

    def mark_used(self, arrival_ns: int) -> None:
        """A packet that arrived then was of use."""
        self._used_ns = arrival_ns

    def kept(self, arrivals_ns: Sequence[int], senders: Sequence[str]) -> list[int]:
        """Which packets are read: those of the first sender; of another, once that has been of no use for long."""
        kept: list[int] = []
        others: set[str] = set()
        used_ns = self._used_ns
        for number, (arrival_ns, sender) in enumerate(zip(arrivals_ns, senders, strict=True)):
            if self.sender is None or (sender != self.sender and abs(arrival_ns - used_ns) >= _GONE_NS):
                self.sender, self._used_ns = sender, arrival_ns
            if sender == self.sender:
                kept.append(number)
                used_ns = arrival_ns
            else:
                others.add(sender)
        self.others = frozenset(others)
        return kept

    def issues(self) -> list[tuple[str, str]]:
        """Those other senders, as issues."""
        text = "packets from {} too, not only of {}: set sender"
        return [("lidar_packets", text.format(sender, self.sender)) for sender in sorted(self.others)]
