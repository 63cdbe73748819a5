"""Which fields of a navigation message stand where: one table to write a subframe with and to read it by.

A layout is a row of entries: a name is that whole field, `name>n` the field without its last n bits, `name<n` these
last n bits, a number so many bits that are zero when written and passed over when read.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from camber.formats.broadcast.ephemeris_fields import BitField

BitLayout = tuple[str | int, ...]


def encode_layout(
    layout: BitLayout, fields: Mapping[str, BitField], integers: Mapping[str, int]
) -> list[tuple[int, int]]:
    """(value, width) pairs for `bit_fields.joined`."""
    pairs = list[tuple[int, int]]()
    for entry in layout:
        if isinstance(entry, int):
            pairs.append((0, entry))
        else:
            name, shift, width = _part(entry, fields)
            pairs.append((integers[name] >> shift, width))
    return pairs


def decode_layout(bits: int, width: int, layout: BitLayout, fields: Mapping[str, BitField]) -> dict[str, int]:
    """The fields at the front of so many bits, unsigned; of a field that stands there in part, that part in its place.

    Raises ValueError where the layout is longer than the bits.
    """
    found, left = dict[str, int](), width
    for entry in layout:
        name, shift, part_width = ("", 0, entry) if isinstance(entry, int) else _part(entry, fields)
        left -= part_width
        if left < 0:
            raise ValueError(f"{width} bits, expected those of {layout}")
        if name:
            found[name] = found.get(name, 0) | (bits >> left & (1 << part_width) - 1) << shift
    return found


def combine_parts(parts: Iterable[Mapping[str, int]], fields: Mapping[str, BitField]) -> dict[str, int]:
    """What several subframes hold as whole fields, with their signs. What stands in two of them must be equal."""
    whole = dict[str, int]()
    for part in parts:
        for name, value in part.items():
            whole[name] = whole.get(name, 0) | value
    for name, value in whole.items():
        if fields[name].signed and value >> (fields[name].width - 1):
            whole[name] = value - (1 << fields[name].width)
    return whole


def _part(entry: str, fields: Mapping[str, BitField]) -> tuple[str, int, int]:
    """Name, how far its bits are shifted, and how many there are."""
    if ">" in entry:
        name, _, bits = entry.partition(">")
        return name, int(bits), fields[name].width - int(bits)
    name, _, bits = entry.partition("<")
    return name, 0, int(bits) if bits else fields[name].width
