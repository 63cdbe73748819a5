import struct
from dataclasses import replace
from random import Random

import pytest

from camber.formats.errors import FormatError
from camber.formats.lidar_can.pcap import Datagram, PcapDecoder, pcap_frames, pcap_header

TIME_NS = 1_700_000_000_123_456_789
SMALL = Datagram(TIME_NS, "192.168.1.201", 2368, b"packet")
LARGE = Datagram(TIME_NS + 1, "192.168.1.201", 7502, bytes(range(256)) * 50)


def recording(*datagrams: Datagram) -> bytes:
    frames = (pcap_frames(each, "192.168.1.100", number) for number, each in enumerate(datagrams))
    return pcap_header() + b"".join(frames)


def decoded(data: bytes) -> tuple[list, PcapDecoder]:
    decoder = PcapDecoder("x.pcap")
    return decoder.feed(data) + decoder.finish(), decoder


def frame_of(datagram: Datagram) -> bytes:
    return pcap_frames(datagram, "10.0.0.1", 1)[16:]


def test_what_was_written_is_read_to_the_nanosecond_longer_than_a_frame_or_not() -> None:
    assert decoded(recording(SMALL, LARGE))[0] == [SMALL, LARGE]


def test_fragments_may_come_in_any_order_and_one_that_is_missing_costs_its_datagram() -> None:
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
def test_fragments_of_a_datagram_that_had_the_same_number_long_before_are_none_of_it(
    apart_s: int,
) -> None:
    """Such as an OS1's packets after 51 s: never one of the bytes of both."""
    again = replace(LARGE, time_ns=LARGE.time_ns + apart_s * 1_000_000_000, payload=b"B" * len(LARGE.payload))
    first = pcap_frames(LARGE, "192.168.1.100", 5)
    lost = first[16 + struct.unpack_from("<I", first, 8)[0] :]
    found, decoder = decoded(pcap_header() + lost + pcap_frames(again, "192.168.1.100", 5))
    assert found == [again]
    assert decoder.skipped == {"fragment": 1}


def test_a_datagram_of_which_a_fragment_lacks_at_the_end_is_counted() -> None:
    first = pcap_frames(LARGE, "192.168.1.100", 5)
    _, decoder = decoded(pcap_header() + first[: 16 + struct.unpack_from("<I", first, 8)[0]])
    assert decoder.skipped == {"fragment": 1}


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("magic", "tick_ns"), [(0xA1B2C3D4, 1000), (0xA1B23C4D, 1)])
def test_both_byte_orders_and_both_resolutions_are_read(order: str, magic: int, tick_ns: int) -> None:
    frame = frame_of(SMALL)
    fraction = TIME_NS % 1_000_000_000 // tick_ns
    header = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 65535, 1)
    record = struct.pack(f"{order}4I", TIME_NS // 1_000_000_000, fraction, len(frame), len(frame))
    ((found,), _) = decoded(header + record + frame)
    assert found.payload == b"packet"
    assert found.time_ns == TIME_NS // tick_ns * tick_ns


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
    ((found,), _) = decoded(data)
    assert (found.payload, found.time_ns) == (b"packet", ticks * 10 ** (9 - power))


def with_link(link: int, frame: bytes) -> bytes:
    header = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    return header + struct.pack("<4I", 1, 0, len(frame), len(frame)) + frame


def test_vlan_tags_cooked_captures_and_raw_ip_are_read() -> None:
    ip = frame_of(SMALL)[14:]
    tagged = bytes(12) + b"\x81\x00\x00\x07\x08\x00" + ip
    for link, frame in ((1, tagged), (113, bytes(14) + b"\x08\x00" + ip), (276, b"\x08\x00" + bytes(18) + ip),
                        (101, ip)):  # fmt: skip
        ((found,), _) = decoded(with_link(link, frame))
        assert (found.source, found.port, found.payload) == ("192.168.1.201", 2368, b"packet")


def test_what_is_no_whole_udp_datagram_is_counted() -> None:
    frame = bytearray(frame_of(SMALL))
    tcp = bytearray(frame)
    tcp[14 + 9] = 6
    longer = bytearray(frame)
    longer[14 + 20 + 5] = 200
    snapped = struct.pack("<4I", 1, 0, 20, 60) + bytes(frame[:20])
    data = with_link(1, bytes(tcp)) + with_link(1, bytes(longer))[24:] + snapped
    found, decoder = decoded(data)
    assert found == []
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
def test_what_is_no_recording_is_one_clear_line(data: bytes, expected: str) -> None:
    found, _ = decoded(data)
    assert len(found) == 1
    assert isinstance(found[0], FormatError)
    assert str(found[0]).startswith(expected)


def test_the_pieces_in_which_a_file_comes_change_nothing() -> None:
    data = recording(SMALL, LARGE, SMALL)
    decoder = PcapDecoder("x.pcap")
    found = [each for k in range(0, len(data), 7) for each in decoder.feed(data[k : k + 7])]
    assert found + decoder.finish() == [SMALL, LARGE, SMALL]
