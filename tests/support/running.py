"""Runs Camber's commands as real processes, on a bus and in replays, and reads what a replay has left behind."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from camber.formats.drive.recording import Recorded, load_recording, read_recording
from camber.replay.drive_inputs import prepare_drive
from camber.replay.run_folder import RunFacts, drive_facts
from camber.replay.short_drive import START_NS
from camber.replay.single_process_replay import ReportedIssue, replay_in_one_process
from camber.runtime.bus import Bus
from camber.runtime.clock import SystemClock
from camber.runtime.query import query_once
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings, ZenohSettings, to_toml
from camber.schemas.codec import encode
from camber.schemas.drive import load_manifest
from camber.schemas.health import Health, HealthRequest
from camber.validation.evaluation import CHANNELS, evaluate
from camber.validation.reference_trajectory import truth_of

MACHINE = frozenset({"latency_ms", "notes", "speed_factor", "wall_s"})
"""What of a summary depends on the machine and its load; nothing else may."""

CLOCK = SystemClock()
_NS = 1_000_000_000


def environment() -> dict[str, str]:
    """This environment, with the same import path, but without CAMBER_ settings of the caller."""
    kept = {
        name: text
        for name, text in os.environ.items()
        if not name.startswith("CAMBER_") or name == "CAMBER_DATA"
    }
    return {**kept, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def python(*arguments: object, timeout_s: float = 60.0, **options: Any) -> subprocess.CompletedProcess[str]:
    """`python …`, to its end."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        **{"env": environment(), **options},
    )


def camber(*arguments: object, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
    """`camber …`, to its end."""
    return python("-m", "camber.cli", *arguments, timeout_s=timeout_s)


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


def camber_started(*arguments: object, **options: Any) -> AbstractContextManager[subprocess.Popen[str]]:
    """`camber …` in the background."""
    return started("-m", "camber.cli", *arguments, **options)


class Processes:
    """By name; each logs into the folder, and can be killed, frozen and started again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self._commands: dict[str, list[str]] = {}

    def start(self, name: str, *command: object, within: Sequence[str] = ()) -> None:
        """Run `within… python command…`; without a command, the one it was started with before."""
        if command:
            self._commands[name] = [*within, sys.executable, *map(str, command)]
        with self.log(name).open("ab") as log:
            self.running[name] = subprocess.Popen(
                self._commands[name], env=environment(), stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def kill(self, name: str) -> None:
        self.running[name].kill()
        self.running[name].wait()

    def freeze(self, name: str) -> None:
        self.running[name].send_signal(signal.SIGSTOP)

    def resume(self, name: str) -> None:
        self.running[name].send_signal(signal.SIGCONT)

    def log(self, name: str) -> Path:
        return self.folder / f"{name}.log"

    def ended(self) -> dict[str, str]:
        """Processes that have ended though they should run, with the end of their logs."""
        return {
            name: self.log(name).read_text()[-1500:]
            for name, process in self.running.items()
            if process.poll() is not None
        }

    def end(self) -> None:
        for process in self.running.values():
            process.kill()
            process.wait()


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


def free_endpoint() -> str:
    """An endpoint of the loopback on which nobody listens."""
    return f"tcp/127.0.0.1:{free_port()}"


@contextmanager
def loopback_router(endpoint: str | None = None) -> Iterator[str]:
    """`camber router` on the loopback, from when it listens on; where it is."""
    endpoint = endpoint or free_endpoint()
    with camber_started("router", "--listen", endpoint) as process:
        assert process.stdout is not None
        assert "listens" in process.stdout.readline()
        yield endpoint


def client_of(endpoint: str, vehicle: str = "car") -> ServiceSettings:
    """Settings of a client of a router."""
    return ServiceSettings(vehicle=vehicle, zenoh=ZenohSettings(mode="client", connect=[endpoint]))


def settings_file(path: Path, joining: str | ZenohSettings, *lines: str, vehicle: str = "car") -> Path:
    """Settings of a service: these lines of TOML, and that it joins the router of an endpoint, or by such settings."""
    zenoh = client_of(joining).zenoh if isinstance(joining, str) else joining
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join((f'vehicle = "{vehicle}"', *lines, "[zenoh]", to_toml(zenoh))))
    return path


def bus_of(endpoint: str, service: str, vehicle: str = "car") -> Bus:
    """The bus of a service that is part of the test."""
    settings = client_of(endpoint, vehicle)
    return Bus(open_session(settings.zenoh), settings, service, CLOCK)


def health_of(endpoint: str, service: str, vehicle: str = "car", *, timeout_s: float = 5.0) -> Health:
    """Health of a service, as it answers now."""
    request = HealthRequest(time_ns=CLOCK.now_ns())
    return query_once(client_of(endpoint, vehicle), "health", request, service=service, timeout_s=timeout_s)


def replayed(manifest: Path, out: Path, *more: object, timeout_s: float = 150.0) -> Path:
    """The folder that a replay leaves."""
    done = camber("replay", manifest, "--out", out, "--quiet", *more, timeout_s=timeout_s)
    assert done.returncode == 0, done.stderr
    return out


def replaying(
    manifest: Path, out: Path, end_s: float, speed: object, *more: object
) -> AbstractContextManager[subprocess.Popen[str]]:
    """A replay by real processes, in the background."""
    to_end = ("--processes", "--quiet", "--set", f"end_s={end_s}", "--speed", speed)
    return camber_started("replay", manifest, "--out", out, *to_end, *more)


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
    by_key: dict[str, list[bytes]] = {}
    for item in read_recording(out / "recording.mcap"):
        if isinstance(item, Recorded):  # a hostile peer's messages are errors
            data = encode(item.message, source=item.source, sequence=item.sequence)
            by_key.setdefault(item.key, []).append(data)
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
