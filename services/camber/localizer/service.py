"""The localizer's process: inputs from the bus, poses and scan matches onto it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from camber.localizer.given_pose import GivenPose
from camber.localizer.localization import Localization
from camber.localizer.map_queries import MapQueryFailure
from camber.localizer.settings import LocalizerSettings
from camber.localizer.warm_up import FUNCTIONS, warm_up
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.health.memory_release import return_freed_memory
from camber.runtime.service import Service
from camber.runtime.state_file import StateFile
from camber.schemas.pose import ScanMatch
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    TileReply,
    TileRequest,
)

_POINTS_EVERY_NS = 1_000_000_000  # chosen: a picture that somebody looks at
_RELEASE_MEMORY_EVERY_NS = 10_000_000_000  # chosen: blocks of the map change every 10 s or more


class LocalizerService(Service[LocalizerSettings]):
    """One pose per motion sample, one match per sweep."""

    NAME = "localizer"
    SETTINGS = LocalizerSettings

    @classmethod
    def prepare(cls, settings: LocalizerSettings) -> None:
        """Compile the matching of sweeps."""
        if settings.match_sweeps:
            warm_up()

    @classmethod
    def compiled_functions(cls, settings: LocalizerSettings) -> int:
        """Those of the warm-up."""
        return FUNCTIONS if settings.match_sweeps else 0

    def __init__(self, settings: LocalizerSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._given_pose_file = StateFile("given_pose", settings=settings, bus=bus)
        given = None if self._given_pose_was_used() else settings.initial_pose
        self._memory_released_ns = 0
        self._points_ns = 0  # time of the last match whose points were published
        self._localization = Localization(settings.options(given), _MapServerQueries(bus), bus)

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        localization = self._localization
        return {
            "motion": self._on_motion,
            "imu": self._on_imu,
            "fix": localization.on_fix,
            "verdict": localization.on_verdict,
            "sweep": localization.on_sweep,
        }

    def _on_motion(self, motion: Any) -> None:
        self._note_start(started=self._localization.on_motion(motion))

    def _on_imu(self, imu: Any) -> None:
        self._note_start(started=self._localization.on_imu(imu))

    def _given_pose_was_used(self) -> bool:
        """Whether an earlier run may have started from the same pose: after a restart the vehicle is somewhere else.

        Where the note of that cannot be read, it may have.
        """
        used = self._given_pose_file.load(GivenPose.model_validate_json)
        if self._given_pose_file.was_rejected:
            self._note_start(started=True)
            return True
        return used is not None and used == self.settings.initial_pose

    def _note_start(self, *, started: bool) -> None:
        """Write that the given pose is used."""
        given, file = self.settings.initial_pose, self._given_pose_file
        if not started or given is None or file.save(given.model_dump_json()):
            return
        if (
            file.path is not None or self.settings.clock != "replay"
        ):  # each replay starts at the begin of its drive
            self.bus.issue("given_pose_not_kept", "state_dir: expected a folder that can be written")

    def advance(self, now_ns: int) -> None:
        """Publish the output."""
        step = self._localization.advance()
        for match in step.matches:
            self.bus.publish("scan_match", match)
        if step.matches:
            self._publish_match_points(step.matches[-1])
        if step.pose is not None:
            self.bus.publish("pose", step.pose)
        if (
            self.settings.match_sweeps
            and not 0 <= now_ns - self._memory_released_ns < _RELEASE_MEMORY_EVERY_NS
        ):
            # Blocks of the map take and free megabytes at a time.
            self._memory_released_ns = now_ns
            return_freed_memory()

    def _publish_match_points(self, match: ScanMatch) -> None:
        """Publish the points of a match, now and then and only for somebody: a vehicle without a viewer makes none."""
        matcher = self._localization.matcher
        if (
            matcher is None
            or match.status == "lost"
            or 0 <= match.time_ns - self._points_ns < _POINTS_EVERY_NS
        ):
            return
        if not self.bus.has_subscriber("scan_match_points"):
            return
        points = matcher.last_points()
        if points is not None:
            self._points_ns = points.time_ns
            self.bus.publish("scan_match_points", points)

    def healthy(self) -> bool:
        """Whether there is a pose."""
        return self._localization.has_pose


class _MapServerQueries:
    """Queries to the map server over the bus."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def elevation(self, request: ElevationRequest) -> ElevationReply | MapQueryFailure:
        return cast(ElevationReply | MapQueryFailure, self._query("elevation", request))

    def links(self, request: LinksRequest) -> LinksReply | MapQueryFailure:
        return cast(LinksReply | MapQueryFailure, self._query("links", request))

    def tile(self, request: TileRequest) -> TileReply | MapQueryFailure:
        return cast(TileReply | MapQueryFailure, self._query("tile", request))

    def is_available(self) -> bool:
        return self._bus.is_alive("map_server")

    def _query(self, name: str, request: Any) -> Any:
        try:
            return self._bus.ask(name, request)
        except QueryFailed as error:
            return MapQueryFailure(error.reason, str(error))


SERVICE = LocalizerService
