"""Mapbox Vector Tiles: features with integer coordinates and small properties, as bytes.

Source: Mapbox Vector Tile Specification 2.1; protocol buffers as their encoding document says. A feature is nothing but
varints: those of all features of a layer are laid out in one array and become bytes at once.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from camber.formats.foxglove.protobuf import BITS_32, LENGTH, VARINT, tag, varint
from camber.schemas.base import Float64, Int64, UInt8

EXTENT = 8192
"""Units of a tile's side; as MapLibre GL keeps them: 6 cm of a tile of 500 m."""
_GEOMETRY = {"LineString": 2, "Polygon": 3}
_MOVE_TO, _LINE_TO, _CLOSE = 1, 2, 7  # commands of the specification, section 4.3.1
_Distinct = tuple[Any, Int64]  # different values of a column, and the place of each row's among them
_BEGIN = 4  # commands and coordinates of a geometry before its second point


@dataclass(frozen=True, slots=True, kw_only=True)
class TileLayer:
    """One layer of a tile: n lines, or rings without their last points, in units of the tile, y downwards.

    `points` (m, 2) of feature i are rows `first[i]` to `first[i + 1]`, with `first` (n + 1,); `numbers` (n,) are their
    ids, not negative; `properties` have a column (n,) each. A feature whose points are one and the same is left out.
    """

    name: str
    kind: Literal["LineString", "Polygon"]
    numbers: Int64
    points: Int64
    first: Int64
    properties: Mapping[str, Int64 | Float64]

    def encode(self) -> bytes:
        """The layer as a field of a tile; empty without features."""
        rows, geometry, begins = self._geometry()
        if not len(rows):
            return b""
        distinct: dict[str, _Distinct] = {}
        for key, column in self.properties.items():
            distinct[key] = np.unique(column[rows], return_inverse=True)
        parts = [_bytes(1, self.name.encode()), _features(self._heads(rows, distinct), geometry, begins)]
        parts += [_bytes(3, key.encode()) for key in distinct]
        parts += [_bytes(4, _value(value)) for values, _ in distinct.values() for value in values.tolist()]
        parts += [_integer(5, EXTENT), _integer(15, 2)]
        return _bytes(3, b"".join(parts))

    def _geometry(self) -> tuple[Int64, Int64, Int64]:
        """Features that are kept, commands and zigzag steps of all of them, and where those of each begin."""
        is_first = np.zeros(len(self.points), bool)
        is_first[self.first[:-1]] = True
        steps = np.diff(self.points, axis=0, prepend=np.zeros((1, 2), np.int64))
        steps[is_first] = self.points[is_first]
        moves = ~is_first & steps.any(axis=1)
        feature = np.cumsum(is_first) - 1
        lines = np.bincount(feature[moves], minlength=len(self.numbers))
        closed = self.kind == "Polygon"
        kept = lines >= (2 if closed else 1)
        steps = steps[(is_first | moves) & kept[feature]]
        zigzag, lines = (steps << 1) ^ (steps >> 63), lines[kept]
        sizes = _BEGIN + 2 * lines + closed
        begins = np.cumsum(sizes) - sizes
        geometry = np.empty(sizes.sum(), np.int64)
        geometry[begins] = _MOVE_TO | 1 << 3
        geometry[begins + _BEGIN - 1] = _LINE_TO | lines << 3
        if closed:
            geometry[begins + sizes - 1] = _CLOSE | 1 << 3
        is_step = np.ones(len(geometry), bool)
        is_step[begins] = is_step[begins + _BEGIN - 1] = False
        is_step[begins + sizes - 1] &= not closed
        geometry[is_step] = zigzag.ravel()
        return np.flatnonzero(kept), geometry, begins

    def _heads(self, rows: Int64, distinct: Mapping[str, _Distinct]) -> Int64:
        """Fields of each feature before its geometry, as varints (n, k)."""
        columns: list[Int64 | int] = []
        offset = 0
        for key, (values, place) in enumerate(distinct.values()):
            columns += [key, offset + place]
            offset += len(values)
        tags = _columns(columns, len(rows))
        lengths = _sizes(tags).sum(axis=1, dtype=np.int64)
        before: list[Int64 | int] = [_key(1, VARINT), self.numbers[rows], _key(2, LENGTH), lengths]
        after: list[Int64 | int] = [_key(3, VARINT), _GEOMETRY[self.kind], _key(4, LENGTH)]
        return np.hstack((_columns(before, len(rows)), tags, _columns(after, len(rows))))


def encode_tile(layers: Iterable[TileLayer]) -> bytes:
    """A tile of these layers."""
    return b"".join(layer.encode() for layer in layers)


def _features(heads: Int64, geometry: Int64, begins: Int64) -> bytes:
    """All features as fields of their layer: key and length, head, length of the geometry, geometry."""
    lengths = np.add.reduceat(_sizes(geometry), begins, dtype=np.int64)
    heads = np.column_stack((heads, lengths))
    whole = _sizes(heads).sum(axis=1, dtype=np.int64) + lengths
    heads = np.column_stack((np.full(len(heads), _key(2, LENGTH)), whole, heads))
    return _varints(np.insert(geometry, np.repeat(begins, heads.shape[1]), heads.ravel()))


def _columns(columns: list[Int64 | int], rows: int) -> Int64:
    """Columns (rows, n), of which those with one value are given by it."""
    made = np.empty((rows, len(columns)), np.int64)
    for k, column in enumerate(columns):
        made[:, k] = column
    return made


def _sizes(values: Int64) -> UInt8:
    """Bytes of each as a varint; none of them is negative."""
    sizes = np.ones(values.shape, np.uint8)
    rest = values >> 7
    while rest.any():
        sizes += rest > 0
        rest >>= 7
    return sizes


def _varints(values: Int64) -> bytes:
    """Varints (n,), one after another."""
    sizes = _sizes(values)
    begins = np.cumsum(sizes, dtype=np.int64) - sizes
    data = np.empty(begins[-1] + sizes[-1], np.uint8)
    for k in range(int(sizes.max())):
        long = sizes > k
        more = (sizes[long] > k + 1).astype(np.int64) << 7
        data[begins[long] + k] = values[long] >> 7 * k & 0x7F | more
    return data.tobytes()


def _key(number: int, wire: int) -> int:
    return tag(number, wire)[0]


def _integer(number: int, value: int) -> bytes:
    return tag(number, VARINT) + varint(value)


def _bytes(number: int, data: bytes) -> bytes:
    return tag(number, LENGTH) + varint(len(data)) + data


def _value(value: int | float) -> bytes:
    if isinstance(value, int):
        return _integer(6, value << 1 ^ value >> 63)
    return tag(2, BITS_32) + struct.pack("<f", value)
