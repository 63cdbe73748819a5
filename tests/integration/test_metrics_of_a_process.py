"""Metrics of a real service process: also where its work loop is frozen, and where somebody floods the port."""

from __future__ import annotations

import json
import os
import signal
import socket
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from support.running import free_port, started, wait_until

# A service whose work loop waits for ever when a file is there, as on a disk that hangs; its other threads go on.
FREEZING = """
import os, sys, time
from camber.runtime.run import run
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
class Freezing(Service):
    NAME = "gnss"
    SETTINGS = ServiceSettings
    def advance(self, now_ns):
        self.bus.count("rounds")
        while os.path.exists(FREEZE):
            time.sleep(0.05)
FREEZE = sys.argv.pop(1)
raise SystemExit(run(Freezing))
"""


class Process:
    """The service, and where its metrics are."""

    def __init__(self, folder: Path, port: int, pid: int) -> None:
        self.freeze = folder / "freeze"
        self.port = port
        self.pid = pid

    def read(self, timeout_s: float = 5.0) -> dict[str, float]:
        """Each metric without its labels, and those with a status or an event with these."""
        with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/metrics", timeout=timeout_s) as answer:
            text = answer.read().decode()
        result = {}
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                label = sample.labels.get("status") or sample.labels.get("event") or ""
                result[f"{sample.name}{f'.{label}' if label else ''}"] = sample.value
        return result

    def try_read(self) -> dict[str, float]:
        with suppress(OSError):
            return self.read()
        return {}


@contextmanager
def running(folder: Path, port: int) -> Iterator[Process]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    log = (folder / "log").open("w")
    command = ["-c", FREEZING, str(folder / "freeze"), "--metrics-port", str(port), "--zenoh.mode", "peer"]
    command += ["--zenoh.connect", "[]", "--zenoh.listen", json.dumps([endpoint])]
    with log, started(*command, stdout=log, stderr=log) as process:
        yield Process(folder, port, process.pid)


@pytest.fixture
def process(tmp_path: Path) -> Iterator[Process]:
    with running(tmp_path, free_port()) as process:
        wait_until(lambda: process.try_read().get("camber_status.ok"), timeout_s=60.0, why="it is well")
        yield process


def test_the_counters_go_on_and_those_of_a_frozen_loop_do_not(process: Process) -> None:
    before = process.read()
    wait_until(
        lambda: process.read()["camber_events_total.rounds"] > before["camber_events_total.rounds"],
        timeout_s=20.0,
        why="it counts on",
    )
    assert before["camber_said_age_seconds"] < 10.0
    assert before["process_resident_memory_bytes"] > 1e7
    process.freeze.touch()
    frozen = wait_until(
        lambda: (now := process.read())["camber_said_age_seconds"] > 3.0 and now,
        timeout_s=20.0,
        why="it is frozen",
    )
    assert frozen["camber_status.ok"] == 1.0, "its last word"
    process.freeze.unlink()
    wait_until(lambda: process.read()["camber_said_age_seconds"] < 1.5, timeout_s=20.0, why="it goes on")


def test_a_process_that_is_frozen_as_a_whole_answers_nothing(process: Process) -> None:
    os.kill(process.pid, signal.SIGSTOP)
    stat = Path(f"/proc/{process.pid}/stat")
    wait_until(lambda: stat.read_text().rpartition(")")[2].split()[0] == "T", timeout_s=10.0, why="it stands")
    try:
        with pytest.raises(OSError, match="timed out"):
            process.read(timeout_s=1.0)
    finally:
        os.kill(process.pid, signal.SIGCONT)
    wait_until(lambda: process.try_read().get("camber_status.ok"), timeout_s=20.0, why="it answers again")


def test_flooding_the_port_does_not_stop_the_work_loop(process: Process) -> None:
    before = process.read()
    ends_s = time.monotonic() + 5.0
    slow: list[socket.socket] = []
    try:
        while time.monotonic() < ends_s:
            connection = socket.socket()
            connection.settimeout(0.2)
            slow.append(connection)
            with suppress(OSError):
                connection.connect(("127.0.0.1", process.port))
                connection.sendall(b"GET /metrics HTTP/1.1\r\nX: " + b"a" * 3000)
            if len(slow) > 200:
                slow.pop(0).close()
    finally:
        for connection in slow:
            connection.close()
    after = wait_until(process.try_read, timeout_s=30.0, why="it answers again")
    assert after["camber_events_total.rounds"] - before["camber_events_total.rounds"] > 20.0
    assert after["process_open_fds"] < before["process_open_fds"] + 20.0
    assert after["camber_threads"] == before["camber_threads"]
    assert after["camber_said_age_seconds"] < 5.0


def test_a_port_that_is_taken_is_a_problem_and_the_service_runs(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, running(tmp_path, taken.getsockname()[1]):
        wait_until(
            lambda: "metrics_not_served" in (tmp_path / "log").read_text(),
            timeout_s=60.0,
            why="no log line",
        )
        wait_until(lambda: "started" in (tmp_path / "log").read_text(), timeout_s=60.0, why="it runs")
