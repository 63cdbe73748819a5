"""UDP datagrams out of recordings of a network: pcap (µs, ns, both byte orders) and pcapng.

Sources: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng (files), RFC 791 (IPv4 and its fragments: a LiDAR's packet
is often longer than a frame), RFC 768 (UDP). Ethernet with VLAN tags, Linux' cooked captures and raw IP are read; what
is not UDP over IPv4 is counted in `skipped`, as are frames that were cut short and datagrams of which a fragment lacks.
"""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass

from camber.formats.errors import FormatError

MOST_BYTES = 1 << 18  # of one frame; what claims more is no recording of a network
_CLASSIC = {b"\xa1\xb2\xc3\xd4": 1000, b"\xa1\xb2\x3c\x4d": 1}
_SECTION = b"\x0a\x0d\x0d\x0a"
_ETHERNET, _RAW, _COOKED, _COOKED_2, _IPV4 = 1, 101, 113, 276, 228
_LINKS = {_ETHERNET: (12, 14), _COOKED: (14, 16), _COOKED_2: (0, 20), _RAW: (None, 0), _IPV4: (None, 0)}
"""Link type → where the protocol stands, and how long its header is."""
_ETHERTYPE_IPV4, _VLAN = 0x0800, (0x8100, 0x88A8)
_UDP = 17
_HELD = 64  # datagrams that wait for fragments
_HELD_NS = 15_000_000_000  # so long (RFC 791): numbers of datagrams come again, an OS1's after 51 s
_MOST_OF_ALL = 1 << 16  # bytes of a datagram


@dataclass(frozen=True, slots=True)
class Datagram:
    """`time_ns` is when it was recorded, by the recording machine's clock: UTC, nanoseconds since 1970."""

    time_ns: int
    source: str
    port: int
    payload: bytes


class PcapDecoder:
    """Datagrams in the file's order, whatever pieces the file comes in. A file that is none costs one FormatError."""

    def __init__(self, source_name: str) -> None:
        self.skipped: Counter[str] = Counter()
        self._name = source_name
        self._bytes = bytearray()
        self._at = 0
        self._kind = ""
        self._order = "<"
        self._tick_ns = 1000
        self._links: list[tuple[int, int, int]] = []  # link type, ticks a second, offset in seconds
        self._fragments: dict[tuple[bytes, bytes, int], _Fragments] = {}
        self._broken = False

    def feed(self, data: bytes) -> list[Datagram | FormatError]:
        """What is complete with these bytes."""
        if self._broken:
            return []
        self._bytes += data
        found: list[Datagram | FormatError] = []
        try:
            while self._step(found):
                pass
        except FormatError as error:
            self._broken = True
            self._bytes.clear()
            found.append(error)
        return found

    def finish(self) -> list[Datagram | FormatError]:
        """The file has ended; one that ends within a frame says so."""
        if self._fragments:
            self.skipped["fragment"] += len(self._fragments)
            self._fragments.clear()
        if self._broken or not self._bytes:
            return []
        return [FormatError(self._name, "end", "a whole frame", byte_offset=self._at)]

    def _step(self, found: list[Datagram | FormatError]) -> bool:
        if not self._kind:
            return self._begin()
        if self._kind == "pcapng":
            return self._block(found)
        if len(self._bytes) < 16:
            return False
        seconds, fraction, length, whole = struct.unpack_from(f"{self._order}4I", self._bytes)
        self._check(length)
        if len(self._bytes) < 16 + length:
            return False
        frame = self._taken(16 + length)[16:]
        self._frame(seconds * 1_000_000_000 + fraction * self._tick_ns, frame, length < whole, 0, found)
        return True

    def _begin(self) -> bool:
        if len(self._bytes) < 4:
            return False
        magic = bytes(self._bytes[:4])
        if magic == _SECTION:
            self._kind = "pcapng"
            return True
        order = ">" if magic in _CLASSIC else "<"
        tick_ns = _CLASSIC.get(magic if order == ">" else magic[::-1])
        if tick_ns is None:
            raise FormatError(
                self._name, "magic number", "that of pcap or pcapng", actual=magic.hex(), byte_offset=0
            )
        if len(self._bytes) < 24:
            return False
        self._kind, self._order, self._tick_ns = "pcap", order, tick_ns
        link = struct.unpack_from(f"{order}I", self._taken(24), 20)[0] & 0xFFFF
        self._add_link(link, 0, 0)
        return True

    def _add_link(self, link: int, ticks: int, offset_s: int) -> None:
        if link not in _LINKS:
            expected = "Ethernet (1), raw IP (101) or Linux cooked (113, 276)"
            raise FormatError(self._name, "link type", expected, actual=str(link), byte_offset=self._at)
        self._links.append((link, ticks, offset_s))

    def _block(self, found: list[Datagram | FormatError]) -> bool:
        if len(self._bytes) < 12:
            return False
        if self._bytes[:4] == _SECTION:
            order = {b"\x1a\x2b\x3c\x4d": ">", b"\x4d\x3c\x2b\x1a": "<"}.get(bytes(self._bytes[8:12]))
            if order is None:
                raise FormatError(self._name, "byte order", "that of pcapng", byte_offset=self._at)
            self._order, self._links = order, []
        kind, length = struct.unpack_from(f"{self._order}2I", self._bytes)
        self._check(length)
        if length < 12 or length % 4:
            raise FormatError(
                self._name,
                "block length",
                "a multiple of 4, 12 or more",
                actual=str(length),
                byte_offset=self._at,
            )
        if len(self._bytes) < length:
            return False
        body = self._taken(length)[8:-4]
        if kind == 1 and len(body) >= 8:
            self._interface(body)
        elif kind == 6 and len(body) >= 20:
            self._packet(body, found)
        return True

    def _interface(self, body: bytes) -> None:
        ticks, offset_s, at = 1_000_000, 0, 8
        while at + 4 <= len(body):
            code, size = struct.unpack_from(f"{self._order}2H", body, at)
            value = body[at + 4 : at + 4 + size]
            if code == 9 and len(value) == 1:
                power = value[0] & 0x7F
                if power > 30:
                    raise FormatError(
                        self._name, "if_tsresol", "at most 30", actual=str(power), byte_offset=self._at
                    )
                ticks = 2**power if value[0] & 0x80 else 10**power
            elif code == 14 and len(value) == 8:
                offset_s = struct.unpack(f"{self._order}q", value)[0]
            at += 4 + (size + 3) // 4 * 4
        self._add_link(struct.unpack_from(f"{self._order}H", body)[0], ticks, offset_s)

    def _packet(self, body: bytes, found: list[Datagram | FormatError]) -> None:
        interface, high, low, length, whole = struct.unpack_from(f"{self._order}5I", body)
        if interface >= len(self._links) or 20 + length > len(body):
            raise FormatError(
                self._name, "packet block", "a known interface and all bytes", byte_offset=self._at
            )
        _, ticks, offset_s = self._links[interface]
        time_ns = (high << 32 | low) * 1_000_000_000 // ticks + offset_s * 1_000_000_000
        self._frame(time_ns, body[20 : 20 + length], length < whole, interface, found)

    def _check(self, length: int) -> None:
        if length > MOST_BYTES:
            expected = f"{MOST_BYTES} bytes at most"
            raise FormatError(self._name, "frame length", expected, actual=str(length), byte_offset=self._at)

    def _taken(self, length: int) -> bytes:
        taken = bytes(self._bytes[:length])
        del self._bytes[:length]
        self._at += length
        return taken

    def _frame(
        self, time_ns: int, frame: bytes, cut: bool, interface: int, found: list[Datagram | FormatError]
    ) -> None:
        if cut:  # by a snap length: half a packet is none
            self.skipped["truncated"] += 1
            return
        datagram = self._datagram(time_ns, _network_layer(frame, self._links[interface][0]))
        if datagram is not None:
            found.append(datagram)

    def _datagram(self, time_ns: int, packet: bytes | None) -> Datagram | None:
        if packet is None or len(packet) < 20 or packet[0] >> 4 != 4 or packet[9] != _UDP:
            self.skipped["other"] += 1
            return None
        header, total = 4 * (packet[0] & 0xF), int.from_bytes(packet[2:4], "big")
        if header < 20 or not header < total <= len(packet):
            self.skipped["truncated"] += 1
            return None
        place = int.from_bytes(packet[6:8], "big")
        payload: bytes | None = packet[header:total]
        if place & 0x3FFF:  # more to come, or not the first
            payload = self._assembled(
                time_ns, packet, packet[header:total], 8 * (place & 0x1FFF), bool(place & 0x2000)
            )
            if payload is None:
                return None
        assert payload is not None
        if len(payload) < 8 or int.from_bytes(payload[4:6], "big") != len(payload):
            self.skipped["truncated"] += 1
            return None
        source = ".".join(map(str, packet[12:16]))
        return Datagram(time_ns, source, int.from_bytes(payload[2:4], "big"), payload[8:])

    def _assembled(self, time_ns: int, packet: bytes, part: bytes, at: int, more: bool) -> bytes | None:
        key = (packet[12:16], packet[16:20], int.from_bytes(packet[4:6], "big"))
        held = self._fragments.setdefault(key, _Fragments(time_ns))
        if abs(time_ns - held.time_ns) > _HELD_NS:  # of a datagram before, that had the same number
            self.skipped["fragment"] += 1
            held = self._fragments[key] = _Fragments(time_ns)
        whole = held.add(at, part, more)
        if whole is not None:
            del self._fragments[key]
        elif len(self._fragments) > _HELD:
            del self._fragments[next(iter(self._fragments))]
            self.skipped["fragment"] += 1
        return whole


class _Fragments:
    """Of one datagram, whose first came at this time."""

    def __init__(self, time_ns: int) -> None:
        self.time_ns = time_ns
        self._parts: dict[int, bytes] = {}
        self._end: int | None = None

    def add(self, at: int, part: bytes, more: bool) -> bytes | None:
        """All of it, once nothing is missing."""
        if sum(map(len, self._parts.values())) + len(part) > _MOST_OF_ALL:  # no datagram is so long
            self._parts.clear()
        self._parts[at] = part
        if not more:
            self._end = at + len(part)
        whole = b""
        while (part := self._parts.get(len(whole), b"")) != b"":
            whole += part
        return whole if len(whole) == self._end else None


def _network_layer(frame: bytes, link: int) -> bytes | None:
    """The IP packet of a frame; None where it carries something else."""
    place, header = _LINKS[link]
    if len(frame) < header:
        return None
    if place is None:
        return frame
    protocol = int.from_bytes(frame[place : place + 2], "big")
    while link == _ETHERNET and protocol in _VLAN:
        protocol = int.from_bytes(frame[header + 2 : header + 4], "big")
        header += 4
    return frame[header:] if protocol == _ETHERTYPE_IPV4 else None


def pcap_header() -> bytes:
    """Of a file of Ethernet frames, with times in nanoseconds."""
    return struct.pack("<4s2HiIII", b"\x4d\x3c\xb2\xa1", 2, 4, 0, 0, MOST_BYTES, _ETHERNET)


def pcap_frames(datagram: Datagram, destination: str, identification: int, most_bytes: int = 1500) -> bytes:
    """A datagram as its frames, recorded at its time: more than one where it is longer than a frame may be."""
    ends = bytes(map(int, f"{datagram.source}.{destination}".split(".")))
    udp = struct.pack(">4H", datagram.port, datagram.port, 8 + len(datagram.payload), 0) + datagram.payload
    step = (most_bytes - 20) // 8 * 8
    frames = []
    for at in range(0, len(udp), step):
        part = udp[at : at + step]
        more = 0x2000 if at + step < len(udp) else 0
        fields = (0x45, 0, 20 + len(part), identification & 0xFFFF, more | at // 8, 64, _UDP)
        header = struct.pack(">2B3H2B", *fields)
        ip = header + _checksum(header + b"\0\0" + ends) + ends + part
        frame = b"\x02" + bytes(5) + b"\x02" + bytes(4) + b"\x01" + b"\x08\0" + ip
        seconds, fraction = divmod(datagram.time_ns, 1_000_000_000)
        frames.append(struct.pack("<4I", seconds, fraction, len(frame), len(frame)) + frame)
    return b"".join(frames)


def _checksum(header: bytes) -> bytes:
    total = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return struct.pack(">H", total ^ 0xFFFF)
