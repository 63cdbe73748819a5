"""Where packets and frames come from: ports of this machine as they arrive, recordings as their time comes."""

from __future__ import annotations

from collections import Counter
from typing import Generic, Protocol, TypeVar

from camber.formats.drive.timed_file import TimedFile, TimedItem
from camber.formats.errors import FormatError
from camber.geodesy.gps_time import UNIX_OF_GPS_EPOCH_NS, gps_ns_from_unix_ns

T = TypeVar("T", bound=TimedItem)
_PAUSE_NS = 10_000_000_000  # what comes so much later was recorded after a pause, or a clock was set
_LOST = ("skipped_truncated", "skipped_fragment")


def gps_ns(unix_ns: int) -> int:
    """GPS time of a machine's clock; zero where that is before 1980, which nobody takes."""
    return gps_ns_from_unix_ns(max(unix_ns, UNIX_OF_GPS_EPOCH_NS))


class Input(Protocol[T]):
    """`issues` are those of the last call; `shift_ns` is to be added to the times of what is made of the items."""

    issues: list[tuple[str, str]]
    counts: Counter[str]
    shift_ns: int

    def take(self, now_ns: int) -> list[T]:
        """What has come by this GPS time."""

    @property
    def ended(self) -> bool:
        """Nothing more will come."""

    def close(self) -> None:
        """Close it."""


class Port(Protocol[T]):
    """An open port, or one that says why it is not."""

    problem: str | None
    lost: int

    def take(self) -> list[T]:
        """What has come since the last call."""

    def close(self) -> None:
        """Close it."""


class Live(Generic[T]):
    """A port; its troubles are called after it."""

    shift_ns = 0
    ended = False

    def __init__(self, name: str, port: Port[T]) -> None:
        self.issues: list[tuple[str, str]] = []
        self.counts: Counter[str] = Counter()
        self._name, self._port = name, port
        self._problem: str | None = None

    def take(self, now_ns: int) -> list[T]:
        """What has come by now."""
        found = self._port.take()
        self.issues = []
        if self._port.problem is not None and self._port.problem != self._problem:
            self.issues.append((f"{self._name}_port", self._port.problem))
        self._problem = self._port.problem
        if self._port.lost > self.counts["lost_in_kernel"]:
            lost = self._port.lost - self.counts["lost_in_kernel"]
            self.issues.append(
                (f"{self._name}_too_fast", f"{lost} packets came while the kernel's buffer was full")
            )
            self.counts["lost_in_kernel"] = self._port.lost
        return found

    def close(self) -> None:
        """Close the port."""
        self._port.close()


class Played(Generic[T]):
    """A recording at the pace of the clock, from when `start` was called; its damages are called after it."""

    def __init__(self, name: str, file: TimedFile[T]) -> None:
        self.issues: list[tuple[str, str]] = []
        self.counts: Counter[str] = Counter()
        self.shift_ns = 0
        self._name, self._file = name, file
        self._ahead_ns: int | None = None
        self._told = False
        self._found_any = False

    def first_ns(self) -> int | None:
        """GPS time of what comes next."""
        first = self._file.first_ns()
        return None if first is None else gps_ns(first)

    def start(self, first_ns: int, now_ns: int, *, dated_now: bool) -> None:
        """What was recorded at `first_ns` comes now; `dated_now`: and is dated so."""
        self._ahead_ns = now_ns - first_ns
        self.shift_ns = self._ahead_ns if dated_now else 0
        self._file.go_on()

    def step_ns(self, now_ns: int) -> int:
        """By how much the recording's time steps before what comes next, which waits for `start`; mostly zero."""
        first_ns = self.first_ns()
        if first_ns is None:
            return 0
        step_ns = first_ns - (now_ns - (self._ahead_ns or 0))
        return step_ns if step_ns > _PAUSE_NS or self._file.steps_back else 0

    def take(self, now_ns: int) -> list[T]:
        """What was recorded by the moment that is played now."""
        self.issues = []
        found: list[T] = []
        # The pace is that of GPS time: a recording over a leap second is a second late, and no more.
        until_ns = now_ns - (self._ahead_ns or 0) + UNIX_OF_GPS_EPOCH_NS - self._leaps_ns()
        for item in self._file.due(until_ns):
            if isinstance(item, FormatError):
                self.counts["damaged"] += 1
                self.issues.append((f"{self._name}_recording", str(item)))
            else:
                found.append(item)
        self._found_any = self._found_any or bool(found)
        ends = self._file.ended and not self._told
        self._look_at_skipped(ends and not self._found_any)
        if ends:
            self._told = True
            self.issues.append((f"{self._name}_ended", "the recording has been played to its end"))
        return found

    def _look_at_skipped(self, nothing_came: bool) -> None:
        skipped = Counter({f"skipped_{reason}": n for reason, n in self._file.skipped.items()})
        if nothing_came or any(skipped[name] > self.counts[name] for name in _LOST):
            words = ", ".join(f"{n} {reason}" for reason, n in self._file.skipped.items()) or "nothing"
            error = FormatError(self._file.name, "skipped", "whole datagrams or data frames", actual=words)
            self.issues.append((f"{self._name}_recording", str(error)))
        self.counts |= skipped

    def _leaps_ns(self) -> int:
        first = self._file.first_ns()
        return 0 if first is None else gps_ns(first) + UNIX_OF_GPS_EPOCH_NS - max(first, UNIX_OF_GPS_EPOCH_NS)

    @property
    def ended(self) -> bool:
        """All of it has been handed out."""
        return self._file.ended

    def close(self) -> None:
        """Close the file."""
        self._file.close()
