"""A service's side of the bus: publish, ask, answer, who is alive, what to report.

Zenoh's callbacks only put bytes into bounded queues; everything else happens in the work loop (`run.py`), in one
thread. A callback that works would block the receive thread and lose other topics of the session.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import zenoh

from camber.runtime.clock import Clock, SystemClock
from camber.runtime.health.issue_log import IssueLog
from camber.runtime.log import make_logger
from camber.runtime.settings import ServiceSettings
from camber.runtime.single_producer import SampleOrigin, SingleProducer
from camber.schemas.base import Message
from camber.schemas.channels import BY_NAME, Channel, outputs_of
from camber.schemas.codec import DecodeError, decode, encode, encoding_of
from camber.schemas.health import ChannelUse, Issue, LogLevel

if TYPE_CHECKING:
    from camber.runtime.access_probe import AccessProbe

Event = tuple[Literal["message", "query", "wake"], str]
_QUEUE_LIMIT = {"small": 1024, "bulk": 1, "barrier": 4096}
_QUERY_LIMIT = 256  # chosen: queries queued before new ones are refused as busy
_LOSSLESS_QUERY_TIMEOUT_S = 10.0  # chosen: a replay waits rather than lose a reply
_AT_ONCE_S = 0.05  # chosen: a reply this early comes from the router itself
_LOG_EVERY_S = 10.0  # chosen: shortest period of equal log lines

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


class QueryFailed(RuntimeError):  # noqa: N818 (the name says what is the matter)
    """A question that got no usable answer; `reason` says why."""

    def __init__(self, reason: Literal["absent", "timeout", "refused", "invalid"], detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


class Arrived(NamedTuple):
    """A message as it came: its bytes, its encoding, its attachment (in lock step a tick or a done), its arrival."""

    data: bytes
    encoding: str
    attachment: bytes | None
    arrival: SampleOrigin


def arrival_of(sample: zenoh.Sample) -> SampleOrigin:
    """The session that published a sample, and the time now."""
    info = sample.source_info
    return SampleOrigin(None if info is None else str(info.source_id.zid), time.monotonic_ns())


def _arrived(sample: zenoh.Sample) -> Arrived:
    attachment = sample.attachment
    return Arrived(
        sample.payload.to_bytes(),
        str(sample.encoding),
        None if attachment is None else attachment.to_bytes(),
        arrival_of(sample),
    )


def _queued_replies(replies: Any) -> Iterator[Any]:
    """Replies that have come since the first one was taken."""
    while replies is not None:
        try:
            reply = replies.try_recv()
        except zenoh.ZError:  # there will be no more
            return
        if reply is None:
            return
        yield reply


def _can_be_read(channel: Channel, item: Arrived) -> bool:
    try:
        decode(channel.message, item.data, item.encoding)
    except DecodeError:
        return False
    return True


@dataclass(slots=True, kw_only=True)
class _InputQueue:
    """One subscribed channel: its bounded queue and how many were pushed out of it.

    For each item that waits there is one event: what puts in and what takes out must not come between one another.
    """

    channel: Channel
    items: deque[Arrived]
    overflow: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)


class Bus:
    """Everything a service needs of the outside; made and closed by `run`, used from the work loop only."""

    LOSSLESS: ClassVar[bool] = False
    """Wait where the bus is congested, and for answers, in place of dropping: so in a replay in lock step."""

    def __init__(self, session: zenoh.Session, settings: ServiceSettings, service: str, clock: Clock) -> None:
        self.service = service
        self.settings = settings
        self.log_level: LogLevel = settings.log_level  # least level that is logged now
        self._level_until_s = float("inf")  # monotonic; then it is that of the settings again
        self._make_logger()
        self._ledger = IssueLog()
        self.counters = self._ledger.counters  # all that was counted so far
        self.published: dict[str, int] = {channel.name: 0 for channel in outputs_of(service)}
        self._session = session
        self._clock = clock
        self._link_s = 0.0
        self._blocking = self.LOSSLESS
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._queriers: dict[str, zenoh.Querier] = {}
        self._answerers: dict[str, SingleProducer] = {}
        self._replies: dict[str, Any] = {}  # to the last question on each channel
        self._entities: list[Any] = []
        self._ports: dict[str, _InputQueue] = {}
        self._queries: dict[str, deque[zenoh.Query]] = {}
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._logged: dict[str, float] = {}
        self._alive: set[str] = set()
        self._access_probe: AccessProbe | None = None
        self._alive_lock = threading.Lock()

    # -- what a service uses --------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        """GPS time now; in a replay the time of the tick."""
        return self._clock.now_ns()

    def set_link_delay(self, delay_s: float) -> None:
        """Live by a time that is so much behind, for what comes over a link that takes that long; not in a replay.

        Ages are judged by that time, and answers may take twice as much longer. Before anything is asked.
        """
        self._link_s = delay_s
        if isinstance(self._clock, SystemClock):
            self._clock.delay_ns = round(delay_s * 1e9)

    def set_blocking(self) -> None:
        """Wait where the bus is congested, in place of dropping. Before anything is published."""
        self._blocking = True

    def publish(self, name: str, message: Message, *, to: str | None = None) -> bytes:
        """Send on a channel that the table gives this service; `to` one service, where there is a key for each.

        Returns the bytes.
        """
        port = name if to is None else f"{name}.{to}"
        sequence = self.published[port]
        data = encode(message, source=self.service, sequence=sequence)
        channel = BY_NAME[name]
        publisher = self._publishers.get(port) or self._declare_publisher(channel, to)
        self.send(channel, publisher, data)
        self.published[port] = sequence + 1
        self._ledger.used("out", port)
        return data

    def has_subscriber(self, name: str) -> bool:
        """Whether somebody subscribes to a channel of this service; in a replay, which is recorded, always."""
        if self.LOSSLESS:
            return True
        publisher = self._publishers.get(name) or self._declare_publisher(BY_NAME[name], None)
        status: Any = publisher.matching_status  # Zenoh's own annotation of it is wrong
        return bool(status.matching)

    def send(self, channel: Channel, publisher: zenoh.Publisher, data: bytes) -> None:
        """Send the bytes of a message, and by which session: consumers refuse a second one."""
        publisher.put(data, source_info=zenoh.SourceInfo(publisher.id, 0))

    def ask(self, name: str, request: Message) -> Any:
        """Ask over a query channel and return the reply.

        Raises QueryFailed: at once when nobody is there to answer, after the channel's oldest age otherwise, and while
        two sessions answer.
        """
        channel = BY_NAME[name]
        assert channel.reply is not None
        if not any(self.is_alive(peer) for peer in channel.consumers):
            raise QueryFailed("absent", f"none of {', '.join(channel.consumers)} is on the bus")
        data = encode(request, source=self.service)
        replies, answer = self._first_answer(channel, data)
        if not self.LOSSLESS:
            self._check_answerer(channel, replies, answer)
        try:
            return decode(channel.reply, answer.ok.payload.to_bytes(), str(answer.ok.encoding)).message
        except DecodeError as error:
            raise QueryFailed("invalid", str(error)) from None

    def ask_bytes(self, name: str, data: bytes) -> tuple[bytes, str]:
        """`ask` with a request that is encoded already: for an outbox, also from its own thread."""
        answer = self._first_answer(BY_NAME[name], data)[1].ok
        return answer.payload.to_bytes(), str(answer.encoding)

    def _first_answer(self, channel: Channel, data: bytes) -> tuple[Any, Any]:
        """The replies, of which more may come, and the first that is no error."""
        querier = self._queriers.get(channel.name) or self._declare_querier(channel)
        detail, asked_s = "", time.monotonic()
        replies: Any = querier.get(payload=data, encoding=encoding_of(channel.message))
        for reply in replies:
            if reply.ok is not None:
                return replies, reply
            detail = reply.err.payload.to_bytes()[:200].decode("utf-8", "replace") if reply.err else ""
        if not detail and time.monotonic() - asked_s < _AT_ONCE_S:
            # A router that knows of nobody says so at once, and of somebody whom access rules hide from us the same.
            raise QueryFailed("absent", "nobody to answer is known here: not there, no link, or denied to us")
        # Zenoh ends the wait of an unanswered query with an error reply that says so, or with no reply at all.
        timed_out = not detail or "timeout" in detail.lower()
        raise QueryFailed("timeout" if timed_out else "refused", detail)

    def _check_answerer(self, channel: Channel, replies: Any, answer: Any) -> None:
        """Raise QueryFailed while two sessions answer, also where the other one's last reply came after the first."""
        name = channel.name
        answerers = self._answerers.setdefault(name, SingleProducer(rate_hz=None))
        for late in (*_queued_replies(self._replies.pop(name, None)), answer):
            replier = late.replier_id
            origin = SampleOrigin(None if replier is None else str(replier.zid), time.monotonic_ns())
            problem = answerers.problem("the answerer", 0, origin)
        self._replies[name] = replies
        if problem == "two_producers":
            self.issue("two_producers", f"{name}: {answerers}; expected one")
        if problem is not None:
            raise QueryFailed("refused", f"{answerers}; expected one")

    def is_alive(self, service: str) -> bool:
        """Is this service on the bus, by its liveliness token?"""
        with self._alive_lock:
            return service in self._alive

    def issue(self, code: str, text: str) -> None:
        """Something an operator should know: counted, shown in health, logged once in a while."""
        code, text, count = self._ledger.issue(code, text)
        now = time.monotonic()
        if now - self._logged.get(code, -_LOG_EVERY_S) >= _LOG_EVERY_S:
            self._logged[code] = now
            self.log.warning(code, detail=text, count=count)
        elif self.log_level == "debug":
            self.log.debug(code, detail=text, count=count)

    def count(self, name: str, n: int = 1) -> None:
        """Add to a counter that health shows."""
        self._ledger.count(name, n)

    def issues(self) -> tuple[Issue, ...]:
        """All issues so far."""
        return self._ledger.issues()

    # -- what the work loop uses ----------------------------------------------------------------------------------

    def channels(self) -> tuple[ChannelUse, ...]:
        """What went over each channel, and what waits in its queue."""
        waiting = {name: len(port.items) for name, port in self._ports.items()}
        waiting |= {name: len(pending) for name, pending in self._queries.items()}
        return self._ledger.channels(waiting)

    def set_log_level(self, level: LogLevel, for_s: float) -> None:
        """Log at another level for so long."""
        self.log_level, self._level_until_s = level, time.monotonic() + for_s
        self._make_logger()

    def restore_log_level(self) -> None:
        """Fall back to the level of the settings, where the time of another one is over."""
        if time.monotonic() >= self._level_until_s:
            self.log_level, self._level_until_s = self.settings.log_level, float("inf")
            self._make_logger()
            self.log.info("log_level", level=self.log_level)

    def _make_logger(self) -> None:
        self.log = make_logger(self.service, level=self.log_level, form=self.settings.log_format)

    def subscribe(self, channel: Channel, *, of: str | None = None) -> None:
        """Queue what arrives on a channel (of one service, where it has a key for each).

        The oldest goes when the queue is full. The port is called as the channel, or `channel.service`.
        """
        limit = _QUEUE_LIMIT["barrier" if self.LOSSLESS else channel.delivery]
        name = channel.name if of is None else f"{channel.name}.{of}"
        port = self._ports[name] = _InputQueue(channel=channel, items=deque(maxlen=limit))
        self._ledger.declare("in", name)
        events, items = self._events, port.items

        def arrived(sample: zenoh.Sample) -> None:
            item = _arrived(sample)
            # What cannot be read must not push out the only one that waits.
            may_push_out = limit > 1 or not items or _can_be_read(channel, item)
            with port.lock:
                full = len(items) == limit
                if may_push_out or not full:
                    items.append(item)
                if full:
                    port.overflow += 1
                else:
                    events.put(("message", name))

        key = channel.key_for(self.settings.vehicle).replace("{service}", of or self.service)
        self._entities.append(self._session.declare_subscriber(key, direct(arrived)))

    def answer(self, channel: Channel) -> None:
        """Queue the questions that arrive on a query channel."""
        pending = self._queries[channel.name] = deque()
        self._ledger.declare("asked", channel.name)
        events, name = self._events, channel.name

        def asked(query: zenoh.Query) -> None:
            if len(pending) >= _QUERY_LIMIT:
                with query:
                    query.reply_err(b"busy")
                return
            pending.append(query)
            events.put(("query", name))

        key = channel.answered_at(self.settings.vehicle).replace("{service}", self.service)
        self._entities.append(self._session.declare_queryable(key, direct(asked)))

    def announce(self) -> None:
        """Declare this service alive, and watch who else is."""
        self.watch_liveliness(self.liveliness_changed)
        self.declare_alive(self.service)
        if self.settings.zenoh.over_tls:  # elsewhere nobody has a name that could be denied
            from camber.runtime.access_probe import AccessProbe

            self._access_probe = AccessProbe(self.settings.zenoh, self.settings.vehicle)

    def liveliness_changed(self, name: str, alive: bool) -> None:
        """A process of this vehicle has joined the bus, or left it; called in the receiving thread."""
        with self._alive_lock:
            (self._alive.add if alive else self._alive.discard)(name)
        self._events.put(("wake", name))

    def listen(self, key: str, callback: Callable[[str, Arrived], None]) -> None:
        """Call back, in the receiving thread, with the key and the bytes of all that arrives on a key expression."""

        def arrived(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr), _arrived(sample))

        self._entities.append(self._session.declare_subscriber(key, direct(arrived)))

    def watch_liveliness(self, callback: Callable[[str, bool], None]) -> None:
        """Call back, in the receiving thread, with the name of each process of this vehicle and whether it is alive."""

        def changed(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr).split("/")[-2], sample.kind == zenoh.SampleKind.PUT)

        key = f"camber/v1/{self.settings.vehicle}/*/alive"
        self._entities.append(self._session.liveliness().declare_subscriber(key, changed, history=True))

    def declare_alive(self, name: str) -> None:
        """Declare a process of this vehicle alive, until this session ends."""
        key = f"camber/v1/{self.settings.vehicle}/{name}/alive"
        self._entities.append(self._session.liveliness().declare_token(key))

    def check_access(self) -> None:
        """Report what the router denies: Zenoh itself never says so."""
        for text in () if self._access_probe is None else self._access_probe.problems():
            self.issue("not_heard", text)

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
        with port.lock:
            overflow, port.overflow = port.overflow, 0
            item = port.items.popleft() if port.items else None
        if overflow:
            self.counters[f"{name}.overflow"] += overflow
        if item is not None:
            self._ledger.used("in", name)
        return item

    def pop_queries(self, name: str) -> list[zenoh.Query]:
        """All questions waiting on a query channel."""
        pending = self._queries[name]
        taken = [pending.popleft() for _ in range(len(pending))]
        if taken:
            self._ledger.used("asked", name, len(taken))
        return taken

    def reply(self, query: zenoh.Query, message: Message) -> None:
        """Answer a question."""
        data = encode(message, source=self.service)
        query.reply(str(query.key_expr), data, encoding=encoding_of(type(message)), express=True)

    def close(self) -> None:
        """Leave the bus."""
        for entity in self._entities:
            entity.undeclare()
        self._session.close()  # type: ignore[no-untyped-call]

    def _declare_publisher(self, channel: Channel, to: str | None) -> zenoh.Publisher:
        blocking = self._blocking or channel.delivery == "barrier"
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
        timeout_s += 2.0 * self._link_s
        querier = self._session.declare_querier(
            channel.key_for(self.settings.vehicle),
            timeout=_LOSSLESS_QUERY_TIMEOUT_S if self.LOSSLESS and channel.delivery == "query" else timeout_s,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=_PRIORITY[channel.delivery],
            express=True,
            # By default a router chooses one of several that answer, and nobody would know that there are several.
            target=zenoh.QueryTarget.ALL if channel.delivery == "query" else zenoh.QueryTarget.BEST_MATCHING,
        )
        self._queriers[channel.name] = querier
        return querier
