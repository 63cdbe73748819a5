"""Starts Camber's commands as real processes, and reads what a replay has left behind."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Channel as McapChannel
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader

from camber.formats.drive.recording import Recorded, load_recording
from camber.replay.drive_inputs import prepare_drive
from camber.replay.one_process import ReportedIssue, replay_in_one_process
from camber.replay.run_folder import RunFacts, drive_facts
from camber.replay.short_drive import START_NS
from camber.schemas.codec import encode
from camber.schemas.drive import load_manifest
from camber.validation.evaluation import CHANNELS, evaluate
from camber.validation.reference_trajectory import truth_of

MACHINE = frozenset({"latency_ms", "notes", "speed_factor", "wall_s"})
"""What of a summary depends on the machine and its load; nothing else may."""

_NS = 1_000_000_000


def environment() -> dict[str, str]:
    """This environment, with the same import path, but without CAMBER_ settings of the caller."""
    kept = {
        name: text
        for name, text in os.environ.items()
        if not name.startswith("CAMBER_") or name == "CAMBER_DATA"
    }
    return {**kept, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def camber(*arguments: object, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
    """`camber …`, to its end."""
    return subprocess.run(
        [sys.executable, "-m", "camber.cli", *map(str, arguments)],
        env=environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
    )


@contextmanager
def started(*arguments: object, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """`python …` in the background; asked to end on leaving, killed where that does not help."""
    process = subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        env=environment(),
        stdin=subprocess.DEVNULL,
        text=True,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, **options},
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


def wait_until(what: Callable[[], Any], *, timeout_s: float, why: str) -> Any:
    """The first true value of `what`; an AssertionError saying `why` after the timeout."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        value = what()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError(f"{why}: not within {timeout_s:g} s")


def free_port() -> int:
    """A port of the loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def process_ids(out: Path) -> dict[str, int]:
    """Of the services of a running replay; empty before they are started."""
    path = out / "processes.json"
    return json.loads(path.read_text()) if path.exists() else {}


def endpoint_of(out: Path) -> str:
    """Where a running replay can be listened to."""
    path = wait_until(
        lambda: process_ids(out) and out / "config" / "gnss.toml",
        timeout_s=30.0,
        why="no services were started",
    )
    (endpoint,) = tomllib.loads(path.read_text())["zenoh"]["connect"]
    return str(endpoint)


def kill(pid: int, number: int = signal.SIGKILL) -> None:
    """Send a signal to a process of this test."""
    os.kill(pid, number)


def recorded(out: Path) -> dict[str, list[Recorded[Any]]]:
    """All that was on the bus, by channel; a damaged recording fails the test."""
    messages, errors = load_recording(out / "recording.mcap")
    assert errors == []
    return messages


def summary_of(out: Path) -> dict[str, Any]:
    """The figures of a replay."""
    return json.loads((out / "summary.json").read_text())


def drive_s(time_ns: int) -> float:
    """Seconds after the start of the short drive."""
    return (time_ns - START_NS) / _NS


def payloads(out: Path) -> dict[str, list[bytes]]:
    """The bytes of every message as they were on the bus, by key, in the file's order."""
    topics: dict[int, str] = {}
    by_key: dict[str, list[bytes]] = {}
    with (out / "recording.mcap").open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, McapChannel):
                topics[record.id] = record.topic
            elif isinstance(record, McapMessage):
                by_key.setdefault(topics[record.channel_id], []).append(record.data)
    return by_key


def figures(out: Path) -> dict[str, Any]:
    """The summary without what depends on the machine: latency and speed."""
    return {name: value for name, value in summary_of(out).items() if name not in MACHINE}


@dataclass(frozen=True)
class Drive:
    """A drive in one process: the inputs of a replay and its services, without bus and without other processes."""

    recorded: dict[str, list[Recorded[Any]]]
    summary: dict[str, Any]
    issues: list[ReportedIssue]


def in_one_process(manifest: Path, folder: Path, *overrides: str) -> Drive:
    """What `camber replay` would record and sum up, at a fifth of the cost."""
    drive = load_manifest(manifest, overrides)
    inputs = prepare_drive(drive, folder / "work")
    driven = replay_in_one_process(inputs, folder)
    truth = None if inputs.truth is None else truth_of(inputs.truth)
    summary = evaluate(driven.recorded, drive_facts(inputs), RunFacts(), truth).summary
    return Drive(driven.recorded, summary, driven.issues)


def assert_same_messages(out: Path, drive: Drive) -> None:
    """Assert that one process and the processes of a replay published the same bytes on every channel."""

    def messages(items: Iterable[Recorded[Any]]) -> list[bytes]:
        return sorted(encode(item.message, source="", sequence=0) for item in items)

    replayed = recorded(out)
    for name in CHANNELS:
        assert messages(replayed.get(name, ())) == messages(drive.recorded[name]), f"{name} differs"
