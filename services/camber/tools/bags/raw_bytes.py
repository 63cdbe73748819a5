"""Frames of UBX and RTCM 3 in topics of bytes, as files: what passes its checksum, and nothing else."""

from __future__ import annotations

import re
from dataclasses import dataclass
from io import BufferedWriter
from pathlib import Path

from camber.formats.receiver.frame_buffer import FrameBuffer
from camber.formats.rtcm.msm_reader import is_msm

_RAWX, _SFRBX = b"\x02\x15", b"\x02\x13"  # class and id in UBX


@dataclass(slots=True, kw_only=True)
class RawFile:
    """A file of one protocol of one topic: how many frames of what it has."""

    name: str
    topic: str
    protocol: str
    frames: int = 0
    measurements: int = 0
    """RXM-RAWX, or MSM."""
    subframes: int = 0
    """RXM-SFRBX: ephemerides."""


class RawBytes:
    """Writes the frames of topics into files as they come."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._buffers: dict[str, FrameBuffer] = {}
        self._files: dict[tuple[str, str], tuple[RawFile, BufferedWriter]] = {}

    @property
    def files(self) -> tuple[RawFile, ...]:
        """The files so far."""
        return tuple(file for file, _ in self._files.values())

    def add(self, topic: str, data: bytes) -> None:
        """Write the frames that these bytes complete."""
        if topic not in self._buffers:
            self._buffers[topic] = FrameBuffer("ubx", "rtcm")
        for frame in self._buffers[topic].feed(data):
            file, stream = self._file(topic, frame.protocol)
            stream.write(frame.data)
            file.frames += 1
            if frame.protocol == "ubx":
                file.measurements += frame.data[2:4] == _RAWX
                file.subframes += frame.data[2:4] == _SFRBX
            else:
                file.measurements += is_msm(int.from_bytes(frame.data[3:5], "big") >> 4)

    def close(self) -> None:
        """Close all files."""
        for _, stream in self._files.values():
            stream.close()

    def _file(self, topic: str, protocol: str) -> tuple[RawFile, BufferedWriter]:
        if (topic, protocol) not in self._files:
            stem = re.sub("[^A-Za-z0-9]+", "_", topic.strip("/"))
            taken = {file.name for file in self.files}
            name = f"{stem}.{protocol}"
            if name in taken:  # /a/b and /a_b
                name = f"{stem}-{len(taken)}.{protocol}"
            file = RawFile(name=name, topic=topic, protocol=protocol)
            self._files[topic, protocol] = file, (self._folder / name).open("wb")
        return self._files[topic, protocol]
