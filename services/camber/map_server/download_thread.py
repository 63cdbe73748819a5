"""Background download of releases, so that neither bus nor disk delays a reply: schedule and retries."""

from __future__ import annotations

import queue
import random
import threading
from collections.abc import Callable
from contextlib import suppress

from camber.map_server.release_download import (
    FolderSupplier,
    ReleaseDownload,
    ReleaseSupplier,
    SupplierUnavailableError,
)
from camber.road_map.release import ReleaseError
from camber.road_map.store import StoreFullError

# Exponential backoff after a query without reply; chosen: a restart of map_update costs seconds at most.
SHORTEST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 60.0
_IDLE_S = 1.0  # chosen: how often position and folder are checked

Problem = tuple[str, str]
"""A code and a text, as `Bus.issue` takes them."""
_UNSEEN = object()


class DownloadThread(threading.Thread):
    """Queries for newer releases and downloads them; `step` is one iteration. Other methods are of the work loop.

    `spread_s`: random delay after a notice, which a whole fleet receives at once. `wake` is called after an activation.
    """

    def __init__(
        self,
        download: ReleaseDownload,
        *,
        cloud: ReleaseSupplier,
        folder: FolderSupplier | None,
        ask_every_s: float,
        spread_s: float,
        retry_every_s: float,
        monotonic_s: Callable[[], float],
        wake: Callable[[], None] = lambda: None,
        rng: random.Random | None = None,
    ) -> None:
        super().__init__(name="fetching", daemon=True)
        self.troubled = False
        """Whether a persistent error prevents downloads."""
        self._download, self._store = download, download.store
        self._cloud, self._folder = cloud, folder
        self._ask_every_s, self._spread_s, self._retry_every_s = ask_every_s, spread_s, retry_every_s
        self._monotonic_s, self._wake, self._rng = monotonic_s, wake, rng or random.Random()
        self._problems: queue.SimpleQueue[Problem] = queue.SimpleQueue()
        self._waking = threading.Event()
        self._stopping = self._noticed = self._damaged = self._changed = False
        self._complete = False
        self._failures = 0
        self._ask_at_s = self._fetch_at_s = float("-inf")
        self._folder_stamp: object | None = _UNSEEN
        self._last_tile: object | None = None
        self._stamp = self._store.stamp()

    def run(self) -> None:
        """Step until `close`."""
        while not self._stopping:
            self._waking.clear()
            try:
                delay_s = self.step(self._monotonic_s())
            except Exception as error:  # the thread must survive any error: nothing would restart it
                self._problems.put(("fetch_failed", f"{type(error).__name__}: {error}"))
                delay_s = _IDLE_S
            self._waking.wait(delay_s)
        self._store.close()

    def notice(self) -> None:
        """Query for a newer release soon, after a notice."""
        self._noticed = True
        self._waking.set()

    def repair(self) -> None:
        """Find damaged blobs and download them again."""
        self._damaged = True
        self._waking.set()

    def take_change(self) -> bool:
        """Return whether a release was activated since the last call."""
        changed, self._changed = self._changed, False
        return changed

    def take_problems(self) -> list[Problem]:
        """Return the problems since the last call."""
        return [self._problems.get() for _ in range(self._problems.qsize())]

    def close(self, timeout_s: float = 1.0) -> None:
        """Stop; downloaded blobs remain."""
        self._stopping = True
        self._waking.set()
        if self.is_alive():
            self.join(timeout_s)

    def step(self, now_s: float) -> float:
        """Do what is due at a monotonic time; returns the time to wait [s]."""
        if self._noticed:
            self._noticed = False
            # Not authenticated: it only brings the next query forward.
            self._ask_at_s = min(self._ask_at_s, now_s + self._rng.random() * self._spread_s)
        if self._damaged:
            self._damaged = self._complete = False
            self._guarded(self._cloud, self._download.drop_damaged, now_s)
        if self._download.position_rad is not None and self._download.tile() != self._last_tile:
            self._last_tile, self._complete = self._download.tile(), False
        if self._folder is not None and self._folder.stamp() != self._folder_stamp:
            self._folder_stamp, folder = self._folder.stamp(), self._folder
            if self._folder_stamp is not None:
                self._guarded(folder, lambda: self._bring(folder, asks=True), now_s)
            elif self._store.stamp() is None:
                self._problems.put(("release_absent", f"{folder.name}: no release there, and none in force"))
        asks = now_s >= self._ask_at_s
        if asks or (not self._complete and now_s >= self._fetch_at_s):
            self._guarded(self._cloud, lambda: self._bring(self._cloud, asks=asks), now_s)
        self._report_change()
        due_s = self._ask_at_s if self._complete else min(self._ask_at_s, self._fetch_at_s)
        return min(max(due_s - now_s, 0.0), _IDLE_S)

    def _bring(self, supplier: ReleaseSupplier, *, asks: bool) -> None:
        if asks:
            self._complete &= not self._download.ask(supplier)
        if self._complete and supplier is self._cloud:
            return
        for _ in self._download.fetch(supplier):
            self._report_change()
            if self._stopping:
                return
        self._complete = True

    def _guarded(self, supplier: ReleaseSupplier, work: Callable[[], None], now_s: float) -> None:
        """Run `work`; report errors and schedule a retry. The active release remains."""
        try:
            work()
        except SupplierUnavailableError as error:
            if supplier is self._cloud:
                self._failures += 1
                longest_s = min(LONGEST_PAUSE_S, SHORTEST_PAUSE_S * 2.0 ** min(self._failures, 16))
                self._ask_at_s = self._fetch_at_s = now_s + longest_s * (0.5 + 0.5 * self._rng.random())
                self._problems.put(("fetch_unanswered", str(error)))
        except ReleaseError as error:
            self.troubled = True
            code = "store_full" if isinstance(error, StoreFullError) else "release_refused"
            self._problems.put((code, str(error)))
            self._ask_at_s = self._fetch_at_s = now_s + self._retry_every_s
        else:
            if supplier is self._cloud:
                self._failures, self.troubled = 0, False
                self._fetch_at_s = float("-inf")
                self._ask_at_s = now_s + self._ask_every_s * (0.5 + 0.5 * self._rng.random())

    def _report_change(self) -> None:
        with suppress(ReleaseError):
            stamp = self._store.stamp()
            if stamp != self._stamp:
                self._stamp, self._changed = stamp, True
                self._wake()
