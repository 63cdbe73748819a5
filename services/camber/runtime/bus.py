"""A service's side of the bus: publish, ask, answer, who is alive, what to report.

Zenoh's callbacks only put bytes into bounded queues; everything else happens in the work loop (`run.py`), in one
thread. A callback that works would block the receive thread and lose other topics of the session.
"""

from __future__ import annotations

import queue
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import zenoh

from camber.runtime.clock import Clock, ReplayClock
from camber.runtime.log import make_logger
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, FEEDER, Channel, outputs_of
from camber.schemas.codec import DecodeError, decode, encode, encoding_of
from camber.schemas.health import Issue

Event = tuple[Literal["message", "query", "wake"], str]
_QUEUE_LIMIT = {"small": 1024, "bulk": 1, "barrier": 4096}
_QUERY_LIMIT = 256
_REPLAY_QUERY_TIMEOUT_S = 10.0
_LOG_EVERY_S = 10.0
# What health can carry; a service that met more must still be able to say how it is.
MAX_ISSUES, MAX_COUNTERS, MAX_TEXT = 64, 192, 512
_OTHERS = "others"
_NO_NAME = re.compile(r"[^A-Za-z0-9_.:@+-]")

# Why each departs from Zenoh's default (drop when congested, priority `data`, batching):
# small: goes at once (express), ahead of bulk; dropped when congested because a consumer judges freshness anyway.
# bulk: behind everything else, the consumer keeps only the newest.
# upload, fetch: behind what a vehicle drives by; both are tried again.
# barrier and all of a replay: blocking, because a replay may lose nothing.
_PRIORITY = {
    "small": zenoh.Priority.INTERACTIVE_HIGH,
    "bulk": zenoh.Priority.BACKGROUND,
    "query": zenoh.Priority.INTERACTIVE_HIGH,
    "upload": zenoh.Priority.DATA_LOW,
    "fetch": zenoh.Priority.DATA_LOW,
    "barrier": zenoh.Priority.INTERACTIVE_HIGH,
}


def direct(callback: Any) -> Any:
    """A callback in the thread that received: it only queues, so the hand-over to a thread of its own is saved."""
    return zenoh.handlers.Callback(callback, indirect=False)


def _bounded(name: str, known: Mapping[str, object], limit: int) -> str:
    """`name` as health can carry it; the one of all others where there are too many, so that none goes uncounted."""
    name = _NO_NAME.sub("_", name)[:64]
    name = name if name[:1].isalnum() else f"x{name}"[:64]
    return name if name in known or len(known) < limit - 1 else _OTHERS


class QueryFailed(RuntimeError):  # noqa: N818 (the name says what is the matter)
    """A question that got no usable answer; `reason` says why."""

    def __init__(self, reason: Literal["absent", "timeout", "refused", "invalid"], detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


class Arrived(NamedTuple):
    """A message as it came: its bytes, its encoding, and in a replay what the barrier has to say with it."""

    data: bytes
    encoding: str
    rider: bytes | None


class _Held(NamedTuple):
    """A message that waits for the end of the tick."""

    channel: Channel
    publisher: zenoh.Publisher
    data: bytes


@dataclass(slots=True)
class _Port:
    """One subscribed channel: its bounded queue and how many were pushed out of it."""

    channel: Channel
    items: deque[Arrived]
    overflow: int = 0


class Bus:
    """Everything a service needs of the outside; made and closed by `run`, used from the work loop only."""

    def __init__(self, session: zenoh.Session, settings: ServiceSettings, service: str, clock: Clock) -> None:
        self.service = service
        self.settings = settings
        self.log = make_logger(service, level=settings.log_level, form=settings.log_format)
        self.counters: Counter[str] = Counter()
        self.published: dict[str, int] = {channel.name: 0 for channel in outputs_of(service)}
        self.participants: frozenset[str] = frozenset()
        self.feeder_gone = False
        self._session = session
        self._clock = clock
        self._replay = isinstance(clock, ReplayClock)
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._queriers: dict[str, zenoh.Querier] = {}
        self._entities: list[Any] = []
        self._ports: dict[str, _Port] = {}
        self._queries: dict[str, deque[zenoh.Query]] = {}
        self._held: list[_Held] = []
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._issues: dict[str, tuple[str, int]] = {}
        self._logged: dict[str, float] = {}
        self._alive: set[str] = set()
        self._alive_lock = threading.Lock()

    # -- what a service uses --------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """GPS time now; in a replay the time of the tick."""
        return self._clock.now_ns()

    def publish(self, name: str, message: Message, *, to: str | None = None) -> bytes:
        """Send on a channel that the table gives this service; `to` one service, where there is a key for each.

        In a replay it goes with `flush`, at the end of the tick. Returns the bytes.
        """
        port = name if to is None else f"{name}.{to}"
        sequence = self.published[port]
        data = encode(message, source=self.service, sequence=sequence)
        channel = BY_NAME[name]
        publisher = self._publishers.get(port) or self._declare_publisher(channel, to)
        if self._replay and channel.delivery != "barrier":
            self._held.append(_Held(channel, publisher, data))
        else:
            publisher.put(data)
        self.published[port] = sequence + 1
        return data

    def flush(self, rider: Message, wanted_by: Set[str]) -> set[str]:
        """Send what was published in this tick of a replay, and `rider` with it.

        The rider travels with the last message of as many channels as it takes to reach those it is wanted by, and
        with the very last one for the feeder: when it has that, it has them all. Returns those that it does not reach.
        """
        held, self._held = self._held, []
        unreached, attachment = set(wanted_by), encode(rider, source=self.service)
        last = {item.channel.name: position for position, item in enumerate(held)}
        of_vehicle = [position for position, item in enumerate(held) if "{vehicle}" in item.channel.key]
        for position, (channel, publisher, data) in enumerate(held):
            hear = set(channel.consumers) & unreached if last[channel.name] == position else set()
            if of_vehicle[-1:] == [position]:
                hear |= {FEEDER} & unreached
            if hear:
                publisher.put(data, attachment=attachment)
                unreached -= hear
            else:
                publisher.put(data)
        return unreached

    def ask(self, name: str, request: Message) -> Any:
        """Ask over a query channel and return the reply.

        Raises QueryFailed: at once when nobody is there to answer, and after the channel's oldest age otherwise.
        """
        channel = BY_NAME[name]
        assert channel.reply is not None
        if not any(self.is_alive(peer) for peer in channel.consumers):
            raise QueryFailed("absent", f"none of {', '.join(channel.consumers)} is on the bus")
        data = encode(request, source=self.service)
        payload, encoding = self.ask_bytes(name, data)
        try:
            return decode(channel.reply, payload, encoding).message
        except DecodeError as error:
            raise QueryFailed("invalid", str(error)) from None

    def ask_bytes(self, name: str, data: bytes) -> tuple[bytes, str]:
        """`ask` with a request that is encoded already: for an outbox, also from its own thread."""
        channel = BY_NAME[name]
        querier = self._queriers.get(name) or self._declare_querier(channel)
        detail = ""
        for reply in querier.get(payload=data, encoding=encoding_of(channel.message)):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes(), str(reply.ok.encoding)
            detail = reply.err.payload.to_bytes()[:200].decode("utf-8", "replace") if reply.err else ""
        # Zenoh ends the wait of an unanswered query with an error reply that says so, or with no reply at all.
        timed_out = not detail or "timeout" in detail.lower()
        raise QueryFailed("timeout" if timed_out else "refused", detail)

    def is_alive(self, service: str) -> bool:
        """Is this service on the bus? Live by its liveliness token, in a replay by the tick's list."""
        if self._replay:
            return service in self.participants
        with self._alive_lock:
            return service in self._alive

    def issue(self, code: str, text: str) -> None:
        """Something an operator should know: counted, shown in health, logged once in a while."""
        code = _bounded(code, self._issues, MAX_ISSUES)
        text = text.encode("utf-8", "backslashreplace").decode()[:MAX_TEXT]  # a file's name may be no UTF-8
        _, count = self._issues.get(code, ("", 0))
        self._issues[code] = (text, count + 1)
        now = time.monotonic()
        if now - self._logged.get(code, -_LOG_EVERY_S) >= _LOG_EVERY_S:
            self._logged[code] = now
            self.log.warning(code, detail=text, count=count + 1)

    def count(self, name: str, n: int = 1) -> None:
        """Add to a counter that health shows."""
        self.counters[_bounded(name, self.counters, MAX_COUNTERS)] += max(n, 0)

    def issues(self) -> tuple[Issue, ...]:
        """All issues so far."""
        return tuple(Issue(code=code, text=text, count=n) for code, (text, n) in sorted(self._issues.items()))

    # -- what the work loop uses ----------------------------------------------------------------------------------

    def subscribe(self, channel: Channel, *, of: str | None = None) -> None:
        """Queue what arrives on a channel (of one service, where it has a key for each).

        The oldest goes when the queue is full. The port is called as the channel, or `channel.service`.
        """
        limit = _QUEUE_LIMIT["barrier"] if self._replay else _QUEUE_LIMIT[channel.delivery]
        name = channel.name if of is None else f"{channel.name}.{of}"
        port = self._ports[name] = _Port(channel, deque(maxlen=limit))
        events, items = self._events, port.items

        def arrived(sample: zenoh.Sample) -> None:
            full = len(items) == limit
            rider = sample.attachment
            items.append(
                Arrived(
                    sample.payload.to_bytes(),
                    str(sample.encoding),
                    None if rider is None else rider.to_bytes(),
                )
            )
            if full:
                port.overflow += 1
            else:
                events.put(("message", name))

        key = channel.key_for(self.settings.vehicle).replace("{service}", of or self.service)
        self._entities.append(self._session.declare_subscriber(key, direct(arrived)))

    def answer(self, channel: Channel) -> None:
        """Queue the questions that arrive on a query channel."""
        pending = self._queries[channel.name] = deque()
        events, name = self._events, channel.name

        def asked(query: zenoh.Query) -> None:
            if len(pending) >= _QUERY_LIMIT:
                with query:
                    query.reply_err(b"busy")
                return
            pending.append(query)
            events.put(("query", name))

        key = channel.key_for(self.settings.vehicle).replace("{service}", self.service)
        self._entities.append(self._session.declare_queryable(key, direct(asked)))

    def announce(self) -> None:
        """Declare this service alive, and watch who else is."""
        prefix = f"camber/v1/{self.settings.vehicle}"

        def changed(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr).split("/")[-2]
            with self._alive_lock:
                if sample.kind == zenoh.SampleKind.PUT:
                    self._alive.add(name)
                else:
                    self._alive.discard(name)
                    if name == FEEDER:
                        self.feeder_gone = True
            self._events.put(("wake", name))

        liveliness = self._session.liveliness()
        self._entities.append(liveliness.declare_subscriber(f"{prefix}/*/alive", changed, history=True))
        self._entities.append(liveliness.declare_token(f"{prefix}/{self.service}/alive"))

    def wake(self) -> None:
        """End the work loop's wait."""
        self._events.put(("wake", ""))

    def next_event(self, timeout_s: float) -> Event | None:
        """The next event, or None after the timeout."""
        try:
            return self._events.get(timeout=timeout_s) if timeout_s > 0 else self._events.get_nowait()
        except queue.Empty:
            return None

    def pop(self, name: str) -> Arrived | None:
        """The oldest bytes queued on a channel."""
        port = self._ports[name]
        if port.overflow:
            self.counters[f"{name}.overflow"] += port.overflow
            port.overflow = 0
        return port.items.popleft() if port.items else None

    def pop_queries(self, name: str) -> list[zenoh.Query]:
        """All questions waiting on a query channel."""
        pending = self._queries[name]
        return [pending.popleft() for _ in range(len(pending))]

    def reply(self, query: zenoh.Query, message: Message) -> None:
        """Answer a question."""
        data = encode(message, source=self.service)
        query.reply(str(query.key_expr), data, encoding=encoding_of(type(message)))

    def close(self) -> None:
        """Leave the bus."""
        for entity in self._entities:
            entity.undeclare()
        self._session.close()  # type: ignore[no-untyped-call]

    def _declare_publisher(self, channel: Channel, to: str | None) -> zenoh.Publisher:
        blocking = self._replay or channel.delivery == "barrier"
        publisher = self._session.declare_publisher(
            channel.key_for(self.settings.vehicle).replace("{service}", to or self.service),
            encoding=encoding_of(channel.message),
            congestion_control=zenoh.CongestionControl.BLOCK if blocking else zenoh.CongestionControl.DROP,
            priority=_PRIORITY[channel.delivery],
            express=channel.delivery != "bulk",
        )
        self._publishers[channel.name if to is None else f"{channel.name}.{to}"] = publisher
        return publisher

    def _declare_querier(self, channel: Channel) -> zenoh.Querier:
        timeout_s = 5.0 if channel.delivery == "upload" else (channel.max_age_s or 1.0)
        querier = self._session.declare_querier(
            channel.key_for(self.settings.vehicle),
            timeout=_REPLAY_QUERY_TIMEOUT_S if self._replay and channel.delivery == "query" else timeout_s,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=_PRIORITY[channel.delivery],
            express=True,
        )
        self._queriers[channel.name] = querier
        return querier
