"""The other end of the replay barrier: publishes what a vehicle would, tick by tick, and sees who has done what."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass

import zenoh

from camber.runtime.barrier import producers_for
from camber.runtime.bus import Bus, direct
from camber.runtime.clock import ReplayClock
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, FEEDER, SERVICES, inputs_of
from camber.schemas.codec import DecodeError, decode, encoding_of
from camber.schemas.health import Done, Tick

AHEAD = 4
"""Ticks published beyond the slowest service; the order of work does not depend on it, only the speed."""
_STUCK_S = 20.0  # beyond the lease: until that ends, one who is frozen cannot be told from one at work
_ASK_AGAIN_S = 3.0  # what was lost on a bus just coming up, a tick or a done, is sent again
HEARTBEAT_NS = 1_000_000_000
"""At least this often everybody works on a tick."""
_SOURCES = {
    service: {
        channel.name if channel.producers == ("vehicle",) else channel.producers[0]
        for channel in inputs_of(service)
        if not channel.looped
    }
    for service in SERVICES
}
"""What brings a service something: channels of the vehicle, and services that work before it."""
_PRODUCERS = {service: frozenset(producers_for(service)) for service in SERVICES}

Observer = Callable[[str, bytes, str, int], None]
"""Key, bytes, encoding and wall-clock arrival (ns) of every message on the vehicle's keys."""


class ReplayStuck(RuntimeError):  # noqa: N818 (the name says what is the matter)
    """A service on the list neither finishes its tick nor leaves the bus."""


@dataclass(slots=True)
class _Peer:
    index: int = -2  # −2: not heard of, −1: listens, else the last tick done
    worked: int = -1  # the last tick on which it was to work
    heard: frozenset[str] = frozenset()


class Feeder:
    """Feeds a drive to the services of one vehicle; use as a context."""

    def __init__(
        self, settings: ServiceSettings, channels: Iterable[str], *, observer: Observer | None = None
    ) -> None:
        """`channels` are those of the vehicle's that this drive has."""
        self._settings = settings
        self._observer = observer
        self._session = open_session(settings.zenoh)
        self._bus = Bus(self._session, settings, "vehicle", ReplayClock())
        self._bus.published = dict.fromkeys((*channels, *(f"tick.{name}" for name in SERVICES)), 0)
        self._peers: dict[str, _Peer] = {}
        self._changed = threading.Condition()
        self._outstanding: deque[Tick] = deque()
        self._participants: frozenset[str] = frozenset()
        self._index = 0
        self._fed: set[str] = set()
        self._died: set[str] = set()  # since the last look: who is back already has still left the tick
        self._beat_ns = 0
        prefix = f"camber/v1/{settings.vehicle}"
        self._entities: list[object] = [
            *(
                self._session.declare_subscriber(f"{prefix}/{service}/*", direct(self._hear_message))
                for service in SERVICES
            ),
            self._session.declare_subscriber(f"{prefix}/replay/done/*", direct(self._hear_done)),
            self._session.liveliness().declare_subscriber(f"{prefix}/*/alive", self._alive, history=True),
        ]
        # Services of a replay end when this token goes: they never outlive their feeder.
        self._entities.append(self._session.liveliness().declare_token(f"{prefix}/{FEEDER}/alive"))

    def __enter__(self) -> Feeder:
        return self

    def __exit__(self, *exc: object) -> None:
        self._bus.close()

    @property
    def participants(self) -> frozenset[str]:
        """Who takes part now."""
        return self._participants

    def assemble(
        self,
        names: Iterable[str],
        *,
        time_ns: int,
        meanwhile: Callable[[], None] = lambda: None,
        timeout_s: float = 30.0,
    ) -> None:
        """Wait until all services have heard one another.

        Raises ReplayStuck after the timeout, and whatever `meanwhile` raises, called again and again.
        """
        wanted = frozenset(names)
        deadline = time.monotonic() + timeout_s
        while not all(self._joined(name, wanted) for name in wanted):
            meanwhile()
            if time.monotonic() > deadline:
                missing = sorted(name for name in wanted if not self._joined(name, wanted))
                raise ReplayStuck(f"not on the bus after {timeout_s:.0f} s: {', '.join(missing)}")
            for name in list(self._peers):
                self._send(name, Tick(time_ns=time_ns, index=0, participants={}, working=(), published={}))
            with self._changed:  # not after each answer: every call is answered, and would bring the next
                self._changed.wait_for(lambda: all(self._joined(name, wanted) for name in wanted), 0.05)
        self._participants = wanted

    def publish(self, name: str, message: Message) -> None:
        """Publish one of the vehicle's messages, with the next tick."""
        data = self._bus.publish(name, message)
        self._fed.add(name)
        if self._observer is not None:
            key, encoding = BY_NAME[name].key_for(self._settings.vehicle), encoding_of(type(message))
            self._observer(key, data, encoding, time.time_ns())

    def tick(self, time_ns: int, *, last: bool = False) -> None:
        """Everything up to `time_ns` has been published; waits while AHEAD ticks are not done."""
        self._admit()
        beat = last or time_ns - self._beat_ns >= HEARTBEAT_NS
        if beat:
            self._beat_ns = time_ns
        working = self._participants if beat else self._touched()
        self._fed.clear()
        published = {name: n for name, n in self._bus.published.items() if not name.startswith("tick.")}
        with self._changed:
            present = {
                name: self._peers[name].worked for name in sorted(self._participants) if name in self._peers
            }
            for name in working & present.keys():
                self._peers[name].worked = self._index
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
        for name in self._bus.flush(tick, self._workers(tick)):
            self._send(name, tick)
        self.wait(behind=0 if last else AHEAD)

    def wait(self, *, behind: int = 0) -> None:
        """Wait until at most `behind` ticks are not done; drop those who die meanwhile."""
        patience_s = self._settings.zenoh.lease_s + _STUCK_S
        deadline, ask_again = time.monotonic() + patience_s, time.monotonic() + _ASK_AGAIN_S
        while True:
            self._dismiss()
            with self._changed:
                while self._outstanding and not self._late(self._outstanding[0]):
                    self._outstanding.popleft()
                if len(self._outstanding) <= behind:
                    return
                late = self._late(self._outstanding[0])
                if not self._died:
                    self._changed.wait(0.5)
            if time.monotonic() > ask_again:
                ask_again = time.monotonic() + _ASK_AGAIN_S
                for tick in self._outstanding:  # to everybody: who has done it says so again
                    for name in list(self._peers):
                        self._send(name, tick)
            if time.monotonic() > deadline:
                index = self._outstanding[0].index
                raise ReplayStuck(f"tick {index} not done after {patience_s:.0f} s by {', '.join(late)}")

    def _touched(self) -> frozenset[str]:
        """Who gets something in this tick: from the vehicle, or from a service before it that works on it."""
        touched: set[str] = set()
        for service in SERVICES:  # in the order of work
            if _SOURCES[service] & (self._fed | touched):
                touched.add(service)
        return self._participants & touched

    def _late(self, tick: Tick) -> list[str]:
        """Who has not done this tick; called with the lock held."""
        there = [name for name in tick.working if name in self._participants and name in self._peers]
        return [name for name in there if self._peers[name].index < tick.index]

    def _joined(self, name: str, others: frozenset[str]) -> bool:
        peer = self._peers.get(name)
        return peer is not None and peer.index >= -1 and peer.heard >= others & _PRODUCERS[name]

    def _admit(self) -> None:
        """Put on the list who listens, has heard whom it needs and was heard by whom needs it."""
        with self._changed:
            for name, peer in self._peers.items():
                if name in self._participants or peer.index != -1:
                    continue
                consumers = {other for other in self._participants if name in _PRODUCERS[other]}
                known = {
                    other for other in consumers if other in self._peers and name in self._peers[other].heard
                }
                if known == consumers and peer.heard >= self._participants & _PRODUCERS[name]:
                    self._participants |= {name}
                    self._beat_ns = 0  # the next tick is everybody's: it starts with what it needs
                    peer.worked = -1

    def _dismiss(self) -> None:
        """Take those off the list who have died, and say so for the ticks that wait for them."""
        with self._changed:
            dead = self._participants & self._died
            self._died.clear()
            self._participants -= dead
        if not dead:
            return
        for position, tick in enumerate(self._outstanding):
            remaining = {name: worked for name, worked in tick.participants.items() if name not in dead}
            working = tuple(name for name in tick.working if name not in dead)
            self._outstanding[position] = tick.model_copy(
                update={"participants": remaining, "working": working}
            )
            self._hand_out(self._outstanding[position])

    def _hand_out(self, tick: Tick) -> None:
        """Anew, on its own."""
        for name in self._workers(tick):
            self._send(name, tick)

    def _workers(self, tick: Tick) -> set[str]:
        """Who works on it, and who is there but not on the list: they answer that they listen."""
        return {name for name in list(self._peers) if name in tick.working or name not in tick.participants}

    def _send(self, name: str, tick: Tick) -> None:
        if name in SERVICES:
            self._bus.publish("tick", tick, to=name)

    def _hear_done(self, sample: zenoh.Sample) -> None:
        with suppress(DecodeError):  # of somebody who does not belong here
            self._add_done(decode(Done, sample.payload.to_bytes(), str(sample.encoding)).message)

    def _hear_message(self, sample: zenoh.Sample) -> None:
        """Something a service has published: for the observer; its *done* may travel with it."""
        arrival_ns, rider = time.time_ns(), sample.attachment
        if self._observer is not None:
            self._observer(str(sample.key_expr), sample.payload.to_bytes(), str(sample.encoding), arrival_ns)
        if rider is not None:
            with suppress(DecodeError):
                self._add_done(decode(Done, rider.to_bytes()).message)

    def _add_done(self, done: Done) -> None:
        with self._changed:
            peer = self._peers.get(done.service)
            if peer is None or 0 <= done.index < peer.index:  # said again
                return
            # A late *I listen* of one who is on the list by now says nothing new.
            if done.index >= 0 or done.service not in self._participants:
                peer.index = done.index
            peer.heard = frozenset(done.heard)
            self._changed.notify()

    def _alive(self, sample: zenoh.Sample) -> None:
        name = str(sample.key_expr).split("/")[-2]
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._peers[name] = _Peer()
            else:
                self._peers.pop(name, None)
                self._died.add(name)
            self._changed.notify()
