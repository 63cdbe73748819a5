"""Bit layouts of navigation messages: one table both to encode a subframe and to decode it.

A layout is a sequence of entries: a name is the whole field, `name>n` the field without its last n bits, `name<n` its
last n bits, a number that many bits, which are encoded as zero and skipped when decoding.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from camber.formats.broadcast.ephemeris_fields import BitField

BitLayout = tuple[str | int, ...]


def encode_layout(
    layout: BitLayout, fields: Mapping[str, BitField], integers: Mapping[str, int]
) -> list[tuple[int, int]]:
    """Return (value, width) pairs for `bit_fields.pack_bits`."""
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
