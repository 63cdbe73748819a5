"""Integers of any width packed one after another, most significant bit first, by layouts; and CRC-24Q.

RTCM 3 messages and the satellites' navigation messages are both encoded like this.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled
from camber.formats.observations import Integers

CRC24Q_POLYNOMIAL = 0x1864CFB
"""RTCM 10403.3, 4.2; Galileo OS SIS ICD 5.1.9.4; initial value zero, not reflected."""


class BitField(NamedTuple):
    """An integer of `width` bits, scaled by `resolution` to the unit of `Ephemeris`; `cyclic` angles wrap at a turn."""

    width: int
    resolution: float = 1.0
    signed: bool = False
    cyclic: bool = False


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


BitLayout = tuple[str | int, ...]
"""One table both to encode and to decode: a name is the whole field, `name>n` the field without its last n bits,
`name<n` its last n bits, a number that many bits, which are encoded as zero and skipped when decoding."""


def encode_layout(
    layout: BitLayout, fields: Mapping[str, BitField], integers: Mapping[str, int]
) -> list[tuple[int, int]]:
    """Return (value, width) pairs for `pack_bits`."""
    pairs = list[tuple[int, int]]()
    for entry in layout:
        if isinstance(entry, int):
            pairs.append((0, entry))
        else:
            name, shift, width = _part(entry, fields)
            pairs.append((integers[name] >> shift, width))
    return pairs


def decode_layout(bits: int, width: int, layout: BitLayout, fields: Mapping[str, BitField]) -> dict[str, int]:
    """Return the fields of the layout, unsigned; a partial field keeps its position within the whole field.

    The layout begins at the most significant of `width` bits. Raises ValueError where it is longer than that.
    """
    decoded, left = dict[str, int](), width
    for entry in layout:
        name, shift, part_width = ("", 0, entry) if isinstance(entry, int) else _part(entry, fields)
        left -= part_width
        if left < 0:
            raise ValueError(f"{width} bits, expected those of {layout}")
        if name:
            decoded[name] = decoded.get(name, 0) | (bits >> left & (1 << part_width) - 1) << shift
    return decoded


def combine_parts(parts: Iterable[Mapping[str, int]], fields: Mapping[str, BitField]) -> dict[str, int]:
    """Return the whole signed fields of several subframes. A field contained in two of them must be equal in both."""
    whole = dict[str, int]()
    for part in parts:
        for name, value in part.items():
            whole[name] = whole.get(name, 0) | value
    for name, value in whole.items():
        if fields[name].signed and value >> (fields[name].width - 1):
            whole[name] = value - (1 << fields[name].width)
    return whole


def _part(entry: str, fields: Mapping[str, BitField]) -> tuple[str, int, int]:
    """Return name, shift of the part within the field, and number of its bits."""
    if ">" in entry:
        name, _, bits = entry.partition(">")
        return name, int(bits), fields[name].width - int(bits)
    name, _, bits = entry.partition("<")
    return name, 0, int(bits) if bits else fields[name].width


def crc24q(data: bytes) -> int:
    """Return the CRC-24Q."""
    return int(_crc24q(np.frombuffer(data, np.uint8), _crc_table()))


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
