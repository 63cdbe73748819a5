"""Fetching beside the work loop, so that neither the bus nor the disk delays an answer: when to ask whom, and again."""

from __future__ import annotations

import queue
import random
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from camber.map_server.release_download import Fetching, FolderSupplier, NoAnswer, Supplier, Where, Wishes
from camber.road_map.release import ReleaseError
from camber.road_map.store import MapStore, StoreFull

SHORTEST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 60.0
_IDLE_S = 1.0

Problem = tuple[str, str]
"""A code and a text, as `Bus.issue` takes them."""


@dataclass(frozen=True)
class Times:
    """How often to ask the cloud; `spread_s`: a notice reaches a whole fleet, which does not ask all at once."""

    ask_every_s: float
    spread_s: float
    retry_every_s: float


_NEVER_LOOKED_AT = object()


class Rounds:
    """What to do when: no thread, no clock; `step` is told the time (monotonic, in seconds)."""

    def __init__(
        self,
        store: MapStore,
        fetching: Fetching,
        where: Where,
        *,
        cloud: Supplier,
        folder: FolderSupplier | None,
        times: Times,
        rng: random.Random,
    ) -> None:
        self.problems: queue.SimpleQueue[Problem] = queue.SimpleQueue()
        self.troubled = False
        self.noticed = False
        self.damaged = False
        self._store = store
        self._fetching = fetching
        self._where = where
        self._cloud = cloud
        self._folder = folder
        self._times = times
        self._rng = rng
        self._folder_stamp: object | None = _NEVER_LOOKED_AT
        self._complete = False
        self._failures = 0
        self._ask_at_s = self._fetch_at_s = float("-inf")
        self._looked_at: object | None = None
        self._stamp = store.stamp()

    def step(self, now_s: float, going_on: Callable[[], bool], changed: Callable[[], None]) -> float:
        """Do what is due while `going_on`; `changed` is told of a release put in force. Returns how long to wait."""
        if self.noticed:
            self.noticed = False
            # A hint that anyone may give: it brings the question forward, and does no more.
            self._ask_at_s = min(self._ask_at_s, now_s + self._rng.random() * self._times.spread_s)
        if self.damaged:
            self.damaged = self._complete = False
            self._guarded(self._cloud, lambda: self._fetching.drop_damaged(), now_s)
        if self._where.point_rad is not None and self._fetching.tile() != self._looked_at:
            self._looked_at, self._complete = self._fetching.tile(), False
        if self._folder is not None and self._folder.stamp() != self._folder_stamp:
            self._folder_stamp, folder = self._folder.stamp(), self._folder
            if self._folder_stamp is None and self._store.stamp() is None:
                self.problems.put(("release_absent", f"{folder.name}: no release there, and none in force"))
            if self._folder_stamp is not None:
                self._guarded(folder, lambda: self._bring(folder, True, going_on, changed), now_s)
        asks = now_s >= self._ask_at_s
        if asks or (not self._complete and now_s >= self._fetch_at_s):
            self._guarded(self._cloud, lambda: self._bring(self._cloud, asks, going_on, changed), now_s)
        self._tell(changed)
        due_s = self._ask_at_s if self._complete else min(self._ask_at_s, self._fetch_at_s)
        return min(max(due_s - now_s, 0.0), _IDLE_S)

    def _bring(
        self, supplier: Supplier, asks: bool, going_on: Callable[[], bool], changed: Callable[[], None]
    ) -> None:
        if asks:
            self._complete &= not self._fetching.ask(supplier)
        if self._complete and supplier is self._cloud:
            return
        for _ in self._fetching.fetch(supplier):
            self._tell(changed)
            if not going_on():
                return
        self._complete = True

    def _guarded(self, supplier: Supplier, work: Callable[[], None], now_s: float) -> None:
        """What goes wrong is said, and the same is tried again later; the release in force stays."""
        every_s = self._times.ask_every_s
        try:
            work()
        except NoAnswer as error:
            if supplier is self._cloud:
                self._failures += 1
                longest_s = min(LONGEST_PAUSE_S, SHORTEST_PAUSE_S * 2.0 ** min(self._failures, 16))
                self._ask_at_s = self._fetch_at_s = now_s + longest_s * (0.5 + 0.5 * self._rng.random())
                self.problems.put(("fetch_unanswered", str(error)))
        except StoreFull as error:
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

    def _tell(self, changed: Callable[[], None]) -> None:
        with suppress(ReleaseError):
            stamp = self._store.stamp()
            if stamp != self._stamp:
                self._stamp = stamp
                changed()


class FetchThread:
    """Runs the rounds, with a store of its own on the same file. All methods are called from the work loop."""

    def __init__(
        self,
        open_store: Callable[[], MapStore],
        wishes: Wishes,
        *,
        cloud: Supplier,
        folder: FolderSupplier | None,
        times: Times,
        now_ns: Callable[[], int],
        monotonic_s: Callable[[], float],
        wake: Callable[[], None],
    ) -> None:
        self._where = Where()
        self._problems: queue.SimpleQueue[Problem] = queue.SimpleQueue()
        self._waking = threading.Event()
        self._changed = threading.Event()
        self._stopping = False
        self._rounds: Rounds | None = None
        self._fetching: Fetching | None = None

        def changed() -> None:
            self._changed.set()
            wake()

        def run() -> None:
            try:
                store = open_store()
            except ReleaseError as error:  # the work loop has said so of the same file
                self._problems.put(("store_unusable", str(error)))
                return
            fetching = self._fetching = Fetching(store, wishes, self._where, now_ns=now_ns)
            fetching.in_use = self._in_use
            rounds = self._rounds = Rounds(
                store, fetching, self._where, cloud=cloud, folder=folder, times=times, rng=random.Random()
            )
            while not self._stopping:
                self._waking.clear()
                try:
                    delay_s = rounds.step(monotonic_s(), lambda: not self._stopping, changed)
                except (
                    Exception
                ) as error:  # the thread must outlive whatever it meets: nobody would restart it
                    self._problems.put(("fetch_failed", f"{type(error).__name__}: {error}"))
                    delay_s = _IDLE_S
                self._waking.wait(delay_s)
            store.close()

        self._in_use: int | None = None
        self._thread = threading.Thread(target=run, name="fetching", daemon=True)

    def start(self, in_use: int | None) -> None:
        """Begin; `in_use` is the version that the work loop reads."""
        self._in_use = in_use
        self._thread.start()

    def uses(self, map_version: int) -> None:
        """The work loop reads this version now: what only older ones need may go."""
        self._in_use = map_version
        if self._fetching is not None:
            self._fetching.in_use = map_version

    def near(self, latitude_rad: float, longitude_rad: float) -> None:
        """The vehicle is about here."""
        self._where.point_rad = latitude_rad, longitude_rad

    def notice(self) -> None:
        """There is a newer release, or somebody says so."""
        if self._rounds is not None:
            self._rounds.noticed = True
            self._waking.set()

    def repair(self) -> None:
        """A blob could not be read as it was written: look for all such, and fetch them again."""
        if self._rounds is not None:
            self._rounds.damaged = True
            self._waking.set()

    def has_changed(self) -> bool:
        """Has a release been put in force since this was last asked?"""
        changed = self._changed.is_set()
        self._changed.clear()
        return changed

    def troubled(self) -> bool:
        """Is something in the way of fetching that does not pass by itself?"""
        return self._rounds is not None and self._rounds.troubled

    def counts(self) -> tuple[int, int]:
        """Bytes and blobs fetched so far."""
        return (
            (0, 0) if self._fetching is None else (self._fetching.fetched_bytes, self._fetching.fetched_blobs)
        )

    def problems(self) -> list[Problem]:
        """What has happened since this was last asked."""
        queues = [self._problems] + ([] if self._rounds is None else [self._rounds.problems])
        return [each.get() for each in queues for _ in range(each.qsize())]

    def close(self, timeout_s: float = 1.0) -> None:
        """Fetch no more; what has come stays."""
        self._stopping = True
        self._waking.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)
