"""Records what is published during a replay into the run folder, in an order that does not depend on the machine."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any, Self

from camber.formats.drive.recorder import Recorder
from camber.replay.run_folder import RunFolder
from camber.schemas.channels import CHANNELS
from camber.schemas.codec import Received, encode
from camber.schemas.drive import DriveManifest

# Longer than a feeder runs ahead (4 ticks) and than a fix is late, so that the recording is in the order of time.
_LAG_NS = 5_000_000_000


class RunRecorder:
    """The recording of one run; use as a context. Sweeps are not recorded: they are in the drive's folder."""

    def __init__(self, folder: RunFolder, manifest: DriveManifest, start_ns: int) -> None:
        vehicle = manifest.vehicle
        about = {
            "drive": manifest.name,
            "vehicle": vehicle,
            "camber": version("camber"),
            "manifest": manifest.model_dump_json(),
        }
        self._recorder = Recorder(folder.recording_path, about=about)
        # Bulk is not recorded: a sweep of 50,000 points has a megabyte.
        self._keys = {
            channel.name: channel.key_for(vehicle) for channel in CHANNELS if channel.delivery != "bulk"
        }
        self._channels = {key: name for name, key in self._keys.items()}
        self._written_ns = start_ns

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

    def tick_done(self, time_ns: int) -> None:
        """Write what was measured long enough before a tick, now and then."""
        if time_ns - self._written_ns >= 2 * _LAG_NS:
            self._written_ns = time_ns - _LAG_NS
            self._recorder.tick_done(self._written_ns)
