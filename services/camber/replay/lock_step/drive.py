"""A replay through the real processes of a vehicle, in lock step over the bus."""

from __future__ import annotations

import math
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from camber.replay.drive_inputs import DriveInputs
from camber.replay.lock_step.feeder import Feeder
from camber.replay.lock_step.processes import Processes
from camber.replay.run_recorder import RunRecorder
from camber.replay.service_settings import service_settings
from camber.replay.sweep_files import SweepReader
from camber.runtime.settings import ServiceSettings, ZenohSettings
from camber.schemas.channels import SERVICES
from camber.schemas.gnss import ReceiverBytes

_SUPERVISE_EVERY_S = 0.05  # chosen: short against the second that a process takes to start
# A killed process closes its links at once; one that a busy machine delays is not gone. Chosen: beyond any such delay.
_LEASE_S = 20.0


def replay_through_processes(
    inputs: DriveInputs,
    folder: Path,
    *,
    recorder: RunRecorder,
    speed: float = math.inf,
    progress: Callable[[], object] = lambda: None,
) -> tuple[float, tuple[str, ...]]:
    """Run a drive at `speed` times real time (infinite: as fast as possible); services keep their state in `folder`.

    Returns the seconds it took, without starting and ending the processes, and notes. Raises ReplayStuckError,
    BusError, and ManifestError where a service refuses its settings. `progress` is called once a tick.
    """
    for left_over in ("state", "logs"):  # what an earlier run has learnt would change this one
        shutil.rmtree(folder / left_over, ignore_errors=True)
    endpoint = _free_endpoint()
    processes = Processes(folder=folder, configs=process_settings(inputs, folder, endpoint))
    settings = ServiceSettings(
        vehicle=inputs.manifest.vehicle,
        clock="replay",
        zenoh=ZenohSettings(connect=[], listen=[endpoint], lease_s=_LEASE_S),
    )
    sweeps = SweepReader()
    with Feeder(settings, inputs.channels, observer=recorder.add_bytes) as feeder:
        try:
            processes.start()
            with _supervised(processes):
                feeder.assemble(
                    SERVICES, time_ns=inputs.tick_times_ns[0], meanwhile=processes.raise_refused_settings
                )
                began = time.monotonic()
                for time_ns in _feed(inputs, feeder, sweeps, processes, speed=speed):
                    recorder.tick_done(time_ns)
                    progress()
                wall_s = time.monotonic() - began
        finally:
            processes.stop()
    return wall_s, (*sweeps.notes(), *processes.notes)


def process_settings(inputs: DriveInputs, folder: Path, endpoint: str) -> dict[str, Mapping[str, Any]]:
    """Return the settings of all services as processes that join the bus at `endpoint`."""
    zenoh = {"mode": "peer", "connect": [endpoint], "listen": ["tcp/127.0.0.1:0"], "lease_s": _LEASE_S}
    return {name: {**table, "zenoh": zenoh} for name, table in service_settings(inputs, folder).items()}


def _feed(
    inputs: DriveInputs, feeder: Feeder, sweeps: SweepReader, processes: Processes, *, speed: float
) -> Iterator[int]:
    """Feed the drive tick by tick; yields the time of each tick that was published."""
    first_ns, last_ns = inputs.tick_times_ns[0], inputs.tick_times_ns[-1]
    greeting = ReceiverGreeting(inputs)
    kills = sorted(inputs.manifest.kills, key=lambda kill: kill.at_s, reverse=True)
    began = time.monotonic()
    for tick in inputs.ticks():
        if math.isfinite(speed):
            due = began + (tick.time_ns - first_ns) / 1e9 / speed
            time.sleep(max(due - time.monotonic(), 0.0))
        while kills and tick.time_ns >= first_ns + round(kills[-1].at_s * 1e9):
            processes.kill(kills.pop().service)
        for header in greeting.messages(tick.time_ns, feeder.participants):
            feeder.publish("receiver_bytes", header)
        for name, message in tick.messages(sweeps):
            feeder.publish(name, message)
        feeder.tick(tick.time_ns, last=tick.time_ns == last_ns)
        yield tick.time_ns


class ReceiverGreeting:
    """The header of the receiver's streams, which a receiver sends to every `gnss` that connects."""

    def __init__(self, inputs: DriveInputs) -> None:
        self._inputs = inputs
        self._connected = True

    def messages(self, time_ns: int, participants: frozenset[str]) -> Iterator[ReceiverBytes]:
        """Yield the header, before all else, where gnss has just come back."""
        was_connected, self._connected = self._connected, "gnss" in participants
        if self._connected and not was_connected:
            yield from self._inputs.greeting_at(time_ns)


def _free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def _supervised(processes: Processes) -> Iterator[None]:
    """Restarts processes that have ended, while the feeder waits for them."""
    stop = threading.Event()

    def supervise() -> None:
        while not stop.wait(_SUPERVISE_EVERY_S):
            processes.restart_ended()

    thread = threading.Thread(target=supervise, name="supervisor", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
