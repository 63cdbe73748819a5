"""Whole messages out of a stream in which UBX, NMEA 0183 and RTCM 3 may be interleaved, with garbage between them.

Sources: u-blox ZED-F9P, interface description (UBX-18010854), 3.2 and 3.4; NMEA 0183 v4.11, 5.3: `$`, printable
characters, `*`, two digits, a line end; RTCM 10403.3, 4: preamble, six zero bits, length, message, CRC-24Q.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from camber.formats.receiver.frame_search import find_frames

FrameProtocol = Literal["ubx", "nmea", "rtcm"]
# By their numbers in the search.
_PROTOCOLS: tuple[FrameProtocol, ...] = ("ubx", "nmea", "rtcm")
_PIECE_BYTES = 1 << 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """UBX and RTCM: a whole message with its framing, whose checksum is right. NMEA: what looks like a sentence."""

    protocol: FrameProtocol
    data: bytes
    byte_offset: int


class FrameBuffer:
    """Finds the frames of some protocols, in order; the result does not depend on how the stream was cut into pieces.

    What begins like a frame and is none costs its first byte, and what follows is looked at anew: a false length, or a
    frame that was cut short, does not take the frames behind it along. At most one frame is kept.
    """

    def __init__(self, *protocols: FrameProtocol) -> None:
        self.bytes_skipped = 0
        """Bytes that belong to no frame; where NMEA is looked for, without carriage returns and line feeds."""
        self.failed_checks = {protocol: 0 for protocol in protocols if protocol != "nmea"}
        """Things that began like a frame and had a wrong checksum."""
        self._wanted = np.array([protocol in protocols for protocol in _PROTOCOLS])
        self._buffer = b""
        self._buffer_offset = 0
        # The first bytes need not wait for the compiler.
        self._found(last=False)

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that the bytes complete."""
        frames = list[Frame]()
        for begin in range(0, len(data), _PIECE_BYTES):
            self._buffer += data[begin : begin + _PIECE_BYTES]
            frames += self._found(last=False)
        return frames

    def finish(self) -> list[Frame]:
        """Call at the end of the stream: frames behind one that was not completed, a last sentence without line end."""
        return self._found(last=True)

    def _found(self, *, last: bool) -> list[Frame]:
        places, used, skipped, failed = find_frames(self._buffer, self._wanted, last=last)
        frames = [
            Frame(
                protocol=_PROTOCOLS[protocol],
                data=self._buffer[start : start + size],
                byte_offset=self._buffer_offset + start,
            )
            for protocol, start, size in places.tolist()
        ]
        self.bytes_skipped += skipped
        for protocol in self.failed_checks:
            self.failed_checks[protocol] += int(failed[_PROTOCOLS.index(protocol)])
        self._buffer = self._buffer[used:]
        self._buffer_offset += used
        return frames
