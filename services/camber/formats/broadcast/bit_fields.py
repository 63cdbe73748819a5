"""Integers of any width packed one after another, most significant bit first, and CRC-24Q.

RTCM 3 messages and the satellites' navigation messages are both encoded like this.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import Integers

CRC24Q_POLYNOMIAL = 0x1864CFB
"""RTCM 10403.3, 4.2; Galileo OS SIS ICD 5.1.9.4; initial value zero, not reflected."""


def quantize(name: str, value: float, resolution: float, width: int, *, signed: bool) -> int:
    """Return `value / resolution`, rounded; ValueError with the range where it does not fit in `width` bits."""
    low = -(1 << (width - 1)) if signed else 0
    high = (1 << (width - 1 if signed else width)) - 1
    # NaN fails the comparison, as it must: it has no integer.
    if not (low - 0.5) * resolution <= value <= (high + 0.5) * resolution:
        raise ValueError(f"{name} is {value:.6g}, expected {low * resolution:.6g} to {high * resolution:.6g}")
    return min(max(round(value / resolution), low), high)


def pack_bits(fields: Iterable[tuple[int, int]]) -> tuple[int, int]:
    """Concatenate (value, width) pairs, negative values in two's complement; return the integer and its width."""
    bits = width = 0
    for value, field_width in fields:
        bits = bits << field_width | value & (1 << field_width) - 1
        width += field_width
    return bits, width


def bits_to_bytes(bits: int, width: int) -> bytes:
    """Return an integer of `width` bits as bytes, zero-padded at the end."""
    padding = -width % 8
    return (bits << padding).to_bytes((width + padding) // 8, "big")


def pack_columns(
    head: Sequence[NDArray[np.uint8] | NDArray[np.bool_]], columns: Sequence[tuple[Integers, int]]
) -> bytes:
    """Pack arrays of single bits, then columns of integers of one width each; zero-padded at the end."""
    values = np.concatenate([column for column, _ in columns])
    widths = np.repeat([width for _, width in columns], [column.size for column, _ in columns])
    ends = np.cumsum(widths)
    shifts = np.repeat(ends, widths) - np.arange(1, int(ends[-1]) + 1)
    bits = np.repeat(values, widths) >> shifts & 1
    return np.packbits(np.concatenate((*head, bits.astype(np.uint8)))).tobytes()


def crc24q(data: bytes) -> int:
    """Return the CRC-24Q."""
    return _crc24q(np.frombuffer(data, np.uint8), _crc_table())


@compiled
def _crc24q(data: NDArray[np.uint8], table: NDArray[np.int64]) -> int:
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ byte]
    return crc


@cache
def _crc_table() -> NDArray[np.int64]:
    """Return the CRC of each byte."""
    crc = np.arange(256) << 16
    for _ in range(8):
        crc <<= 1
        crc = np.where(crc & 1 << 24, crc ^ CRC24Q_POLYNOMIAL, crc)
    return crc
