"""Records what is published during a replay into the run folder, in an order that does not depend on the machine."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, Self

from camber.formats.drive.mcap_recorder import Recorder
from camber.formats.foxglove.drawings import log
from camber.replay.run_folder import RunFolder
from camber.road_map.road_columns import RoadLinks
from camber.road_map.road_drawing import draw_roads
from camber.schemas.channels import CHANNELS
from camber.schemas.codec import Received, encode
from camber.schemas.drive import DriveManifest
from camber.schemas.lidar import Sweep

# Longer than a feeder runs ahead (4 ticks) and than a fix is late, so that the recording is in the order of time.
_LAG_NS = 5_000_000_000
_REPEATED_ISSUE_NS = 10_000_000_000  # chosen: as in the services' own logs


class RunRecorder:
    """The recording of one run; use as a context. Sweeps are not recorded: they are in the drive's folder."""

    def __init__(
        self,
        folder: RunFolder,
        manifest: DriveManifest,
        start_ns: int,
        *,
        settings: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """`settings` of the services stand in the recording's metadata, as the manifest does."""
        vehicle = manifest.vehicle
        about = {
            "drive": manifest.name,
            "vehicle": vehicle,
            "camber": version("camber"),
            "manifest": manifest.model_dump_json(),
            "settings": json.dumps(settings or {}, default=str),
        }
        self._recorder = Recorder(folder.recording_path, about=about)
        # A sweep of 50,000 points has a megabyte.
        self._keys = {
            channel.name: channel.key_for(vehicle) for channel in CHANNELS if channel.message is not Sweep
        }
        self._channels = {key: name for name, key in self._keys.items()}
        self._start_ns = self._written_ns = start_ns
        self._issues_ns: dict[tuple[str, str], int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._recorder.close()

    @property
    def notes(self) -> tuple[str, ...]:
        """Why the recording ended early, if it did."""
        return (self._recorder.problem,) if self._recorder.problem else ()

    def add_bytes(self, key: str, data: bytes, arrival_ns: int) -> None:
        """Record a message as it was on the bus; may be called from any thread."""
        name = self._channels.get(key)
        if name is not None:
            self._recorder.add(name, data, key=key, arrival_ns=arrival_ns)

    def add_message(self, channel: str, received: Received[Any], arrival_ns: int) -> None:
        """Record a message as it would be on the bus."""
        if channel in self._keys:
            data = encode(received.message, source=received.source, sequence=received.sequence)
            self._recorder.add(channel, data, key=self._keys[channel], arrival_ns=arrival_ns)

    def draw_roads(self, links: RoadLinks) -> None:
        """Record the roads of the map, as viewers draw them."""
        self._recorder.draw(draw_roads(links), time_ns=self._written_ns, arrival_ns=time.time_ns())

    def add_issue(self, time_ns: int, service: str, text: str) -> None:
        """Record an issue of a service in the log that viewers show; the same one at most once in a while."""
        time_ns = max(time_ns, self._start_ns)  # before the first tick a service has no time
        last_ns = self._issues_ns.get((service, text))
        if last_ns is None or time_ns - last_ns >= _REPEATED_ISSUE_NS:
            self._issues_ns[service, text] = time_ns
            line = log(time_ns, service, text, warning=True)
            self._recorder.draw(line, time_ns=time_ns, arrival_ns=time.time_ns())

    def tick_done(self, time_ns: int) -> None:
        """Write what was measured long enough before a tick, now and then."""
        if time_ns - self._written_ns >= 2 * _LAG_NS:
            self._written_ns = time_ns - _LAG_NS
            self._recorder.tick_done(self._written_ns)
