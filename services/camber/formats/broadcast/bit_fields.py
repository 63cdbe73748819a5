"""Integers of any width side by side, most significant bit first, and the CRC that guards them.

RTCM 3 and the navigation messages of the satellites are both made like this.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import Integers

CRC24Q_POLYNOMIAL = 0x1864CFB
"""RTCM 10403.3, 4.2; Galileo OS SIS ICD 5.1.9.4; start value zero, not reflected."""


def quantize(name: str, value: float, resolution: float, width: int, *, signed: bool) -> int:
    """`value / resolution`, rounded; ValueError with the range where it does not fit in `width` bits."""
    low = -(1 << (width - 1)) if signed else 0
    high = (1 << (width - 1 if signed else width)) - 1
    # A comparison that NaN fails: it has no integer.
    if not (low - 0.5) * resolution <= value <= (high + 0.5) * resolution:
        raise ValueError(f"{name} is {value:.6g}, expected {low * resolution:.6g} to {high * resolution:.6g}")
    return min(max(round(value / resolution), low), high)


def joined(fields: Iterable[tuple[int, int]]) -> tuple[int, int]:
    """(value, width) pairs side by side: the integer they make and its width. Negative ones in two's complement."""
    bits = width = 0
    for value, field_width in fields:
        bits = bits << field_width | value & (1 << field_width) - 1
        width += field_width
    return bits, width


def bits_to_bytes(bits: int, width: int) -> bytes:
    """An integer of so many bits as bytes, filled up with zeros at its end."""
    padding = -width % 8
    return (bits << padding).to_bytes((width + padding) // 8, "big")


def bit_array(bits: int, width: int) -> NDArray[np.uint8]:
    """An integer of so many bits as an array of bits."""
    return np.unpackbits(np.frombuffer(bits_to_bytes(bits, width), np.uint8), count=width)


def pack_columns(
    head: Sequence[NDArray[np.uint8] | NDArray[np.bool_]], columns: Sequence[tuple[Integers, int]]
) -> bytes:
    """Single bits, then columns of integers, each item in as many bits as its column says; filled up with zeros."""
    values = np.concatenate([column for column, _ in columns])
    widths = np.repeat([width for _, width in columns], [column.size for column, _ in columns])
    ends = np.cumsum(widths)
    shifts = np.repeat(ends, widths) - np.arange(1, int(ends[-1]) + 1)
    bits = np.repeat(values, widths) >> shifts & 1
    return np.packbits(np.concatenate((*head, bits.astype(np.uint8)))).tobytes()


def crc24q(data: bytes) -> int:
    """CRC-24Q."""
    return _crc24q(np.frombuffer(data, np.uint8), _crc_table())


@compiled
def _crc24q(data: NDArray[np.uint8], table: NDArray[np.int64]) -> int:
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ byte]
    return crc


@cache
def _crc_table() -> NDArray[np.int64]:
    """CRC of each byte."""
    one = np.arange(256) << 16
    for _ in range(8):
        one <<= 1
        one = np.where(one & 1 << 24, one ^ CRC24Q_POLYNOMIAL, one)
    return one
