"""The streams of a drive's receiver and base station and its files of ephemerides, as messages by time of arrival."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camber.replay.arrivals import TimedBytes, read_arrivals
from camber.replay.observation_files import read_observation_file, read_raw_file
from camber.replay.receiver_file import read_receiver_file, receive_times
from camber.schemas.drive import DriveManifest
from camber.schemas.gnss import Protocol, ReceiverBytes, Stream

MOST_PIECE_BYTES = 64_000
"""Of a file that comes as a whole; larger messages delay others on a slow bus."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReceiverStream:
    """One stream in the order of arrival. `header` is what stands before the first epoch of a file."""

    stream: Stream
    protocol: Protocol
    header: bytes
    parts: tuple[TimedBytes, ...]

    def messages(self, first_ns: int, last_ns: int) -> Iterator[ReceiverBytes]:
        """One message a time of arrival, in a period; the header comes with the first of them."""
        together: dict[int, list[bytes]] = {}
        for part in self.parts:
            if first_ns <= part.time_ns <= last_ns:
                together.setdefault(part.time_ns, []).append(part.payload)
        header = self.header
        for time_ns, parts in together.items():
            yield _message(time_ns, self.stream, self.protocol, header + b"".join(parts))
            header = b""

    def greeting(self, time_ns: int) -> Iterator[ReceiverBytes]:
        """Yield what a client that connects later needs before the next epoch: the header, without damaged lines."""
        header = self.header
        if self.protocol == "pos":
            header = b"".join(line for line in header.splitlines(keepends=True) if line.startswith(b"%"))
        if header:
            yield _message(time_ns, self.stream, self.protocol, header)


def read_streams(manifest: DriveManifest, dated_ns: int | None) -> list[ReceiverStream]:
    """The base before the rover, so that of two epochs of one time the base's comes first; then the solutions.

    `dated_ns` is a time of the drive, within half a week, for files without their week. Raises FormatError,
    OSError.
    """
    solutions: list[ReceiverStream] = []
    if manifest.receiver is not None:
        file, noted = manifest.receiver, manifest.receiver.arrivals
        header, epochs = read_receiver_file(file)
        parts = _arrived(header, epochs, noted)
        solutions = [ReceiverStream(stream="rover", protocol=file.format, header=header, parts=parts)]
        dated_ns = solutions[0].parts[0].time_ns
    if manifest.observations is None:
        return solutions
    raw = manifest.observations
    rover = _observed("rover", raw.rover_obs, raw.rover_arrivals, dated_ns)
    return [_observed("base", raw.base_obs, raw.base_arrivals, rover.parts[0].time_ns), rover, *solutions]


def whole_files(manifest: DriveManifest, time_ns: int) -> list[ReceiverBytes]:
    """The files of ephemerides in pieces, all at one time. Raises FormatError, OSError."""
    if manifest.observations is None:
        return []
    pieces = []
    for path in manifest.observations.ephemerides:
        protocol, data = read_raw_file(path)
        for start in range(0, len(data), MOST_PIECE_BYTES):
            piece = data[start : start + MOST_PIECE_BYTES]
            pieces.append(_message(time_ns, "ephemerides", protocol, piece))
    return pieces


def _observed(stream: Stream, path: Path, noted: Path | None, near_ns: int | None) -> ReceiverStream:
    protocol, header, epochs = read_observation_file(path, near_ns)
    parts = _arrived(header, epochs, noted)
    return ReceiverStream(stream=stream, protocol=protocol, header=header, parts=parts)


def _arrived(header: bytes, epochs: list[TimedBytes], noted: Path | None) -> tuple[TimedBytes, ...]:
    """By time of arrival: as it was noted down, or as if all was sent at once."""
    if noted is not None:
        data = header + b"".join(epoch.payload for epoch in epochs)
        return tuple(read_arrivals(noted, len(header), data))
    at_ns = receive_times([epoch.time_ns for epoch in epochs])
    return tuple(TimedBytes(time_ns, epoch.payload) for time_ns, epoch in zip(at_ns, epochs, strict=True))


def _message(time_ns: int, stream: Stream, protocol: Protocol, payload: bytes) -> ReceiverBytes:
    return ReceiverBytes(
        time_ns=time_ns, stream=stream, protocol=protocol, payload=np.frombuffer(payload, np.uint8)
    )
