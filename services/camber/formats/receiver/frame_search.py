"""Search for frames of UBX, NMEA 0183, RTCM 3 and SBF in a chunk of a stream, in linear time for any input.

Hostile input may begin a long frame every few bytes. So checksums are not computed for each candidate: they are
differences of running sums over the chunk. For the Fletcher sums that is direct; a CRC is linear, and removing a prefix
multiplies the prefix's CRC by x^8 for each byte after it.
"""

from __future__ import annotations

from binascii import crc_hqx
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.broadcast.bit_fields import CRC24Q_POLYNOMIAL, crc24q
from camber.formats.observations import Integers

Bytes = NDArray[np.uint8]
UBX, NMEA, RTCM, SBF = 0, 1, 2, 3
MAX_SENTENCE_BYTES = 1024
"""Chosen: NMEA allows 82, but receivers exceed it in high-precision modes and proprietary sentences."""
MAX_UBX_PAYLOAD_BYTES = 8192
"""RXM-RAWX with 255 measurements has 8176, and no navigation message has more: a greater length is invalid."""
MAX_SBF_BYTES = 16384
"""Chosen: a MeasEpoch with all 448 channels of a mosaic-X5, each a sub-block of 20 bytes, has 8980."""

# UBX-18010854, 3.2; RTCM 10403.3, 4.2: bytes up to the length, and of the frame without payload. mosaic-X5, 4.1.1: the
# length of SBF is of the whole frame, a multiple of four.
_UBX_HEAD, _UBX_FRAMING = 6, 8
_RTCM_HEAD, _RTCM_FRAMING = 3, 6
_MAX_RTCM_BYTES = _RTCM_FRAMING + 1023
_SBF_HEAD = 8  # mosaic-X5, 4.1.1
_SBF_CRC_START = 4  # the CRC stands before what it covers
_CRC16_POLYNOMIAL = 0x11021  # mosaic-X5, 4.1.1: CRC-CCITT, initial value zero, not reflected
_INCOMPLETE = 0  # size of a frame whose end has not arrived
_SUM, _WEIGHTED, _CRC, _CRC16 = 0, 1, 2, 3


class FrameSearch(NamedTuple):
    """Frames (n, 3) as protocol, start and size; bytes consumed; bytes skipped; failed checksums by protocol (4,)."""

    frames: Integers
    consumed: int
    skipped: int
    failed: Integers


class CrcTables(NamedTuple):
    """Of CRC-24Q and of CRC-CCITT: the CRC of each byte (256,), and x^8n modulo the polynomial by n."""

    table: Integers
    powers: Integers
    table16: Integers
    powers16: Integers


def find_frames(data: bytes, wanted: NDArray[np.bool_], *, last: bool) -> FrameSearch:
    """Search for frames of the `wanted` (4,) protocols.

    Bytes that are not consumed are the beginning of a frame; with `last`, the end of the stream, all are consumed.
    Where NMEA is wanted, carriage returns and line feeds do not count as skipped.
    """
    return FrameSearch(*_find(np.frombuffer(data, np.uint8), wanted, last, tables=_crc_tables()))


@compiled
def _find(
    data: Bytes, wanted: NDArray[np.bool_], last: bool, tables: CrcTables
) -> tuple[Integers, int, int, Integers]:
    frames = np.empty((data.size // 3 + 1, 3), np.int64)
    sums = np.empty((4, data.size + 1), np.int64)
    sums[:, 0] = 0
    count, start, skipped, summed, summed16 = 0, 0, 0, 0, 0
    failed = np.zeros(4, np.int64)
    while start < data.size:
        protocol = _protocol_at(data, start, wanted)
        if protocol < 0:
            size = -1
        elif protocol == NMEA:
            size = _sentence_size(data, start, last)
        else:
            size = _frame_size(data, start, protocol, last)
        if size == _INCOMPLETE:
            break
        if size > 0 and protocol != NMEA:
            end = start + size
            if protocol == SBF:
                summed16 = _extend_crc16(data, sums, (summed16, end), tables)
            else:
                summed = _extend_sums(data, sums, (summed, end), tables)
            if not _is_valid(data, sums, (protocol, start, end), tables):
                failed[protocol] += 1
                size = -1
        if size > 0:
            frames[count, 0], frames[count, 1], frames[count, 2] = protocol, start, size
            count += 1
        else:
            for byte in data[start : start - size]:
                if not (wanted[NMEA] and (byte == 13 or byte == 10)):
                    skipped += 1
        start += abs(size)
    return frames[:count].copy(), start, skipped, failed


@compiled
def _protocol_at(data: Bytes, start: int, wanted: NDArray[np.bool_]) -> int:
    """Return the protocol of which a frame may begin here, −1 for none. The last byte may be a first sync character."""
    first, at_end = data[start], start + 1 == data.size
    if first == 0xB5 and wanted[UBX] and (at_end or data[start + 1] == 0x62):
        return UBX
    if first == 0x24 and wanted[SBF] and not at_end and data[start + 1] == 0x40:
        return SBF
    if first == 0x24 and wanted[NMEA]:
        return NMEA
    if first == 0x24 and wanted[SBF] and at_end:
        return SBF
    if first == 0xD3 and wanted[RTCM] and (at_end or data[start + 1] <= 3):
        return RTCM
    return -1


@compiled
def _frame_size(data: Bytes, start: int, protocol: int, last: bool) -> int:
    """Return the bytes of the frame that begins here, if its checksum is correct; −1 for no frame; or incomplete."""
    left = data.size - start
    head = _UBX_HEAD if protocol == UBX else _SBF_HEAD if protocol == SBF else _RTCM_HEAD
    if left < head:
        return -1 if last else _INCOMPLETE
    if protocol == UBX:
        length = int(data[start + 4]) | int(data[start + 5]) << 8
        if length > MAX_UBX_PAYLOAD_BYTES:
            return -1
        size = _UBX_FRAMING + length
    elif protocol == SBF:
        size = int(np.int64(data[start + 6]) | np.int64(data[start + 7]) << 8)
        if size < _SBF_HEAD or size > MAX_SBF_BYTES or size % 4:
            return -1
    else:
        size = _RTCM_FRAMING + (int(data[start + 1]) << 8 | int(data[start + 2]))
    if left < size:
        return -1 if last else _INCOMPLETE
    return size


@compiled
def _sentence_size(data: Bytes, start: int, last: bool) -> int:
    """Return the size of a candidate sentence up to its end; negative for no candidate; or incomplete."""
    end = start + 1
    while end < data.size and 0x20 <= data[end] <= 0x7E and data[end] != 0x24:
        end += 1
    if end == data.size and end - start <= MAX_SENTENCE_BYTES and not last:
        return _INCOMPLETE
    # Of a sentence that is too long only the allowed part is taken: the rest is not a sentence.
    size = min(end - start, MAX_SENTENCE_BYTES + 1)
    # Two capital letters follow; else it is a dollar sign inside a binary message.
    is_candidate = size > 2 and 0x41 <= data[start + 1] <= 0x5A and 0x41 <= data[start + 2] <= 0x5A
    return size if is_candidate else -size


@compiled
def _extend_sums(data: Bytes, sums: Integers, span: tuple[int, int], tables: CrcTables) -> int:
    """Extend the sums (4, n + 1) before each byte: bytes, index × byte, CRC-24Q; return how far they are valid."""
    summed, end = span
    for k in range(summed, end):
        byte, crc = np.int64(data[k]), sums[_CRC, k]
        sums[_SUM, k + 1] = sums[_SUM, k] + byte
        sums[_WEIGHTED, k + 1] = sums[_WEIGHTED, k] + k * byte
        sums[_CRC, k + 1] = (crc << 8 & 0xFFFFFF) ^ tables.table[crc >> 16 ^ byte]
    return max(summed, end)


@compiled
def _extend_crc16(data: Bytes, sums: Integers, span: tuple[int, int], tables: CrcTables) -> int:
    """Extend CRC-CCITT before each byte, apart from the others: most streams have no SBF."""
    summed, end = span
    for k in range(summed, end):
        crc = sums[_CRC16, k]
        sums[_CRC16, k + 1] = (crc << 8 & 0xFFFF) ^ tables.table16[crc >> 8 ^ np.int64(data[k])]
    return max(summed, end)


@compiled
def _is_valid(data: Bytes, sums: Integers, frame: tuple[int, int, int], tables: CrcTables) -> bool:
    protocol, start, end = frame
    if protocol == UBX:
        return _is_fletcher_valid(data, sums, start, end)
    if protocol == SBF:
        return _is_crc16_valid(data, sums, (start, end), tables)
    # Including its CRC, the CRC of a frame is zero.
    removed = _product(sums[_CRC, start], tables.powers[end - start], CRC24Q_POLYNOMIAL, 24)
    return bool(sums[_CRC, end] == removed)


@compiled
def _is_fletcher_valid(data: Bytes, sums: Integers, start: int, end: int) -> bool:
    first, last = start + 2, end - 2
    total = sums[_SUM, last] - sums[_SUM, first]
    # The second sum contains the first byte as often as there are bytes, and the last one once.
    second = last * total - (sums[_WEIGHTED, last] - sums[_WEIGHTED, first])
    return bool((total & 255) == data[last] and (second & 255) == data[last + 1])


@compiled
def _is_crc16_valid(data: Bytes, sums: Integers, span: tuple[int, int], tables: CrcTables) -> bool:
    start, end = span
    first = start + _SBF_CRC_START
    removed = _product(sums[_CRC16, first], tables.powers16[end - first], _CRC16_POLYNOMIAL, 16)
    return bool(sums[_CRC16, end] ^ removed == np.int64(data[start + 2]) | np.int64(data[start + 3]) << 8)


@compiled
def _product(a: int, b: int, polynomial: int, degree: int) -> int:
    """Return the product of two polynomials over GF(2), modulo one of this degree."""
    product = 0
    for bit in range(degree - 1, -1, -1):
        product <<= 1
        if product >> degree:
            product ^= polynomial
        if a >> bit & 1:
            product ^= b
    return product


@cache
def _crc_tables() -> CrcTables:
    table = [crc24q(bytes([byte])) for byte in range(256)]
    table16 = [crc_hqx(bytes([byte]), 0) for byte in range(256)]
    return CrcTables(
        table=np.array(table, np.int64),
        powers=_powers(_MAX_RTCM_BYTES, CRC24Q_POLYNOMIAL, 24),
        table16=np.array(table16, np.int64),
        powers16=_powers(MAX_SBF_BYTES, _CRC16_POLYNOMIAL, 16),
    )


@compiled
def _powers(most: int, polynomial: int, degree: int) -> Integers:
    powers = np.ones(most + 1, np.int64)
    for n in range(1, most + 1):
        powers[n] = _product(powers[n - 1], 1 << 8, polynomial, degree)
    return powers
