"""Wires uploads to the store, the store to the fusion, and the fusion's releases to the map servers."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
from pydantic import SecretStr

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_update.admission import check, check_vehicle
from camber.map_update.contribution import Contribution, from_batch, from_upload
from camber.map_update.fusion.pipeline import Fusion
from camber.map_update.fusion.publication_decision import DECISIONS, REASONS
from camber.map_update.fusion.votes import check_secret
from camber.map_update.queue.queue_messages import QueuedContribution, QueueError
from camber.map_update.release.fusion_cycle import FusionCycle, FusionDecision, IngestResult
from camber.map_update.release.operator_decisions import UnrecordedError
from camber.map_update.release.release_builder import ReleaseBuilder
from camber.map_update.settings import MapUpdateSettings
from camber.map_update.stores.shards import WORLD, Shards
from camber.map_update.stores.sqlite_store import SqliteStore
from camber.map_update.stores.store import OvertakenError, Store, StoreError
from camber.map_update.stores.upload_deduplication import Outcome
from camber.map_update.warm_up import FUNCTIONS, warm_up
from camber.road_map.operator_keys import load_operator_keys
from camber.road_map.release import ReleaseError, load_signing_key, read_release
from camber.road_map.release_server import ReleaseServer
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from camber.runtime.uploads.received_upload import ReceivedUpload
from camber.schemas.base import EARLIEST_NS, Message
from camber.schemas.fleet import (
    MapChanges,
    MapChangesRequest,
    MapDecision,
    MapDecisionReceipt,
    MapVotes,
    MapVotesRequest,
    UploadReceipt,
)
from camber.schemas.plain_file import read_plain_file

if TYPE_CHECKING:
    from camber.map_update.queue.nats_queue import QueueReceiver, QueueSender

T = TypeVar("T")

# Chosen: a lost connection shows in health within seconds; deletions are spread over the day; reading a reference may
# take seconds without replies, so a failed start is repeated each minute.
_CHECK_NS = 2 * 1_000_000_000
_FORGET_NS = 60 * 1_000_000_000
_RESTART_NS = 60 * 1_000_000_000
_FORGET_ROWS = 1000
"""Chosen: rows deleted at a time, because uploads wait meanwhile."""
_MOST_KEY_BYTES = 1 << 10  # chosen: far more than a key has
_VOTERS_KEY_BYTES = 32
"""Length of a new key of pseudonyms: 256 bits."""
UNAVAILABLE_ISSUES = {
    # A full disk may still answer reads, so a failed commit stays an issue until the next commit succeeds.
    "store": "store_unavailable",
    "commit": "store_unavailable",
    "queue": "queue_unavailable",
    "fusion": "fusion_stopped",
}


class MapUpdateService(Service[MapUpdateSettings]):
    """Stores each upload of a fleet once, and makes releases of the map from them.

    Without a commit there is no receipt, and the vehicle sends again. The role decides whether one worker does all of
    it, or only a part, with a queue or a database to the workers that do the rest.
    """

    NAME: ClassVar[str] = "map_update"
    SETTINGS: ClassVar[type[ServiceSettings]] = MapUpdateSettings

    @classmethod
    def state_folder(cls, settings: MapUpdateSettings) -> Path | None:
        """None: workers may share it; the store's transactions and the lock of the releases keep them apart."""
        return None

    @classmethod
    def prepare(cls, settings: MapUpdateSettings) -> None:
        """Compile the fusion before the service joins the bus."""
        if settings.reference is not None:
            warm_up()

    @classmethod
    def compiled_functions(cls, settings: MapUpdateSettings) -> int:
        """Those of the warm-up."""
        return FUNCTIONS if settings.reference is not None else 0

    def __init__(self, settings: MapUpdateSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._unavailable: set[str] = set()
        self._checked_ns = self._forgot_ns = 0
        self._started_ns = bus.now_ns()
        self._sender, self._receiver = _queue(settings)
        self._store = _open_store(settings) if settings.role != "receive" else None
        self._cycle: FusionCycle | None = None
        self._serving = None
        if settings.reference is not None and self._store is not None:
            self._serving = ReleaseServer(_releases_folder(settings))
            self._start_fusion(settings.reference, self._store)
        self._announced_version = -1
        self._changes: MapChanges | None = None

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """Uploads one by one and in batches; the root and the blobs of releases; changes of the map."""
        served: dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]] = {}
        if self._serving is not None:
            served = self._serving.answers(self.bus.now_ns)
            served["map_changes"] = lambda requests: [self._map_changes(request) for request in requests]
            served["map_votes"] = lambda requests: [self._map_votes(request) for request in requests]
            served["map_decision"] = lambda requests: [self._map_decision(request) for request in requests]
        if self.settings.role in ("store", "fuse"):
            return served
        return served | {
            "upload": lambda uploads: self._receive(uploads, from_upload),
            "upload_batch": lambda batches: self._receive(batches, from_batch),
        }

    def advance(self, now_ns: int) -> None:
        """Store what the queue delivered, fuse, delete what is too old, and check the connections."""
        if self._receiver is not None and self._store is not None:
            self._store_from_queue(self._receiver, self._store)
        if self._cycle is not None and now_ns >= EARLIEST_NS:
            self._fuse(self._cycle, now_ns)
        if now_ns - self._checked_ns >= _CHECK_NS:
            self._checked_ns = now_ns
            for name, part in (("store", self._store), ("queue", self._sender or self._receiver)):
                if part is not None:
                    self._attempt(name, part.check)
        waits = 0 <= now_ns - self._started_ns < _RESTART_NS
        reference = self.settings.reference
        if self._cycle is None and reference is not None and self._store is not None and not waits:
            self._started_ns = now_ns
            self._start_fusion(reference, self._store)
        if self._store is not None and now_ns - self._forgot_ns >= _FORGET_NS:
            self._forgot_ns = now_ns
            self._forget(self._store, now_ns)

    def healthy(self) -> bool:
        """Return whether store and queue are available and the last group was stored."""
        return not self._unavailable

    def gauges(self) -> dict[str, float]:
        """Messages waiting on the queue's server, if this worker receives from it."""
        waiting = None if self._receiver is None else self._receiver.waiting
        return {} if waiting is None else {"queue_waiting": float(waiting)}

    def facts(self) -> dict[str, str]:
        """Return the role and the release last announced to vehicles."""
        release = {} if self._announced_version < 0 else {"map_release": f"{self._announced_version}"}
        return {"role": self.settings.role, **release}

    def close(self) -> None:
        """Close the store, leave the queue."""
        for part in (self._sender, self._receiver, self._store):
            if part is not None:
                part.close()

    def _receive(
        self, uploads: Sequence[ReceivedUpload], to_contribution: Callable[[Any], Contribution]
    ) -> list[Message | None]:
        now_ns = self.bus.now_ns()
        if now_ns < EARLIEST_NS:
            # A refusal is final, and without a valid clock times cannot be checked.
            self.bus.issue("time_not_known", f"{len(uploads)} uploads not acknowledged")
            return [None] * len(uploads)
        contributions = [to_contribution(upload.message) for upload in uploads]
        # Another vehicle's name is refused before the ledger is consulted: it could occupy that vehicle's ids.
        outcomes: list[Outcome | None] = [
            None if refusal is None else Outcome("refused", refusal)
            for refusal in map(check_vehicle, (upload.vehicle for upload in uploads), contributions)
        ]
        accepted = [c for c, outcome in zip(contributions, outcomes, strict=True) if outcome is None]
        stored = iter(self._store_or_forward(accepted, now_ns) if accepted else ())
        outcomes = [next(stored) if outcome is None else outcome for outcome in outcomes]
        if missed := outcomes.count(None):
            self.bus.count("unacknowledged", missed)
        return [
            None if outcome is None else self._receipt(contribution, outcome, now_ns)
            for contribution, outcome in zip(contributions, outcomes, strict=True)
        ]

    def _store_or_forward(
        self, contributions: Sequence[Contribution], now_ns: int
    ) -> Sequence[Outcome | None]:
        """Return the outcomes; contributions are checked as a whole, before parts go to different shards."""
        refusals = check(contributions, now_ns, self.settings)
        if (cycle := self._cycle) is not None:
            refusals = [
                refusal or cycle.refusal(contribution)
                for contribution, refusal in zip(contributions, refusals, strict=True)
            ]
        queued = [QueuedContribution(*pair) for pair in zip(contributions, refusals, strict=True)]
        sender = self._sender
        outcomes = self._commit(queued, now_ns) if sender is None else self._forward(sender, queued)
        return outcomes or [None] * len(contributions)

    def _commit(self, queued: Sequence[QueuedContribution], now_ns: int) -> list[Outcome] | None:
        store = self._store
        assert store is not None
        contributions = [item.contribution for item in queued]
        refusal_of = {id(item.contribution): item.refusal for item in queued}
        return self._attempt(
            "commit", lambda: store.commit(contributions, now_ns, lambda c: refusal_of[id(c)])
        )

    def _forward(
        self, sender: QueueSender, queued: Sequence[QueuedContribution]
    ) -> list[Outcome | None] | None:
        before = sender.too_large
        outcomes = self._attempt("queue", lambda: sender.send(queued))
        if sender.too_large > before:
            self.bus.issue(
                "too_large_for_queue", "raise max_payload of the queue's server, or lower most_records"
            )
        return outcomes

    def _store_from_queue(self, receiver: QueueReceiver, store: Store) -> None:
        """Commit what the queue delivered as one group, and request the next iteration at once."""
        self.bus.wake()
        deliveries = self._attempt("queue", lambda: receiver.take(self.settings.period_s))
        if receiver.damaged:
            self.bus.count("refused.damaged", receiver.damaged)
            receiver.damaged = 0
        if not deliveries:
            return
        queued = [item for delivery in deliveries for item in delivery.contributions]
        now_ns = self.bus.now_ns()
        outcomes = self._commit(queued, now_ns) if now_ns >= EARLIEST_NS else None
        if outcomes is None:
            self._attempt("queue", lambda: receiver.redeliver(deliveries))
            return
        rest = iter(outcomes)
        by_delivery = [[next(rest) for _ in delivery.contributions] for delivery in deliveries]
        self._attempt("queue", lambda: receiver.acknowledge(deliveries, by_delivery))
        for outcome in outcomes:
            self.bus.count(outcome.status)

    def _fuse(self, cycle: FusionCycle, now_ns: int) -> None:
        """Do one step of the fusion if one is due; the next in the following iteration of the work loop."""
        try:
            result = self._attempt("fusion", lambda: cycle.step(now_ns))
        except OvertakenError:  # by another worker on this database: the next step starts from what it wrote
            self.bus.count("overtaken")
            return
        if isinstance(result, IngestResult):
            self.bus.count("fused", result.observations)
            if result.other_datum:
                self.bus.count("not_fused.datum", result.other_datum)
            self.bus.wake()
        elif isinstance(result, FusionDecision):
            self._changes = cycle.changes(result, now_ns)
            self._report(result, now_ns)

    def _map_changes(self, request: MapChangesRequest) -> MapChanges:
        """The changes after the last fusion."""
        if self._changes is not None:
            return self._changes
        return MapChanges(time_ns=request.time_ns, status="unknown", reason="nothing has been fused yet")

    def _map_votes(self, request: MapVotesRequest) -> MapVotes:
        """The votes on a surface by day."""
        cycle = self._cycle
        if cycle is None:
            return _no_votes(request, "nothing is fused here")
        result = self._attempt("store", lambda: cycle.votes_over_time(request.surface_id, request.time_ns))
        return _no_votes(request, "the store cannot be read") if result is None else result

    def _map_decision(self, decision: MapDecision) -> MapDecisionReceipt:
        """Record an operator's decision, or say why not."""
        now_ns, cycle = self.bus.now_ns(), self._cycle
        if cycle is None or not cycle.is_of_this_map(decision):
            reason = "nothing is fused here" if cycle is None else "the map here has another reference"
            return MapDecisionReceipt(time_ns=now_ns, status="elsewhere", reason=reason)
        try:
            cycle.carry_out(decision, now_ns)
        except UnrecordedError as error:
            self.bus.issue("decision_refused", str(error))
            self.bus.wake()
            return MapDecisionReceipt(time_ns=now_ns, status="unrecorded", reason=str(error)[:512])
        except (ReleaseError, OSError) as error:
            reason = str(error)
        else:
            self.bus.count(f"operator.{decision.action}")
            self.bus.wake()
            return MapDecisionReceipt(time_ns=now_ns, status="recorded")
        self.bus.count("refused.decision")
        self.bus.issue("decision_refused", f"{decision.action}: {reason}")
        return MapDecisionReceipt(time_ns=now_ns, status="refused", reason=reason[:512])

    def _report(self, result: FusionDecision, now_ns: int) -> None:
        """Report decisions in health, and announce a release that is new or was not announced yet."""
        surfaces = result.decisions.surfaces
        for index, name in enumerate(DECISIONS):
            if name != "nothing" and (count := int((surfaces["decision"] == index).sum())):
                self.bus.count(f"decided.{name}", count)
        held = result.decisions.of("hold")
        if len(held):
            reasons = sorted({REASONS[reason] for reason in held["reason"].tolist()})
            self.bus.issue("changes_held", f"{len(held)} surfaces wait for review: {', '.join(reasons)}")
        for alarm in result.decisions.alarms:
            where = "everywhere" if alarm["region"] < 0 else "in one region"
            self.bus.issue(
                "common_shift",
                f"{alarm['share']:.0%} of {alarm['surfaces']} surfaces {where} moved by {alarm['shift_m']:+.3f} m: "
                "a base station, a datum or the survey, and not the roads",
            )
        if result.root.map_version != self._announced_version and self._serving is not None:
            self._announced_version = result.root.map_version
            self.bus.publish("release", self._serving.head(time_ns=now_ns))
        if result.is_new:
            self.bus.count("released")

    def _start_fusion(self, reference: Path, store: Store) -> None:
        """Start the fusion; if reference or key cannot be used, uploads are still stored and it is tried again."""
        self._cycle = self._attempt("fusion", lambda: _fusion_cycle(self.settings, reference, store))

    def _forget(self, store: Store, now_ns: int) -> None:
        before_ns = now_ns - round(self.settings.retention_days * NS_PER_DAY)
        forgotten = self._attempt("store", lambda: store.forget(before_ns, most=_FORGET_ROWS))
        if forgotten:
            self.bus.count("forgotten", forgotten)
        pruned = None
        if (ledger_s := self.settings.ledger_s) is not None:
            before_ns = now_ns - round(ledger_s * 1e9)
            pruned = self._attempt("store", lambda: store.prune(before_ns, most=_FORGET_ROWS))
        if pruned:
            self.bus.count("pruned", pruned)
        if _FORGET_ROWS in (forgotten, pruned):
            self._forgot_ns -= _FORGET_NS

    def _attempt(self, name: str, work: Callable[[], T]) -> T | None:
        """Return what `work` returns; None and an issue if store, queue or disk fail."""
        try:
            result = work()
        except OvertakenError:
            raise
        except (StoreError, QueueError, ReleaseError, OSError) as error:
            self._unavailable.add(name)
            self.bus.issue(UNAVAILABLE_ISSUES[name], str(error))
            return None
        self._unavailable.discard(name)
        return result

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


def _no_votes(request: MapVotesRequest, reason: str) -> MapVotes:
    none, zero = np.zeros(0, np.float32), np.zeros(0, np.int32)
    return MapVotes(
        time_ns=request.time_ns,
        status="unknown",
        reason=reason,
        day=zero,
        vehicles=zero,
        offset_m=none,
        low_m=none,
        high_m=none,
    )


def _open_store(settings: MapUpdateSettings) -> Store:
    if settings.store is None:
        return SqliteStore(settings.state_dir / "uploads.sqlite", busy_s=settings.busy_s)
    from camber.map_update.stores.postgres_store import PostgresStore

    return PostgresStore(settings.store, password=_secret(settings.store_password), limit_s=settings.answer_s)


def _releases_folder(settings: MapUpdateSettings) -> Path:
    return settings.releases or settings.state_dir / "releases"


def _fusion_cycle(settings: MapUpdateSettings, folder: Path, store: Store) -> FusionCycle:
    """Raises ReleaseError or OSError for a reference or a key that cannot be used."""
    key = None if settings.signing_key is None else load_signing_key(settings.signing_key)
    secret = _voters_key(settings.voters_key, settings.state_dir / "voters.key")
    reference = read_release(folder)
    fusion = Fusion(reference.road_surfaces(), secret, settings)
    builder = ReleaseBuilder(_releases_folder(settings), reference, signing_key=key)
    operators = None if settings.operator_keys is None else load_operator_keys(settings.operator_keys)
    return FusionCycle(
        store,
        fusion,
        builder,
        every_s=settings.fuse_every_s,
        most_records=settings.fuse_records,
        operators=operators,
    )


def _voters_key(path: Path | None, default: Path) -> bytes:
    """Return the key of pseudonyms, from `path` or from `default`, which is made atomically if missing."""
    try:
        if path is None and not default.exists():
            default.parent.mkdir(parents=True, exist_ok=True)
            temporary = default.with_name(f"{default.name}.{os.getpid()}.new")
            temporary.unlink(missing_ok=True)
            handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(handle, "wb") as file:
                file.write(os.urandom(_VOTERS_KEY_BYTES))
                file.flush()
                os.fsync(file.fileno())
            with suppress(FileExistsError):  # another worker was first: its key is used
                os.link(temporary, default)
            temporary.unlink()
        return check_secret(read_plain_file(path or default, _MOST_KEY_BYTES))
    except (OSError, ValueError) as error:
        raise ReleaseError(
            str(path or default), "voters' key", f"a file of 16 to 64 bytes ({error})"
        ) from None


def _queue(settings: MapUpdateSettings) -> tuple[QueueSender | None, QueueReceiver | None]:
    if settings.queue is None:
        return None, None
    from camber.map_update.queue.nats_queue import QueueReceiver, QueueSender

    password, limit_s = _secret(settings.queue_password), settings.answer_s
    if settings.role == "receive":
        return QueueSender(settings.queue, Shards(settings.shards), password=password, limit_s=limit_s), None
    return None, QueueReceiver(settings.queue, settings.shard or WORLD, password=password, limit_s=limit_s)


def _secret(value: SecretStr | None) -> str | None:
    return None if value is None else value.get_secret_value()


SERVICE = MapUpdateService
