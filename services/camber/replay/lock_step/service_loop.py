"""A service's side of lock step: its bus and its work loop, in place of those of `camber.runtime`.

`camber.runtime.run` loads this module where a service's settings say `clock = "replay"`.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Set
from typing import Any, NamedTuple

from camber.replay.lock_step.barrier import Barrier, producers_for
from camber.runtime.bus import Arrived, Bus
from camber.runtime.clock import ReplayClock
from camber.runtime.run import Loop
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, FEEDER, Channel, inputs_of
from camber.schemas.codec import DecodeError, decode, encode
from camber.schemas.health import Done, Tick

_REPORT_WAITING_S = 5.0  # chosen: far longer than any tick takes, short against the feeder's 40 s
_FEEDER_TIMEOUT_S = 60.0  # chosen: twice what the feeder itself waits for its services
# Dones that are sent again: those of all ticks that may be under way (4), and the one before, which loops wait for.
_KEPT_DONES = 8


class _Held(NamedTuple):
    """A message that is sent at the end of its tick."""

    channel: Channel
    publisher: Any
    data: bytes


class LockStepBus(Bus):
    """Sends what is published within a tick together at its end; may lose nothing, so it waits instead of dropping."""

    LOSSLESS = True

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.participants: frozenset[str] = frozenset()
        self.feeder_gone = False
        self._held: list[_Held] = []

    def send(self, channel: Channel, publisher: Any, data: bytes) -> None:
        """Keep the message until the end of the tick; ticks and dones go at once."""
        if channel.delivery == "barrier":
            publisher.put(data)
        else:
            self._held.append(_Held(channel, publisher, data))

    def flush(self, attached: Message, wanted_by: Set[str]) -> set[str]:
        """Send what was published within this tick, with `attached` (its tick or done) as attachment.

        It is attached to the last message of as many channels as it takes to reach those it is wanted by, and to the
        very last message for the feeder: when it has that, it has them all. Returns those that it does not reach.
        """
        held, self._held = self._held, []
        unreached, attachment = set(wanted_by), encode(attached, source=self.service)
        last = {item.channel.name: position for position, item in enumerate(held)}
        of_vehicle = [position for position, item in enumerate(held) if "{vehicle}" in item.channel.key]
        for position, (channel, publisher, data) in enumerate(held):
            reached = set(channel.consumers) & unreached if last[channel.name] == position else set()
            if of_vehicle[-1:] == [position]:
                reached |= {FEEDER} & unreached
            if reached:
                publisher.put(data, attachment=attachment)
                unreached -= reached
            else:
                publisher.put(data)
        return unreached

    def is_alive(self, service: str) -> bool:
        """Does this service take part in the tick?"""
        return service in self.participants

    def liveliness_changed(self, name: str, alive: bool) -> None:
        """A process has joined the bus or left it; without the feeder the replay is over."""
        if name == FEEDER and not alive:
            self.feeder_gone = True
        super().liveliness_changed(name, alive)


class LockStepLoop(Loop):
    """The work loop of a service that works by the feeder's ticks."""

    bus: LockStepBus
    _clock: ReplayClock

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._barrier = Barrier(service=self.service.NAME, inputs=self.inputs())
        self._kept_dones: deque[Done] = deque(maxlen=_KEPT_DONES)
        self.bus.published.setdefault("done", 0)

    def inputs(self) -> tuple[Channel, ...]:
        """Return all channels that the table gives this service: ticks and dones are attached to their messages."""
        return inputs_of(self.service.NAME)

    def subscribe(self) -> None:
        """Subscribe to all inputs, and then to the barrier's keys: a producer seen there reaches the inputs too."""
        super().subscribe()
        self.bus.subscribe(BY_NAME["tick"])
        for producer in producers_for(self.service.NAME):
            self.bus.subscribe(BY_NAME["done"], of=producer)

    def work(self) -> None:
        """Work by the feeder's ticks until stopped, or until the feeder is gone."""
        barrier, waiting_since = self._barrier, time.monotonic()
        while not self.stopping and not self.bus.feeder_gone:
            event = self.bus.next_event(_REPORT_WAITING_S)
            if event is None:
                if barrier.index < 0 and self._report.uptime_s > _FEEDER_TIMEOUT_S:
                    self.bus.log.error(
                        "no_feeder", detail=f"no tick of a feeder for {_FEEDER_TIMEOUT_S:.0f} s"
                    )
                    return
                if barrier.ticks:
                    waited_s = time.monotonic() - waiting_since
                    self.bus.issue("barrier_waits", f"{waited_s:.0f} s for {', '.join(barrier.missing())}")
                continue
            self._handle(event)
            if self._work_on_ready_ticks():
                waiting_since = time.monotonic()
            self._round_ended()

    def _work_on_ready_ticks(self) -> bool:
        barrier, worked = self._barrier, False
        while barrier.ticks and not self.stopping:
            if not barrier.participates():
                tick = barrier.ticks[0]
                barrier.skip()
                self._send_done(tick, -1)
            elif barrier.ready():
                self._work_on_tick()
                worked = True
            else:
                break
        return worked

    def _handle(self, event: tuple[str, str]) -> None:
        kind, name = event
        if kind == "query":
            self.answer(name)
        item = self.bus.pop(name) if kind == "message" else None
        if item is None:
            return
        try:
            self._add_to_barrier(name, item)
        except DecodeError as error:  # on the barrier's keys: from a process that is no part of this replay
            self.bus.issue("refused_input", f"{name}: {error}")

    def _add_to_barrier(self, name: str, item: Arrived) -> None:
        data, encoding, attachment, _ = item
        if name == "tick":
            if self._barrier.add_tick(decode(Tick, data, encoding).message):
                for done in self._kept_dones:
                    self.bus.publish("done", done)
            return
        if name.startswith("done."):
            self._barrier.add_done(decode(Done, data, encoding).message)
            return
        received = self._inboxes[name].open(data, encoding)
        if received is None:
            self.refused(self._inboxes[name])
        else:
            self._barrier.add_message(name, received)
        if attachment is None:
            return
        if BY_NAME[name].producers == ("vehicle",):
            self._barrier.add_tick(decode(Tick, attachment).message)
        else:
            self._barrier.add_done(decode(Done, attachment).message)

    def _work_on_tick(self) -> None:
        tick, messages = self._barrier.take()
        self._clock.set(tick.time_ns)
        self.bus.participants = frozenset(tick.participants)
        for name, received in messages:
            inbox = self._inboxes[name]
            # The barrier makes them fresh; only repeated and out-of-order messages are refused here.
            message = inbox.accept(received, tick.time_ns, judge_age=False)
            if message is None:
                self.refused(inbox)
            elif name in self._handlers:
                self._guard(self._handlers[name], message)
        self._guard(self.service.advance, tick.time_ns)
        self._send_done(tick, tick.index)
        self._barrier.forget_absent(tick)

    def _send_done(self, tick: Tick, index: int) -> None:
        """Attach the done to what was published in this tick; send it on its own to those that does not reach."""
        done = Done(
            time_ns=tick.time_ns,
            service=self.service.NAME,
            index=index,
            published={name: n for name, n in self.bus.published.items() if name != "done"},
            heard=tuple(sorted(self._barrier.producers_seen)),
        )
        if index < 0:
            self._kept_dones.clear()
        else:
            self._kept_dones.append(done)
        if self.bus.flush(done, self._barrier.waiting_for_done(tick)) or index < 0:
            self.bus.publish("done", done)

    def _replies(self, name: str, requests: list[Any]) -> Any:
        """Answer at the time of the request: this service may not have reached that tick, or be beyond it."""
        tick_ns = self._clock.now_ns()
        self._clock.set(max(request.time_ns for request in requests))
        replies = super()._replies(name, requests)
        self._clock.set(tick_ns)
        return replies
