"""The process of antenna_height: hears a vehicle's sensors and the pose, says how high the antenna stands."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camber.antenna_height.available_heights import Vehicle
from camber.antenna_height.estimator import Antenna
from camber.antenna_height.method_comparison import References
from camber.antenna_height.saved_state import references_as_text, references_from_text
from camber.antenna_height.settings import AntennaHeightSettings
from camber.runtime.bus import Bus
from camber.runtime.service import Service

_KEEP_EVERY_NS = 60_000_000_000


class AntennaHeightService(Service[AntennaHeightSettings]):
    """Publishes the height, or why there is none: for each new measurement, and at least every `publish_period_s`."""

    NAME = "antenna_height"
    SETTINGS = AntennaHeightSettings

    def __init__(self, settings: AntennaHeightSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        options = settings.options()
        self._vehicle = options.vehicle
        self._file = settings.state_dir / "differences.json" if settings.state_dir else None
        self._antenna = Antenna(options, _load(self._file, options.vehicle, bus))
        self._kept: References = self._antenna.references
        self._kept_ns = 0
        self._published_ns = 0
        self._source_ns = 0
        self._status: str | None = None

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        return {
            "motion": self._antenna.hear_motion,
            "suspension": self._antenna.hear_suspension,
            "ranging": self._antenna.hear_ranging,
            "pose": self._antenna.hear_pose,
            "scan_match": self._antenna.hear_match,
        }

    def advance(self, now_ns: int) -> None:
        """Publish, when it is time."""
        source_ns = self._antenna.source_time_ns
        # A clock that was set back is no reason to fall silent.
        waiting = 0 <= now_ns - self._published_ns < self.settings.publish_period_s * 1e9
        if now_ns <= 0 or (waiting and source_ns == self._source_ns):
            return
        self._published_ns, self._source_ns = now_ns, source_ns
        height, problems = self._antenna.height(now_ns)
        if height.status not in ("known", self._status):
            self.bus.issue("height_unknown", f"{height.status}: {height.reason}")
        self._status = height.status
        for problem in problems:
            self.bus.issue("implausible_height", problem)
        self.bus.publish("antenna_height", height)
        if not 0 <= now_ns - self._kept_ns < _KEEP_EVERY_NS:
            self._kept_ns = now_ns
            self._keep()

    def close(self) -> None:
        """Keep what the ways differed by for the next drive."""
        self._keep()

    def _keep(self) -> None:
        references = self._antenna.references
        if self._file is None or references == self._kept:
            return
        self._kept = references
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            fresh = self._file.with_suffix(".new")
            with fresh.open("w", encoding="utf-8") as file:
                file.write(references_as_text(self._vehicle, references))
                file.flush()
                os.fsync(file.fileno())
            fresh.replace(self._file)
        except OSError as error:
            self.bus.issue("differences_not_kept", f"{self._file}: {error.strerror}")

    def healthy(self) -> bool:
        """Without a height nothing can be confirmed."""
        return self._status == "known"


def _load(path: Path | None, vehicle: Vehicle, bus: Bus) -> References:
    if path is None or not path.exists():
        return {}
    try:
        return references_from_text(path.read_text("utf-8"), vehicle)
    except (OSError, ValueError) as error:
        bus.issue("differences_unreadable", f"{path}: {error}")
        return {}


SERVICE = AntennaHeightService
