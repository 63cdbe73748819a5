"""The other end of the replay barrier: publishes what a vehicle would, tick by tick, and sees who has done what."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import zenoh

from camber.runtime.barrier import producers_for
from camber.runtime.bus import FEEDER, Bus
from camber.runtime.clock import ReplayClock
from camber.runtime.session import open_session
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message
from camber.schemas.channels import SERVICES
from camber.schemas.codec import decode
from camber.schemas.health import Done, Tick

AHEAD = 4
"""Ticks published beyond the slowest service; the order of work does not depend on it, only the speed."""
_STUCK_S = 20.0
_PRODUCERS = {service: frozenset(producers_for(service)) for service in SERVICES}

Observer = Callable[[str, bytes, str, int], None]
"""Key, bytes, encoding and wall-clock arrival (ns) of every message on the vehicle's keys."""


class ReplayStuck(RuntimeError):
    """A service on the list neither finishes its tick nor leaves the bus."""


@dataclass(slots=True)
class _Peer:
    index: int = -2  # −2: not heard of, −1: listens, else the last tick done
    heard: frozenset[str] = frozenset()
    published: dict[str, int] = field(default_factory=dict)


class Feeder:
    """Feeds a drive to the services of one vehicle; use as a context."""

    def __init__(self, settings: ServiceSettings, *, observer: Observer | None = None) -> None:
        self._settings = settings
        self._session = open_session(settings.zenoh)
        self._bus = Bus(self._session, settings, "vehicle", ReplayClock())
        self._bus.published |= {"tick": 0}
        self._peers: dict[str, _Peer] = {}
        self._changed = threading.Condition()
        self._outstanding: deque[Tick] = deque()
        self._participants: dict[str, int] = {}
        self._index = 0
        prefix = f"camber/v1/{settings.vehicle}"
        self._entities: list[object] = [
            self._session.declare_subscriber(f"{prefix}/replay/done/*", self._done),
            self._session.liveliness().declare_subscriber(f"{prefix}/*/alive", self._alive, history=True),
        ]
        # Services of a replay end when this token goes: they never outlive their feeder.
        self._entities.append(self._session.liveliness().declare_token(f"{prefix}/{FEEDER}/alive"))
        if observer is not None:

            def observe(sample: zenoh.Sample) -> None:
                observer(str(sample.key_expr), sample.payload.to_bytes(), str(sample.encoding), time.time_ns())

            for kind in ("vehicle", *SERVICES):  # all but the barrier's own keys
                self._entities.append(self._session.declare_subscriber(f"{prefix}/{kind}/*", observe))

    def __enter__(self) -> Feeder:
        return self

    def __exit__(self, *exc: object) -> None:
        self._bus.close()

    @property
    def participants(self) -> frozenset[str]:
        """Who takes part now."""
        return frozenset(self._participants)

    def assemble(self, names: Iterable[str], *, time_ns: int, timeout_s: float = 30.0) -> None:
        """Wait until all services have heard one another; raises ReplayStuck after the timeout."""
        wanted = frozenset(names)
        deadline = time.monotonic() + timeout_s
        while not all(self._joined(name, wanted) for name in wanted):
            if time.monotonic() > deadline:
                missing = sorted(name for name in wanted if not self._joined(name, wanted))
                raise ReplayStuck(f"not on the bus after {timeout_s:.0f} s: {', '.join(missing)}")
            self._publish_tick(Tick(time_ns=time_ns, index=0, participants={}, published={}))
            with self._changed:
                self._changed.wait(0.05)
        self._participants = dict.fromkeys(sorted(wanted), 0)

    def publish(self, name: str, message: Message) -> None:
        """Publish one of the vehicle's messages."""
        self._bus.publish(name, message)

    def tick(self, time_ns: int, *, last: bool = False) -> None:
        """Everything up to `time_ns` has been published; waits while the slowest service is AHEAD ticks behind."""
        self._admit()
        published = {name: n for name, n in self._bus.published.items() if name != "tick"}
        participants = dict(sorted(self._participants.items()))
        tick = Tick(time_ns=time_ns, index=self._index, participants=participants, published=published, last=last)
        self._outstanding.append(tick)
        self._publish_tick(tick)
        self._index += 1
        self.wait(behind=0 if last else AHEAD)

    def wait(self, *, behind: int = 0) -> None:
        """Wait until every participant is at most `behind` ticks behind; drop those who die meanwhile."""
        deadline = time.monotonic() + _STUCK_S
        while True:
            slowest = self._dismiss()
            while self._outstanding and self._outstanding[0].index <= slowest:
                self._outstanding.popleft()
            if self._index - 1 - slowest <= behind:
                return
            if time.monotonic() > deadline:
                late = sorted(n for n, peer in self._peers.items() if n in self._participants and peer.index <= slowest)
                raise ReplayStuck(f"tick {slowest + 1} not done after {_STUCK_S:.0f} s by {', '.join(late)}")
            with self._changed:
                if self._slowest() == slowest:
                    self._changed.wait(0.5)

    def _joined(self, name: str, others: frozenset[str]) -> bool:
        peer = self._peers.get(name)
        return peer is not None and peer.index >= -1 and peer.heard >= others & _PRODUCERS[name]

    def _admit(self) -> None:
        """Put on the list who listens, has heard everybody and was heard by everybody."""
        for name, peer in list(self._peers.items()):
            if name in self._participants or peer.index != -1:
                continue
            consumers = {other for other in self._participants if name in _PRODUCERS[other]}
            heard_by_all = all(name in self._peers[other].heard for other in consumers)
            if heard_by_all and peer.heard >= self._participants.keys() & _PRODUCERS[name]:
                self._participants[name] = self._index
                peer.index = self._index - 1

    def _slowest(self) -> int | None:
        """The last tick that all participants have done; None: one of them has died. Called with the lock held."""
        if not self._participants.keys() <= self._peers.keys():
            return None
        return min((self._peers[name].index for name in self._participants), default=self._index - 1)

    def _dismiss(self) -> int:
        """Take those off the list who have died, and say so for the ticks that wait for them; return the slowest."""
        with self._changed:
            dead = self._participants.keys() - self._peers.keys()
            for name in dead:
                del self._participants[name]
            slowest = self._slowest()
        assert slowest is not None
        if not dead:
            return slowest
        for position, tick in enumerate(self._outstanding):
            remaining = {name: since for name, since in tick.participants.items() if name not in dead}
            self._outstanding[position] = tick.model_copy(update={"participants": remaining})
            self._publish_tick(self._outstanding[position])
        return slowest

    def _publish_tick(self, tick: Tick) -> None:
        self._bus.publish("tick", tick)

    def _done(self, sample: zenoh.Sample) -> None:
        done = decode(Done, sample.payload.to_bytes(), str(sample.encoding)).message
        with self._changed:
            peer = self._peers.get(done.service)
            if peer is None:
                return
            if not (done.index == -1 and done.service in self._participants):
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
            self._changed.notify()


