"""Wires uploads to the store: commit all that have arrived, then acknowledge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from camber.map_update.admission import Refusal, refusal
from camber.map_update.contribution import Contribution, from_batch, from_upload
from camber.map_update.settings import MapUpdateSettings
from camber.map_update.sqlite_store import SqliteStore
from camber.map_update.store import Outcome, StoreError
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.runtime.settings import ServiceSettings
from camber.schemas.base import EARLIEST_NS, Message
from camber.schemas.fleet import UploadReceipt


class MapUpdateService(Service[MapUpdateSettings]):
    """Uploads of a fleet, each kept once. Without a commit there is no receipt, and the vehicle asks again."""

    NAME: ClassVar[str] = "map_update"
    SETTINGS: ClassVar[type[ServiceSettings]] = MapUpdateSettings

    def __init__(self, settings: MapUpdateSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._rules = settings.rules()
        self._store = SqliteStore(settings.state_dir / "uploads.sqlite", busy_s=settings.busy_s)
        self._stores = True

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """Uploads one by one, and in batches."""
        return {
            "upload": lambda uploads: self._receive([from_upload(upload) for upload in uploads]),
            "upload_batch": lambda batches: self._receive([from_batch(batch) for batch in batches]),
        }

    def healthy(self) -> bool:
        """Could the last group be stored?"""
        return self._stores

    def close(self) -> None:
        """Close the store."""
        self._store.close()

    def _receive(self, contributions: Sequence[Contribution]) -> Sequence[Message | None]:
        now_ns = self.bus.now_ns()
        if now_ns < EARLIEST_NS:
            # A refusal is for ever; one that does not know the time cannot judge times.
            self.bus.issue("time_not_known", f"{len(contributions)} uploads not acknowledged")
            return [None] * len(contributions)

        def judge(contribution: Contribution) -> Refusal | None:
            return refusal(contribution, now_ns, self._rules)

        try:
            outcomes = self._store.commit(contributions, now_ns, judge)
        except StoreError as error:
            self._stores = False
            self.bus.count("unacknowledged", len(contributions))
            self.bus.issue("store_unavailable", str(error))
            return [None] * len(contributions)
        self._stores = True
        return [self._receipt(*pair, now_ns) for pair in zip(contributions, outcomes, strict=True)]

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


SERVICE = MapUpdateService
