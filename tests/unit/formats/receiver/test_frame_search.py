"""The frame search compared with a simple one: the same frames, skipped bytes and failed checksums."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camber.formats.receiver.frame_buffer import FrameBuffer, FrameProtocol
from camber.formats.receiver.frame_search import MAX_SBF_BYTES, MAX_SENTENCE_BYTES, MAX_UBX_PAYLOAD_BYTES
from camber.formats.rtcm.writer import rtcm_frame
from camber.formats.ubx.writer import ubx_frame
from support.gnss_files import fed_in_pieces
from support.plain_frames import PlainFrameBuffer
from support.sbf_blocks import sbf_frame

PROTOCOLS: tuple[tuple[FrameProtocol, ...], ...] = (
    ("ubx", "nmea", "rtcm"),
    ("ubx",),
    ("nmea",),
    ("rtcm",),
    ("ubx", "rtcm"),
    ("sbf",),
    ("nmea", "sbf"),
    ("ubx", "nmea", "rtcm", "sbf"),
)


def false_beginning(rng: random.Random) -> bytes:
    """The beginning of a frame with a random length."""
    length = rng.choice([0, 1, 7, 100, 1023, MAX_UBX_PAYLOAD_BYTES, MAX_UBX_PAYLOAD_BYTES + 1, 0xFFFF])
    ubx = b"\xb5\x62\x01\x07" + length.to_bytes(2, "little")
    rtcm = b"\xd3" + min(length, 1023).to_bytes(2, "big")
    sbf = b"$@\x00\x00\xbb\x0f" + rng.choice([0, 4, 8, 10, 400, 0xFFFC, MAX_SBF_BYTES]).to_bytes(2, "little")
    whole = rng.choice([ubx, rtcm, sbf, b"$GNGGA,", b"$", b"$GN", b"$gn", b"$@"])
    return whole[: rng.randrange(1, len(whole) + 1)]


def damaged_frame(rng: random.Random) -> bytes:
    data = bytearray(frame(rng))
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def frame(rng: random.Random) -> bytes:
    content = rng.randbytes(rng.choice([0, 1, 20, 300, 1023]))
    ubx = ubx_frame(content[0] if content else 0, 7, content)
    return rng.choice([ubx, rtcm_frame(content), sbf_frame(rng.randrange(8192), content)])


def sentence(rng: random.Random) -> bytes:
    text = bytes(rng.randrange(0x20, 0x7F) for _ in range(rng.choice([0, 5, 80, MAX_SENTENCE_BYTES])))
    return b"$GNGGA" + text + rng.choice([b"\r\n", b"\n", b"", b"\x00"])


def within(rng: random.Random) -> bytes:
    """A valid frame inside an invalid one."""
    inner = frame(rng)
    return ubx_frame(1, 2, false_beginning(rng) + inner)[: rng.choice([-1, 10_000])]


PARTS: tuple[Callable[[random.Random], bytes], ...] = (
    false_beginning,
    damaged_frame,
    frame,
    sentence,
    within,
    lambda rng: rng.randbytes(rng.choice([1, 10, 500])),
    lambda rng: false_beginning(rng) * rng.randrange(1, 200),
)


def stream(rng: random.Random) -> bytes:
    return b"".join(rng.choice(PARTS)(rng) for _ in range(rng.randrange(30)))


def frames_and_counts(
    buffer: FrameBuffer | PlainFrameBuffer, data: bytes, cuts: Sequence[int] = ()
) -> object:
    return fed_in_pieces(buffer, data, cuts), buffer.bytes_skipped, buffer.failed_checks


@given(st.integers(0, 2**32), st.sampled_from(PROTOCOLS))
@settings(derandomize=True, max_examples=400, deadline=None)
def test_frames_equal_those_of_a_simple_search(seed: int, protocols: tuple[FrameProtocol, ...]) -> None:
    rng = random.Random(seed)
    data = stream(rng)
    expected = frames_and_counts(PlainFrameBuffer(*protocols), data)
    assert frames_and_counts(FrameBuffer(*protocols), data) == expected
    cuts = rng.sample(range(len(data) + 1), min(len(data), rng.choice([1, 5, 100])))
    assert frames_and_counts(FrameBuffer(*protocols), data, cuts) == expected


@given(st.integers(0, 2**32), st.sampled_from(PROTOCOLS))
@settings(derandomize=True, max_examples=100, deadline=None)
def test_frames_are_returned_as_early_as_by_a_simple_search(
    seed: int, protocols: tuple[FrameProtocol, ...]
) -> None:
    rng = random.Random(seed)
    data = stream(rng)[:20_000]
    plain, buffer = PlainFrameBuffer(*protocols), FrameBuffer(*protocols)
    size = rng.choice([1, 7, 64, 1000])
    if size == 1:
        data = data[:2000]
    for place in range(0, len(data), size):
        piece = data[place : place + size]
        assert buffer.feed(piece) == plain.feed(piece)
        assert (buffer.bytes_skipped, buffer.failed_checks) == (plain.bytes_skipped, plain.failed_checks)


@pytest.mark.parametrize("size", [(1 << 16) - 1, 1 << 16, (1 << 16) + 1, 200_000])
def test_long_chunks_equal_short_ones(size: int) -> None:
    rng = random.Random(size)
    data = b""
    while len(data) < size:
        data += stream(rng)
    data = data[:size]
    expected = frames_and_counts(PlainFrameBuffer(*PROTOCOLS[-1]), data)
    assert frames_and_counts(FrameBuffer(*PROTOCOLS[-1]), data) == expected


@pytest.mark.parametrize("size", range(MAX_SENTENCE_BYTES - 1, MAX_SENTENCE_BYTES + 3))
@pytest.mark.parametrize("beginning", [b"$GN", b"$gn"])
def test_sentences_are_cut_at_the_same_length_as_by_a_simple_search(size: int, beginning: bytes) -> None:
    plain, buffer = PlainFrameBuffer("nmea"), FrameBuffer("nmea")
    for piece in (beginning + b"a" * (size - 3), b"a", b"\n"):
        assert buffer.feed(piece) == plain.feed(piece)
        assert buffer.bytes_skipped == plain.bytes_skipped
