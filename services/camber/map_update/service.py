"""Wires uploads to the store, the store to the fusion, and what that makes to whoever asks for releases."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from pydantic import SecretStr

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_update.admission import Refusal, other_name, refusals
from camber.map_update.contribution import Contribution, from_batch, from_upload
from camber.map_update.fusion.pipeline import Fusion
from camber.map_update.fusion.publication import DECISIONS, REASONS
from camber.map_update.fusion.votes import checked_secret
from camber.map_update.queue.queue_messages import QueuedContribution, QueueError
from camber.map_update.release.fusion_cycle import FusionCycle, FusionDecision, IngestResult
from camber.map_update.release.release_builder import ReleaseBuilder
from camber.map_update.settings import MapUpdateSettings
from camber.map_update.stores.shards import WORLD, Shards
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import Outcome, OvertakenError, Store, StoreError
from camber.map_update.warm_up import warm_up
from camber.road_map.release import ReleaseError, load_signing_key, read_release
from camber.road_map.release_server import ReleaseServer
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from camber.runtime.uploads.received import ReceivedUpload
from camber.schemas.base import EARLIEST_NS, Message
from camber.schemas.fleet import UploadReceipt

if TYPE_CHECKING:
    from camber.map_update.queue.nats_queue import QueueReceiver, QueueSender

T = TypeVar("T")

_NS = 1_000_000_000
_CHECK_NS = 2 * _NS
_FORGET_NS = 60 * _NS
_BEGIN_AGAIN_NS = 60 * _NS  # to read a reference may take seconds, in which nobody is answered
# A disk may be full for what is written and answer what is read: one that refused a commit is well after the next.
_UNAVAILABLE = {
    "store": "store_unavailable",
    "commit": "store_unavailable",
    "queue": "queue_unavailable",
    "fusion": "fusion_stopped",
}
_VOTERS_KEY_BYTES = 32


class MapUpdateService(Service[MapUpdateSettings]):
    """Uploads of a fleet, each kept once, and the releases of the map that come of them.

    Without a commit there is no receipt, and the vehicle asks again. By its role it does all, or only a part, with a
    queue or a database to those that do the others.
    """

    NAME: ClassVar[str] = "map_update"
    SETTINGS: ClassVar[type[ServiceSettings]] = MapUpdateSettings

    @classmethod
    def prepare(cls, settings: MapUpdateSettings) -> None:
        """Compile what fusing needs, before the bus is joined and anyone counts on answers."""
        if settings.reference is not None:
            warm_up()

    def __init__(self, settings: MapUpdateSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._rules = settings.rules()
        self._down: set[str] = set()
        self._checked_ns = self._forgot_ns = 0
        self._begun_ns = bus.now_ns()
        self._sending = _sending(settings) if settings.role == "receive" else None
        self._taking = _taking(settings) if settings.role == "store" else None
        self._store = _store(settings) if settings.role != "receive" else None
        self._rounds: FusionCycle | None = None
        self._serving = None
        if settings.reference is not None and self._store is not None:
            self._serving = ReleaseServer(_releases(settings))
            self._begin_fusion(settings.reference, self._store)
        self._told_version = -1

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """Uploads one by one and in batches; the root and the blobs of releases."""
        served = {} if self._serving is None else self._serving.answers(self.bus.now_ns)
        if self.settings.role in ("store", "fuse"):
            return served
        return served | {
            "upload": lambda uploads: self._from(uploads, from_upload),
            "upload_batch": lambda batches: self._from(batches, from_batch),
        }

    def advance(self, now_ns: int) -> None:
        """Store what the queue has brought, fuse, delete what is too old, and look after the connections."""
        if self._taking is not None and self._store is not None:
            self._store_from(self._taking, self._store, now_ns)
        if self._rounds is not None and now_ns >= EARLIEST_NS:
            self._fuse(self._rounds, now_ns)
        if now_ns - self._checked_ns >= _CHECK_NS:
            self._checked_ns = now_ns
            for name, part in (("store", self._store), ("queue", self._sending or self._taking)):
                if part is not None:
                    self._reached(name, part.check)
        waits = 0 <= now_ns - self._begun_ns < _BEGIN_AGAIN_NS
        reference = self.settings.reference
        if self._rounds is None and reference is not None and self._store is not None and not waits:
            self._begun_ns = now_ns
            self._begin_fusion(reference, self._store)
        if self._store is not None and now_ns - self._forgot_ns >= _FORGET_NS:
            self._forgot_ns = now_ns
            self._forget(self._store, now_ns)

    def healthy(self) -> bool:
        """Are store and queue there, and was the last group stored?"""
        return not self._down

    def gauges(self) -> dict[str, float]:
        """Messages that wait in the queue's server, where this worker takes from it."""
        waiting = None if self._taking is None else self._taking.waiting
        return {} if waiting is None else {"queue_waiting": float(waiting)}

    def facts(self) -> dict[str, str]:
        """Its part, and the release that vehicles are told of."""
        told = {} if self._told_version < 0 else {"map_release": f"{self._told_version}"}
        return {"role": self.settings.role, **told}

    def close(self) -> None:
        """Close the store, leave the queue."""
        for part in (self._sending, self._taking, self._store):
            if part is not None:
                part.close()

    def _from(
        self, uploads: Sequence[ReceivedUpload], contribution_of: Callable[[Any], Contribution]
    ) -> list[Message | None]:
        """One in another vehicle's name is refused before store and ledger see it: it could take that one's ids."""
        contributions = [contribution_of(upload.message) for upload in uploads]
        refused = [
            other_name(upload.vehicle, contribution)
            for upload, contribution in zip(uploads, contributions, strict=True)
        ]
        own = [c for c, why in zip(contributions, refused, strict=True) if why is None]
        receipts = iter(self._receive(own) if own else ())
        now_ns = self.bus.now_ns()
        if now_ns < EARLIEST_NS:
            return [None] * len(uploads)
        return [
            next(receipts) if why is None else self._receipt(contribution, Outcome("refused", why), now_ns)
            for contribution, why in zip(contributions, refused, strict=True)
        ]

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
            outcomes = self._committed(contributions, refusals(contributions, now_ns, self._rules), now_ns)
        outcomes = outcomes or [None] * len(contributions)
        if missed := sum(outcome is None for outcome in outcomes):
            self.bus.count("unacknowledged", missed)
        return [
            None if outcome is None else self._receipt(contribution, outcome, now_ns)
            for contribution, outcome in zip(contributions, outcomes, strict=True)
        ]

    def _committed(
        self, contributions: Sequence[Contribution], judged: Sequence[Refusal | None], now_ns: int
    ) -> list[Outcome] | None:
        store = self._store
        assert store is not None
        of = {id(contribution): why for contribution, why in zip(contributions, judged, strict=True)}
        return self._reached("commit", lambda: store.commit(contributions, now_ns, lambda c: of[id(c)]))

    def _handed_over(
        self, sending: QueueSender, contributions: Sequence[Contribution], now_ns: int
    ) -> list[Outcome | None] | None:
        """Judged here as a whole, before its parts go to different shards."""
        judged = refusals(contributions, now_ns, self._rules)
        parcels = [QueuedContribution(*pair) for pair in zip(contributions, judged, strict=True)]
        before = sending.too_large
        outcomes = self._reached("queue", lambda: sending.send(parcels))
        if sending.too_large > before:
            self.bus.issue(
                "too_large_for_queue", "raise max_payload of the queue's server, or lower most_records"
            )
        return outcomes

    def _store_from(self, taking: QueueReceiver, store: Store, now_ns: int) -> None:
        """One round: what has come is one commit. Asks for the next round at once."""
        self.bus.wake()
        deliveries = self._reached("queue", lambda: taking.take(self.settings.period_s))
        if taking.damaged:
            self.bus.count("refused.damaged", taking.damaged)
            taking.damaged = 0
        if not deliveries:
            return
        parcels = [parcel for delivery in deliveries for parcel in delivery.parcels]
        now_ns = self.bus.now_ns()
        outcomes = None
        if now_ns >= EARLIEST_NS:
            judged = [parcel.refusal for parcel in parcels]
            outcomes = self._committed([parcel.contribution for parcel in parcels], judged, now_ns)
        if outcomes is None:
            self._reached("queue", lambda: taking.again(deliveries))
            return
        rest = iter(outcomes)
        of_each = [[next(rest) for _ in delivery.parcels] for delivery in deliveries]
        self._reached("queue", lambda: taking.stored(deliveries, of_each))
        for outcome in outcomes:
            self.bus.count(outcome.status)

    def _fuse(self, rounds: FusionCycle, now_ns: int) -> None:
        """One step of the fusion, if one is due; more of it in the next round of the work loop."""
        try:
            done = self._reached("fusion", lambda: rounds.step(now_ns))
        except OvertakenError:  # by another worker of this database; what it has written is the new beginning
            self.bus.count("overtaken")
            return
        if isinstance(done, IngestResult):
            self.bus.count("fused", done.observations)
            if done.other_datum:
                self.bus.count("not_fused.datum", done.other_datum)
            self.bus.wake()
        elif isinstance(done, FusionDecision):
            self._tell(done, now_ns)

    def _tell(self, found: FusionDecision, now_ns: int) -> None:
        """Health of what was decided, and the notice of a release that is new, or that nobody was told of yet."""
        surfaces = found.decisions.surfaces
        for word, name in enumerate(DECISIONS):
            if name != "nothing" and (count := int((surfaces["decision"] == word).sum())):
                self.bus.count(f"decided.{name}", count)
        held = surfaces[surfaces["decision"] == DECISIONS.index("hold")]
        if len(held):
            reasons = sorted({REASONS[reason] for reason in held["reason"].tolist()})
            self.bus.issue("changes_held", f"{len(held)} surfaces wait for review: {', '.join(reasons)}")
        for alarm in found.decisions.alarms:
            where = "everywhere" if alarm["region"] < 0 else "in one region"
            self.bus.issue(
                "common_shift",
                f"{alarm['share']:.0%} of {alarm['surfaces']} surfaces {where} moved by {alarm['shift_m']:+.3f} m: "
                "a base station, a datum or the survey, and not the roads",
            )
        if found.root.map_version != self._told_version and self._serving is not None:
            self._told_version = found.root.map_version
            self.bus.publish("release", self._serving.head(time_ns=now_ns))
        if found.made:
            self.bus.count("released")

    def _begin_fusion(self, reference: Path, store: Store) -> None:
        """Where reference or key cannot be used, uploads are taken in all the same; tried again each minute."""
        self._rounds = self._reached("fusion", lambda: _rounds_of(self.settings, reference, store))

    def _forget(self, store: Store, now_ns: int) -> None:
        """Some at a time: uploads wait meanwhile."""
        before_ns = now_ns - round(self.settings.retention_days * NS_PER_DAY)
        forgotten = self._reached("store", lambda: store.forget(before_ns, most=1000))
        if forgotten:
            self.bus.count("forgotten", forgotten)
        pruned = None
        if (ledger_s := self.settings.ledger_s) is not None:
            pruned = self._reached("store", lambda: store.prune(now_ns - round(ledger_s * _NS), most=1000))
        if pruned:
            self.bus.count("pruned", pruned)
        if 1000 in (forgotten, pruned):
            self._forgot_ns -= _FORGET_NS

    def _reached(self, name: str, work: Callable[[], T]) -> T | None:
        """What `work` returns; None where store or queue is not there, which health then says until it is."""
        try:
            found = work()
        except OvertakenError:
            raise
        except (StoreError, QueueError, ReleaseError, OSError) as error:
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
    from camber.map_update.stores.postgres_store import PostgresStore

    return PostgresStore(settings.store, password=_secret(settings.store_password), limit_s=settings.answer_s)


def _releases(settings: MapUpdateSettings) -> Path:
    return settings.releases or settings.state_dir / "releases"


def _rounds_of(settings: MapUpdateSettings, folder: Path, store: Store) -> FusionCycle:
    """Raises ReleaseError or OSError for a reference or a key that cannot be used."""
    key = None if settings.signing_key is None else load_signing_key(settings.signing_key)
    secret = _voters_key(settings.voters_key, settings.state_dir / "voters.key")
    reference = read_release(folder)
    fusion = Fusion(reference.road_surfaces(), secret, settings.fusion_rules())
    making = ReleaseBuilder(_releases(settings), reference, signing_key=key)
    return FusionCycle(store, fusion, making, every_s=settings.fuse_every_s, most=settings.fuse_records)


def _voters_key(path: Path | None, own: Path) -> bytes:
    """The key of pseudonyms: of its file, or of one that is made once beside the store, whole or not at all."""
    try:
        if path is None and not own.exists():
            own.parent.mkdir(parents=True, exist_ok=True)
            making = own.with_name(f"{own.name}.{os.getpid()}.new")
            making.unlink(missing_ok=True)
            handle = os.open(making, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "wb") as file:
                file.write(os.urandom(_VOTERS_KEY_BYTES))
                file.flush()
                os.fsync(file.fileno())
            with suppress(FileExistsError):  # another worker was first: its key is the one
                os.link(making, own)
            making.unlink()
        return checked_secret((path or own).read_bytes())
    except (OSError, ValueError) as error:
        raise ReleaseError(str(path or own), "voters' key", f"a file of 16 to 64 bytes ({error})") from None


def _sending(settings: MapUpdateSettings) -> QueueSender:
    from camber.map_update.queue.nats_queue import QueueSender

    assert settings.queue is not None
    password = _secret(settings.queue_password)
    return QueueSender(settings.queue, Shards(settings.shards), password=password, limit_s=settings.answer_s)


def _taking(settings: MapUpdateSettings) -> QueueReceiver:
    from camber.map_update.queue.nats_queue import QueueReceiver

    assert settings.queue is not None
    password = _secret(settings.queue_password)
    return QueueReceiver(
        settings.queue, settings.shard or WORLD, password=password, limit_s=settings.answer_s
    )


def _secret(value: SecretStr | None) -> str | None:
    return None if value is None else value.get_secret_value()


SERVICE = MapUpdateService
