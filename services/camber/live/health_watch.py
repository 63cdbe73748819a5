"""Health of a vehicle's services, asked again and again in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryClient
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import FEEDER, VEHICLE_SERVICES
from camber.schemas.health import HealthRequest
from camber.tools.operate.status_view import Answers, view_of

_EVERY_S = 1.0  # chosen: as often as a person looks
_TIMEOUT_S = 1.5  # chosen: longer than the second within which a work loop answers (table of channels)
_NO_SERVICES = frozenset({FEEDER, "vehicle", "player"})  # they have a liveliness token but no work loop


class HealthWatch:
    """The newest view of all services, as `camber status` makes it; `usual` are those that are expected."""

    def __init__(self, settings: ServiceSettings, usual: Sequence[str] = VEHICLE_SERVICES) -> None:
        self.number = 0
        self.view: dict[str, Any] | None = None
        """As JSON: services, channels, notes; None before the first answer."""
        self.vehicles: list[str] = []
        self._settings, self._usual = settings, tuple(usual)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="health", daemon=True)

    def start(self) -> None:
        """Begin to ask."""
        self._thread.start()

    def end(self) -> None:
        """Leave the bus."""
        self._ended.set()
        self._thread.join(2.0 * _TIMEOUT_S)

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                with QueryClient(self._settings, timeout_s=_TIMEOUT_S, source="live") as client:
                    self._ask(client)
            except BusError:
                self._show(None)
                self._ended.wait(_EVERY_S)

    def _ask(self, client: QueryClient) -> None:
        vehicle = self._settings.vehicle
        before: Answers = {}
        while not self._ended.is_set():
            everyone = client.alive()
            self.vehicles = sorted(everyone)
            alive = everyone.get(vehicle, frozenset())
            services = (*self._usual, *sorted(alive - set(self._usual) - _NO_SERVICES))
            request = HealthRequest(time_ns=SystemClock().now_ns())
            answers = client.ask("health", request, vehicle, services)
            self._show(view_of(vehicle, answers, before, alive).as_json())
            before = answers
            self._ended.wait(_EVERY_S)

    def _show(self, view: dict[str, Any] | None) -> None:
        self.view = view
        self.number += 1
