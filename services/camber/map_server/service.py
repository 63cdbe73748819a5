"""Connects the release on disk to the queries on the bus, and newer releases in the cloud to the disk."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_server.download_thread import DownloadThread
from camber.map_server.links import unknown_links
from camber.map_server.release_download import FolderSupplier, ReleaseDownload, SupplierUnavailableError
from camber.map_server.release_queries import ReleaseQueries, unknown_tile
from camber.map_server.settings import MapServerSettings
from camber.map_server.warm_up import FUNCTIONS, warm_up
from camber.road_map.release import BlobMissingError, Release, ReleaseError
from camber.road_map.release_order import AcceptedRelease, check_order
from camber.road_map.release_watch import ReleaseWatch
from camber.road_map.signing_keys import TrustedKey
from camber.road_map.store import MapStore
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.service import Service
from camber.runtime.state_file import StateFile
from camber.schemas.base import Message
from camber.schemas.codec import DecodeError, decode, encode
from camber.schemas.fleet import MapBlobReply, MapBlobRequest, MapRootReply, MapRootRequest, ReleaseHead
from camber.schemas.pose import Road, RoadReason
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    ReleaseRoot,
    TileReply,
    TileRequest,
)

ReplyT = TypeVar("ReplyT", bound=Message)


class _DatumMismatchError(ReleaseError):
    """A valid release with another datum than expected."""


class MapServerService(Service[MapServerSettings]):
    """Answers elevation, links and tile; *unknown* where the map has no data."""

    NAME: ClassVar[str] = "map_server"
    SETTINGS: ClassVar[type[MapServerSettings]] = MapServerSettings

    @classmethod
    def prepare(cls, settings: MapServerSettings) -> None:
        """Compile the road selection."""
        warm_up()

    @classmethod
    def compiled_functions(cls, settings: MapServerSettings) -> int:
        """Those of the warm-up."""
        return FUNCTIONS

    @classmethod
    def state_folder(cls, settings: MapServerSettings) -> Path | None:
        """The folder of the store, or of the state without one."""
        return settings.state_dir if settings.store is None else settings.store.parent

    def __init__(self, settings: MapServerSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        key = settings.trusted_key(bus.now_ns)
        self._accepted_file = StateFile("release", settings=settings, bus=bus)
        self._accepted = self._accepted_file.load(AcceptedRelease.model_validate_json)
        self._store: MapStore | None = None if settings.store is None else self._open_store(settings.store)
        # Without a usable store the folder `release` is served, if there is one.
        source = self._store or settings.release or settings.store
        assert source is not None, "the settings have seen to it"
        self._watch = ReleaseWatch(source, public_key=key, acceptable=self._check_release)
        self._queries: ReleaseQueries | None = None
        self._unreadable = False
        self._counted: Counter[str] = Counter()
        self._download: ReleaseDownload | None = None
        self._thread: DownloadThread | None = None
        self._looked_ns = self._tried_ns = bus.now_ns()
        self._look()
        self._verify(float("inf"))
        # A replay downloads nothing.
        if self._store is not None and settings.clock == "system":
            self._start_download(self._store.path, key)

    def answers(self) -> dict[str, Callable[[Sequence[Any]], Sequence[Message | None]]]:
        """Return the handlers of the three queries."""
        return {
            "elevation": lambda requests: [self.elevation(request) for request in requests],
            "links": lambda requests: [self.links(request) for request in requests],
            "tile": lambda requests: [self.tile(request) for request in requests],
        }

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Return the handler of notices of new releases."""
        return {"release": self.on_release}

    def elevation(self, request: ElevationRequest) -> ElevationReply:
        """Answer the road under a point."""
        if self._download is not None:
            self._download.position_rad = request.latitude_rad, request.longitude_rad
        reply = self._answered(
            lambda queries, now_ns: queries.elevation(request, time_ns=now_ns),
            lambda reason, now_ns: ElevationReply(time_ns=now_ns, road=Road(status="unknown", reason=reason)),
        )
        self.bus.count(f"elevation.{'known' if reply.road.status == 'known' else reply.road.reason}")
        return reply

    def links(self, request: LinksRequest) -> LinksReply:
        """Answer the links around a point."""
        release = self._watch.current
        version = 0 if release is None else release.manifest.map_version
        return self._answered(
            lambda queries, now_ns: queries.links(request, time_ns=now_ns),
            lambda reason, now_ns: unknown_links(reason, map_version=version, time_ns=now_ns),
        )

    def tile(self, request: TileRequest) -> TileReply:
        """Answer a part of a tile's blob."""
        return self._answered(
            lambda queries, now_ns: queries.tile(request, time_ns=now_ns),
            lambda reason, now_ns: unknown_tile(reason, time_ns=now_ns),
        )

    def on_release(self, head: ReleaseHead) -> None:
        """Handle the notice of a new release: download it, or report an issue without a store."""
        if self._thread is not None:
            self._thread.notice()
            return
        release = self._watch.current
        in_use = None if release is None or release.root.region != head.region else release.root.map_version
        if in_use is None or head.map_version > in_use:
            text = f"version {head.map_version} of {head.region} is out, here is {in_use}"
            self.bus.issue("release_behind", text)

    def advance(self, now_ns: int) -> None:
        """Look for a new release at intervals; verify a part of it in each iteration of the work loop."""
        if _due(now_ns, self._tried_ns, self.settings.retry_every_s):
            self._tried_ns = now_ns
            self._unreadable = False
            if self._watch.problem is not None:
                self._watch.forget()
        self._report_download()
        changed = self._thread is not None and self._thread.take_change()
        if changed or _due(now_ns, self._looked_ns, self.settings.look_every_s):
            self._looked_ns = now_ns
            self._look()
            if self._why_unknown(now_ns) == "map_stale":
                self.bus.issue("map_stale", f"the release is older than {self.settings.max_age_days} days")
        if self._watch.busy:
            self._verify(self.settings.verify_bytes)

    def healthy(self) -> bool:
        """Whether a map is in use, is the one on disk, is readable, and can be updated."""
        usable = self._why_unknown(self.bus.now_ns()) is None
        no_store = self.settings.store is not None and self._store is None
        troubled = no_store or (self._thread is not None and self._thread.troubled)
        return usable and self._watch.problem is None and not self._unreadable and not troubled

    def facts(self) -> dict[str, str]:
        """Return the release in use."""
        release = self._watch.current
        if release is None:
            return {}
        manifest = release.manifest
        return {"map_release": f"{manifest.region} {manifest.map_version}", "datum": manifest.datum}

    def close(self) -> None:
        """Stop the download."""
        if self._thread is not None:
            self._thread.close()
        if self._store is not None:
            self._store.close()

    def _open_store(self, path: Path) -> MapStore | None:
        try:
            store = MapStore(path, limit_bytes=self.settings.store_limit_bytes)
        except ReleaseError as error:
            self.bus.issue("store_unusable", str(error))
            return None
        if store.notice is not None:
            self.bus.issue("store_damaged", store.notice)
        return store

    def _start_download(self, path: Path, key: TrustedKey | None) -> None:
        """Start the thread, with a connection of its own to the store."""
        settings, bus = self.settings, self.bus
        store = self._open_store(path)
        if store is None:
            return
        self._download = ReleaseDownload(
            store,
            region=settings.region,
            public_key=key,
            around_m=None if settings.around_km is None else 1000.0 * settings.around_km,
            now_ns=bus.now_ns,
            acceptable=self._check_datum,
        )
        if self._watch.current is not None:
            self._download.in_use = self._watch.current.manifest.map_version
        self._thread = DownloadThread(
            self._download,
            cloud=_Cloud(bus, trusted=key is not None or settings.unsigned),
            folder=None if settings.release is None else FolderSupplier(settings.release),
            ask_every_s=settings.ask_every_s,
            spread_s=settings.ask_spread_s,
            retry_every_s=settings.retry_every_s,
            monotonic_s=time.monotonic,
            wake=bus.wake,
        )
        self._thread.start()

    def _report_download(self) -> None:
        if self._download is None or self._thread is None:
            return
        for code, text in self._thread.take_problems():
            self.bus.issue(code, text)
        for name in ("fetched_bytes", "fetched_blobs"):
            before, now = self._counted[name], getattr(self._download, name)
            if now > before:
                self.bus.count(f"release.{name}", now - before)
            self._counted[name] = now

    def _answered(
        self, answer: Callable[[ReleaseQueries, int], ReplyT], unknown: Callable[[RoadReason, int], ReplyT]
    ) -> ReplyT:
        """Return the answer of the release in use, or `unknown` with the reason why there is none now."""
        now_ns = self.bus.now_ns()
        reason = self._why_unknown(now_ns)
        if reason is None and self._queries is not None:
            try:
                return answer(self._queries, now_ns)
            except BlobMissingError:  # not downloaded, or not yet
                self.bus.count("tile.not_fetched")
            except ReleaseError as error:
                self._unreadable = True
                if self._thread is not None:
                    self._thread.repair()
                self.bus.issue("tile_unreadable", str(error))
        return unknown(reason or "map_missing", now_ns)

    def _why_unknown(self, now_ns: int) -> RoadReason | None:
        """Return why nothing can be answered now; None if the map is usable."""
        if self._watch.current is None:
            return "datum_mismatch" if isinstance(self._watch.problem, _DatumMismatchError) else "map_missing"
        if self.settings.max_age_days is None:
            return None
        age_ns = now_ns - self._watch.current.manifest.time_ns
        # More than a day in the future: one of the two clocks is wrong.
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
        self._queries = ReleaseQueries(release, tiles_kept=self.settings.tiles_kept)
        self._unreadable = False
        if self._download is not None:
            self._download.in_use = manifest.map_version
        if self._store is None:
            self._keep_accepted(release.root)
        self.bus.count("release.loaded")
        if manifest.surrogate:
            self.bus.issue("surrogate_map", manifest.surrogate)

    def _keep_accepted(self, root: ReleaseRoot) -> None:
        before = self._accepted
        self._accepted = AcceptedRelease(
            region=root.region, map_version=root.map_version, manifest_sha256=root.manifest_sha256
        )
        if self._accepted != before and self._accepted_file.path is not None:
            self._accepted_file.save(self._accepted.model_dump_json())

    def _check_release(self, release: Release) -> None:
        self._check_datum(release)
        if self._store is not None:
            return  # has checked it, and knows what an operator went back to
        root, before = release.root, self._accepted
        same = before is not None and before.map_version == root.map_version
        check_order(
            root,
            release.source.name(None),
            region=self.settings.region or (before.region if before else None),
            highest=before.map_version if before else None,
            manifest_sha256=before.manifest_sha256 if before and same else None,
        )

    def _check_datum(self, release: Release) -> None:
        if release.manifest.datum != self.settings.datum:
            file = release.source.name(None)
            raise _DatumMismatchError(file, "datum", self.settings.datum, actual=release.manifest.datum)

    def _report_problem(self, before: ReleaseError | None) -> None:
        problem = self._watch.problem
        if problem is not None and str(problem) != str(before):
            code = "datum_mismatch" if isinstance(problem, _DatumMismatchError) else "release_refused"
            self.bus.issue(code, str(problem))


class _Cloud:
    """map_update as supplier, over the bus; called from the download thread."""

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

    def _ask(self, name: str, request: Message, reply: type[ReplyT]) -> ReplyT:
        if not self._trusted:
            raise ReleaseError(self.name, "public_key", "a key for releases from the bus", actual="none")
        try:
            return decode(reply, *self._bus.ask_bytes(name, encode(request, source="map_server"))).message
        except QueryFailed as error:
            raise SupplierUnavailableError(f"{self.name}: {error}") from None
        except DecodeError as error:
            raise ReleaseError(self.name, name, f"a reply ({error})") from None


def _due(now_ns: int, last_ns: int, every_s: float) -> bool:
    """Whether the interval has passed or the clock was set back."""
    return not 0 <= now_ns - last_ns < every_s * 1e9


SERVICE = MapServerService
