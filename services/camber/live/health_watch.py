"""What services answer, asked again and again in a thread of its own: their health, and changes of the map."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from camber.runtime.bus import QueryFailed
from camber.runtime.clock import SystemClock
from camber.runtime.query import BusError, QueryClient
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import FEEDER, VEHICLE_SERVICES
from camber.schemas.fleet import (
    HELD_REASONS,
    HeldChanges,
    MapChanges,
    MapChangesRequest,
    PublishedChanges,
    RegionAlarms,
)
from camber.schemas.health import HealthRequest
from camber.tools.maps.road_names import road_text
from camber.tools.operate.status_view import Answers, view_of

_EVERY_S = 1.0  # chosen: as often as a person looks
_TIMEOUT_S = 1.5  # chosen: longer than the second within which a work loop answers (table of channels)
_CHANGES_EVERY_S = 5.0  # chosen: the fusion decides once a minute
_NO_SERVICES = frozenset({FEEDER, "vehicle", "player"})  # they have a liveliness token but no work loop


class QueryWatch(ABC):
    """Asks from `start` to `end`, and tries again where there is no bus. `view`: the newest answer, None without."""

    def __init__(self, name: str, settings: ServiceSettings) -> None:
        self.number = 0
        """Grows when something else is answered."""
        self.view: dict[str, Any] | None = None
        self._settings = settings
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

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

    @abstractmethod
    def _ask(self, client: QueryClient) -> None: ...

    def _show(self, view: dict[str, Any] | None) -> None:
        if view != self.view:
            self.view = view
            self.number += 1


class HealthWatch(QueryWatch):
    """The newest view of all services, as `camber status` makes it; `usual` are those that are expected.

    As JSON: services, channels, notes.
    """

    def __init__(self, settings: ServiceSettings, usual: Sequence[str] = VEHICLE_SERVICES) -> None:
        super().__init__("health", settings)
        self.vehicles: list[str] = []
        self._usual = tuple(usual)

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


class MapChangesWatch(QueryWatch):
    """Changes of the map that `map_update` holds, has published and alarms, of all its workers together.

    As JSON: `problem`, and lists of `held`, `pending`, `published` and `alarms`, with places in degrees. `names`: of
    roads by link.
    """

    def __init__(self, settings: ServiceSettings, names: Mapping[int, str]) -> None:
        super().__init__("changes", settings)
        self._names = names

    def _ask(self, client: QueryClient) -> None:
        while not self._ended.is_set():
            request = MapChangesRequest(time_ns=SystemClock().now_ns())
            (replies,) = client.ask("map_changes", request, "fleet", ["map_update"]).values()
            self._show(changes_as_json(replies, self._names))
            self._ended.wait(_CHANGES_EVERY_S)


def changes_as_json(replies: Sequence[MapChanges | QueryFailed], names: Mapping[int, str]) -> dict[str, Any]:
    """What all workers answered, for the page, with the names of roads by link."""
    known = [reply for reply in replies if isinstance(reply, MapChanges) and reply.status == "known"]
    problem = "" if known else "; ".join(r.reason if isinstance(r, MapChanges) else str(r) for r in replies)
    return {
        "problem": problem,
        "left_out": sum(reply.left_out for reply in known),
        "map_version": max((reply.map_version or 0 for reply in known), default=0),
        "held": [_with_reason(row) for reply in known for row in _rows_of(reply.held, names, reply)],
        "pending": [_with_reason(row) for reply in known for row in _rows_of(reply.pending, names, reply)],
        "published": [row for reply in known for row in _rows_of(reply.published, names, reply)],
        "alarms": [row for reply in known for row in _rows_of(reply.alarms, names, reply)],
    }


def _with_reason(row: dict[str, Any]) -> dict[str, Any]:
    return row | {"reason": HELD_REASONS[row["reason"]]}


def _rows_of(
    columns: HeldChanges | PublishedChanges | RegionAlarms | None, names: Mapping[int, str], reply: MapChanges
) -> list[dict[str, Any]]:
    """One table's rows by column; places are `lat` and `lon` in degrees, ids are texts."""
    if columns is None:
        return []
    values = {name: column.tolist() for name, column in columns}
    values["lat"] = [math.degrees(value) for value in values.pop("latitude_rad")]
    values["lon"] = [math.degrees(value) for value in values.pop("longitude_rad")]
    if "link_id" in values:
        values["road"] = [road_text(link_id, names) for link_id in values["link_id"]]
    for name in {"surface_id", "link_id"} & values.keys():
        values[name] = [str(value) for value in values[name]]  # JSON has 53 bits
    values["reference_sha256"] = [reply.reference_sha256] * len(values["lat"])  # a decision names the map
    return [dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)]
