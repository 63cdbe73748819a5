"""Where packets and frames come from: ports of this machine as they arrive, recordings as their time comes."""

from __future__ import annotations

from collections import Counter
from typing import Generic, Protocol, TypeVar

from camber.formats.drive.timed_file import TimedFile, TimedItem
from camber.formats.errors import FormatError
from camber.geodesy.gps_time import UNIX_OF_GPS_EPOCH_NS, gps_ns_from_unix_ns

T = TypeVar("T", bound=TimedItem)
_PAUSE_NS = 10_000_000_000  # chosen: what comes so much later was recorded after a pause, or a clock was set
_LOST = ("skipped_truncated", "skipped_fragment")


def gps_ns(unix_ns: int) -> int:
    """GPS time of a machine's clock; zero where that is before 1980."""
    return gps_ns_from_unix_ns(max(unix_ns, UNIX_OF_GPS_EPOCH_NS))


class PortOf(Protocol[T]):
    """An open port, or one that has the reason why it is not."""

    problem: str | None
    lost: int

    def take(self) -> list[T]:
        """What has come since the last call."""

    def close(self) -> None:
        """Close it."""


class _Input(Generic[T]):
    """`issues` are those of the last call; `shift_ns` is to be added to the times of what is made of the items."""

    def __init__(self, name: str) -> None:
        self.issues: list[tuple[str, str]] = []
        self.counts: Counter[str] = Counter()
        self.shift_ns = 0
        self.ended = False
        self._name = name


class Live(_Input[T]):
    """A port; its issues are named after it."""

    def __init__(self, name: str, port: PortOf[T]) -> None:
        super().__init__(name)
        self._port = port
        self._problem: str | None = None

    def take(self, now_ns: int) -> list[T]:
        """What has come by now."""
        items = self._port.take()
        self.issues = []
        if self._port.problem is not None and self._port.problem != self._problem:
            self.issues.append((f"{self._name}_port", self._port.problem))
        self._problem = self._port.problem
        lost = self._port.lost - self.counts["lost_in_kernel"]
        if lost > 0:
            text = f"{lost} packets came while the kernel's buffer was full"
            self.issues.append((f"{self._name}_too_fast", text))
            self.counts["lost_in_kernel"] = self._port.lost
        return items

    def close(self) -> None:
        """Close the port."""
        self._port.close()


class Played(_Input[T]):
    """A recording at the pace of the clock, from when `start` was called; its issues are named after it."""

    def __init__(self, name: str, file: TimedFile[T]) -> None:
        super().__init__(name)
        self._file = file
        self._ahead_ns = 0
        self._has_any = False

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
        step_ns = first_ns - (now_ns - self._ahead_ns)
        return step_ns if step_ns > _PAUSE_NS or self._file.steps_back else 0

    def take(self, now_ns: int) -> list[T]:
        """What was recorded by the moment that is played now."""
        self.issues = []
        items: list[T] = []
        # The pace is that of GPS time: a recording over a leap second is a second late, and no more.
        for item in self._file.due(now_ns - self._ahead_ns + UNIX_OF_GPS_EPOCH_NS - self._leaps_ns()):
            if isinstance(item, FormatError):
                self.counts["damaged"] += 1
                self.issues.append((f"{self._name}_recording", str(item)))
            else:
                items.append(item)
        self._has_any = self._has_any or bool(items)
        ends = self._file.ended and not self.ended
        self._check_skipped(ends and not self._has_any)
        if ends:
            self.issues.append((f"{self._name}_ended", "the recording has been played to its end"))
        self.ended = self._file.ended
        return items

    def _check_skipped(self, nothing_came: bool) -> None:
        skipped = Counter({f"skipped_{reason}": n for reason, n in self._file.skipped.items()})
        if nothing_came or any(skipped[name] > self.counts[name] for name in _LOST):
            actual = ", ".join(f"{n} {reason}" for reason, n in self._file.skipped.items()) or "nothing"
            error = FormatError(self._file.name, "skipped", "whole datagrams or data frames", actual=actual)
            self.issues.append((f"{self._name}_recording", str(error)))
        self.counts |= skipped

    def _leaps_ns(self) -> int:
        first = self._file.first_ns()
        return 0 if first is None else gps_ns(first) + UNIX_OF_GPS_EPOCH_NS - max(first, UNIX_OF_GPS_EPOCH_NS)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
