"""Where all vehicles on the bus are: the newest position of each, kept from a thread of its own."""

from __future__ import annotations

import math
import threading
from typing import Any

from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.live.sources import ListeningSource
from camber.runtime.raw_subscription import RawSample
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import DecodeError, decode
from camber.schemas.integrity import Position, Verdict

_EVERY_S = 0.5  # chosen: a map of many vehicles needs no more
_MOST_MESSAGES = 5000
"""Read in one round. Chosen: of 500 vehicles at 10 Hz; of more messages the oldest are left out."""
_MOST_VEHICLES = 2000
"""Chosen: a peer that invents names must not fill the memory; of more vehicles the newest are left out."""
_NAME_LENGTH = 64  # as `Name` of the messages


class FleetSource(ListeningSource):
    """Reads position and verdict of every vehicle."""

    mode = "fleet"

    def __init__(self, settings: ServiceSettings) -> None:
        every = settings.model_copy(update={"vehicle": "*"})
        channels = ("position", "verdict")
        super().__init__("fleet", every, channels, every_s=_EVERY_S, most_messages=_MOST_MESSAGES)
        self.number = 0
        """Grows when something has come."""
        self._vehicles: dict[str, dict[str, Any]] = {}
        self._lock = threading.Lock()

    def vehicles(self) -> list[dict[str, Any]]:
        """The newest of each vehicle, as JSON, by name."""
        with self._lock:
            return [dict(row) for _, row in sorted(self._vehicles.items())]

    def take(self, samples: list[RawSample]) -> None:
        """Keep what the newest of these messages say."""
        super().take(samples)
        if samples:
            self.number += 1

    def _read(self, sample: RawSample) -> None:
        channel = BY_NAME[sample.channel]
        try:
            vehicle = channel.vehicle_in(sample.key)
            message = decode(channel.message, sample.data).message
        except (ValueError, DecodeError):
            self._left_out["undecodable"] += 1
            return
        with self._lock:
            known = vehicle in self._vehicles
            if len(vehicle) > _NAME_LENGTH or (not known and len(self._vehicles) >= _MOST_VEHICLES):
                self._left_out["vehicles"] += 1
                return
            row = self._vehicles.setdefault(vehicle, {"vehicle": vehicle})
            if isinstance(message, Position):
                row.update(_position(message))
            elif isinstance(message, Verdict):
                row.update(verdict=message.verdict, reason=message.reason)


def _position(position: Position) -> dict[str, Any]:
    latitude, longitude = position.latitude_rad, position.longitude_rad
    return {
        "t": unix_ns_from_gps_ns(position.time_ns) / 1e9,
        "lat": None if latitude is None else math.degrees(latitude),
        "lon": None if longitude is None else math.degrees(longitude),
        "yaw_rad": position.yaw_rad,
        "hpl_m": position.horizontal_protection_level_m,
        "source": position.source,
        "usable": position.usable,
        "why": position.reason,
    }
