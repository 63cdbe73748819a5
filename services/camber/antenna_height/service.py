"""The process of antenna_height: inputs from the bus, the antenna height onto it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from camber.antenna_height.estimator import AntennaHeightEstimator
from camber.antenna_height.method_comparison import References
from camber.antenna_height.saved_state import references_as_text, references_from_text
from camber.antenna_height.settings import AntennaHeightSettings
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.runtime.state_file import StateFile

_SAVE_EVERY_NS = 60_000_000_000  # chosen: a minute of driving is lost with the power at most


class AntennaHeightService(Service[AntennaHeightSettings]):
    """Publishes the height, or why there is none: for each new measurement, and at least every `publish_period_s`."""

    NAME = "antenna_height"
    SETTINGS = AntennaHeightSettings

    def __init__(self, settings: AntennaHeightSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        options = settings.options()
        self._vehicle = options.vehicle
        self._file = StateFile("differences", settings=settings, bus=bus)
        earlier = self._file.load(lambda text: references_from_text(text, options.vehicle))
        self._estimator = AntennaHeightEstimator(options, earlier or {})
        self._saved: References = self._estimator.references
        self._saved_ns = self._published_ns = self._source_ns = 0
        self._status: str | None = None

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        return self._estimator.handlers()

    def advance(self, now_ns: int) -> None:
        """Publish where due."""
        source_ns = self._estimator.source_time_ns
        # After the clock was set back the next height is due at once.
        waiting = 0 <= now_ns - self._published_ns < self.settings.publish_period_s * 1e9
        if now_ns <= 0 or (waiting and source_ns == self._source_ns):
            return
        self._published_ns, self._source_ns = now_ns, source_ns
        height, problems = self._estimator.height(now_ns)
        if height.status not in ("known", self._status):
            self.bus.issue("height_unknown", f"{height.status}: {height.reason}")
        self._status = height.status
        for problem in problems:
            self.bus.issue("implausible_height", problem)
        self.bus.publish("antenna_height", height)
        if not 0 <= now_ns - self._saved_ns < _SAVE_EVERY_NS:
            self._saved_ns = now_ns
            self._save()

    def close(self) -> None:
        """Save the differences of the methods for the next drive."""
        self._save()

    def _save(self) -> None:
        references = self._estimator.references
        if self._file.path is None or references == self._saved:
            return
        self._saved = references
        self._file.save(references_as_text(self._vehicle, references))

    def healthy(self) -> bool:
        """Whether the height is known: without it nothing can be confirmed."""
        return self._status == "known"


SERVICE = AntennaHeightService
