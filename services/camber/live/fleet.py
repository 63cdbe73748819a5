"""Where all vehicles on the bus are: the newest position of each, kept from a thread of its own."""

from __future__ import annotations

import math
import threading
from collections import Counter
from typing import Any

from camber.geodesy.gps_time import unix_ns_from_gps_ns
from camber.live.sources import State
from camber.runtime.raw_subscription import RawSample, RawSubscription
from camber.runtime.session import BusError
from camber.runtime.settings import ServiceSettings
from camber.schemas.channels import BY_NAME
from camber.schemas.codec import DecodeError, decode
from camber.schemas.integrity import Position, Verdict

_EVERY_S = 0.5  # chosen: a map of many vehicles needs no more
_RETRY_S = 2.0  # chosen: a router that is started comes within some seconds
_LIMIT_BYTES = 32 << 20  # chosen: a flood must not take the machine's memory
_MOST_MESSAGES = 5000
"""Read in one round. Chosen: of 500 vehicles at 10 Hz; of more messages the oldest are left out."""
_MOST_VEHICLES = 2000
"""Chosen: a peer that invents names must not fill the memory; of more vehicles the newest are left out."""
_NAME_LENGTH = 64  # as `Name` of the messages


class FleetSource:
    """Reads position and verdict of every vehicle."""

    mode = "fleet"

    def __init__(self, settings: ServiceSettings) -> None:
        self.state: State = "waiting"
        self.problem = ""
        self.number = 0
        """Grows when something has come."""
        self._settings = settings.model_copy(update={"vehicle": "*"})
        self._vehicles: dict[str, dict[str, Any]] = {}
        self._left_out: Counter[str] = Counter()
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="fleet", daemon=True)

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def end(self) -> None:
        """Leave the bus."""
        self._ended.set()
        self._thread.join(_RETRY_S)

    def left_out(self) -> dict[str, int]:
        """How many messages are not shown, by reason."""
        return dict(self._left_out)

    def vehicles(self) -> list[dict[str, Any]]:
        """The newest of each vehicle, as JSON, by name."""
        with self._lock:
            return [dict(row) for _, row in sorted(self._vehicles.items())]

    def take(self, samples: list[RawSample]) -> None:
        """Keep what these messages say."""
        dropped = max(len(samples) - _MOST_MESSAGES, 0)
        self._left_out["flood"] += dropped
        for sample in samples[dropped:]:
            self._read(sample)
        if samples:
            self.number += 1

    def _run(self) -> None:
        channels = [BY_NAME["position"], BY_NAME["verdict"]]
        while not self._ended.is_set():
            try:
                with RawSubscription(
                    self._settings, channels, timeout_s=_RETRY_S, limit_bytes=_LIMIT_BYTES
                ) as listener:
                    self.state, self.problem = "receiving", ""
                    while not self._ended.wait(_EVERY_S):
                        self.take(listener.take())
                        self._left_out["flood"] += listener.dropped.total()
                        listener.dropped.clear()
            except BusError as error:
                self.state, self.problem = "waiting", str(error)
                self._ended.wait(_RETRY_S)

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
