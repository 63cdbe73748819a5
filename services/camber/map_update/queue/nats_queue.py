"""Uploads on their way from who receives them to who stores them, past one machine: a stream of NATS JetStream.

    receive ──▶ camber.uploads.<shard> (stream, a work queue in files) ──▶ store ──▶ database of the shard
       ▲                                                                    │
       └──────────── what became of each, after the database's commit ──────┘

**Where the acknowledgement comes from.** From the commit of the shard's database, which the storing worker reports to
the receiving one; not from JetStream's. JetStream acknowledges what it has written but not flushed (every two minutes;
before 2.10 there is no `sync_interval: always`), and it cannot say whether a contribution is a duplicate or is refused.
So nothing acknowledged is in the stream alone: it may lose all it holds, and the vehicles send again.

What is delivered again, because a worker or the server died, is a duplicate by the ledger. There is no `Nats-Msg-Id`: a
stream that swallows a repetition would leave its vehicle without a receipt.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import TypeVar
from urllib.parse import urlsplit

import nats.errors
import nats.js.errors
from nats.aio.client import Client
from nats.aio.msg import Msg
from nats.js.api import AckPolicy, ConsumerConfig, DiscardPolicy, RetentionPolicy, StorageType, StreamConfig

from camber.map_update.queue.queue_messages import (
    QueuedContribution,
    QueueError,
    QueueMessageError,
    pack_outcomes,
    pack_parcels,
    unpack_outcomes,
    unpack_parcels,
)
from camber.map_update.stores.reconnecting_client import ConnectionFailedError, ReconnectingClient
from camber.map_update.stores.shards import Shards
from camber.map_update.stores.store import Outcome

T = TypeVar("T")

STREAM = "CAMBER_UPLOADS"
_SUBJECT = "camber.uploads"
_MESSAGE_BYTES = 256 << 10
_STREAM_BYTES = 1 << 30
_IN_FLIGHT = 64
_AGAIN_S = 1.0
_LOST_S = 10.0


@dataclass(slots=True)
class _Connected:
    client: Client
    inbox: str = ""
    waiting: dict[str, asyncio.Future[bytes]] = field(default_factory=dict)
    number: int = 0
    arrived: deque[Msg] = field(default_factory=deque)
    some: asyncio.Event = field(default_factory=asyncio.Event)


class _Queue:
    """The connection that both ends have: `address` is `nats://user@host:port`, `limit_s` how long to wait for it."""

    def __init__(self, address: str, password: str | None, limit_s: float) -> None:
        parts = urlsplit(address)
        self._host = f"nats://{parts.hostname}:{parts.port or 4222}"
        self._user, self._password, self._limit_s = parts.username, password, limit_s
        self._link: ReconnectingClient[_Connected] = ReconnectingClient(
            self._host, self._connected, _ended, (nats.errors.Error,)
        )

    def check(self) -> None:
        """Answer the server's pings; connect again where the connection was lost. Raises QueueError."""
        self._run(self._checked)

    def close(self) -> None:
        """Leave the queue."""
        self._link.close()

    def _run(self, work: Callable[[_Connected], Awaitable[T]]) -> T:
        try:
            return self._link.run(work)
        except ConnectionFailedError as error:
            raise QueueError(str(error)) from error

    async def _checked(self, connected: _Connected) -> None:
        await asyncio.sleep(0)
        if not connected.client.is_connected:
            raise nats.errors.ConnectionClosedError

    async def _connected(self) -> _Connected:
        client = Client()

        async def quiet(_: Exception) -> None:
            """Whoever asks next is told; nats-py would log it."""

        await asyncio.wait_for(
            client.connect(
                servers=[self._host],
                user=self._user,
                password=self._password,
                name="camber map_update",
                allow_reconnect=False,  # a link that broke is made anew, with the stream that it needs
                connect_timeout=math.ceil(self._limit_s),
                error_cb=quiet,
            ),
            self._limit_s,
        )
        connected = _Connected(client)
        try:
            await self._ready(connected)
        except BaseException:
            await _ended(connected)
            raise
        return connected

    async def _ready(self, connected: _Connected) -> None:
        streams = connected.client.jetstream(timeout=self._limit_s)
        try:
            await streams.stream_info(STREAM)
        except nats.js.errors.NotFoundError:
            await streams.add_stream(
                StreamConfig(
                    name=STREAM,
                    subjects=[f"{_SUBJECT}.*"],
                    retention=RetentionPolicy.WORK_QUEUE,
                    storage=StorageType.FILE,
                    discard=DiscardPolicy.NEW,  # full is full: the vehicles keep what nobody takes
                    max_bytes=_STREAM_BYTES,
                )
            )


class QueueSender(_Queue):
    """The receiving worker's end."""

    def __init__(
        self, address: str, shards: Shards, *, password: str | None = None, limit_s: float = 1.0
    ) -> None:
        super().__init__(address, password, limit_s)
        self._shards = shards
        self.too_large = 0
        """Messages that were more than the server's `max_payload`, and were not sent."""

    def send(self, parcels: Sequence[QueuedContribution]) -> list[Outcome | None]:
        """Hand over to the shards; returns what became of each, None where nothing was heard in time.

        Raises QueueError where the queue is not there.
        """
        by_shard: dict[int, list[tuple[int, QueuedContribution]]] = {}
        divided = self._shards.split([parcel.contribution for parcel in parcels])
        for n, (parcel, parts_of) in enumerate(zip(parcels, divided, strict=True)):
            for shard, part in parts_of:
                by_shard.setdefault(shard, []).append((n, QueuedContribution(part, parcel.refusal)))
        parts: list[list[Outcome | None]] = [[] for _ in parcels]
        messages = [(shard, chunk) for shard, items in by_shard.items() for chunk in _chunks(items)]
        answers = self._run(
            lambda connected: self._asked(
                connected, [(shard, [parcel for _, parcel in chunk]) for shard, chunk in messages]
            )
        )
        for (_, chunk), outcomes in zip(messages, answers, strict=True):
            for (n, _), outcome in zip_longest(chunk, outcomes or ()):
                parts[n].append(outcome)
        return [_together(outcomes) for outcomes in parts]

    async def _ready(self, connected: _Connected) -> None:
        await super()._ready(connected)
        connected.inbox = connected.client.new_inbox()

        async def answered(message: Msg) -> None:
            waiting = connected.waiting.pop(message.subject.rpartition(".")[2], None)
            if waiting is not None and not waiting.done():
                waiting.set_result(message.data)

        await connected.client.subscribe(f"{connected.inbox}.*", cb=answered)
        await connected.client.flush(timeout=math.ceil(self._limit_s))

    async def _asked(
        self, connected: _Connected, messages: Sequence[tuple[int, Sequence[QueuedContribution]]]
    ) -> list[list[Outcome] | None]:
        await self._checked(connected)
        streams = connected.client.jetstream(timeout=self._limit_s)
        waiting: list[asyncio.Future[bytes]] = []
        taken = []
        for shard, parcels in messages:
            connected.number += 1
            token = str(connected.number)
            answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
            waiting.append(answer)
            data = pack_parcels(f"{connected.inbox}.{token}", parcels)
            if len(data) > connected.client.max_payload:
                self.too_large += 1
                continue
            connected.waiting[token] = answer
            taken.append(
                streams.publish(f"{_SUBJECT}.{self._shards.name(shard)}", data, timeout=self._limit_s)
            )
        try:
            for error in await asyncio.gather(*taken, return_exceptions=True):
                if isinstance(error, BaseException):  # there is no stream, or no room in it
                    raise error
            if connected.waiting:
                await asyncio.wait(connected.waiting.values(), timeout=self._limit_s)
        finally:
            connected.waiting.clear()
        found: list[list[Outcome] | None] = []
        for answer, (_, parcels) in zip(waiting, messages, strict=True):
            outcomes = unpack_outcomes(answer.result()) if answer.done() else []
            found.append(outcomes if len(outcomes) == len(parcels) else None)
        return found


class QueueDelivery:
    """A message of the queue: its parcels, where to report, and the message to be settled."""

    def __init__(self, message: Msg) -> None:
        self.message = message
        self.reply, self.parcels = unpack_parcels(message.data)


class QueueReceiver(_Queue):
    """The storing worker's end, of one shard; any number of workers may share it."""

    def __init__(
        self, address: str, shard: str, *, password: str | None = None, limit_s: float = 1.0
    ) -> None:
        super().__init__(address, password, limit_s)
        self._shard = shard
        self.damaged = 0
        """Messages that were none, and will not come again."""
        self.waiting: int | None = None
        """Messages of this shard that the server had not yet given out when last something was taken."""

    def take(self, wait_s: float) -> list[QueueDelivery]:
        """What has arrived, after at most `wait_s`. Raises QueueError where the queue is not there."""
        return self._run(lambda connected: self._taken(connected, wait_s))

    def stored(self, deliveries: Sequence[QueueDelivery], outcomes: Sequence[Sequence[Outcome]]) -> None:
        """Report what became of each after its commit; they will not come again."""
        self._run(lambda connected: self._settled(connected, deliveries, outcomes))

    def again(self, deliveries: Sequence[QueueDelivery]) -> None:
        """They could not be stored: let them come again in a second, here or elsewhere."""
        self._run(lambda _: self._refused(deliveries))

    async def _ready(self, connected: _Connected) -> None:
        await super()._ready(connected)
        name = f"store_{self._shard}"

        async def arrived(message: Msg) -> None:
            connected.arrived.append(message)
            connected.some.set()

        await connected.client.jetstream(timeout=self._limit_s).subscribe(
            f"{_SUBJECT}.{self._shard}",
            queue=name,
            stream=STREAM,
            manual_ack=True,
            cb=arrived,
            config=ConsumerConfig(
                durable_name=name,
                deliver_subject=f"camber.store.{self._shard}",
                deliver_group=name,
                ack_policy=AckPolicy.EXPLICIT,
                ack_wait=_LOST_S,
                max_ack_pending=_IN_FLIGHT,
            ),
        )

    async def _taken(self, connected: _Connected, wait_s: float) -> list[QueueDelivery]:
        await self._checked(connected)
        if not connected.arrived:
            connected.some.clear()
            try:
                await asyncio.wait_for(connected.some.wait(), wait_s)
            except TimeoutError:
                self.waiting = 0
                return []
        deliveries = []
        while connected.arrived:
            message = connected.arrived.popleft()
            self.waiting = message.metadata.num_pending
            try:
                deliveries.append(QueueDelivery(message))
            except QueueMessageError:
                self.damaged += 1
                await message.term()
        return deliveries

    async def _settled(
        self,
        connected: _Connected,
        deliveries: Sequence[QueueDelivery],
        outcomes: Sequence[Sequence[Outcome]],
    ) -> None:
        for delivery, found in zip(deliveries, outcomes, strict=True):
            await connected.client.publish(delivery.reply, pack_outcomes(found))
            await delivery.message.ack()
        await asyncio.sleep(0)

    async def _refused(self, deliveries: Sequence[QueueDelivery]) -> None:
        for delivery in deliveries:
            await delivery.message.nak(delay=_AGAIN_S)
        await asyncio.sleep(0)


def _chunks(items: Sequence[tuple[int, QueuedContribution]]) -> list[list[tuple[int, QueuedContribution]]]:
    """In messages of some hundred kB: few enough for a server's limit, many enough to be cheap."""
    chunks: list[list[tuple[int, QueuedContribution]]] = [[]]
    size = 0
    for item in items:
        size += item[1].contribution.observations.nbytes + 512
        if chunks[-1] and size > _MESSAGE_BYTES:
            chunks.append([])
            size = item[1].contribution.observations.nbytes + 512
        chunks[-1].append(item)
    return chunks


def _together(parts: Sequence[Outcome | None]) -> Outcome | None:
    """Of the parts of one contribution: not known before all are, refused if one is, stored if one is new."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    for status in ("refused", "stored"):
        for part in known:
            if part.status == status:
                return part
    return known[0]


async def _ended(connected: _Connected) -> None:
    with contextlib.suppress(nats.errors.Error, OSError, TimeoutError):  # it may be gone
        await asyncio.wait_for(connected.client.close(), 1.0)
