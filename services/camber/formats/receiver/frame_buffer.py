"""Whole messages of a stream in which UBX, NMEA 0183, RTCM 3 and SBF may be interleaved, with garbage between them.

Sources: u-blox ZED-F9P, interface description (UBX-18010854), 3.2 and 3.4; NMEA 0183 v4.11, 5.3: `$`, printable
characters, `*`, two digits, a line end; RTCM 10403.3, 4: preamble, six zero bits, length, message, CRC-24Q; Septentrio
mosaic-X5 reference guide, 4.1.1: `$@`, CRC-CCITT, id, length.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

import numpy as np

from camber.formats.receiver.frame_search import find_frames

FrameProtocol = Literal["ubx", "nmea", "rtcm", "sbf"]
# In the order of their numbers in `frame_search`.
_PROTOCOLS: tuple[FrameProtocol, ...] = ("ubx", "nmea", "rtcm", "sbf")
_CHUNK_BYTES = 1 << 16  # chosen: bounds the memory of the search


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """UBX, RTCM and SBF: a whole message with its framing and a correct checksum. NMEA: a candidate sentence."""

    protocol: FrameProtocol
    data: bytes
    byte_offset: int


class FrameBuffer:
    """Returns the frames of some protocols, in order; the result does not depend on how the stream is chunked.

    A false beginning costs its first byte, and the search goes on at the next: a wrong length or a truncated frame does
    not cost the frames after it. At most one frame is kept.
    """

    def __init__(self, *protocols: FrameProtocol) -> None:
        self.bytes_skipped = 0
        """Bytes that are not part of a frame; with NMEA, without carriage returns and line feeds."""
        self.failed_checks = {protocol: 0 for protocol in protocols if protocol != "nmea"}
        """Frames with a wrong checksum."""
        self._wanted = np.array([protocol in protocols for protocol in _PROTOCOLS])
        self._buffer = b""
        self._buffer_offset = 0
        # Compile now, so that the first bytes do not wait.
        self._search(last=False)

    @property
    def bytes_pending(self) -> int:
        """Bytes kept of an incomplete frame."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that the bytes complete."""
        frames = list[Frame]()
        for start in range(0, len(data), _CHUNK_BYTES):
            self._buffer += data[start : start + _CHUNK_BYTES]
            frames += self._search(last=False)
        return frames

    def finish(self) -> list[Frame]:
        """Return the remaining frames at the end of the stream: after an incomplete one, or without line end."""
        return self._search(last=True)

    def _search(self, *, last: bool) -> list[Frame]:
        search = find_frames(self._buffer, self._wanted, last=last)
        frames = [
            Frame(
                protocol=_PROTOCOLS[protocol],
                data=self._buffer[start : start + size],
                byte_offset=self._buffer_offset + start,
            )
            for protocol, start, size in search.frames.tolist()
        ]
        self.bytes_skipped += search.skipped
        for protocol in self.failed_checks:
            self.failed_checks[protocol] += int(search.failed[_PROTOCOLS.index(protocol)])
        self._buffer = self._buffer[search.consumed :]
        self._buffer_offset += search.consumed
        return frames


R = TypeVar("R")


class FramedDecoder(ABC, Generic[R]):
    """Decodes the frames of some protocols in a stream; the results do not depend on how it is chunked."""

    def __init__(self, *protocols: FrameProtocol) -> None:
        self._frames = FrameBuffer(*protocols)

    @property
    def bytes_skipped(self) -> int:
        """Bytes that are not part of a frame with a correct checksum, or of a sentence."""
        return self._frames.bytes_skipped

    @property
    def bytes_pending(self) -> int:
        """Bytes kept of an incomplete frame."""
        return self._frames.bytes_pending

    @property
    def failed_checks(self) -> int:
        """Frames of UBX, RTCM or SBF with a wrong checksum."""
        return sum(self._frames.failed_checks.values())

    def feed(self, data: bytes) -> list[R]:
        """Return the results that the bytes complete, in order. Never raises; keeps at most a frame and an epoch."""
        return [result for frame in self._frames.feed(data) for result in self._take(frame)]

    def finish(self) -> list[R]:
        """Return the remaining results at the end of the stream, or when it is silent."""
        return [result for frame in self._frames.finish() for result in self._take(frame)] + self._end()

    @abstractmethod
    def _take(self, frame: Frame) -> list[R]:
        """Return the results that a frame completes."""

    @abstractmethod
    def _end(self) -> list[R]:
        """Return the results of what is incomplete."""
