"""The localizer's process: what is heard on the bus goes in, poses and scan matches come out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from camber.localizer.localization import Localization
from camber.localizer.map_queries import NoAnswer
from camber.localizer.settings import GivenPose, LocalizerSettings
from camber.localizer.warm_up import warm_up
from camber.runtime.bus import Bus, QueryFailed
from camber.runtime.health.memory_release import return_freed_memory
from camber.runtime.service import Service
from camber.schemas.road import (
    ElevationReply,
    ElevationRequest,
    LinksReply,
    LinksRequest,
    TileReply,
    TileRequest,
)

_TIDY_EVERY_NS = 10_000_000_000


class LocalizerService(Service[LocalizerSettings]):
    """One pose per motion sample, one match per sweep."""

    NAME = "localizer"
    SETTINGS = LocalizerSettings

    @classmethod
    def prepare(cls, settings: LocalizerSettings) -> None:
        """Compile what sweeps will need."""
        if settings.match_sweeps:
            warm_up()

    def __init__(self, settings: LocalizerSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._remembers = _GivenPoseFile(settings)
        given = None if self._remembers.used_before() else settings.initial_pose
        self._tidied_ns = 0
        self._localization = Localization(settings.options(given), _MapOnTheBus(bus), bus)

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        localization = self._localization
        return {
            "motion": self._on_motion,
            "fix": localization.on_fix,
            "verdict": localization.on_verdict,
            "sweep": localization.on_sweep,
        }

    def _on_motion(self, motion: Any) -> None:
        if self._localization.on_motion(motion):
            problem = self._remembers.remember()
            if problem is not None:
                self.bus.issue("given_pose_not_kept", problem)

    def advance(self, now_ns: int) -> None:
        """Publish what has come out."""
        step = self._localization.advance()
        for match in step.matches:
            self.bus.publish("scan_match", match)
        if step.pose is not None:
            self.bus.publish("pose", step.pose)
        if self.settings.match_sweeps and not 0 <= now_ns - self._tidied_ns < _TIDY_EVERY_NS:
            # Blocks of the map come and go, megabytes at a time.
            self._tidied_ns = now_ns
            return_freed_memory()

    def healthy(self) -> bool:
        """Is there a pose?"""
        return self._localization.has_pose


class _MapOnTheBus:
    """The map server's answers."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus

    def elevation(self, request: ElevationRequest) -> ElevationReply | NoAnswer:
        reply: ElevationReply | NoAnswer = self._ask("elevation", request)
        return reply

    def links(self, request: LinksRequest) -> LinksReply | NoAnswer:
        reply: LinksReply | NoAnswer = self._ask("links", request)
        return reply

    def tile(self, request: TileRequest) -> TileReply | NoAnswer:
        reply: TileReply | NoAnswer = self._ask("tile", request)
        return reply

    def is_there(self) -> bool:
        return self._bus.is_alive("map_server")

    def _ask(self, name: str, request: Any) -> Any:
        try:
            return self._bus.ask(name, request)
        except QueryFailed as error:
            return NoAnswer(error.reason, str(error))


class _GivenPoseFile:
    """A given pose is believed once: the vehicle has moved since when this service is started again."""

    def __init__(self, settings: LocalizerSettings) -> None:
        self._given = settings.initial_pose
        self._replayed = settings.clock == "replay"  # begins at its drive's begin each time
        self._path: Path | None = settings.state_dir / "given_pose.json" if settings.state_dir else None

    def used_before(self) -> bool:
        """Has an earlier run of this service started from the same pose?"""
        try:
            used = self._path.read_text("utf-8") if self._path is not None else ""
        except (OSError, UnicodeDecodeError):
            used = ""
        return bool(used) and used == _text_of(self._given)

    def remember(self) -> str | None:
        """The pose is used now; what is wrong where that cannot be kept."""
        if self._path is None:
            return None if self._replayed else "state_dir: expected a folder, found none"
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.write_text(_text_of(self._given), "utf-8")
        except OSError as error:
            return f"{self._path}: {error.strerror}"
        return None


def _text_of(given: GivenPose | None) -> str:
    return "" if given is None else given.model_dump_json()


SERVICE = LocalizerService
