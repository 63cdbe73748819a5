"""Wires the release on disk to the questions on the bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from camber.formats.map_release import Release, ReleaseError, load_public_key
from camber.formats.map_release_watch import ReleaseWatch
from camber.map_server.links import unknown_links
from camber.map_server.release_answers import ReleaseAnswers
from camber.map_server.settings import MapServerSettings
from camber.map_server.tile_parts import unknown_tile
from camber.map_server.warm_up import warm_up
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.schemas.base import Message
from camber.schemas.fleet import ReleaseHead
from camber.schemas.pose import Road, RoadReason
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    TileReply,
    TileRequest,
)

_DAY_NS = 86_400 * 1_000_000_000


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
        self._watch = ReleaseWatch(settings.release, public_key=key, acceptable=self._check_datum)
        self._answers: ReleaseAnswers | None = None
        self._unreadable = False
        self._looked_ns = self._tried_ns = bus.now_ns()
        self._look()
        self._verify(float("inf"))

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
        now_ns = self.bus.now_ns()
        reason = self._why_unknown(now_ns) or "map_missing"
        reply = ElevationReply(time_ns=now_ns, road=Road(status="unknown", reason=reason))
        answers = self._in_force(now_ns)
        if answers is not None:
            try:
                reply = answers.elevation(request, time_ns=now_ns)
            except ReleaseError as error:
                self._report_unreadable(error)
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
        """There is a release somewhere; one that is newer than the one here is what an operator should know of."""
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
        if _due(now_ns, self._looked_ns, self.settings.look_every_s):
            self._looked_ns = now_ns
            self._look()
            if self._why_unknown(now_ns) == "map_stale":
                self.bus.issue("map_stale", f"the release is older than {self.settings.max_age_days} days")
        if self._watch.busy:
            self._verify(self.settings.verify_bytes)

    def healthy(self) -> bool:
        """A map is in use, what the folder holds is that map, and its tiles could be read."""
        usable = self._why_unknown(self.bus.now_ns()) is None
        return usable and self._watch.problem is None and not self._unreadable

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
        return None if -_DAY_NS <= age_ns <= self.settings.max_age_days * _DAY_NS else "map_stale"

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
        self.bus.count("release.loaded")
        if manifest.surrogate:
            self.bus.issue("surrogate_map", manifest.surrogate)

    def _check_datum(self, release: Release) -> None:
        if release.manifest.datum != self.settings.datum:
            file = str(self.settings.release)
            raise _DatumMismatchError(file, "datum", self.settings.datum, found=release.manifest.datum)

    def _report_problem(self, before: ReleaseError | None) -> None:
        problem = self._watch.problem
        if problem is not None and str(problem) != str(before):
            code = "datum_mismatch" if isinstance(problem, _DatumMismatchError) else "release_refused"
            self.bus.issue(code, str(problem))

    def _report_unreadable(self, error: ReleaseError) -> None:
        self._unreadable = True
        self.bus.issue("tile_unreadable", str(error))


def _due(now_ns: int, last_ns: int, every_s: float) -> bool:
    """Has the time passed, or the clock been set back?"""
    return not 0 <= now_ns - last_ns < every_s * 1e9


SERVICE = MapServerService
