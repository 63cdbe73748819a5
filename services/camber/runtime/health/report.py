"""How a service is, in its own words: made in its work loop, for health queries and metrics."""

from __future__ import annotations

import functools
import hashlib
import os
import socket
import time
from collections import deque
from pathlib import Path
from typing import Any, Literal

from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.service import Service
from camber.schemas.base import EARLIEST_NS, LATEST_NS
from camber.schemas.channels import CHANNELS
from camber.schemas.health import Health

VERSION = "0.1.0"
_LAG_OVER_S = 10.0  # chosen: window of the largest lag
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_MOST_GAUGES, _MOST_FACTS, _MOST_TEXT = 48, 16, 512


class HealthReporter:
    """Collects figures of the work loop, and makes `Health` of it."""

    def __init__(self, service: Service[Any], bus: Bus) -> None:
        self.failed = 0
        self._service = service
        self._bus = bus
        self._started = self._round = time.monotonic()
        self._late: deque[tuple[float, float]] = deque()  # when, by how much: only what nothing later exceeds
        self._of_process = [
            ("process", f"{socket.gethostname()}:{os.getpid()}"),
            ("messages", messages_digest()),
        ]

    @property
    def uptime_s(self) -> float:
        """Since the service began."""
        return time.monotonic() - self._started

    def round_ended(self) -> None:
        """The work loop has done a round."""
        self._round = time.monotonic()

    def came_late(self, by_s: float) -> None:
        """A round came later than its time: the one before it took too long."""
        now_s = time.monotonic()
        while self._late and self._late[-1][1] <= by_s:
            self._late.pop()
        self._late.append((now_s, by_s))
        while now_s - self._late[0][0] > _LAG_OVER_S:
            self._late.popleft()

    def health(self, healthy: bool | None, gauges: dict[str, float], facts: dict[str, str]) -> Health:
        """Whatever it has met, it can say so; the rest is the service's own words, `healthy` None where that failed."""
        now_s = time.monotonic()
        lag_s = max((by_s for _, by_s in self._late), default=0.0)
        status: Literal["ok", "degraded", "failing"] = (
            "failing" if self.failed or healthy is None else "ok" if healthy else "degraded"
        )
        return Health(
            time_ns=min(max(SystemClock().now_ns(), EARLIEST_NS), LATEST_NS),
            service=self._service.NAME,
            version=VERSION,
            status=status,
            uptime_s=now_s - self._started,
            loop_age_s=now_s - self._round,
            issues=self._bus.issues(),
            counters=dict(self._bus.counters),
            channels=self._bus.channels(),
            gauges=dict(list({"loop_lag_s": lag_s, **process_figures(), **gauges}.items())[:_MOST_GAUGES]),
            facts={
                name: text[:_MOST_TEXT] for name, text in [*self._of_process, *facts.items()][:_MOST_FACTS]
            },
            log_level=self._bus.log_level,
        )


@functools.cache
def messages_digest() -> str:
    """Eight characters that differ where two services differ in the versions of the messages they exchange."""
    names = {cls.schema_name() for c in CHANNELS for cls in (c.message, c.reply) if cls is not None}
    return hashlib.sha256("\n".join(sorted(names)).encode()).hexdigest()[:8]


def process_figures() -> dict[str, float]:
    """Resident memory, processor time, threads and open files of this process, as Linux has them."""
    try:
        resident = int(Path("/proc/self/statm").read_text("ascii").split()[1]) * _PAGE_BYTES
        threads, files = len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd"))
    except OSError:  # no more files may be opened: then health is needed most
        return {"cpu_s": time.process_time()}
    return {
        "memory_bytes": float(resident),
        "cpu_s": time.process_time(),
        "threads": float(threads),
        "open_files": float(files),
    }
