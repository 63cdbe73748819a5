"""Background download of releases, so that neither bus nor disk delays a reply; schedule, retries and the thread."""

from __future__ import annotations

import queue
import random
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from camber.map_server.release_download import (
    FetchRequest,
    FolderSupplier,
    ReleaseDownload,
    ReleaseSupplier,
    SupplierUnavailableError,
    VehiclePosition,
)
from camber.road_map.release import ReleaseError
from camber.road_map.store import MapStore, StoreFullError

# Exponential backoff after a query without reply; chosen: a restart of map_update costs seconds at most.
SHORTEST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 60.0
_IDLE_S = 1.0  # chosen: how often position and folder are checked

Problem = tuple[str, str]
"""A code and a text, as `Bus.issue` takes them."""


@dataclass(frozen=True, kw_only=True)
class DownloadIntervals:
    """Intervals of queries; `spread_s`: random delay after a notice, which a whole fleet receives at once."""

    ask_every_s: float
    spread_s: float
    retry_every_s: float


_UNSEEN = object()


class DownloadScheduler:
    """Schedule of queries and downloads without thread or clock; `step` gets the monotonic time in seconds."""

    def __init__(
        self,
        store: MapStore,
        download: ReleaseDownload,
        position: VehiclePosition,
        *,
        cloud: ReleaseSupplier,
        folder: FolderSupplier | None,
        times: DownloadIntervals,
        rng: random.Random,
    ) -> None:
        self.problems: queue.SimpleQueue[Problem] = queue.SimpleQueue()
        self.troubled = False
        self.noticed = False
        self.damaged = False
        self._store = store
        self._download = download
        self._position = position
        self._cloud = cloud
        self._folder = folder
        self._times = times
        self._rng = rng
        self._folder_stamp: object | None = _UNSEEN
        self._complete = False
        self._failures = 0
        self._ask_at_s = self._fetch_at_s = float("-inf")
        self._looked_at: object | None = None
        self._stamp = store.stamp()

    def step(self, now_s: float, going_on: Callable[[], bool], changed: Callable[[], None]) -> float:
        """Do what is due while `going_on`; calls `changed` after an activation. Returns the time to wait [s]."""
        if self.noticed:
            self.noticed = False
            # Not authenticated: it only brings the next query forward.
            self._ask_at_s = min(self._ask_at_s, now_s + self._rng.random() * self._times.spread_s)
        if self.damaged:
            self.damaged = self._complete = False
            self._guarded(self._cloud, lambda: self._download.drop_damaged(), now_s)
        if self._position.point_rad is not None and self._download.tile() != self._looked_at:
            self._looked_at, self._complete = self._download.tile(), False
        if self._folder is not None and self._folder.stamp() != self._folder_stamp:
            self._folder_stamp, folder = self._folder.stamp(), self._folder
            if self._folder_stamp is None and self._store.stamp() is None:
                self.problems.put(("release_absent", f"{folder.name}: no release there, and none in force"))
            if self._folder_stamp is not None:
                self._guarded(folder, lambda: self._bring(folder, True, going_on, changed), now_s)
        asks = now_s >= self._ask_at_s
        if asks or (not self._complete and now_s >= self._fetch_at_s):
            self._guarded(self._cloud, lambda: self._bring(self._cloud, asks, going_on, changed), now_s)
        self._report_change(changed)
        due_s = self._ask_at_s if self._complete else min(self._ask_at_s, self._fetch_at_s)
        return min(max(due_s - now_s, 0.0), _IDLE_S)

    def _bring(
        self, supplier: ReleaseSupplier, asks: bool, going_on: Callable[[], bool], changed: Callable[[], None]
    ) -> None:
        if asks:
            self._complete &= not self._download.ask(supplier)
        if self._complete and supplier is self._cloud:
            return
        for _ in self._download.fetch(supplier):
            self._report_change(changed)
            if not going_on():
                return
        self._complete = True

    def _guarded(self, supplier: ReleaseSupplier, work: Callable[[], None], now_s: float) -> None:
        """Run `work`; report errors and schedule a retry. The active release remains."""
        every_s = self._times.ask_every_s
        try:
            work()
        except SupplierUnavailableError as error:
            if supplier is self._cloud:
                self._failures += 1
                longest_s = min(LONGEST_PAUSE_S, SHORTEST_PAUSE_S * 2.0 ** min(self._failures, 16))
                self._ask_at_s = self._fetch_at_s = now_s + longest_s * (0.5 + 0.5 * self._rng.random())
                self.problems.put(("fetch_unanswered", str(error)))
        except StoreFullError as error:
            self._trouble("store_full", error, now_s)
        except ReleaseError as error:
            self._trouble("release_refused", error, now_s)
        else:
            if supplier is self._cloud:
                self._failures, self.troubled = 0, False
                self._fetch_at_s = float("-inf")
                self._ask_at_s = now_s + every_s * (0.5 + 0.5 * self._rng.random())

    def _trouble(self, code: str, error: ReleaseError, now_s: float) -> None:
        self.troubled = True
        self.problems.put((code, str(error)))
        self._ask_at_s = self._fetch_at_s = now_s + self._times.retry_every_s

    def _report_change(self, changed: Callable[[], None]) -> None:
        with suppress(ReleaseError):
            stamp = self._store.stamp()
            if stamp != self._stamp:
                self._stamp = stamp
                changed()


class DownloadThread:
    """Runs the schedule with its own connection to the store. All methods are called from the work loop."""

    def __init__(
        self,
        open_store: Callable[[], MapStore],
        request: FetchRequest,
        *,
        cloud: ReleaseSupplier,
        folder: FolderSupplier | None,
        times: DownloadIntervals,
        now_ns: Callable[[], int],
        monotonic_s: Callable[[], float],
        wake: Callable[[], None],
    ) -> None:
        self._position = VehiclePosition()
        self._problems: queue.SimpleQueue[Problem] = queue.SimpleQueue()
        self._waking = threading.Event()
        self._changed = threading.Event()
        self._stopping = False
        self._scheduler: DownloadScheduler | None = None
        self._download: ReleaseDownload | None = None

        def changed() -> None:
            self._changed.set()
            wake()

        def run() -> None:
            try:
                store = open_store()
            except ReleaseError as error:
                self._problems.put(("store_unusable", str(error)))
                return
            download = self._download = ReleaseDownload(store, request, self._position, now_ns=now_ns)
            download.in_use = self._in_use
            scheduler = self._scheduler = DownloadScheduler(
                store, download, self._position, cloud=cloud, folder=folder, times=times, rng=random.Random()
            )
            while not self._stopping:
                self._waking.clear()
                try:
                    delay_s = scheduler.step(monotonic_s(), lambda: not self._stopping, changed)
                except Exception as error:  # the thread must survive any error: nothing would restart it
                    self._problems.put(("fetch_failed", f"{type(error).__name__}: {error}"))
                    delay_s = _IDLE_S
                self._waking.wait(delay_s)
            store.close()

        self._in_use: int | None = None
        self._thread = threading.Thread(target=run, name="fetching", daemon=True)

    def start(self, in_use: int | None) -> None:
        """Start; `in_use` is the version that the work loop reads."""
        self._in_use = in_use
        self._thread.start()

    def uses(self, map_version: int) -> None:
        """Report the version that the work loop reads now; blobs of older ones may be deleted."""
        self._in_use = map_version
        if self._download is not None:
            self._download.in_use = map_version

    def near(self, latitude_rad: float, longitude_rad: float) -> None:
        """Report the position of the vehicle."""
        self._position.point_rad = latitude_rad, longitude_rad

    def notice(self) -> None:
        """Query for a newer release soon, after a notice."""
        if self._scheduler is not None:
            self._scheduler.noticed = True
            self._waking.set()

    def repair(self) -> None:
        """Find damaged blobs and download them again."""
        if self._scheduler is not None:
            self._scheduler.damaged = True
            self._waking.set()

    def take_change(self) -> bool:
        """Return whether a release was activated since the last call."""
        changed = self._changed.is_set()
        self._changed.clear()
        return changed

    def troubled(self) -> bool:
        """Whether a persistent error prevents downloads."""
        return self._scheduler is not None and self._scheduler.troubled

    def counts(self) -> tuple[int, int]:
        """Return the bytes and blobs downloaded so far."""
        download = self._download
        return (0, 0) if download is None else (download.fetched_bytes, download.fetched_blobs)

    def take_problems(self) -> list[Problem]:
        """Return the problems since the last call."""
        queues = [self._problems] + ([] if self._scheduler is None else [self._scheduler.problems])
        return [each.get() for each in queues for _ in range(each.qsize())]

    def close(self, timeout_s: float = 1.0) -> None:
        """Stop; downloaded blobs remain."""
        self._stopping = True
        self._waking.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)
