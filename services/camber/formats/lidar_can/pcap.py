"""UDP datagrams of network recordings: pcap (µs, ns, both byte orders) and pcapng.

Sources: draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng (files), RFC 791 (IPv4 and its fragments: a LiDAR's packet
is often longer than a frame), RFC 768 (UDP). Ethernet with VLAN tags, Linux' cooked captures and raw IP are supported;
other protocols than UDP over IPv4 are counted in `skipped`, as are truncated frames and datagrams with a missing
fragment.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Generator
from dataclasses import dataclass

from camber.formats.errors import FormatError
from camber.geodesy.gps_time import NS_PER_SECOND

MOST_BYTES = 1 << 18  # chosen: of one frame; a greater length is no recording of a network
_CLASSIC = {b"\xa1\xb2\xc3\xd4": 1000, b"\xa1\xb2\x3c\x4d": 1}
_SECTION = b"\x0a\x0d\x0d\x0a"
_ETHERNET, _RAW, _COOKED, _COOKED_2, _IPV4 = 1, 101, 113, 276, 228
_LINKS = {_ETHERNET: (12, 14), _COOKED: (14, 16), _COOKED_2: (0, 20), _RAW: (None, 0), _IPV4: (None, 0)}
"""Link type → position of the protocol, and length of the header."""
_ETHERTYPE_IPV4, _VLAN = 0x0800, (0x8100, 0x88A8)
_UDP = 17  # RFC 790
_MAX_INCOMPLETE = 64  # chosen: datagrams that wait for fragments
_REASSEMBLY_NS = 15_000_000_000  # RFC 791; identifications repeat, an OS1's after 51 s
_MAX_DATAGRAM_BYTES = 1 << 16  # RFC 791


@dataclass(frozen=True, slots=True, kw_only=True)
class Datagram:
    """`time_ns` is when it was recorded, by the recording machine's clock: UTC, nanoseconds since 1970."""

    time_ns: int
    source: str
    port: int
    payload: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class _Interface:
    link: int
    ticks_per_s: int
    offset_s: int = 0

    def time_ns(self, ticks: int) -> int:
        return ticks * NS_PER_SECOND // self.ticks_per_s + self.offset_s * NS_PER_SECOND


class PcapDecoder:
    """Datagrams in the file's order, for chunks of any size. A file of another format is one FormatError."""

    def __init__(self, source_name: str) -> None:
        self.skipped: Counter[str] = Counter()
        self._name = source_name
        self._bytes = bytearray()
        self._place = 0  # of the bytes that wait, in the file
        self._at = 0  # begin of the header, block or frame that is being read
        self._order = "<"
        self._interfaces: list[_Interface] = []
        self._fragments: dict[tuple[bytes, bytes, int], _Fragments] = {}
        self._broken = False
        self._results: list[Datagram | FormatError] = []
        self._reader = self._read()
        self._wanted = next(self._reader)

    def feed(self, data: bytes) -> list[Datagram | FormatError]:
        """Return the datagrams that these bytes complete."""
        if self._broken:
            return []
        self._bytes += data
        try:
            while len(self._bytes) >= self._wanted:
                taken = bytes(self._bytes[: self._wanted])
                del self._bytes[: self._wanted]
                self._place += self._wanted
                self._wanted = self._reader.send(taken)
        except FormatError as error:
            self._broken = True
            self._bytes.clear()
            self._results.append(error)
        results, self._results = self._results, []
        return results

    def finish(self) -> list[Datagram | FormatError]:
        """Return an error where the file ends within a frame."""
        if self._fragments:
            self.skipped["fragment"] += len(self._fragments)
            self._fragments.clear()
        whole = self._place == self._at and not self._bytes
        return [] if self._broken or whole else [self._error("end", "a whole frame")]

    def _error(self, field: str, expected: str, actual: object = None) -> FormatError:
        text = None if actual is None else str(actual)
        return FormatError(self._name, field, expected, actual=text, byte_offset=self._at)

    def _read(self) -> Generator[int, bytes, None]:
        """Yield how many bytes are needed next, and receive them."""
        magic = yield 4
        if magic == _SECTION:
            yield from self._read_pcapng(magic)
        order = ">" if magic in _CLASSIC else "<"
        tick_ns = _CLASSIC.get(magic if order == ">" else magic[::-1])
        if tick_ns is None:
            raise self._error("magic number", "that of pcap or pcapng", magic.hex())
        link = struct.unpack(f"{order}I", (yield 20)[16:])[0] & 0xFFFF
        self._at = self._place
        self._add_interface(_Interface(link=link, ticks_per_s=NS_PER_SECOND // tick_ns))
        interface = self._interfaces[0]
        while True:
            self._at = self._place
            seconds, fraction, length, original_length = struct.unpack(f"{order}4I", (yield 16))
            self._check(length)
            ticks = seconds * interface.ticks_per_s + fraction
            self._frame(interface, ticks, (yield length), original_length)

    def _read_pcapng(self, first: bytes) -> Generator[int, bytes, None]:
        while True:
            head = first + (yield 12 - len(first))
            if head[:4] == _SECTION:
                order = {b"\x1a\x2b\x3c\x4d": ">", b"\x4d\x3c\x2b\x1a": "<"}.get(head[8:])
                if order is None:
                    raise self._error("byte order", "that of pcapng")
                self._order, self._interfaces = order, []
            kind, length = struct.unpack_from(f"{self._order}2I", head)
            self._check(length)
            if length < 12 or length % 4:
                raise self._error("block length", "a multiple of 4, 12 or more", length)
            body = (head[8:] + (yield length - 12))[:-4]
            self._at, first = self._place, b""
            if kind == 1 and len(body) >= 8:
                self._interface_description(body)
            elif kind == 6 and len(body) >= 20:
                self._enhanced_packet(body)

    def _add_interface(self, interface: _Interface) -> None:
        if interface.link not in _LINKS:
            expected = "Ethernet (1), raw IP (101) or Linux cooked (113, 276)"
            raise self._error("link type", expected, interface.link)
        self._interfaces.append(interface)

    def _interface_description(self, body: bytes) -> None:
        ticks_per_s, offset_s, at = 1_000_000, 0, 8
        while at + 4 <= len(body):
            code, size = struct.unpack_from(f"{self._order}2H", body, at)
            value = body[at + 4 : at + 4 + size]
            if code == 9 and len(value) == 1:
                power = value[0] & 0x7F
                if power > 30:
                    raise self._error("if_tsresol", "at most 30", power)
                ticks_per_s = 2**power if value[0] & 0x80 else 10**power
            elif code == 14 and len(value) == 8:
                offset_s = struct.unpack(f"{self._order}q", value)[0]
            at += 4 + (size + 3) // 4 * 4
        link = struct.unpack_from(f"{self._order}H", body)[0]
        self._add_interface(_Interface(link=link, ticks_per_s=ticks_per_s, offset_s=offset_s))

    def _enhanced_packet(self, body: bytes) -> None:
        number, high, low, length, original_length = struct.unpack_from(f"{self._order}5I", body)
        if number >= len(self._interfaces) or 20 + length > len(body):
            raise self._error("packet block", "a known interface and all bytes")
        self._frame(self._interfaces[number], high << 32 | low, body[20 : 20 + length], original_length)

    def _check(self, length: int) -> None:
        if length > MOST_BYTES:
            raise self._error("frame length", f"{MOST_BYTES} bytes at most", length)

    def _frame(self, interface: _Interface, ticks: int, frame: bytes, original_length: int) -> None:
        if len(frame) < original_length:  # cut by a snap length
            self.skipped["truncated"] += 1
            return
        datagram = self._datagram(interface.time_ns(ticks), _network_layer(frame, interface.link))
        if datagram is not None:
            self._results.append(datagram)

    def _datagram(self, time_ns: int, packet: bytes | None) -> Datagram | None:
        if packet is None or len(packet) < 20 or packet[0] >> 4 != 4 or packet[9] != _UDP:
            self.skipped["other"] += 1
            return None
        header, total = 4 * (packet[0] & 0xF), int.from_bytes(packet[2:4], "big")
        if header < 20 or not header < total <= len(packet):
            self.skipped["truncated"] += 1
            return None
        payload = packet[header:total]
        if int.from_bytes(packet[6:8], "big") & 0x3FFF:  # more fragments follow, or not the first one
            whole = self._reassembled(time_ns, packet, payload)
            if whole is None:
                return None
            payload = whole
        if len(payload) < 8 or int.from_bytes(payload[4:6], "big") != len(payload):
            self.skipped["truncated"] += 1
            return None
        source, port = ".".join(map(str, packet[12:16])), int.from_bytes(payload[2:4], "big")
        return Datagram(time_ns=time_ns, source=source, port=port, payload=payload[8:])

    def _reassembled(self, time_ns: int, packet: bytes, part: bytes) -> bytes | None:
        position = int.from_bytes(packet[6:8], "big")
        key = (packet[12:16], packet[16:20], int.from_bytes(packet[4:6], "big"))
        fragments = self._fragments.setdefault(key, _Fragments(time_ns))
        if abs(time_ns - fragments.time_ns) > _REASSEMBLY_NS:
            # Of an earlier datagram with this identification.
            self.skipped["fragment"] += 1
            fragments = self._fragments[key] = _Fragments(time_ns)
        whole = fragments.add(8 * (position & 0x1FFF), part, more=bool(position & 0x2000))
        if whole is not None:
            del self._fragments[key]
        elif len(self._fragments) > _MAX_INCOMPLETE:
            del self._fragments[next(iter(self._fragments))]
            self.skipped["fragment"] += 1
        return whole


class _Fragments:
    """Fragments of one datagram, whose first was recorded at this time."""

    def __init__(self, time_ns: int) -> None:
        self.time_ns = time_ns
        self._parts: dict[int, bytes] = {}
        self._end: int | None = None

    def add(self, at: int, part: bytes, *, more: bool) -> bytes | None:
        """Return the datagram once nothing is missing."""
        if sum(map(len, self._parts.values())) + len(part) > _MAX_DATAGRAM_BYTES:
            self._parts.clear()
        self._parts[at] = part
        if not more:
            self._end = at + len(part)
        whole = b""
        while (part := self._parts.get(len(whole), b"")) != b"":
            whole += part
        return whole if len(whole) == self._end else None


def _network_layer(frame: bytes, link: int) -> bytes | None:
    """Return the IPv4 packet of a frame; None for another protocol."""
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
    """Return the header of a file of Ethernet frames, with times in nanoseconds."""
    return struct.pack("<4s2HiIII", b"\x4d\x3c\xb2\xa1", 2, 4, 0, 0, MOST_BYTES, _ETHERNET)


def pcap_frames(datagram: Datagram, destination: str, identification: int, most_bytes: int = 1500) -> bytes:
    """Return a datagram's frames, recorded at its time: several where it is longer than a frame may be."""
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
        seconds, fraction = divmod(datagram.time_ns, NS_PER_SECOND)
        frames.append(struct.pack("<4I", seconds, fraction, len(frame), len(frame)) + frame)
    return b"".join(frames)


def _checksum(header: bytes) -> bytes:
    total = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return struct.pack(">H", total ^ 0xFFFF)
