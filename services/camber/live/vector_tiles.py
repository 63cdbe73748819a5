"""Mapbox Vector Tiles: features with integer coordinates and small properties, as bytes.

Source: Mapbox Vector Tile Specification 2.1; protocol buffers as their encoding document says.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from camber.formats.foxglove.protobuf import BITS_32, LENGTH, VARINT, tag, varint
from camber.schemas.base import Int64

EXTENT = 8192
"""Units of a tile's side; as MapLibre GL keeps them: 6 cm of a tile of 500 m."""
_GEOMETRY = {"LineString": 2, "Polygon": 3}
_MOVE_TO, _LINE_TO, _CLOSE = 1, 2, 7  # commands of the specification, section 4.3.1
Value = int | float


@dataclass(slots=True, kw_only=True)
class TileLayer:
    """One layer of a tile."""

    name: str
    kind: Literal["LineString", "Polygon"]
    _keys: dict[str, int] = field(default_factory=dict)
    _values: dict[Value, int] = field(default_factory=dict)
    _features: list[bytes] = field(default_factory=list)

    def add(self, number: int, points: Int64, properties: dict[str, Value]) -> None:
        """Add a line, or a ring without its last point, (n, 2) in units of the tile, y downwards."""
        commands = _geometry(points, closed=self.kind == "Polygon")
        if not commands:
            return
        tags: list[int] = []
        for key, value in properties.items():
            tags += [
                self._keys.setdefault(key, len(self._keys)),
                self._values.setdefault(value, len(self._values)),
            ]
        self._features.append(
            _integer(1, number)
            + _bytes(2, _varints(tags))
            + _integer(3, _GEOMETRY[self.kind])
            + _bytes(4, _varints(commands))
        )

    def encode(self) -> bytes:
        """The layer as a field of a tile; empty without features."""
        if not self._features:
            return b""
        parts = [_bytes(1, self.name.encode())]
        parts += [_bytes(2, feature) for feature in self._features]
        parts += [_bytes(3, key.encode()) for key in self._keys]
        parts += [_bytes(4, _value(value)) for value in self._values]
        parts += [_integer(5, EXTENT), _integer(15, 2)]
        return _bytes(3, b"".join(parts))


def encode_tile(layers: Iterable[TileLayer]) -> bytes:
    """A tile of these layers."""
    return b"".join(layer.encode() for layer in layers)


def _geometry(points: Int64, *, closed: bool) -> list[int]:
    """Commands and zigzag steps; none where the points are one and the same."""
    steps = np.diff(points, axis=0, prepend=np.zeros((1, 2), np.int64))
    moved = steps[1:].any(axis=1)
    if moved.sum() < (2 if closed else 1):
        return []
    steps = np.vstack((steps[:1], steps[1:][moved]))
    zigzag: list[int] = ((steps << 1) ^ (steps >> 63)).ravel().tolist()
    lines = len(steps) - 1
    return [
        _MOVE_TO | 1 << 3,
        *zigzag[:2],
        _LINE_TO | lines << 3,
        *zigzag[2:],
        *([_CLOSE | 1 << 3] if closed else []),
    ]


def _varints(values: Sequence[int]) -> bytes:
    return b"".join(map(varint, values))


def _integer(number: int, value: int) -> bytes:
    return tag(number, VARINT) + varint(value)


def _bytes(number: int, data: bytes) -> bytes:
    return tag(number, LENGTH) + varint(len(data)) + data


def _value(value: Value) -> bytes:
    if isinstance(value, int):
        return _integer(6, value << 1 ^ value >> 63)
    return tag(2, BITS_32) + struct.pack("<f", value)
