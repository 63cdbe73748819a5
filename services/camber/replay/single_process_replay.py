"""A replay in one process: the services' own step functions, without bus and without bytes, as fast as possible.

The services are the objects that the processes run, and get the same messages in the same order as in lock step
(`lock_step/barrier.py`): at each tick those work that something has reached, in the order of the table of channels,
each with what was published for it so far, by time, table and sequence; a looped channel is delivered one tick later.
So all published messages are those of the processes, bit for bit. What differs: nothing is uploaded, an exception in a
service ends the replay, and a service that the drive kills is absent for `RESTART_S` of the drive instead of the time
that a process takes to start.
"""

from __future__ import annotations

import importlib
import shutil
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from camber.formats.drive.recording import Recorded
from camber.replay.drive_inputs import DriveInputs, DriveTick
from camber.replay.local_bus import LocalBus
from camber.replay.run_recorder import RunRecorder
from camber.replay.service_settings import service_settings, validated_settings
from camber.replay.sweep_files import SweepReader
from camber.replay.work_schedule import WorkSchedule
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.clock import ReplayClock
from camber.runtime.inbox import Inbox
from camber.runtime.service import Service
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, CHANNELS, VEHICLE_SERVICES, inputs_of
from camber.schemas.codec import Received
from camber.validation.evaluation import CHANNELS as EVALUATED

RESTART_S = 2.0
"""How long a killed service is absent. Chosen: what a process of the vehicle takes to start, 1 to 3 s."""
_ORDER = {channel.name: position for position, channel in enumerate(CHANNELS)}
Settings = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportedIssue:
    """An issue that a service has reported, at the time of its tick."""

    time_ns: int
    service: str
    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOutput:
    """The messages of the channels asked for, in the order of publishing, and all reported issues."""

    recorded: dict[str, list[Recorded[Any]]]
    issues: list[ReportedIssue]
    notes: tuple[str, ...] = ()


def replay_in_one_process(
    inputs: DriveInputs,
    folder: Path,
    *,
    settings: Settings | None = None,
    channels: Collection[str] = EVALUATED,
    recorder: RunRecorder | None = None,
    progress: Callable[[], object] = lambda: None,
) -> DriveOutput:
    """Run a drive; `settings` are added to those of the drive, by service; services keep their state in `folder`.

    What a service raises is raised here. `progress` is called once a tick.
    """
    vehicle = _Vehicle(inputs, folder, settings=settings or {}, channels=channels, recorder=recorder)
    for tick in inputs.ticks():
        vehicle.work_on(tick)
        if recorder is not None:
            recorder.tick_done(tick.time_ns)
        progress()
    return DriveOutput(recorded=vehicle.recorded, issues=vehicle.issues, notes=vehicle.sweeps.notes())


@dataclass(slots=True, kw_only=True)
class _RunningService:
    """A service, and the messages that wait for it."""

    service: Service[Any]
    handlers: dict[str, Callable[[Any], None]]
    answers: dict[str, Callable[[Any], Any]]
    inboxes: dict[str, Inbox]
    waiting: list[tuple[int, int, int, str, Received[Any]]] = field(default_factory=list)


class _Vehicle:
    """The services of one vehicle, and what goes between them."""

    def __init__(
        self,
        inputs: DriveInputs,
        folder: Path,
        *,
        settings: Settings,
        channels: Collection[str],
        recorder: RunRecorder | None,
    ) -> None:
        self.clock = ReplayClock()
        self.issues: list[ReportedIssue] = []
        self._inputs = inputs
        self.sweeps = SweepReader()
        self._recorder = recorder
        # What an earlier run has learnt would change this one.
        shutil.rmtree(folder / "state", ignore_errors=True)
        tables = service_settings(inputs, folder)
        self._settings = {name: {**tables[name], **settings.get(name, {})} for name in VEHICLE_SERVICES}
        self._settings["integrity"] |= {"upload": False}
        self.recorded: dict[str, list[Recorded[Any]]] = {name: [] for name in channels}
        self._sequence: Counter[tuple[str, str]] = Counter()
        self._schedule = WorkSchedule()
        self._running: dict[str, _RunningService] = {}
        self._returns_ns: dict[str, int] = {}
        first_ns = inputs.tick_times_ns[0]
        self._kills = [(first_ns + round(kill.at_s * 1e9), kill.service) for kill in inputs.manifest.kills]
        for name in VEHICLE_SERVICES:
            self._start(name)

    def work_on(self, tick: DriveTick) -> None:
        """Restart and kill services, publish what arrives at the tick, let the services work."""
        time_ns = tick.time_ns
        self._restart(time_ns)
        self._kill(time_ns)
        self._feed(tick.messages(self.sweeps))
        working = self._schedule.next_tick(time_ns, last=time_ns == self._inputs.tick_times_ns[-1])
        for name in VEHICLE_SERVICES:
            if name in working and name in self._running:
                self._work(self._running[name], time_ns)

    def publish(self, source: str, name: str, message: Message) -> None:
        """Hand a message to those that consume it, and record it."""
        sequence = self._sequence[source, name]
        self._sequence[source, name] += 1
        received = Received(message=message, source=source, sequence=sequence)
        arrival_ns = message.time_ns
        if self._recorder is not None:
            arrival_ns = time.time_ns()
            self._recorder.add_message(name, received, arrival_ns)
        if name in self.recorded:
            self.recorded[name].append(
                Recorded(
                    channel=name, key=name, message=message, source=source, sequence=sequence, arrival_ns=arrival_ns
                )
            )  # fmt: skip
        for consumer in BY_NAME[name].consumers:
            running = self._running.get(consumer)
            if running is not None and name in running.handlers:
                running.waiting.append((message.time_ns, _ORDER[name], sequence, name, received))

    def ask(self, name: str, request: Message) -> Any:
        """Return the answer at the time of the request."""
        (answerer,) = BY_NAME[name].consumers
        running = self._running.get(answerer)
        if running is None:
            raise QueryFailed("absent", f"{answerer} does not run")
        now_ns = self.clock.now_ns()
        self.clock.set(request.time_ns)
        (reply,) = running.answers[name]([request])
        self.clock.set(now_ns)
        if reply is None:
            raise QueryFailed("refused")
        return reply

    def is_kept(self, name: str) -> bool:
        return self._recorder is not None or name in self.recorded

    def is_running(self, name: str) -> bool:
        return name in self._running or name == "map_update"

    def report(self, service: str, time_ns: int, code: str, text: str) -> None:
        self.issues.append(ReportedIssue(time_ns=time_ns, service=service, code=code, text=text))
        if self._recorder is not None:
            self._recorder.add_issue(time_ns, service, f"{code}: {text}")

    def _feed(self, messages: Iterable[tuple[str, Message]]) -> None:
        for name, message in messages:
            self._schedule.add(name)
            self.publish("vehicle", name, message)

    def _start(self, name: str) -> None:
        kind: type[Service[Any]] = importlib.import_module(f"camber.{name}.service").SERVICE
        settings = validated_settings(name, kind.SETTINGS, self._settings[name])
        service = kind(settings, cast(Bus, LocalBus(self, name)))
        handlers = service.handlers()
        self._running[name] = _RunningService(
            service=service,
            handlers=handlers,
            answers=service.answers(),
            inboxes={c.name: Inbox(channel=c) for c in inputs_of(name) if c.name in handlers},
        )

    def _restart(self, time_ns: int) -> None:
        for name in [name for name, at_ns in self._returns_ns.items() if time_ns >= at_ns]:
            del self._returns_ns[name]
            self._start(name)
            self._schedule.wake_all()
            if name == "gnss":
                self._feed(("receiver_bytes", message) for message in self._inputs.greeting_at(time_ns))

    def _kill(self, time_ns: int) -> None:
        for at_ns, name in [kill for kill in self._kills if time_ns >= kill[0]]:
            self._kills.remove((at_ns, name))
            self._running.pop(name, None)
            self._returns_ns[name] = time_ns + round(RESTART_S * 1e9)
            self.report(name, time_ns, "killed", f"for {RESTART_S:g} s")

    def _work(self, running: _RunningService, time_ns: int) -> None:
        self.clock.set(time_ns)
        waiting, running.waiting = running.waiting, []
        waiting.sort(key=lambda item: item[:3])
        for _, _, _, channel, received in waiting:
            message = running.inboxes[channel].accept(received, time_ns, judge_age=False)
            if message is not None:
                running.handlers[channel](message)
        running.service.advance(time_ns)
