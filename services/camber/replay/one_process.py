"""A drive through all services in one process: no bus, no bytes, as fast as it goes.

The services are the same objects that the processes of a replay run, fed in the same order (`runtime/barrier.py`): in
each tick those that something has reached, in the order of the table, each with what was published for it so far, by
time, table and sequence; what is looped arrives at the next tick. So verdicts and positions are those of a replay.
What services keep over a restart is in the drive's folder; nothing is uploaded. A service that the drive kills is
missing for `RESTART_S` of the drive; in a replay it takes what a process takes to start.
"""

from __future__ import annotations

import importlib
import shutil
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from camber.formats.drive.recording import Recorded
from camber.replay.command import messages_of, service_configs
from camber.replay.drive_inputs import DriveInputs
from camber.replay.sweep_files import SweepReader
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.clock import ReplayClock
from camber.runtime.feeder import HEARTBEAT_NS
from camber.runtime.inbox import Inbox
from camber.runtime.service import Service
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, CHANNELS, VEHICLE_SERVICES, inputs_of
from camber.schemas.codec import Received
from camber.validation.evaluation import CHANNELS as EVALUATED

RESTART_S = 2.0
_FEEDER = "vehicle"
_ORDER = {channel.name: place for place, channel in enumerate(CHANNELS)}
_SOURCES = {
    service: {
        channel.name if channel.producers == (_FEEDER,) else channel.producers[0]
        for channel in inputs_of(service)
        if not channel.looped
    }
    for service in VEHICLE_SERVICES
}
Settings = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class Reported:
    """An issue that a service has reported, at the time of its tick."""

    time_ns: int
    service: str
    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Driven:
    """What was said on the channels asked for, in the order of saying, as a recording gives it, and what was amiss."""

    recorded: dict[str, list[Recorded[Any]]]
    issues: list[Reported]


def drive_through(
    inputs: DriveInputs,
    folder: Path,
    *,
    settings: Settings | None = None,
    channels: Collection[str] = EVALUATED,
    progress: Callable[[], None] = lambda: None,
) -> Driven:
    """Run a drive; `settings` are added to those of a replay, by service; services keep their state in `folder`.

    What a service raises is raised here. `progress` is called once a tick.
    """
    vehicle = _Vehicle(inputs, folder, settings or {}, channels)
    for tick in inputs.ticks():
        vehicle.tick(tick.time_ns, messages_of(tick, vehicle.sweeps))
        progress()
    return vehicle.driven()


@dataclass(slots=True)
class _Here:
    """A service that runs, and what waits for it."""

    service: Service[Any]
    handlers: dict[str, Callable[[Any], None]]
    answers: dict[str, Callable[[Any], Any]]
    inboxes: dict[str, Inbox]
    waiting: list[tuple[int, int, int, str, Received[Any]]] = field(default_factory=list)


class _Vehicle:
    """The services of one vehicle, and what goes between them."""

    def __init__(
        self, inputs: DriveInputs, folder: Path, settings: Settings, channels: Collection[str]
    ) -> None:
        self.clock = ReplayClock()
        self.sweeps = SweepReader()
        self.issues: list[Reported] = []
        self._greeting = inputs.greeting
        configs = service_configs(inputs.manifest, inputs, folder, "tcp/127.0.0.1:0")
        shutil.rmtree(
            folder / "state", ignore_errors=True
        )  # what an earlier drive has learnt is not this one's
        self._configs = {name: {**configs[name], **settings.get(name, {})} for name in VEHICLE_SERVICES}
        self._configs["integrity"] |= {"upload": False}
        self._recorded: dict[str, list[Recorded[Any]]] = {name: [] for name in channels}
        self._sequence: Counter[tuple[str, str]] = Counter()
        self._fed: set[str] = set()
        self._beat_ns = 0
        self._last_ns = inputs.tick_times_ns[-1]
        self._here: dict[str, _Here] = {}
        self._away: dict[str, int] = {}
        first_ns = inputs.tick_times_ns[0]
        self._kills = [(first_ns + round(kill.at_s * 1e9), kill.service) for kill in inputs.manifest.kills]
        for name in VEHICLE_SERVICES:
            self._start(name)

    def tick(self, time_ns: int, messages: Any) -> None:
        """One tick: kill and start, feed, work."""
        self._kill_and_start(time_ns)
        for name, message in messages:
            self.say(_FEEDER, name, message)
        beat = time_ns == self._last_ns or time_ns - self._beat_ns >= HEARTBEAT_NS
        if beat:
            self._beat_ns = time_ns
        touched, self._fed = self._fed, set()
        for name in VEHICLE_SERVICES:
            if beat or _SOURCES[name] & touched:
                touched.add(name)
                if name in self._here:
                    self._work(name, time_ns)

    def say(self, source: str, name: str, message: Message) -> None:
        """Hand a message to those who consume it, and keep it if it was asked for."""
        channel = BY_NAME[name]
        sequence = self._sequence[source, name]
        self._sequence[source, name] += 1
        if source == _FEEDER:
            self._fed.add(name)
        if name in self._recorded:
            self._recorded[name].append(Recorded(name, name, message, source, sequence, message.time_ns))
        received = Received(message, source, sequence)
        for consumer in channel.consumers:
            here = self._here.get(consumer)
            if here is not None and name in here.handlers:
                here.waiting.append((message.time_ns, _ORDER[name], sequence, name, received))

    def ask(self, name: str, request: Message) -> Any:
        """The answer at the asker's time."""
        channel = BY_NAME[name]
        (answerer,) = channel.consumers
        here = self._here.get(answerer)
        if here is None:
            raise QueryFailed("absent", f"{answerer} is not there")
        now_ns = self.clock.now_ns()
        self.clock.set(request.time_ns)
        (reply,) = here.answers[name]([request])
        self.clock.set(now_ns)
        if reply is None:
            raise QueryFailed("refused")
        return reply

    def is_here(self, name: str) -> bool:
        """Does this service run?"""
        return name in self._here or name == "map_update"

    def driven(self) -> Driven:
        """What came of it."""
        return Driven(self._recorded, self.issues)

    def _start(self, name: str) -> None:
        module = importlib.import_module(f"camber.{name}.service")
        kind: type[Service[Any]] = module.SERVICE
        settings: Any = kind.SETTINGS
        service = kind(settings(**self._configs[name]), cast(Bus, _BusAtHand(self, name)))
        handlers = service.handlers()
        inboxes = {c.name: Inbox(c) for c in inputs_of(name) if c.name in handlers}
        self._here[name] = _Here(service, handlers, service.answers(), inboxes)

    def _kill_and_start(self, time_ns: int) -> None:
        for name in [name for name, back_ns in self._away.items() if time_ns >= back_ns]:
            del self._away[name]
            self._start(name)
            self._beat_ns = 0  # the next tick is everybody's
            if name == "gnss":
                for said in self._greeting:
                    self.say(_FEEDER, "receiver_bytes", said.model_copy(update={"time_ns": time_ns}))
        for at_ns, name in [kill for kill in self._kills if time_ns >= kill[0]]:
            self._kills.remove((at_ns, name))
            self._here.pop(name, None)
            self._away[name] = time_ns + round(RESTART_S * 1e9)
            self.issues.append(Reported(time_ns, name, "killed", f"for {RESTART_S:g} s"))

    def _work(self, name: str, time_ns: int) -> None:
        here = self._here[name]
        self.clock.set(time_ns)
        waiting, here.waiting = here.waiting, []
        waiting.sort(key=lambda item: item[:3])
        for _, _, _, channel, received in waiting:
            message = here.inboxes[channel].accept(received, time_ns, judge_age=False)
            if message is not None:
                here.handlers[channel](message)
        here.service.advance(time_ns)


class _BusAtHand:
    """What a service uses of `runtime.bus.Bus`, within one process."""

    def __init__(self, vehicle: _Vehicle, service: str) -> None:
        self.service = service
        self.counters: Counter[str] = Counter()
        self._vehicle = vehicle

    def now_ns(self) -> int:
        """The tick's time."""
        return self._vehicle.clock.now_ns()

    def publish(self, name: str, message: Message) -> None:
        """To whom it concerns."""
        self._vehicle.say(self.service, name, message)

    def ask(self, name: str, request: Message) -> Any:
        """Raises QueryFailed as the bus does."""
        return self._vehicle.ask(name, request)

    def ask_bytes(self, name: str, data: bytes) -> tuple[bytes, str]:
        """Nobody takes uploads."""
        raise QueryFailed("absent", name)

    def is_alive(self, service: str) -> bool:
        """Does it run?"""
        return self._vehicle.is_here(service)

    def issue(self, code: str, text: str) -> None:
        """Kept, with its time."""
        self._vehicle.issues.append(Reported(self.now_ns(), self.service, code, text))

    def count(self, name: str, n: int = 1) -> None:
        """Counted."""
        self.counters[name] += n

    def wake(self) -> None:
        """Nobody sleeps."""
