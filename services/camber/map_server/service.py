"""Wires the release on disk to the questions on the bus, and newer releases in the cloud to the disk."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_server.download_thread import FetchThread, Times
from camber.map_server.links import unknown_links
from camber.map_server.release_download import FolderSupplier, NoAnswer, Wishes
from camber.map_server.release_queries import ReleaseAnswers
from camber.map_server.settings import MapServerSettings
from camber.map_server.tile_parts import unknown_tile
from camber.map_server.warm_up import warm_up
from camber.road_map.release import BlobMissing, Release, ReleaseError, load_public_key
from camber.road_map.release_watch import ReleaseWatch
from camber.road_map.store import MapStore
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.service import Service
from camber.schemas.base import Message
from camber.schemas.codec import DecodeError, decode, encode
from camber.schemas.fleet import MapBlobReply, MapBlobRequest, MapRootReply, MapRootRequest, ReleaseHead
from camber.schemas.pose import Road, RoadReason
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    TileReply,
    TileRequest,
)

MessageT = TypeVar("MessageT", bound=Message)


class _DatumMismatchError(ReleaseError):
    """A good release whose datum is not the one expected."""


class MapServerService(Service[MapServerSettings]):
    """Answers elevation, links and tile; *unknown* wherever the map does not say."""

    NAME: ClassVar[str] = "map_server"
    SETTINGS: ClassVar[type[MapServerSettings]] = MapServerSettings

    @classmethod
    def prepare(cls, settings: MapServerSettings) -> None:
        """Compile what questions will need."""
        warm_up()

    def __init__(self, settings: MapServerSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        key = None if settings.public_key is None else load_public_key(settings.public_key)
        self._store: MapStore | None = None if settings.store is None else self._open_store(settings.store)
        # Where a store cannot be used, the release beside it still can; without one there is no map.
        source = self._store or settings.release or settings.store
        assert source is not None, "the settings have seen to it"
        self._watch = ReleaseWatch(source, public_key=key, acceptable=self._check_datum)
        self._answers: ReleaseAnswers | None = None
        self._unreadable = False
        self._fetched = (0, 0)
        self._fetch: FetchThread | None = None
        self._looked_ns = self._tried_ns = bus.now_ns()
        self._look()
        self._verify(float("inf"))
        # In a replay nothing comes from outside: the map is what is here.
        if self._store is not None and settings.clock == "system":
            self._fetch = self._fetcher(key)

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """The three questions."""
        return {
            "elevation": lambda requests: [self.elevation(request) for request in requests],
            "links": lambda requests: [self.links(request) for request in requests],
            "tile": lambda requests: [self.tile(request) for request in requests],
        }

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Notices of new releases."""
        return {"release": self.on_release}

    def elevation(self, request: ElevationRequest) -> ElevationReply:
        """The road under a point."""
        if self._fetch is not None:
            self._fetch.near(request.latitude_rad, request.longitude_rad)
        now_ns = self.bus.now_ns()
        answers, reply = self._in_force(now_ns), None
        if answers is not None:
            try:
                reply = answers.elevation(request, time_ns=now_ns)
            except ReleaseError as error:
                self._report_unreadable(error)
        if reply is None:
            reason = self._why_unknown(now_ns) or "map_missing"
            reply = ElevationReply(time_ns=now_ns, road=Road(status="unknown", reason=reason))
        road = reply.road
        self.bus.count(f"elevation.{road.status if road.status == 'known' else road.reason}")
        return reply

    def links(self, request: LinksRequest) -> LinksReply:
        """The links around a point."""
        now_ns = self.bus.now_ns()
        answers = self._in_force(now_ns)
        if answers is not None:
            try:
                return answers.links(request, time_ns=now_ns)
            except ReleaseError as error:
                self._report_unreadable(error)
        release = self._watch.current
        version = 0 if release is None else release.manifest.map_version
        return unknown_links(self._why_unknown(now_ns) or "map_missing", map_version=version, time_ns=now_ns)

    def tile(self, request: TileRequest) -> TileReply:
        """A part of a tile's blob."""
        now_ns = self.bus.now_ns()
        answers = self._in_force(now_ns)
        if answers is not None:
            try:
                return answers.tile(request, time_ns=now_ns)
            except ReleaseError as error:
                self._report_unreadable(error)
        return unknown_tile(self._why_unknown(now_ns) or "map_missing", time_ns=now_ns)

    def on_release(self, head: ReleaseHead) -> None:
        """There is a release somewhere: it is fetched, or else is what an operator should know of."""
        if self._fetch is not None:
            self._fetch.notice()
            return
        release = self._watch.current
        here = None if release is None or release.root.region != head.region else release.root.map_version
        if here is None or head.map_version > here:
            self.bus.issue(
                "release_behind", f"version {head.map_version} of {head.region} is out, here is {here}"
            )

    def advance(self, now_ns: int) -> None:
        """Look for a new release now and then; verify a part of it in each round."""
        if _due(now_ns, self._tried_ns, self.settings.retry_every_s):
            self._tried_ns = now_ns
            self._unreadable = False
            if self._watch.problem is not None:
                self._watch.forget()
        self._hear_of_fetching()
        fetched = self._fetch is not None and self._fetch.has_changed()
        if fetched or _due(now_ns, self._looked_ns, self.settings.look_every_s):
            self._looked_ns = now_ns
            self._look()
            if self._why_unknown(now_ns) == "map_stale":
                self.bus.issue("map_stale", f"the release is older than {self.settings.max_age_days} days")
        if self._watch.busy:
            self._verify(self.settings.verify_bytes)

    def healthy(self) -> bool:
        """A map is in use, what the disk holds is that map, its tiles could be read, and newer ones can come."""
        usable = self._why_unknown(self.bus.now_ns()) is None
        troubled = self._storeless() or (self._fetch is not None and self._fetch.troubled())
        return usable and self._watch.problem is None and not self._unreadable and not troubled

    def facts(self) -> dict[str, str]:
        """The release in use."""
        release = self._watch.current
        if release is None:
            return {}
        manifest = release.manifest
        return {"map_release": f"{manifest.region} {manifest.map_version}", "datum": manifest.datum}

    def close(self) -> None:
        """Fetch no more."""
        if self._fetch is not None:
            self._fetch.close()
        if self._store is not None:
            self._store.close()

    def _storeless(self) -> bool:
        """It should keep releases, and cannot."""
        return self.settings.store is not None and self._store is None

    def _open_store(self, path: Path) -> MapStore | None:
        try:
            store = MapStore(path, limit_bytes=self.settings.store_limit_bytes)
        except ReleaseError as error:
            self.bus.issue("store_unusable", str(error))
            return None
        if store.notice is not None:
            self.bus.issue("store_damaged", store.notice)
        return store

    def _fetcher(self, key: Ed25519PublicKey | None) -> FetchThread:
        settings, bus = self.settings, self.bus
        path = settings.store
        assert path is not None
        around_m = None if settings.around_km is None else 1000.0 * settings.around_km
        fetch = FetchThread(
            lambda: MapStore(path, limit_bytes=settings.store_limit_bytes),
            Wishes(settings.region, key, around_m, self._check_datum),
            cloud=_Cloud(bus, trusted=key is not None or settings.unsigned),
            folder=None if settings.release is None else FolderSupplier(settings.release),
            times=Times(settings.ask_every_s, settings.ask_spread_s, settings.retry_every_s),
            now_ns=bus.now_ns,
            monotonic_s=time.monotonic,
            wake=bus.wake,
        )
        fetch.start(None if self._watch.current is None else self._watch.current.manifest.map_version)
        return fetch

    def _hear_of_fetching(self) -> None:
        if self._fetch is None:
            return
        for code, text in self._fetch.problems():
            self.bus.issue(code, text)
        before, self._fetched = self._fetched, self._fetch.counts()
        for name, was, now in zip(("fetched_bytes", "fetched_blobs"), before, self._fetched, strict=True):
            if now > was:
                self.bus.count(f"release.{name}", now - was)

    def _in_force(self, now_ns: int) -> ReleaseAnswers | None:
        """The answers of the release in use; None where nothing can be answered now."""
        return self._answers if self._why_unknown(now_ns) is None else None

    def _why_unknown(self, now_ns: int) -> RoadReason | None:
        """Why nothing can be answered now; None: something can."""
        if self._watch.current is None:
            return "datum_mismatch" if isinstance(self._watch.problem, _DatumMismatchError) else "map_missing"
        if self.settings.max_age_days is None:
            return None
        age_ns = now_ns - self._watch.current.manifest.time_ns
        # A release from the future has no age that could be judged: one of the two clocks is wrong.
        return None if -NS_PER_DAY <= age_ns <= self.settings.max_age_days * NS_PER_DAY else "map_stale"

    def _look(self) -> None:
        before = self._watch.problem
        self._watch.look()
        self._report_problem(before)

    def _verify(self, max_bytes: float) -> None:
        before = self._watch.problem
        if self._watch.verify(max_bytes) and self._watch.current is not None:
            self._use(self._watch.current)
        self._report_problem(before)

    def _use(self, release: Release) -> None:
        manifest = release.manifest
        self._answers = ReleaseAnswers(release, tiles_kept=self.settings.tiles_kept)
        self._unreadable = False
        if self._fetch is not None:
            self._fetch.uses(manifest.map_version)
        self.bus.count("release.loaded")
        if manifest.surrogate:
            self.bus.issue("surrogate_map", manifest.surrogate)

    def _check_datum(self, release: Release) -> None:
        if release.manifest.datum != self.settings.datum:
            file = release.source.name(None)
            raise _DatumMismatchError(file, "datum", self.settings.datum, actual=release.manifest.datum)

    def _report_problem(self, before: ReleaseError | None) -> None:
        problem = self._watch.problem
        if problem is not None and str(problem) != str(before):
            code = "datum_mismatch" if isinstance(problem, _DatumMismatchError) else "release_refused"
            self.bus.issue(code, str(problem))

    def _report_unreadable(self, error: ReleaseError) -> None:
        if isinstance(error, BlobMissing):  # this part of the map is not here, or not yet
            self.bus.count("tile.not_fetched")
            return
        self._unreadable = True
        if self._fetch is not None:
            self._fetch.repair()
        self.bus.issue("tile_unreadable", str(error))


class _Cloud:
    """map_update, over the bus; asked from the thread that fetches."""

    name = "map_update"
    may_be_old = False

    def __init__(self, bus: Bus, *, trusted: bool) -> None:
        self._bus = bus
        self._trusted = trusted

    def region(self) -> str | None:
        return None

    def root(self, request: MapRootRequest) -> MapRootReply:
        return self._ask("map_root", request, MapRootReply)

    def blob(self, request: MapBlobRequest) -> MapBlobReply:
        return self._ask("map_blob", request, MapBlobReply)

    def _ask(self, name: str, request: Message, reply: type[MessageT]) -> MessageT:
        if not self._trusted:
            raise ReleaseError(self.name, "public_key", "a key of what is taken over the bus", actual="none")
        try:
            return decode(reply, *self._bus.ask_bytes(name, encode(request, source="map_server"))).message
        except QueryFailed as error:
            raise NoAnswer(f"{self.name}: {error}") from None
        except DecodeError as error:
            raise ReleaseError(self.name, name, f"a reply ({error})") from None


def _due(now_ns: int, last_ns: int, every_s: float) -> bool:
    """Has the time passed, or the clock been set back?"""
    return not 0 <= now_ns - last_ns < every_s * 1e9


SERVICE = MapServerService
