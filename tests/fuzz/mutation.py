"""Damage to valid input: bytes flipped, removed, repeated, moved, inserted from other input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random

_BOUNDARY_BYTES = b"\x00\x01\x7f\x80\xff\n\r $*,-.09\xb5\xd3"
"""Bytes at the ends of ranges, and those of text and frames."""
_LONGEST = 200_000


def damaged(random: Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Return `data` after one to eight damages; `others` are the source of foreign bytes."""
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 4, 8))):
        random.choice(_DAMAGES)(random, changed, others)
    return bytes(changed[:_LONGEST])


def cut_up(random: Random, data: bytes) -> list[bytes]:
    """Return the same bytes in pieces of random size, some empty."""
    longest = random.choice((1, 3, 50, 4096)) if len(data) < 5_000 else random.choice((1_000, 50_000))
    pieces, at = [], 0
    while at < len(data):
        size = random.randint(0, longest)
        pieces.append(data[at : at + size])
        at += size
    return pieces


def _slice(random: Random, size: int) -> slice:
    begin = random.randint(0, size)
    return slice(begin, min(begin + random.choice((1, 2, 4, 16, random.randint(0, max(size, 1)))), size))


def _flip(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    for _ in range(random.choice((1, 1, 1, 20))):
        if data:
            data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def _boundary(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    for _ in range(random.choice((1, 1, 4))):
        if data:
            data[random.randrange(len(data))] = random.choice(_BOUNDARY_BYTES)


def _fill(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    part = _slice(random, len(data))
    data[part] = bytes([random.choice(_BOUNDARY_BYTES)]) * (part.stop - part.start)


def _scramble(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    part = _slice(random, len(data))
    data[part] = random.randbytes(part.stop - part.start)


def _cut(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    del data[_slice(random, len(data))]


def _end(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    del data[random.randint(0, len(data)) :]


def _repeat(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    part = _slice(random, len(data))
    times = random.choice((1, 1, 2, 30))
    if (part.stop - part.start) * times < _LONGEST:
        data[part.stop : part.stop] = data[part] * times


def _move(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    part = _slice(random, len(data))
    moved = data[part]
    del data[part]
    at = random.randint(0, len(data))
    data[at:at] = moved


def _splice(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    other = random.choice(others)
    data[_slice(random, len(data))] = other[_slice(random, len(other))]


def _digit(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    """Replace a digit, as text has digits where binary data have bytes."""
    places = [place for place, byte in enumerate(data) if 0x30 <= byte <= 0x39]
    if places:
        data[random.choice(places)] = random.choice(b"0123456789")


_DAMAGES: tuple[Callable[[Random, bytearray, Sequence[bytes]], None], ...] = (
    *(_flip, _flip, _boundary, _fill, _scramble, _cut),
    *(_end, _repeat, _move, _splice, _digit),
)
