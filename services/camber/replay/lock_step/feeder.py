"""The feeder of a replay in lock step: publishes what a vehicle would, tick by tick, and waits for the services."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass

from camber.replay.lock_step.barrier import producers_for
from camber.replay.lock_step.service_loop import LockStepBus
from camber.replay.work_schedule import WorkSchedule
from camber.runtime.bus import Arrived
from camber.runtime.clock import ReplayClock
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, FEEDER, SERVICES
from camber.schemas.codec import DecodeError, decode
from camber.schemas.health import Done, Tick

AHEAD = 4
"""Ticks published beyond the slowest service. Chosen: enough that all services work at once; the order of work does
not depend on it, only the speed."""
# Beyond the lease, during which a frozen process looks like a busy one. Chosen: a long pause of a busy machine.
_STUCK_S = 20.0
RESEND_S = 3.0
"""A tick or a done that was lost on a bus just coming up is sent again. Chosen: no tick takes that long."""
_JOIN_TIMEOUT_S = 30.0  # chosen: the services start within 2 to 5 s, on a busy machine within 15
_RECALL_S = 0.05  # between two calls to assemble: every call is answered, and must not bring the next at once
_PRODUCERS = {service: frozenset(producers_for(service)) for service in SERVICES}

Observer = Callable[[str, bytes, int], None]
"""Key, bytes and wall-clock arrival (ns) of every message on the vehicle's keys."""


class ReplayStuckError(RuntimeError):
    """A service on the list neither finishes its tick nor leaves the bus."""


@dataclass(slots=True, kw_only=True)
class _Peer:
    """A service as the feeder knows it."""

    index: int = -2
    """−2: no done received, −1: it listens, else the last tick done."""
    last_work_index: int = -1
    """The last tick on which it was to work."""
    producers_seen: frozenset[str] = frozenset()


class Feeder:
    """Feeds a drive to the services of one vehicle; use as a context."""

    def __init__(self, settings: ServiceSettings, channels: Iterable[str], *, observer: Observer) -> None:
        """`channels` are those of the vehicle's that this drive has."""
        self._settings = settings
        self._observer = observer
        self._bus = LockStepBus(open_session(settings.zenoh), settings, "vehicle", ReplayClock())
        self._bus.published = dict.fromkeys((*channels, *(f"tick.{name}" for name in SERVICES)), 0)
        self._peers: dict[str, _Peer] = {}
        self._changed = threading.Condition()
        self._outstanding: deque[Tick] = deque()
        self._participants: frozenset[str] = frozenset()
        self._index = 0
        self._schedule = WorkSchedule()
        self._died: set[str] = set()  # since the last look: one that is back already has still left the tick
        prefix = f"camber/v1/{settings.vehicle}"
        for service in SERVICES:
            self._bus.listen(f"{prefix}/{service}/*", self._message_arrived)
        self._bus.listen(f"{prefix}/replay/done/*", self._done_arrived)
        self._bus.watch_liveliness(self._liveliness_changed)
        self._bus.declare_alive(FEEDER)  # services of a replay end with this token: they never outlive it

    def __enter__(self) -> Feeder:
        return self

    def __exit__(self, *exc: object) -> None:
        self._bus.close()

    @property
    def participants(self) -> frozenset[str]:
        """The services that take part now."""
        return self._participants

    def assemble(
        self, names: Iterable[str], *, time_ns: int, meanwhile: Callable[[], None] = lambda: None
    ) -> None:
        """Wait until all services have seen one another.

        Raises ReplayStuckError after 30 s, and whatever `meanwhile` raises, which is called again and again.
        """
        wanted = frozenset(names)
        deadline = time.monotonic() + _JOIN_TIMEOUT_S
        while missing := self._not_joined(wanted):
            meanwhile()
            if time.monotonic() > deadline:
                raise ReplayStuckError(f"not on the bus after {_JOIN_TIMEOUT_S:.0f} s: {', '.join(missing)}")
            for name in list(self._peers):
                self._send(name, Tick(time_ns=time_ns, index=0, participants={}, working=(), published={}))
            with self._changed:
                self._changed.wait_for(lambda: not self._not_joined(wanted), _RECALL_S)
        self._participants = wanted

    def publish(self, name: str, message: Message) -> None:
        """Publish one of the vehicle's messages, with the next tick."""
        data = self._bus.publish(name, message)
        self._schedule.add(name)
        self._observer(BY_NAME[name].key_for(self._settings.vehicle), data, time.time_ns())

    def tick(self, time_ns: int, *, last: bool = False) -> None:
        """Everything up to `time_ns` has been published; waits while `AHEAD` ticks are not done."""
        self._admit()
        working = self._schedule.next_tick(time_ns, last=last) & self._participants
        published = {name: n for name, n in self._bus.published.items() if not name.startswith("tick.")}
        with self._changed:
            there = sorted(name for name in self._participants if name in self._peers)
            present = {name: self._peers[name].last_work_index for name in there}
            for name in working & present.keys():
                self._peers[name].last_work_index = self._index
        tick = Tick(
            time_ns=time_ns,
            index=self._index,
            participants=present,
            working=tuple(sorted(working & present.keys())),
            published=published,
            last=last,
        )
        self._outstanding.append(tick)
        self._index += 1
        for name in self._bus.flush(tick, self._recipients(tick)):
            self._send(name, tick)
        self.wait(pending=0 if last else AHEAD)

    def wait(self, *, pending: int = 0) -> None:
        """Wait until at most `pending` ticks are not done; drop the services that die meanwhile."""
        timeout_s = self._settings.zenoh.lease_s + _STUCK_S
        deadline, resend_at = time.monotonic() + timeout_s, time.monotonic() + RESEND_S
        while True:
            self._dismiss()
            with self._changed:
                while self._outstanding and not self._late(self._outstanding[0]):
                    self._outstanding.popleft()
                if len(self._outstanding) <= pending:
                    return
                late = self._late(self._outstanding[0])
                if not self._died:
                    self._changed.wait(0.5)
            if time.monotonic() > resend_at:
                resend_at = time.monotonic() + RESEND_S
                for tick in self._outstanding:  # to all: a service that has done it sends its done again
                    for name in list(self._peers):
                        self._send(name, tick)
            if time.monotonic() > deadline:
                index = self._outstanding[0].index
                raise ReplayStuckError(f"tick {index} not done after {timeout_s:.0f} s by {', '.join(late)}")

    def _late(self, tick: Tick) -> list[str]:
        """Return who has not done this tick; called with the lock held."""
        present = [name for name in tick.working if name in self._participants and name in self._peers]
        return [name for name in present if self._peers[name].index < tick.index]

    def _not_joined(self, names: frozenset[str]) -> list[str]:
        """Return those that do not listen yet, or have not yet seen all of `names` that they need."""

        def joined(name: str) -> bool:
            peer = self._peers.get(name)
            return peer is not None and peer.index >= -1 and peer.producers_seen >= names & _PRODUCERS[name]

        return sorted(name for name in names if not joined(name))

    def _admit(self) -> None:
        """Put services on the list that listen, have seen those they need and were seen by those that need them."""
        with self._changed:
            for name, peer in self._peers.items():
                if name in self._participants or peer.index != -1:
                    continue
                seen = all(
                    other in self._peers and name in self._peers[other].producers_seen
                    for other in self._participants
                    if name in _PRODUCERS[other]
                )
                if seen and peer.producers_seen >= self._participants & _PRODUCERS[name]:
                    self._participants |= {name}
                    self._schedule.wake_all()
                    peer.last_work_index = -1

    def _dismiss(self) -> None:
        """Take the services off the list that have died, and send the ticks that wait for them again without them."""
        with self._changed:
            dead = self._participants & self._died
            self._died.clear()
            self._participants -= dead
        if not dead:
            return
        for position, tick in enumerate(self._outstanding):
            remaining = {name: index for name, index in tick.participants.items() if name not in dead}
            working = tuple(name for name in tick.working if name not in dead)
            tick = tick.model_copy(update={"participants": remaining, "working": working})
            self._outstanding[position] = tick
            for name in self._recipients(tick):
                self._send(name, tick)

    def _recipients(self, tick: Tick) -> set[str]:
        """Return who works on a tick, and who is not on its list: they answer that they listen."""
        return {name for name in list(self._peers) if name in tick.working or name not in tick.participants}

    def _send(self, name: str, tick: Tick) -> None:
        if name in SERVICES:
            self._bus.publish("tick", tick, to=name)

    def _done_arrived(self, key: str, item: Arrived) -> None:
        with suppress(DecodeError):  # from a process that is no part of this replay
            self._add_done(decode(Done, item.data, item.encoding).message)

    def _message_arrived(self, key: str, item: Arrived) -> None:
        """Pass a service's message to the observer; a done may be attached to it."""
        self._observer(key, item.data, time.time_ns())
        if item.attachment is not None:
            with suppress(DecodeError):
                self._add_done(decode(Done, item.attachment).message)

    def _add_done(self, done: Done) -> None:
        with self._changed:
            peer = self._peers.get(done.service)
            if peer is None or 0 <= done.index < peer.index:  # sent again
                return
            # A late "I listen" of one that is on the list by now adds nothing.
            if done.index >= 0 or done.service not in self._participants:
                peer.index = done.index
            peer.producers_seen = frozenset(done.heard)
            self._changed.notify()

    def _liveliness_changed(self, name: str, alive: bool) -> None:
        with self._changed:
            if alive:
                self._peers[name] = _Peer()
            else:
                self._peers.pop(name, None)
                self._died.add(name)
            self._changed.notify()
