"""From the last byte of an epoch to its fix on the bus: a real receiver's port, a real caster, a real `camber gnss`.

The receiver sends UBX over TCP at 10 Hz, the base RTCM through RTKLIB's caster, a subscriber of Zenoh has the fix. One
machine, one monotonic clock. The peer is the goal, as there is no other chain to measure beside it.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

from figure import Figure, percentiles

from camber.runtime.subscription import Subscription
from support.live_satellites import LiveDrive, live_gnss, serving
from support.running import free_port
from support.streams import rtklib_caster

MEASURED_S = 60.0
WARM_S = 15.0
DRIVE_S = 160.0
GOAL_MS = 30.0


def latencies_ms(folder: Path) -> tuple[list[float], int]:
    """Of all epochs of a minute; and how many of them were fixed."""
    drive = LiveDrive(folder / "drive", DRIVE_S)
    port = free_port()
    with (
        serving(drive.rover) as rover,
        serving(drive.base) as base,
        rtklib_caster(base.number, port),
        live_gnss(folder, rover, port) as gnss,
        Subscription("fix", vehicle="car", connect=[gnss.endpoint]) as listener,
    ):
        latency_ms: list[float] = []
        fixed = 0
        began = time.monotonic()
        while time.monotonic() - began < WARM_S + MEASURED_S:
            fix = listener.next(1.0)
            now_ns = time.monotonic_ns()
            if fix is None or time.monotonic() - began < WARM_S:
                continue
            latency_ms.append((now_ns - rover.sent_ns[fix.time_ns]) / 1e6)
            fixed += fix.quality == "fixed"
        print(f"health: {gnss.health().counters} {gnss.issues()}", file=sys.stderr)
        return latency_ms, fixed


def figures() -> list[Figure]:
    """p50 and p99; the load of the machine goes to the standard error."""
    with tempfile.TemporaryDirectory() as folder:
        before = os.getloadavg()[0]
        latency_ms, fixed = latencies_ms(Path(folder))
    print(
        f"gnss_live: {len(latency_ms)} epochs, {fixed} fixed, load {before:.1f} to {os.getloadavg()[0]:.1f}, "
        f"most {max(latency_ms):.1f} ms",
        file=sys.stderr,
    )
    return percentiles("live chain, last byte to fix", "ms", latency_ms, GOAL_MS, "goal, p99")


if __name__ == "__main__":
    print(figures())
