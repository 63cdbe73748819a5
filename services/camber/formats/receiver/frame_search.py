"""Finds the frames in a piece of a stream, in time that grows with its length whatever the bytes are.

Bytes that lie may begin a long frame every few bytes. So checksums are not summed up for each: they are differences of
sums since the beginning of the piece, taken once. For the Fletcher sums that is plain; a CRC is linear, and a beginning
that is cut away has been multiplied by x^8 for each byte behind it.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.broadcast.bit_fields import CRC24Q_POLYNOMIAL, crc24q

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
UBX, NMEA, RTCM = 0, 1, 2
MOST_SENTENCE_BYTES = 1024
"""NMEA allows 82, but receivers exceed it in high-precision modes and proprietary sentences."""
MOST_UBX_PAYLOAD_BYTES = 8192
"""RXM-RAWX with 255 measurements has 8176, and no message of navigation has more: a greater length is no length."""

_UBX_HEAD, _UBX_FRAMING = 6, 8
_RTCM_HEAD, _RTCM_FRAMING = 3, 6
_MOST_RTCM_BYTES = _RTCM_FRAMING + 1023
_WAIT = 0
_SUM, _WEIGHTED, _CRC = 0, 1, 2


def find_frames(data: bytes, wanted: NDArray[np.bool_], *, last: bool) -> tuple[Integers, int, int, Integers]:
    """Frames (n, 3) as protocol, start and size; how far the bytes are used; bytes skipped; failed checks (3,).

    `wanted` (3,): of which protocols. What is behind is the beginning of a frame, unless these are the `last` bytes.
    Where NMEA is wanted, carriage returns and line feeds are not counted as skipped.
    """
    return _find(np.frombuffer(data, np.uint8), wanted, last, *_crc_tables())


@compiled
def _find(
    data: Bytes, wanted: NDArray[np.bool_], last: bool, crc_table: Integers, crc_powers: Integers
) -> tuple[Integers, int, int, Integers]:
    frames = np.empty((data.size // 3 + 1, 3), np.int64)
    sums = np.empty((3, data.size + 1), np.int64)
    sums[:, 0] = 0
    count, place, skipped, summed = 0, 0, 0, 0
    failed = np.zeros(3, np.int64)
    while place < data.size:
        protocol = _beginning(data, place, wanted)
        if protocol < 0:
            size = -1
        elif protocol == NMEA:
            size = _sentence_size(data, place, last)
        else:
            size = _frame_size(data, place, protocol, last)
        if size == _WAIT:
            break
        if size > 0 and protocol != NMEA:
            summed = _sum_up(data, sums, summed, place + size, crc_table)
            if not _is_right(data, sums, place, size, protocol, crc_powers):
                failed[protocol] += 1
                size = -1
        if size > 0:
            frames[count] = protocol, place, size
            count += 1
        else:
            for byte in data[place : place - size]:
                if not (wanted[NMEA] and (byte == 13 or byte == 10)):
                    skipped += 1
        place += abs(size)
    return frames[:count].copy(), place, skipped, failed


@compiled
def _beginning(data: Bytes, place: int, wanted: NDArray[np.bool_]) -> int:
    """The protocol of which something may begin here; −1: none. At the end a first character alone may be one."""
    first, at_end = data[place], place + 1 == data.size
    if first == 0xB5 and wanted[UBX] and (at_end or data[place + 1] == 0x62):
        return UBX
    if first == 0x24 and wanted[NMEA]:
        return NMEA
    if first == 0xD3 and wanted[RTCM] and (at_end or data[place + 1] <= 3):
        return RTCM
    return -1


@compiled
def _frame_size(data: Bytes, start: int, protocol: int, last: bool) -> int:
    """Bytes of the frame that begins here, if its checksum is right; −1: none begins here; or wait."""
    left = data.size - start
    head = _UBX_HEAD if protocol == UBX else _RTCM_HEAD
    if left < head:
        return -1 if last else _WAIT
    if protocol == UBX:
        length = int(data[start + 4]) | int(data[start + 5]) << 8
        if length > MOST_UBX_PAYLOAD_BYTES:
            return -1
        size = _UBX_FRAMING + length
    else:
        size = _RTCM_FRAMING + (int(data[start + 1]) << 8 | int(data[start + 2]))
    if left < size:
        return -1 if last else _WAIT
    return size


@compiled
def _sentence_size(data: Bytes, start: int, last: bool) -> int:
    """Of what looks like a sentence, up to its end; negative: of what does not; or wait."""
    end = start + 1
    while end < data.size and 0x20 <= data[end] <= 0x7E and data[end] != 0x24:
        end += 1
    if end == data.size and end - start <= MOST_SENTENCE_BYTES and not last:
        return _WAIT
    # Of a sentence that is too long only the allowed part is taken: the rest is found to be no sentence.
    size = min(end - start, MOST_SENTENCE_BYTES + 1)
    # Else it is a dollar sign inside a binary message.
    is_one = size > 2 and 0x41 <= data[start + 1] <= 0x5A and 0x41 <= data[start + 2] <= 0x5A
    return size if is_one else -size


@compiled
def _sum_up(data: Bytes, sums: Integers, summed: int, end: int, crc_table: Integers) -> int:
    """Sums (3, n + 1) before each byte up to the end: of bytes, of place × byte, CRC; returns how far they go."""
    for k in range(summed, end):
        byte, crc = np.int64(data[k]), sums[_CRC, k]
        sums[_SUM, k + 1] = sums[_SUM, k] + byte
        sums[_WEIGHTED, k + 1] = sums[_WEIGHTED, k] + k * byte
        sums[_CRC, k + 1] = (crc << 8 & 0xFFFFFF) ^ crc_table[crc >> 16 ^ byte]
    return max(summed, end)


@compiled
def _is_right(
    data: Bytes, sums: Integers, start: int, size: int, protocol: int, crc_powers: Integers
) -> bool:
    if protocol == UBX:
        begin, end = start + 2, start + size - 2
        total = sums[_SUM, end] - sums[_SUM, begin]
        # The second sum has the first byte as often as there are bytes, and the last one once.
        second = end * total - (sums[_WEIGHTED, end] - sums[_WEIGHTED, begin])
        return bool((total & 255) == data[end] and (second & 255) == data[end + 1])
    # Over the whole frame, with its CRC, it is zero.
    end = start + size
    return bool(sums[_CRC, end] == _product(sums[_CRC, start], crc_powers[size]))


@compiled
def _product(a: int, b: int) -> int:
    """Of two polynomials over GF(2), modulo CRC-24Q's."""
    product = 0
    for bit in range(23, -1, -1):
        product <<= 1
        if product >> 24:
            product ^= CRC24Q_POLYNOMIAL
        if a >> bit & 1:
            product ^= b
    return product


@cache
def _crc_tables() -> tuple[Integers, Integers]:
    """The CRC of each byte, and x^8n modulo the polynomial."""
    table = np.array([crc24q(bytes([byte])) for byte in range(256)], np.int64)
    powers = np.ones(_MOST_RTCM_BYTES + 1, np.int64)
    for n in range(1, powers.size):
        powers[n] = _product(powers[n - 1], 1 << 8)
    return table, powers
