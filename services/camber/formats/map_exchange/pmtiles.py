"""PMTiles: vector tiles of all zoom levels in one file, which a reader fetches by ranges of bytes.

Source: PMTiles specification, version 3. Tiles are numbered zoom by zoom along Hilbert's curve and stored in this
order. After the header and the root directory, which are within the first 16 KiB, come the tiles, then leaf directories
and metadata, so that a writer keeps two numbers of each tile and no tile.
"""

from __future__ import annotations

import gzip
import json
import os
import struct
import zlib
from array import array
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from camber.formats.errors import FormatError
from camber.formats.foxglove.protobuf import varint
from camber.schemas.base import Int64

HEAD_BYTES = 16_384  # source: section 2, of header and root directory
_HEADER = struct.Struct("<7sB11Q6B4iB2i")  # source: section 3
_MAGIC, _VERSION, _GZIP, _MVT = b"PMTiles", 3, 2, 1
_LEAF_ENTRIES = 4096  # chosen: some kilobytes; as many leaves fit in the root directory
_MOST_BYTES = 64 << 20  # of a tile; chosen: bounds memory
_MOST_DIRECTORY_BYTES = 4 << 20  # chosen: a million numbers in memory
_VARINT_BITS = 63  # the last shift of a number of 64 bits
_PER_DEGREE = 1e7  # source: section 3, positions
_MOST_DEPTH = 4  # source: section 4, directories
_LARGEST_ZOOM = 26  # chosen: numbers of tiles then fit into 53 bits

Bounds = tuple[float, float, float, float]
"""West, south, east, north in degrees."""


class DirectoryEntry(NamedTuple):
    """Where a tile is, or with `run` 0 the leaf directory from this tile onwards."""

    number: int
    run: int
    size: int
    offset: int


def hilbert_numbers(zoom: int, x: Int64, y: Int64) -> Int64:
    """Numbers (n,) of tiles of one zoom level: a tile's parent has a quarter of its number."""
    x, y = x.copy(), y.copy()
    numbers = np.zeros(len(x), np.int64)
    for bit in range(zoom - 1, -1, -1):
        side = 1 << bit
        right, low = x & side, y & side
        numbers += (3 * right ^ low) << bit
        turned, flipped = low == 0, (low == 0) & (right != 0)
        x, y = np.where(flipped, side - 1 - x, x), np.where(flipped, side - 1 - y, y)
        x, y = np.where(turned, y, x), np.where(turned, x, y)
    return numbers


def first_number(zoom: int) -> int:
    """How many tiles all lower zoom levels have."""
    return int(((1 << 2 * zoom) - 1) // 3)


class PmtilesWriter:
    """Writes tiles into a new file, in the order of their numbers."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._numbers, self._sizes = array("Q"), array("Q")
        stream.write(bytes(HEAD_BYTES))

    def add(self, number: int, tile: bytes) -> None:
        """Store a tile that is not compressed yet. Raises ValueError unless its number exceeds that before it."""
        if self._numbers and number <= self._numbers[-1]:
            raise ValueError(f"tile {number} after {self._numbers[-1]}, expected ascending numbers")
        data = gzip.compress(tile, mtime=0)
        self._stream.write(data)
        self._numbers.append(number)
        self._sizes.append(len(data))

    def finish(self, metadata: Mapping[str, Any], *, zooms: tuple[int, int], bounds_deg: Bounds) -> int:
        """Write directories, metadata and the header; returns the number of tiles."""
        count, data_bytes = len(self._numbers), sum(self._sizes)
        root, leaves = self._directories()
        text = gzip.compress(json.dumps(metadata).encode(), mtime=0)
        self._stream.write(leaves)
        self._stream.write(text)
        leaves_at = HEAD_BYTES + data_bytes
        west, south, east, north = (round(angle * _PER_DEGREE) for angle in bounds_deg)
        header = _HEADER.pack(
            _MAGIC, _VERSION, _HEADER.size, len(root), leaves_at + len(leaves), len(text), leaves_at, len(leaves),
            HEAD_BYTES, data_bytes, count, count, count, 1, _GZIP, _GZIP, _MVT, *zooms, west, south, east, north,
            zooms[1], (west + east) // 2, (south + north) // 2,
        )  # fmt: skip
        self._stream.seek(0)
        self._stream.write(header + root)
        return count

    def _directories(self) -> tuple[bytes, bytes]:
        """The root directory, and all leaf directories where the root alone is too large."""
        offsets = np.append(0, np.cumsum(np.array(self._sizes, np.int64)))[:-1].tolist()
        columns = zip(self._numbers, self._sizes, offsets, strict=True)
        entries = [DirectoryEntry(number, 1, size, offset) for number, size, offset in columns]
        root, leaves, per_leaf = encode_directory(entries), b"", _LEAF_ENTRIES
        while len(root) > HEAD_BYTES - _HEADER.size:
            parts, heads, leaves_bytes = [], [], 0
            for first in range(0, len(entries), per_leaf):
                parts.append(encode_directory(entries[first : first + per_leaf]))
                heads.append(DirectoryEntry(entries[first].number, 0, len(parts[-1]), leaves_bytes))
                leaves_bytes += len(parts[-1])
            root, leaves = encode_directory(heads), b"".join(parts)
            per_leaf *= 2
        return root, leaves


def encode_directory(entries: Sequence[DirectoryEntry]) -> bytes:
    """A directory, compressed."""
    numbers = [entry.number for entry in entries]
    steps = [after - before for before, after in zip([0, *numbers], numbers, strict=False)]
    offsets = []
    end = -1
    for entry in entries:
        offsets.append(0 if entry.offset == end else entry.offset + 1)
        end = entry.offset + entry.size
    columns = (steps, [entry.run for entry in entries], [entry.size for entry in entries], offsets)
    values = [len(entries), *(value for column in columns for value in column)]
    return gzip.compress(b"".join(map(varint, values)), mtime=0)


class PmtilesFile:
    """Reads tiles of a file; whatever is in it, FormatError names what is wrong."""

    def __init__(self, path: Path) -> None:
        self._path = path
        head = self._bytes(0, HEAD_BYTES, whole=False)
        if len(head) < _HEADER.size or head[:8] != _MAGIC + bytes([_VERSION]):
            raise FormatError(str(path), "header", "PMTiles, version 3")
        fields = _HEADER.unpack_from(head)
        if fields[14:17] != (_GZIP, _GZIP, _MVT):
            raise FormatError(str(path), "header", "vector tiles, compressed by gzip")
        self._leaves_at, self._tiles_at = fields[6], fields[8]
        self.zooms: tuple[int, int] = fields[17:19]
        west, south, east, north = (value / _PER_DEGREE for value in fields[19:23])
        self.bounds_deg: Bounds = (west, south, east, north)
        self._root = self._directory(fields[2], fields[3])
        self.metadata = self._json(fields[4], fields[5])

    def tile(self, zoom: int, x: int, y: int) -> bytes | None:
        """A tile, no longer compressed; None where there is none."""
        if not 0 <= zoom <= _LARGEST_ZOOM or not (0 <= x < 1 << zoom and 0 <= y < 1 << zoom):
            return None
        number = first_number(zoom) + int(hilbert_numbers(zoom, np.array([x]), np.array([y]))[0])
        entries = self._root
        for _ in range(_MOST_DEPTH):
            place = bisect_right(entries, number, key=lambda entry: entry.number) - 1
            if place < 0:
                return None
            entry = entries[place]
            if entry.run:
                inside = number < entry.number + entry.run
                return self._unpacked(self._tiles_at + entry.offset, entry.size, "tile") if inside else None
            entries = self._directory(self._leaves_at + entry.offset, entry.size)
        raise FormatError(str(self._path), "directory", f"at most {_MOST_DEPTH} one within another")

    def _json(self, offset: int, size: int) -> dict[str, Any]:
        try:
            metadata = json.loads(self._unpacked(offset, size, "metadata"))
        except (ValueError, RecursionError):
            metadata = None
        if not isinstance(metadata, dict):
            raise FormatError(str(self._path), "metadata", "a JSON object")
        return metadata

    def _directory(self, offset: int, size: int) -> list[DirectoryEntry]:
        values = _varints(self._unpacked(offset, size, "directory"))
        count = values[0] if values else 0
        if len(values) != 4 * count + 1:
            raise FormatError(str(self._path), "directory", "four numbers of each entry")
        steps, runs, sizes, offsets = (values[1 + k * count : 1 + (k + 1) * count] for k in range(4))
        entries: list[DirectoryEntry] = []
        number = end = 0
        for step, run, size_bytes, at in zip(steps, runs, sizes, offsets, strict=True):
            number += step
            begin = at - 1 if at else end
            entries.append(DirectoryEntry(number, run, size_bytes, begin))
            end = begin + size_bytes
        return entries

    def _unpacked(self, offset: int, size: int, what: str) -> bytes:
        most = _MOST_BYTES if what == "tile" else _MOST_DIRECTORY_BYTES
        unpacker = zlib.decompressobj(16 + zlib.MAX_WBITS)
        try:
            data = unpacker.decompress(self._bytes(offset, size), most)
        except zlib.error:
            data = b""
        if not unpacker.eof:
            raise FormatError(str(self._path), what, f"gzip of at most {most} bytes")
        return data

    def _bytes(self, offset: int, size: int, *, whole: bool = True) -> bytes:
        with self._path.open("rb") as stream:
            file_bytes = stream.seek(0, os.SEEK_END)
            if size > _MOST_BYTES or (whole and offset + size > file_bytes):
                raise FormatError(str(self._path), "size", "sections within the file", actual=str(file_bytes))
            stream.seek(offset)
            return stream.read(size)


def _varints(data: bytes) -> list[int]:
    """Numbers, one after another; none where one of them has more than 64 bits."""
    values, value, shift = [], 0, 0
    for byte in data:
        if shift > _VARINT_BITS:
            return []
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            values.append(value)
            value = shift = 0
    return values
