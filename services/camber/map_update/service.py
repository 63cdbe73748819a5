"""Wires uploads to the store: commit all that have arrived, then acknowledge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from pydantic import SecretStr

from camber.map_update.admission import Refusal, refusal
from camber.map_update.contribution import Contribution, from_batch, from_upload
from camber.map_update.queue_messages import Parcel, QueueError
from camber.map_update.settings import MapUpdateSettings
from camber.map_update.shards import WORLD, Shards
from camber.map_update.sqlite_store import SqliteStore
from camber.map_update.store import Judge, Outcome, Store, StoreError
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import EARLIEST_NS, Message
from camber.schemas.fleet import UploadReceipt

if TYPE_CHECKING:
    from camber.map_update.nats_queue import Sending, Taking

T = TypeVar("T")

_NS = 1_000_000_000
_CHECK_NS = 2 * _NS
_FORGET_NS = 60 * _NS
_DAY_NS = 86_400 * _NS
# A disk may be full for what is written and answer what is read: one that refused a commit is well after the next.
_UNAVAILABLE = {"store": "store_unavailable", "commit": "store_unavailable", "queue": "queue_unavailable"}


class MapUpdateService(Service[MapUpdateSettings]):
    """Uploads of a fleet, each kept once. Without a commit there is no receipt, and the vehicle asks again.

    By its role it receives and stores, or does one of both, with a queue to those that do the other.
    """

    NAME: ClassVar[str] = "map_update"
    SETTINGS: ClassVar[type[ServiceSettings]] = MapUpdateSettings

    def __init__(self, settings: MapUpdateSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._rules = settings.rules()
        self._down: set[str] = set()
        self._checked_ns = self._forgot_ns = 0
        self._sending = _sending(settings) if settings.role == "receive" else None
        self._taking = _taking(settings) if settings.role == "store" else None
        self._store = _store(settings) if settings.role != "receive" else None

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """Uploads one by one, and in batches."""
        if self.settings.role == "store":
            return {}
        return {
            "upload": lambda uploads: self._receive([from_upload(upload) for upload in uploads]),
            "upload_batch": lambda batches: self._receive([from_batch(batch) for batch in batches]),
        }

    def advance(self, now_ns: int) -> None:
        """Store what the queue has brought, delete what is too old, and look after the connections."""
        if self._taking is not None and self._store is not None:
            self._store_from(self._taking, self._store, now_ns)
        if now_ns - self._checked_ns >= _CHECK_NS:
            self._checked_ns = now_ns
            for name, part in (("store", self._store), ("queue", self._sending or self._taking)):
                if part is not None:
                    self._reached(name, part.check)
        if self._store is not None and now_ns - self._forgot_ns >= _FORGET_NS:
            self._forgot_ns = now_ns
            self._forget(self._store, now_ns)

    def healthy(self) -> bool:
        """Are store and queue there, and was the last group stored?"""
        return not self._down

    def close(self) -> None:
        """Close the store, leave the queue."""
        for part in (self._sending, self._taking, self._store):
            if part is not None:
                part.close()

    def _receive(self, contributions: Sequence[Contribution]) -> Sequence[Message | None]:
        now_ns = self.bus.now_ns()
        if now_ns < EARLIEST_NS:
            # A refusal is for ever; one that does not know the time cannot judge times.
            self.bus.issue("time_not_known", f"{len(contributions)} uploads not acknowledged")
            return [None] * len(contributions)
        outcomes: Sequence[Outcome | None] | None
        if self._sending is not None:
            outcomes = self._handed_over(self._sending, contributions, now_ns)
        else:
            outcomes = self._committed(contributions, now_ns, lambda c: refusal(c, now_ns, self._rules))
        outcomes = outcomes or [None] * len(contributions)
        if missed := sum(outcome is None for outcome in outcomes):
            self.bus.count("unacknowledged", missed)
        return [
            None if outcome is None else self._receipt(contribution, outcome, now_ns)
            for contribution, outcome in zip(contributions, outcomes, strict=True)
        ]

    def _committed(
        self, contributions: Sequence[Contribution], now_ns: int, judge: Judge
    ) -> list[Outcome] | None:
        store = self._store
        assert store is not None
        return self._reached("commit", lambda: store.commit(contributions, now_ns, judge))

    def _handed_over(
        self, sending: Sending, contributions: Sequence[Contribution], now_ns: int
    ) -> list[Outcome | None] | None:
        """Judged here as a whole, before its parts go to different shards."""
        parcels = [Parcel(c, refusal(c, now_ns, self._rules)) for c in contributions]
        before = sending.too_large
        outcomes = self._reached("queue", lambda: sending.send(parcels))
        if sending.too_large > before:
            self.bus.issue(
                "too_large_for_queue", "raise max_payload of the queue's server, or lower most_records"
            )
        return outcomes

    def _store_from(self, taking: Taking, store: Store, now_ns: int) -> None:
        """One round: what has come is one commit. Asks for the next round at once."""
        self.bus.wake()
        deliveries = self._reached("queue", lambda: taking.take(self.settings.period_s))
        if taking.damaged:
            self.bus.count("refused.damaged", taking.damaged)
            taking.damaged = 0
        if not deliveries:
            return
        parcels = [parcel for delivery in deliveries for parcel in delivery.parcels]
        refusals: dict[int, Refusal | None] = {id(p.contribution): p.refusal for p in parcels}
        now_ns = self.bus.now_ns()
        outcomes = None
        if now_ns >= EARLIEST_NS:
            outcomes = self._committed([p.contribution for p in parcels], now_ns, lambda c: refusals[id(c)])
        if outcomes is None:
            self._reached("queue", lambda: taking.again(deliveries))
            return
        rest = iter(outcomes)
        of_each = [[next(rest) for _ in delivery.parcels] for delivery in deliveries]
        self._reached("queue", lambda: taking.stored(deliveries, of_each))
        for outcome in outcomes:
            self.bus.count(outcome.status)

    def _forget(self, store: Store, now_ns: int) -> None:
        """Some at a time: uploads wait meanwhile."""
        before_ns = now_ns - round(self.settings.retention_days * _DAY_NS)
        forgotten = self._reached("store", lambda: store.forget(before_ns, most=1000))
        if forgotten:
            self.bus.count("forgotten", forgotten)
        if forgotten == 1000:
            self._forgot_ns -= _FORGET_NS

    def _reached(self, name: str, work: Callable[[], T]) -> T | None:
        """What `work` returns; None where store or queue is not there, which health then says until it is."""
        try:
            found = work()
        except (StoreError, QueueError) as error:
            self._down.add(name)
            self.bus.issue(_UNAVAILABLE[name], str(error))
            return None
        self._down.discard(name)
        return found

    def _receipt(self, contribution: Contribution, outcome: Outcome, now_ns: int) -> UploadReceipt:
        self.bus.count(outcome.status)
        reason = ""
        if outcome.refusal is not None:
            reason = outcome.refusal.text[:512]
            self.bus.count(f"refused.{outcome.refusal.code}")
            self.bus.issue("refused_upload", f"{contribution.vehicle}, {contribution.id}: {reason}")
        return UploadReceipt(
            time_ns=now_ns,
            vehicle=contribution.vehicle,
            upload_id=contribution.id,
            status=outcome.status,
            reason=reason,
        )


def _store(settings: MapUpdateSettings) -> Store:
    if settings.store is None:
        return SqliteStore(settings.state_dir / "uploads.sqlite", busy_s=settings.busy_s)
    from camber.map_update.postgres_store import PostgresStore

    return PostgresStore(settings.store, password=_secret(settings.store_password), limit_s=settings.answer_s)


def _sending(settings: MapUpdateSettings) -> Sending:
    from camber.map_update.nats_queue import Sending

    assert settings.queue is not None
    password = _secret(settings.queue_password)
    return Sending(settings.queue, Shards(settings.shards), password=password, limit_s=settings.answer_s)


def _taking(settings: MapUpdateSettings) -> Taking:
    from camber.map_update.nats_queue import Taking

    assert settings.queue is not None
    password = _secret(settings.queue_password)
    return Taking(settings.queue, settings.shard or WORLD, password=password, limit_s=settings.answer_s)


def _secret(value: SecretStr | None) -> str | None:
    return None if value is None else value.get_secret_value()


SERVICE = MapUpdateService
