"""The process of antenna_height: the fixed value, or the stroke sensor's with the fixed one beside it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydantic import ValidationError

from camber.antenna_height.settings import AntennaHeightSettings
from camber.antenna_height.ways import disagree, fixed_height, stroke_height
from camber.runtime.bus import Bus
from camber.runtime.service import Service
from camber.schemas.antenna import AntennaHeight, HeightByWay
from camber.schemas.channels import BY_NAME
from camber.schemas.motion import Suspension


class AntennaHeightService(Service[AntennaHeightSettings]):
    """Publishes the height, or why there is none, at least every `publish_period_s`."""

    NAME = "antenna_height"
    SETTINGS = AntennaHeightSettings

    def __init__(self, settings: AntennaHeightSettings, bus: Bus) -> None:
        super().__init__(settings, bus)
        self._suspension: Suspension | None = None
        self._published_ns = 0
        self._known = False

    def handlers(self) -> dict[str, Callable[[Any], None]]:
        """Inputs."""
        return {"suspension": self._hear}

    def _hear(self, suspension: Suspension) -> None:
        self._suspension = suspension

    def advance(self, now_ns: int) -> None:
        """Publish, when it is time."""
        if now_ns <= 0:
            return
        fresh = self._suspension is not None and self._suspension.time_ns > self._published_ns
        # A clock that was set back is no reason to fall silent.
        if not fresh and 0 <= now_ns - self._published_ns < self.settings.publish_period_s * 1e9:
            return
        self._published_ns = now_ns
        height = self._height(now_ns)
        self._known = height.status == "known"
        self.bus.publish("antenna_height", height)

    def _height(self, now_ns: int) -> AntennaHeight:
        settings = self.settings
        fixed = None
        if settings.fixed_height_m is not None:
            fixed = fixed_height(settings.fixed_height_m, settings.fixed_sigma_m)
        if settings.way == "fixed":
            return _known(now_ns, fixed, None, "fixed_height_m is not set")
        stroke = self._stroke(now_ns)
        return _known(now_ns, stroke, fixed, "no fresh and plausible stroke height")

    def _stroke(self, now_ns: int) -> HeightByWay | None:
        suspension, limit_s = self._suspension, BY_NAME["suspension"].max_age_s
        if suspension is None or limit_s is None or now_ns - suspension.time_ns > limit_s * 1e9:
            return None
        settings = self.settings
        if settings.suspension_to_antenna_m is None or settings.tyre_radius_m is None:
            return None
        try:
            return stroke_height(
                suspension,
                suspension_to_antenna_m=settings.suspension_to_antenna_m,
                tyre_radius_m=settings.tyre_radius_m,
                stored_sigma_m=settings.stored_sigma_m,
            )
        except ValidationError as error:
            self.bus.issue("implausible_height", f"stroke: {error.errors(include_url=False)[0]['msg']}")
            return None

    def healthy(self) -> bool:
        """Without a height nothing can be confirmed."""
        return self._known


def _known(now_ns: int, chosen: HeightByWay | None, other: HeightByWay | None, reason: str) -> AntennaHeight:
    others = () if other is None else (other,)
    if chosen is None:
        return AntennaHeight(time_ns=now_ns, status="unknown", reason=reason, others=others)
    if other is not None and disagree(chosen, other):
        reason = f"{chosen.way} {chosen.height_m:.3f} m, {other.way} {other.height_m:.3f} m"
        return AntennaHeight(time_ns=now_ns, status="disagreement", reason=reason, others=(chosen, other))
    return AntennaHeight(
        time_ns=now_ns,
        status="known",
        way=chosen.way,
        height_m=chosen.height_m,
        sigma_m=chosen.sigma_m,
        others=others,
    )


SERVICE = AntennaHeightService
