"""A decoder of vector tiles, written from the specification."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

from camber.live.vector_tiles import EXTENT


def varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        value |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if not data[at - 1] & 0x80:
            return value, at


def fields(data: bytes) -> Iterator[tuple[int, Any]]:
    at = 0
    while at < len(data):
        key, at = varint(data, at)
        if key & 7 == 0:
            value, at = varint(data, at)
            yield key >> 3, value
        elif key & 7 == 5:
            yield key >> 3, struct.unpack_from("<f", data, at)[0]
            at += 4
        else:
            length, at = varint(data, at)
            yield key >> 3, data[at : at + length]
            at += length


def varints(data: bytes) -> list[int]:
    values, at = [], 0
    while at < len(data):
        value, at = varint(data, at)
        values.append(value)
    return values


def geometry(commands: list[int]) -> list[list[tuple[int, int]]]:
    parts: list[list[tuple[int, int]]] = []
    x = y = at = 0
    while at < len(commands):
        command, count = commands[at] & 7, commands[at] >> 3
        at += 1
        if command == 7:
            continue
        for _ in range(count):
            dx, dy = ((value >> 1) ^ -(value & 1) for value in commands[at : at + 2])
            x, y, at = x + dx, y + dy, at + 2
            if command == 1:
                parts.append([])
            parts[-1].append((x, y))
    return parts


def decoded(tile: bytes) -> dict[str, list[tuple[int, list[tuple[int, int]], dict[str, float]]]]:
    layers = {}
    for _, layer in fields(tile):
        parts = list(fields(layer))
        keys = [value.decode() for number, value in parts if number == 3]
        values = []
        for number, value in parts:
            if number == 4:
                ((kind, content),) = fields(value)
                values.append(content if kind == 2 else (content >> 1) ^ -(content & 1))
        features = []
        for number, feature in parts:
            if number == 2:
                content = dict(fields(feature))
                tags = varints(content[2])
                properties = {keys[k]: values[v] for k, v in zip(tags[::2], tags[1::2], strict=True)}
                features.append((content[1], geometry(varints(content[4]))[0], properties))
        assert dict(parts)[5] == EXTENT
        layers[dict(parts)[1].decode()] = features
    return layers
