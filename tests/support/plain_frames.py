"""A second, slow search for frames in a stream, byte by byte as the documents say it: the oracle of `FrameBuffer`.

Sources: u-blox ZED-F9P, interface description (UBX-18010854), 3.2 and 3.4; NMEA 0183 v4.11, 5.3: `$`, printable
characters, `*`, two digits, a line end; RTCM 10403.3, 4: preamble, six zero bits, length, message, CRC-24Q; Septentrio
mosaic-X5 reference guide, 4.1.1: `$@`, CRC-CCITT of what follows, id, length of the whole frame, a multiple of four.
"""

from __future__ import annotations

import re
from binascii import crc_hqx

from camber.formats.broadcast.bit_fields import crc24q
from camber.formats.receiver.frame_buffer import Frame, FrameProtocol
from camber.formats.receiver.frame_search import MAX_SBF_BYTES, MAX_SENTENCE_BYTES, MAX_UBX_PAYLOAD_BYTES
from camber.formats.rtcm.writer import PREAMBLE
from camber.formats.ubx.writer import SYNC, checksum

_UBX_HEAD, _UBX_FRAMING = 6, 8
_RTCM_HEAD, _RTCM_FRAMING = 3, 6
# At the end of the bytes a first character alone may be a beginning.
_BEGINNINGS = {
    "ubx": rb"\xb5(?:\x62|\Z)",
    "nmea": rb"\$",
    "rtcm": rb"\xd3(?:[\x00-\x03]|\Z)",
    "sbf": rb"\$(?:@|\Z)",
}
_SENTENCE_END = re.compile(rb"[^\x20-\x23\x25-\x7e]")
_LOOKS_LIKE_A_SENTENCE = re.compile(rb"\$[A-Z]{2}")


class PlainFrameBuffer:
    """Has the results and counts of `FrameBuffer`."""

    def __init__(self, *protocols: FrameProtocol) -> None:
        self.bytes_skipped = 0
        """Bytes that are not part of a frame; with NMEA, without carriage returns and line feeds."""
        self.failed_checks = {protocol: 0 for protocol in protocols if protocol != "nmea"}
        """Frames with a wrong checksum."""
        self._buffer = bytearray()
        self._buffer_offset = 0
        self._beginning = re.compile(b"|".join(_BEGINNINGS[protocol] for protocol in protocols), re.DOTALL)
        self._protocols = protocols
        self._ignored = b"\r\n" if "nmea" in protocols else b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that the bytes complete."""
        self._buffer += data
        return self._scan(last=False)

    def finish(self) -> list[Frame]:
        """Return the remaining frames at the end of the stream."""
        return self._scan(last=True)

    def _scan(self, *, last: bool) -> list[Frame]:
        buffer, frames, place = self._buffer, list[Frame](), 0
        while True:
            match = self._beginning.search(buffer, place)
            start = len(buffer) if match is None else match.start()
            self._skip(buffer[place:start])
            place = start
            if match is None:
                break
            protocol = self._protocol(start)
            size = self._size(start, last=last)
            if size is None:
                break
            data = bytes(buffer[start : start + abs(size)])
            place += len(data)
            if size < 0:
                self._skip(data)
            else:
                frames.append(Frame(protocol=protocol, data=data, byte_offset=self._buffer_offset + start))
        self._buffer_offset += place
        del buffer[:place]
        return frames

    def _protocol(self, start: int) -> FrameProtocol:
        """Return the protocol of a beginning; a dollar sign alone may be either."""
        if self._buffer[start] != ord("$"):
            return _PROTOCOL_OF[self._buffer[start]]
        is_sbf = self._buffer[start + 1 : start + 2] == b"@" and "sbf" in self._protocols
        return "sbf" if is_sbf or "nmea" not in self._protocols else "nmea"

    def _size(self, start: int, *, last: bool) -> int | None:
        """Return the size of the frame, negative for bytes to skip, None for an incomplete frame."""
        protocol = self._protocol(start)
        if protocol == "nmea":
            return self._sentence_size(start, last=last)
        head, framing, most, false_start = _BINARY[protocol]
        left = len(self._buffer) - start
        if left < head:
            return -min(left, false_start) if last else None
        at, order = {"ubx": (4, "little"), "rtcm": (1, "big"), "sbf": (6, "little")}[protocol]
        length = int.from_bytes(self._buffer[start + at : start + at + 2], order)
        if length > most or (protocol == "sbf" and (length < head or length % 4)):
            return -false_start
        size = framing + length
        if left < size:
            return -false_start if last else None
        if _is_right(protocol, bytes(self._buffer[start : start + size])):
            return size
        self.failed_checks[protocol] += 1
        return -false_start

    def _sentence_size(self, start: int, *, last: bool) -> int | None:
        buffer = self._buffer
        match = _SENTENCE_END.search(buffer, start + 1)
        end = len(buffer) if match is None else match.start()
        if match is None and end - start <= MAX_SENTENCE_BYTES and not last:
            return None
        # Of a sentence that is too long only the allowed part is taken: the rest is found to be no sentence.
        size = min(end - start, MAX_SENTENCE_BYTES + 1)
        # Else it is a dollar sign inside a binary message.
        return size if _LOOKS_LIKE_A_SENTENCE.match(buffer, start) else -size

    def _skip(self, data: bytes | bytearray) -> None:
        self.bytes_skipped += len(data) - sum(data.count(byte) for byte in self._ignored)


_PROTOCOL_OF: dict[int, FrameProtocol] = {SYNC[0]: "ubx", PREAMBLE: "rtcm"}
# Bytes before the length is known, bytes around the content, its greatest length, what a false beginning costs.
_BINARY = {
    "ubx": (_UBX_HEAD, _UBX_FRAMING, MAX_UBX_PAYLOAD_BYTES, len(SYNC)),
    "rtcm": (_RTCM_HEAD, _RTCM_FRAMING, 1023, 1),
    "sbf": (8, 0, MAX_SBF_BYTES, 1),
}


def _is_right(protocol: FrameProtocol, frame: bytes) -> bool:
    if protocol == "ubx":
        return checksum(frame[2:-2]) == frame[-2:]
    if protocol == "sbf":
        return crc_hqx(frame[4:], 0) == int.from_bytes(frame[2:4], "little")
    return crc24q(frame[:-3]) == int.from_bytes(frame[-3:], "big")
