"""The queue between receiving and storing workers: a stream of NATS JetStream.

    receive ──▶ camber.uploads.<shard> (stream, a work queue in files) ──▶ store ──▶ database of the shard
       ▲                                                                    │
       └──────────── outcome of each, after the database's commit ──────────┘

**Acknowledgement.** Uploads are acknowledged after the commit of the shard's database, which the storing worker reports
to the receiving one, not after JetStream's acknowledgement. JetStream acknowledges what is written but not flushed
(every two minutes; `sync_interval: always` exists since 2.10), and cannot distinguish duplicates and refusals. So the
stream never holds the only copy of an acknowledged upload: if it is lost, the vehicles send again.

Messages redelivered because a worker or the server died are duplicates by the ledger. No `Nats-Msg-Id` is set: a stream
that drops a repetition would leave its vehicle without a receipt.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
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
    pack_contributions,
    pack_outcomes,
    unpack_contributions,
    unpack_outcomes,
)
from camber.map_update.stores.reconnecting_client import ReconnectingClient
from camber.map_update.stores.shards import Shards
from camber.map_update.stores.upload_deduplication import Outcome

STREAM = "CAMBER_UPLOADS"
_SUBJECT = "camber.uploads"
# Chosen: well below the server's default `max_payload` of 1 MB, and large enough that a message costs little a record.
_MESSAGE_BYTES = 256 << 10
_STREAM_BYTES = 1 << 30  # chosen: some minutes of uploads at full load
_IN_FLIGHT = 64  # chosen: unacknowledged messages of a shard, enough to keep a storing worker busy
# Chosen: a message is redelivered 1 s after a failed commit, and 10 s after its worker died: longer than any commit.
_REDELIVER_S = 1.0
_ACK_WAIT_S = 10.0
_HEADER_BYTES = 512  # at most, of a contribution in a message


@dataclass(slots=True, kw_only=True)
class _NatsConnection:
    client: Client
    inbox: str = ""
    waiting: dict[str, asyncio.Future[bytes]] = field(default_factory=dict)
    number: int = 0
    arrived: deque[Msg] = field(default_factory=deque)
    has_arrivals: asyncio.Event = field(default_factory=asyncio.Event)


class _Queue:
    """Connection of sender and receiver: `address` is `nats://user@host:port`, `limit_s` the longest wait for it."""

    def __init__(self, address: str, password: str | None, limit_s: float) -> None:
        parts = urlsplit(address)
        self._host = f"nats://{parts.hostname}:{parts.port or 4222}"
        self._user, self._password, self._limit_s = parts.username, password, limit_s
        self._client: ReconnectingClient[_NatsConnection] = ReconnectingClient(
            self._host, self._connect, _disconnect, broken=(nats.errors.Error,), error=QueueError
        )

    def check(self) -> None:
        """Answer the server's pings; reconnect if the connection was lost. Raises QueueError."""
        self._client.run(self._check)

    def close(self) -> None:
        """Disconnect from the queue."""
        self._client.close()

    async def _check(self, connection: _NatsConnection) -> None:
        await asyncio.sleep(0)
        if not connection.client.is_connected:
            raise nats.errors.ConnectionClosedError

    async def _connect(self) -> _NatsConnection:
        client = Client()

        async def ignore(_: Exception) -> None:
            """The next call reports it; nats-py would log it."""

        await asyncio.wait_for(
            client.connect(
                servers=[self._host],
                user=self._user,
                password=self._password,
                name="camber map_update",
                allow_reconnect=False,  # `ReconnectingClient` reconnects, and makes the stream again
                connect_timeout=math.ceil(self._limit_s),
                error_cb=ignore,
            ),
            self._limit_s,
        )
        connection = _NatsConnection(client=client)
        try:
            await self._ready(connection)
        except BaseException:
            await _disconnect(connection)
            raise
        return connection

    async def _ready(self, connection: _NatsConnection) -> None:
        streams = connection.client.jetstream(timeout=self._limit_s)
        try:
            await streams.stream_info(STREAM)
        except nats.js.errors.NotFoundError:
            await streams.add_stream(
                StreamConfig(
                    name=STREAM,
                    subjects=[f"{_SUBJECT}.*"],
                    retention=RetentionPolicy.WORK_QUEUE,
                    storage=StorageType.FILE,
                    discard=DiscardPolicy.NEW,  # when full, new messages are refused and the vehicles keep them
                    max_bytes=_STREAM_BYTES,
                )
            )


class QueueSender(_Queue):
    """The receiving worker's side."""

    def __init__(
        self, address: str, shards: Shards, *, password: str | None = None, limit_s: float = 1.0
    ) -> None:
        super().__init__(address, password, limit_s)
        self._shards = shards
        self.too_large = 0
        """Messages larger than the server's `max_payload`, which were not sent."""

    def send(self, queued: Sequence[QueuedContribution]) -> list[Outcome | None]:
        """Send contributions to their shards; returns the outcomes, None without a reply in time.

        Raises QueueError if the queue is not reached.
        """
        by_shard: dict[int, list[tuple[int, QueuedContribution]]] = {}
        divided = self._shards.split([item.contribution for item in queued])
        for n, (item, parts) in enumerate(zip(queued, divided, strict=True)):
            for shard, part in parts:
                by_shard.setdefault(shard, []).append((n, QueuedContribution(part, item.refusal)))
        messages = [(shard, chunk) for shard, items in by_shard.items() for chunk in _chunks(items)]
        requests = [(shard, [item for _, item in chunk]) for shard, chunk in messages]
        replies = self._client.run(lambda connection: self._request(connection, requests))
        outcomes: list[list[Outcome | None]] = [[] for _ in queued]
        for (_, chunk), reply in zip(messages, replies, strict=True):
            for (n, _), outcome in zip_longest(chunk, reply or ()):
                outcomes[n].append(outcome)
        return [_combine(of_parts) for of_parts in outcomes]

    async def _ready(self, connection: _NatsConnection) -> None:
        await super()._ready(connection)
        connection.inbox = connection.client.new_inbox()

        async def on_reply(message: Msg) -> None:
            waiting = connection.waiting.pop(message.subject.rpartition(".")[2], None)
            if waiting is not None and not waiting.done():
                waiting.set_result(message.data)

        await connection.client.subscribe(f"{connection.inbox}.*", cb=on_reply)
        await connection.client.flush(timeout=math.ceil(self._limit_s))

    async def _request(
        self, connection: _NatsConnection, messages: Sequence[tuple[int, Sequence[QueuedContribution]]]
    ) -> list[list[Outcome] | None]:
        await self._check(connection)
        streams = connection.client.jetstream(timeout=self._limit_s)
        waiting: list[asyncio.Future[bytes]] = []
        published = []
        for shard, queued in messages:
            connection.number += 1
            token = str(connection.number)
            reply: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
            waiting.append(reply)
            data = pack_contributions(f"{connection.inbox}.{token}", queued)
            if len(data) > connection.client.max_payload:
                self.too_large += 1
                continue
            connection.waiting[token] = reply
            published.append(
                streams.publish(f"{_SUBJECT}.{self._shards.name(shard)}", data, timeout=self._limit_s)
            )
        try:
            for error in await asyncio.gather(*published, return_exceptions=True):
                if isinstance(error, BaseException):  # no stream, or no room in it
                    raise error
            if connection.waiting:
                await asyncio.wait(connection.waiting.values(), timeout=self._limit_s)
        finally:
            connection.waiting.clear()
        replies: list[list[Outcome] | None] = []
        for reply, (_, queued) in zip(waiting, messages, strict=True):
            outcomes = unpack_outcomes(reply.result()) if reply.done() else []
            replies.append(outcomes if len(outcomes) == len(queued) else None)
        return replies


class QueueDelivery:
    """A message of the queue: its contributions, the reply subject, and the message to be acknowledged."""

    def __init__(self, message: Msg) -> None:
        self.message = message
        self.reply, self.contributions = unpack_contributions(message.data)


class QueueReceiver(_Queue):
    """The storing worker's side, for one shard; any number of workers may share it."""

    def __init__(
        self, address: str, shard: str, *, password: str | None = None, limit_s: float = 1.0
    ) -> None:
        super().__init__(address, password, limit_s)
        self._shard = shard
        self.damaged = 0
        """Messages that could not be decoded; they are not redelivered."""
        self.waiting: int | None = None
        """Messages of this shard that the server had not delivered at the last call of `take`."""

    def take(self, wait_s: float) -> list[QueueDelivery]:
        """Return what was delivered, after at most `wait_s`. Raises QueueError if the queue is not reached."""
        return self._client.run(lambda connection: self._taken(connection, wait_s))

    def acknowledge(self, deliveries: Sequence[QueueDelivery], outcomes: Sequence[Sequence[Outcome]]) -> None:
        """Report the outcomes after the commit; the deliveries are not repeated."""

        async def work(connection: _NatsConnection) -> None:
            for delivery, of_delivery in zip(deliveries, outcomes, strict=True):
                await connection.client.publish(delivery.reply, pack_outcomes(of_delivery))
                await delivery.message.ack()
            await asyncio.sleep(0)

        self._client.run(work)

    def redeliver(self, deliveries: Sequence[QueueDelivery]) -> None:
        """Request redelivery in a second, to any worker of the shard: the deliveries could not be stored."""

        async def work(_: _NatsConnection) -> None:
            for delivery in deliveries:
                await delivery.message.nak(delay=_REDELIVER_S)
            await asyncio.sleep(0)

        self._client.run(work)

    async def _ready(self, connection: _NatsConnection) -> None:
        await super()._ready(connection)
        name = f"store_{self._shard}"

        async def on_message(message: Msg) -> None:
            connection.arrived.append(message)
            connection.has_arrivals.set()

        await connection.client.jetstream(timeout=self._limit_s).subscribe(
            f"{_SUBJECT}.{self._shard}",
            queue=name,
            stream=STREAM,
            manual_ack=True,
            cb=on_message,
            config=ConsumerConfig(
                durable_name=name,
                deliver_subject=f"camber.store.{self._shard}",
                deliver_group=name,
                ack_policy=AckPolicy.EXPLICIT,
                ack_wait=_ACK_WAIT_S,
                max_ack_pending=_IN_FLIGHT,
            ),
        )

    async def _taken(self, connection: _NatsConnection, wait_s: float) -> list[QueueDelivery]:
        await self._check(connection)
        if not connection.arrived:
            connection.has_arrivals.clear()
            try:
                await asyncio.wait_for(connection.has_arrivals.wait(), wait_s)
            except TimeoutError:
                self.waiting = 0
                return []
        deliveries = []
        while connection.arrived:
            message = connection.arrived.popleft()
            self.waiting = message.metadata.num_pending
            try:
                deliveries.append(QueueDelivery(message))
            except QueueMessageError:
                self.damaged += 1
                await message.term()
        return deliveries


def _chunks(items: Sequence[tuple[int, QueuedContribution]]) -> list[list[tuple[int, QueuedContribution]]]:
    """Divide contributions into messages of about _MESSAGE_BYTES."""
    chunks: list[list[tuple[int, QueuedContribution]]] = [[]]
    size = 0
    for item in items:
        bytes_of_item = item[1].contribution.observations.nbytes + _HEADER_BYTES
        size += bytes_of_item
        if chunks[-1] and size > _MESSAGE_BYTES:
            chunks.append([])
            size = bytes_of_item
        chunks[-1].append(item)
    return chunks


def _combine(parts: Sequence[Outcome | None]) -> Outcome | None:
    """Return the outcome of a contribution from its parts': unknown if one is, refused if one is, stored if one is."""
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    for status in ("refused", "stored"):
        for part in known:
            if part.status == status:
                return part
    return known[0]


async def _disconnect(connection: _NatsConnection) -> None:
    with contextlib.suppress(nats.errors.Error, OSError, TimeoutError):  # it may be gone
        await asyncio.wait_for(connection.client.close(), 1.0)
