"""The time of a ROS graph: this machine's, or simulated by `/clock` (ROS 2 design, "Clock and Time")."""

from __future__ import annotations

from camber.geodesy.gps_time import NS_PER_SECOND

_MOST_OFF_NS = NS_PER_SECOND // 2
"""Chosen: as far as a stamp may be in the future; below it a difference is taken for delay of the messages."""


class GraphTime:
    """Where the graph's time is simulated, stamps are shifted to this machine's Unix time by a constant.

    `ahead_ns`: this machine's time less the graph's; None before the first time of `/clock`. It is kept while simulated
    time runs as fast as the machine's, so that delays of single messages do not change the times between samples.
    """

    def __init__(self, *, simulated: bool) -> None:
        self.simulated = simulated
        self.ahead_ns: int | None = None if simulated else 0

    def set(self, clock_ns: int, now_unix_ns: int) -> float | None:
        """Take a time of `/clock`; return by how many seconds it is off the time expected, where that is a step."""
        ahead_ns = now_unix_ns - clock_ns
        if self.ahead_ns is not None and abs(ahead_ns - self.ahead_ns) <= _MOST_OFF_NS:
            return None
        before_ns, self.ahead_ns = self.ahead_ns, ahead_ns
        return None if before_ns is None else (before_ns - ahead_ns) / NS_PER_SECOND
