import struct
from dataclasses import replace
from random import Random

import pytest

from camber.formats.errors import FormatError
from camber.formats.lidar_can.pcap import Datagram, PcapDecoder, pcap_frames, pcap_header

TIME_NS = 1_700_000_000_123_456_789
SMALL = Datagram(time_ns=TIME_NS, source="192.168.1.201", port=2368, payload=b"packet")
LARGE = Datagram(time_ns=TIME_NS + 1, source="192.168.1.201", port=7502, payload=bytes(range(256)) * 50)


def recording(*datagrams: Datagram) -> bytes:
    frames = (pcap_frames(each, "192.168.1.100", number) for number, each in enumerate(datagrams))
    return pcap_header() + b"".join(frames)


def decoded(data: bytes) -> tuple[list, PcapDecoder]:
    decoder = PcapDecoder("x.pcap")
    return decoder.feed(data) + decoder.finish(), decoder


def frame_of(datagram: Datagram) -> bytes:
    return pcap_frames(datagram, "10.0.0.1", 1)[16:]


def test_written_datagrams_are_read_back_to_the_nanosecond_fragmented_or_not() -> None:
    assert decoded(recording(SMALL, LARGE))[0] == [SMALL, LARGE]


def test_fragments_in_any_order_are_reassembled_and_a_missing_one_loses_its_datagram() -> None:
    whole = pcap_frames(LARGE, "192.168.1.100", 5)
    parts, at = [], 0
    while at < len(whole):
        size = 16 + struct.unpack_from("<I", whole, at + 8)[0]
        parts.append(whole[at : at + size])
        at += size
    assert len(parts) == 9
    Random(1).shuffle(parts)
    assert decoded(pcap_header() + b"".join(parts))[0] == [LARGE]
    small = pcap_frames(SMALL, "192.168.1.100", 6)
    assert decoded(pcap_header() + b"".join(parts[1:]) + small)[0] == [SMALL]


@pytest.mark.parametrize("apart_s", [51, -51])
def test_old_fragments_with_a_repeated_identification_are_not_mixed_in(apart_s: int) -> None:
    """Such as an OS1's packets after 51 s: never one of the bytes of both."""
    again = replace(LARGE, time_ns=LARGE.time_ns + apart_s * 1_000_000_000, payload=b"B" * len(LARGE.payload))
    first = pcap_frames(LARGE, "192.168.1.100", 5)
    lost = first[16 + struct.unpack_from("<I", first, 8)[0] :]
    results, decoder = decoded(pcap_header() + lost + pcap_frames(again, "192.168.1.100", 5))
    assert results == [again]
    assert decoder.skipped == {"fragment": 1}


def test_an_incomplete_datagram_at_the_end_is_counted() -> None:
    first = pcap_frames(LARGE, "192.168.1.100", 5)
    _, decoder = decoded(pcap_header() + first[: 16 + struct.unpack_from("<I", first, 8)[0]])
    assert decoder.skipped == {"fragment": 1}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("magic", "tick_ns"), [(0xA1B2C3D4, 1000), (0xA1B23C4D, 1)])
def test_both_byte_orders_and_resolutions(order: str, magic: int, tick_ns: int) -> None:
    frame = frame_of(SMALL)
    fraction = TIME_NS % 1_000_000_000 // tick_ns
    header = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, 1)
    record = struct.pack(f"{order}4I", TIME_NS // 1_000_000_000, fraction, len(frame), len(frame))
    ((datagram,), _) = decoded(header + record + frame)
    assert datagram.payload == b"packet"
    assert datagram.time_ns == TIME_NS // tick_ns * tick_ns


def block(kind: int, body: bytes) -> bytes:
    length = 12 + len(body)
    return struct.pack("<II", kind, length) + body + struct.pack("<I", length)


def padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


@pytest.mark.parametrize("power", [6, 9])
def test_pcapng_is_read_with_the_resolution_of_its_interface(power: int) -> None:
    frame = frame_of(SMALL)
    ticks = TIME_NS // 10 ** (9 - power)
    data = b"".join(
        (
            block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)),
            block(1, struct.pack("<HHI", 1, 0, 0) + struct.pack("<HHBxxx", 9, 1, power) + bytes(4)),
            block(5, bytes(12)),
            block(
                6,
                struct.pack("<5I", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame))
                + padded(frame),
            ),
        )
    )
    ((datagram,), _) = decoded(data)
    assert (datagram.payload, datagram.time_ns) == (b"packet", ticks * 10 ** (9 - power))


def with_link(link: int, frame: bytes) -> bytes:
    header = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    return header + struct.pack("<4I", 1, 0, len(frame), len(frame)) + frame


def test_vlan_tags_cooked_captures_and_raw_ip_are_read() -> None:
    ip = frame_of(SMALL)[14:]
    tagged = bytes(12) + b"\x81\x00\x00\x07\x08\x00" + ip
    for link, frame in ((1, tagged), (113, bytes(14) + b"\x08\x00" + ip), (276, b"\x08\x00" + bytes(18) + ip),
                        (101, ip)):  # fmt: skip
        ((datagram,), _) = decoded(with_link(link, frame))
        assert (datagram.source, datagram.port, datagram.payload) == ("192.168.1.201", 2368, b"packet")


def test_other_protocols_and_truncated_datagrams_are_counted() -> None:
    frame = bytearray(frame_of(SMALL))
    tcp = bytearray(frame)
    tcp[14 + 9] = 6
    longer = bytearray(frame)
    longer[14 + 20 + 5] = 200
    snapped = struct.pack("<4I", 1, 0, 20, 60) + bytes(frame[:20])
    data = with_link(1, bytes(tcp)) + with_link(1, bytes(longer))[24:] + snapped
    results, decoder = decoded(data)
    assert results == []
    assert decoder.skipped == {"other": 1, "truncated": 2}


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"no recording at all", "x.pcap at byte 0: magic number is '6e6f2072', expected that of pcap or pcapng"),
        (recording(SMALL)[:-3], "x.pcap at byte 24: end, expected a whole frame"),
        (pcap_header() + struct.pack("<4I", 1, 0, 1 << 30, 1 << 30), "x.pcap at byte 24: frame length is '1073741824'"),
        (with_link(147, b"frame"), "x.pcap at byte 24: link type is '147', expected Ethernet (1)"),
    ],
)  # fmt: skip
def test_an_invalid_recording_is_one_clear_error(data: bytes, expected: str) -> None:
    results, _ = decoded(data)
    assert len(results) == 1
    assert isinstance(results[0], FormatError)
    assert str(results[0]).startswith(expected)
