"""The replay barrier of one service: when may a tick be worked on, and with which messages?

The feeder publishes a tick after everything up to its time. A service works on tick i when it has all messages
that the feeder and the services before it have published for it up to i (for looped channels: up to the tick
before i); then it says *done to i*. Counts, not arrival order, decide: so the same drive gives the same bytes at any
speed. A service works only on the ticks that bring it something (the feeder says which), or on which a second has
passed. One that has died leaves the tick's list of participants and nobody waits for it; one that returns listens
until it has seen every participant before it and every participant after it has seen it, and only then is put on
the list. A tick that was lost is seen from the next one, which says when this service worked last.

Pure: messages go in, decisions come out.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from camber.schemas.channels import CHANNELS, FEEDER, SERVICES, Channel, inputs_of, outputs_of
from camber.schemas.codec import Received
from camber.schemas.health import Done, Tick

_ORDER = {channel.name: position for position, channel in enumerate(CHANNELS)}
_KEEP = 64  # ticks of which the counts are kept; far more than any feeder runs ahead


def producers_for(service: str) -> tuple[str, ...]:
    """The services whose *done* this one waits for, by the table."""
    return tuple(sorted({channel.producers[0] for channel in inputs_of(service)} - {"vehicle", service}))


def _made(channel: Channel, tick: Tick) -> bool:
    """May there be something on this channel in this drive at all?"""
    return not channel.made_from or channel.made_from in tick.published


@dataclass(slots=True, kw_only=True)
class Barrier:
    """State of one service's barrier."""

    service: str
    inputs: tuple[Channel, ...]
    ticks: deque[Tick] = field(default_factory=deque)
    index: int = -1
    producers_seen: set[str] = field(default_factory=set)
    _waiting: dict[str, deque[Received[Any]]] = field(default_factory=dict)
    _next: dict[str, int] = field(default_factory=dict)
    _done: dict[str, dict[int, dict[str, int]]] = field(default_factory=dict)
    _joining: bool = True

    def __post_init__(self) -> None:
        self._waiting = {channel.name: deque() for channel in self.inputs}
        self._next = {channel.name: 0 for channel in self.inputs}

    def add_message(self, name: str, received: Received[Any]) -> None:
        """A message has arrived on an input channel."""
        self._waiting[name].append(received)
        self._next[name] = received.sequence + 1

    def add_tick(self, tick: Tick) -> bool:
        """The feeder has published a tick, or again: one has died, or it is not done and something may be lost.

        Returns whether it brings this service, which takes part, nothing new: then somebody may be waiting for what
        a done of this service.
        """
        there = self.service in tick.participants
        if tick.index <= self.index or (there and self.service not in tick.working):
            return there
        for position, waiting in enumerate(self.ticks):
            if waiting.index == tick.index:
                self.ticks[position] = tick
                return there
        # One before those that wait was lost; but for a service that came later it is over.
        earlier = sum(waiting.index < tick.index for waiting in self.ticks)
        if there or earlier == len(self.ticks):
            self.ticks.insert(earlier, tick)
        return False

    def add_done(self, done: Done) -> None:
        """Another service has finished a tick, or (index −1) has joined and begins to count at zero."""
        self.producers_seen.add(done.service)
        counts = self._done.setdefault(done.service, {})
        if done.index < 0:
            if counts.keys() != {-1}:
                counts.clear()
                for channel in self.inputs:
                    if channel.producers == (done.service,):
                        self._next[channel.name] = 0
                        self._waiting[channel.name].clear()
            counts[-1] = done.published
            return
        counts[done.index] = done.published
        if len(counts) > _KEEP:
            del counts[min(counts)]

    def participates(self) -> bool:
        """Is this service on the list of the oldest tick?"""
        return self.service in self.ticks[0].participants

    def skip(self) -> None:
        """Drop the oldest tick, of which this service is no participant, and take its counts as the base."""
        tick = self.ticks.popleft()
        for channel in self.inputs:
            counts = self._counts(channel, tick)
            if counts is not None:
                self._count_from(channel, counts)
        self._joining = True

    def ready(self) -> bool:
        """May the oldest tick be worked on?"""
        return bool(self.ticks) and not self.missing()

    def missing(self) -> list[str]:
        """What the oldest tick still waits for: names of channels or services."""
        tick = self.ticks[0]
        if tick.participants.get(self.service, -1) > self.index:
            return ["tick"]  # the one on which this service was to work before was lost; it comes again
        if self._joining:
            self._take_base(tick)
        waits = []
        for channel in self.inputs:
            if not self._expects(channel, tick):
                continue
            counts = self._counts(channel, tick)
            if counts is None:
                waits.append(channel.producers[0])
            elif self._next[channel.name] < counts:
                waits.append(channel.name)
        return waits

    def waiting_for_done(self, tick: Tick) -> set[str]:
        """Who needs this service's *done* of a tick: the feeder, and who consumes what it publishes.

        While somebody is missing on the list, all of them: a service that returns must see everybody first.
        """
        everybody = len(tick.participants) < len(SERVICES)
        consumers = {
            consumer
            for channel in outputs_of(self.service)
            if everybody or _made(channel, tick)
            for consumer in channel.consumers
        }
        return {FEEDER} | consumers & set(SERVICES)

    def take(self) -> tuple[Tick, list[tuple[str, Received[Any]]]]:
        """The oldest tick with its messages in total order: by time, then the table's order, then the sequence."""
        tick = self.ticks.popleft()
        self.index = tick.index
        self._joining = False
        taken: list[tuple[str, Received[Any]]] = []
        for channel in self.inputs:
            waiting = self._waiting[channel.name]
            limit = self._counts(channel, tick)
            while waiting and (limit is None or waiting[0].sequence < limit):  # None: died, this is all of it
                taken.append((channel.name, waiting.popleft()))
        taken.sort(key=lambda item: (item[1].message.time_ns, _ORDER[item[0]], item[1].sequence))
        return tick, taken

    def forget_absent(self, tick: Tick) -> None:
        """Forget the services that are not on the tick's list: they must be seen again when they return."""
        self.producers_seen &= set(tick.participants)

    def _take_base(self, tick: Tick) -> None:
        """What was published before this service listened will not come: count from the last done."""
        for channel in self.inputs:
            counts = self._done.get(channel.producers[0], {})
            base = [
                published.get(channel.name, 0) for index, published in counts.items() if index < tick.index
            ]
            self._count_from(channel, max(base, default=0))

    def _count_from(self, channel: Channel, base: int) -> None:
        """What was published before number `base` is of no use; what is here already of later ticks is kept."""
        self._next[channel.name] = max(self._next[channel.name], base)
        waiting = self._waiting[channel.name]
        while waiting and waiting[0].sequence < base:
            waiting.popleft()

    def _expects(self, channel: Channel, tick: Tick) -> bool:
        producer = channel.producers[0]
        if producer == "vehicle":
            return True
        if not _made(channel, tick):
            return False
        if channel.looped:
            return tick.participants.get(producer, -1) >= 0
        return producer in tick.working

    def _counts(self, channel: Channel, tick: Tick) -> int | None:
        producer = channel.producers[0]
        if producer == "vehicle":
            return tick.published.get(channel.name, 0)
        if producer not in tick.participants:
            return None
        if not self._expects(channel, tick):
            return 0  # it has published nothing for this tick; what waits is for a later one
        wanted = tick.participants[producer] if channel.looped else tick.index
        counts = self._done.get(producer, {}).get(wanted)
        return None if counts is None else counts.get(channel.name, 0)
