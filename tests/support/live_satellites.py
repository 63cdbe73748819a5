"""A simulated drive that happens now: a receiver's port and a real caster feed it live to a real `camber gnss`.

Raw observations belong to their satellites' orbits and cannot be dated anew, so the drive is simulated from now on, and
what lies in the past once it is made is not sent.
"""

from __future__ import annotations

import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

from camber.formats.drive.truth_csv import read_truth
from camber.gnss.warm_up import warm_up
from camber.replay.arrivals import TimedBytes
from camber.replay.observation_files import read_observation_file
from camber.schemas.gnss import Fix
from camber.schemas.health import Health
from support.raw_drive import error_m
from support.running import (
    CLOCK,
    camber,
    camber_started,
    health_of,
    loopback_router,
    settings_file,
    wait_until,
)

_GPS_AHEAD_OF_UTC = timedelta(seconds=18)


class LiveDrive:
    """Its files, by epoch, and where its antenna is."""

    def __init__(self, folder: Path, duration_s: float, *, scenario: str = "open-sky") -> None:
        warm_up()  # machine code is made before the drive begins; other processes find it on disk
        start = datetime.now(UTC).replace(tzinfo=None, microsecond=0) + _GPS_AHEAD_OF_UTC
        made = camber(
            "simulate", scenario, "--set", f"duration_s={duration_s}", "--set", f"start={start.isoformat()}",
            "--out", folder, "--quiet", timeout_s=300.0,
        )  # fmt: skip
        assert made.returncode == 0, made.stderr
        _, _, self.rover = read_observation_file(folder / "rover.ubx", None)
        _, _, self.base = read_observation_file(folder / "base.rtcm", self.rover[0].time_ns)
        self._truth = read_truth(folder / "truth.csv", "camber")

    def error_m(self, fix: Fix) -> float:
        """How far a fix is from the truth of its epoch, in three dimensions."""
        return error_m(self._truth, fix)


class Port(threading.Thread):
    """A TCP server that sends to all its clients what is due, and notes when each epoch had gone."""

    def __init__(self, parts: list[TimedBytes]) -> None:
        super().__init__(name="live-port", daemon=True)
        self._parts = parts
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.setblocking(False)
        self.number = int(self._server.getsockname()[1])
        self._clients: list[socket.socket] = []
        self._ended = threading.Event()
        self.silent = False
        self.pause_between_bytes_s = 0.0
        """A slow line: the bytes of an epoch come in eight pieces, so far apart."""
        self.sent_ns: dict[int, int] = {}
        """By epoch, `time.monotonic_ns()` before its bytes went, all at once: none can have arrived earlier."""

    def run(self) -> None:
        for part in self._parts:
            wait_s = (part.time_ns - CLOCK.now_ns()) / 1e9
            if wait_s < -0.2:
                continue
            if self._ended.wait(max(wait_s, 0.0)):
                break
            self._accept()
            if not self.silent:
                self.sent_ns[part.time_ns] = time.monotonic_ns()
                self._send(part.payload)
        self.cut()
        self._server.close()

    def cut(self) -> None:
        """Close all connections; new ones are served."""
        clients, self._clients = self._clients, []
        for client in clients:
            client.close()

    def end(self) -> None:
        """Send nothing more."""
        self._ended.set()
        self.join(5.0)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except BlockingIOError:
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client.settimeout(1.0)
            self._clients.append(client)

    def _send(self, data: bytes) -> None:
        size = len(data) if self.pause_between_bytes_s == 0.0 else max(len(data) // 8, 1)
        for start in range(0, len(data), size):
            for client in list(self._clients):
                try:
                    client.sendall(data[start : start + size])
                except OSError:
                    self._clients.remove(client)
                    client.close()
            self._ended.wait(self.pause_between_bytes_s)


@contextmanager
def serving(parts: list[TimedBytes]) -> Iterator[Port]:
    """A port that sends until the block is left."""
    port = Port(parts)
    port.start()
    try:
        yield port
    finally:
        port.end()


class LiveGnss:
    """A router and `camber gnss` as processes."""

    def __init__(self, endpoint: str, process: subprocess.Popen[str]) -> None:
        self.endpoint, self.process = endpoint, process

    def health(self) -> Health:
        """As it says itself."""
        return health_of(self.endpoint, "gnss")

    def issues(self) -> dict[str, str]:
        """Texts by code."""
        return {issue.code: issue.text for issue in self.health().issues}


@contextmanager
def live_gnss(folder: Path, rover: Port, caster_port: int) -> Iterator[LiveGnss]:
    """The engine's positions of a receiver's port and a caster's base."""
    log = folder / "gnss.log"
    lines = (
        'positions = "engine"', f'source = "tcp:127.0.0.1:{rover.number}"', 'protocol = "ubx"',
        f'base_source = "ntrip://127.0.0.1:{caster_port}/BASE"', 'ntrip_user = "driver"',
        'ntrip_password = "geheim"', "position_interval_s = 1.0", "silence_s = 2.0",
    )  # fmt: skip
    with loopback_router() as endpoint, log.open("w") as file, camber_started(
        "gnss", "--config", settings_file(folder / "gnss.toml", endpoint, *lines), stdout=file
    ) as process:  # fmt: skip
        wait_until(
            lambda: "started" in log.read_text() or process.poll() is not None,
            timeout_s=300.0,
            why="camber gnss did not start",
        )
        assert process.poll() is None, log.read_text()
        yield LiveGnss(endpoint, process)
