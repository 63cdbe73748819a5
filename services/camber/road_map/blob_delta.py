"""Compress the blobs of a release for transfer, as a difference when the receiver has an older blob.

The first byte names the encoding:

    r   raw
    z   zstd (RFC 8878)
    p   zstd with the older blob as dictionary
    s   a surface tile in which only heights, σ, vehicles or times have changed: zstd of integers

The integers of `s` are LEB128 (zigzag where they may be negative), column by column: number of surfaces; increase of
the tile's time [ns]; greatest common divisor of the ages; then for each surface the step from the row before; what
changes (bits of `_SurfaceChange`); height in steps of 0.1 mm, once or per node; σ in steps of 0.1 mm; vehicles; age in
divisors.

The receiver verifies the hash of the result and asks for the whole blob if it differs.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable

import numpy as np
import zstandard

from camber.road_map.release_files import MAX_BLOB_BYTES
from camber.road_map.road_columns import Integers, ReleaseError
from camber.road_map.road_tiles import changed_tile, grid_nodes
from camber.schemas.codec import DecodeError, decode, encode
from camber.schemas.road import SurfaceTile

_STEPS_PER_M = 10_000  # resolution of heights in a tile: `road_tiles` rounds them to 0.1 mm
_LARGE_BYTES = 1 << 20  # larger blobs take seconds at the highest compression level
_MAX_WINDOW_LOG = 27  # largest window that zstd decoders accept by default (RFC 8878: 128 MiB)
_UNCHANGED_FIELDS = (
    *("x", "y", "base_height_m", "surface_id", "link_id", "level", "centre_east_m", "centre_north_m"),
    *("yaw_rad", "half_length_m", "half_width_m", "rows", "columns", "first_height"),
)


class _SurfaceChange(enum.IntFlag):
    SHIFT = 1  # all nodes by the same height
    NODES = 2  # each node by a height of its own
    SIGMA = 4
    VEHICLES = 8
    SEEN = 16


def compress_blob(blob: bytes, base: bytes | None = None) -> bytes:
    """Compress a blob in the shortest encoding; `base` is an older blob that the receiver has."""
    encodings = [uncompressed_blob(blob), b"z" + _compressed(blob, None)]
    if base is not None:
        encodings.append(b"p" + _compressed(blob, base))
        numbers = _surface_numbers(blob, base)
        if numbers is not None:
            encodings.append(b"s" + _compressed(_leb128(numbers), None))
    return min(encodings, key=len)


def uncompressed_blob(blob: bytes) -> bytes:
    """Encode a blob without compression."""
    return b"r" + blob


def decompress_blob(data: bytes, base: bytes | None, *, limit: int = MAX_BLOB_BYTES) -> bytes:
    """Reverse `compress_blob`; the caller verifies the hash of the result.

    Raises ReleaseError for malformed bytes, and for a result of more than `limit` bytes.
    """
    encoding = data[:1]
    if encoding in (b"p", b"s") and base is None:
        raise ReleaseError("packed blob", "encoding", "one without another blob", actual=encoding.decode())
    if encoding == b"r" and len(data) - 1 <= limit:
        return data[1:]
    if encoding in (b"z", b"p"):
        return _decompressed(data[1:], base if encoding == b"p" else None, limit)
    if encoding == b"s":
        assert base is not None
        try:
            return _with_changes(base, _Numbers(_decompressed(data[1:], None, limit)))
        except (ValueError, OverflowError, IndexError) as error:  # ReleaseError is a ValueError too
            raise ReleaseError(
                "packed blob", "surfaces", f"changes of surfaces of the tile ({error})"
            ) from None
    raise ReleaseError("packed blob", "encoding", "r, z, p or s", actual=repr(encoding))


def _compressed(blob: bytes, base: bytes | None) -> bytes:
    size = len(blob) + (0 if base is None else len(base))
    parameters = zstandard.ZstdCompressionParameters.from_level(
        19 if size < _LARGE_BYTES else 9,
        window_log=min(max(size.bit_length(), 10), _MAX_WINDOW_LOG),
        write_content_size=True,
        write_checksum=False,
        write_dict_id=False,
    )
    return zstandard.ZstdCompressor(compression_params=parameters, dict_data=_dictionary(base)).compress(blob)


def _decompressed(data: bytes, base: bytes | None, limit: int) -> bytes:
    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= limit:
            raise ReleaseError("packed blob", "size", f"at most {limit} bytes", actual=str(size))
        decompressor = zstandard.ZstdDecompressor(
            dict_data=_dictionary(base), max_window_size=1 << _MAX_WINDOW_LOG
        )
        return decompressor.decompress(data, max_output_size=limit, allow_extra_data=False)
    except (zstandard.ZstdError, MemoryError) as error:
        raise ReleaseError("packed blob", "bytes", f"a zstd frame ({error})") from None


def _dictionary(base: bytes | None) -> zstandard.ZstdCompressionDict | None:
    if not base:
        return None
    return zstandard.ZstdCompressionDict(base, dict_type=zstandard.DICT_TYPE_RAWCONTENT)


def _surface_numbers(blob: bytes, base: bytes) -> list[int] | None:
    """Return the changes of a surface tile as integers; None if the blobs are no such tiles or more has changed."""
    try:
        new, old = decode(SurfaceTile, blob).message, decode(SurfaceTile, base).message
    except DecodeError:
        return None
    if any(not np.array_equal(getattr(new, name), getattr(old, name)) for name in _UNCHANGED_FIELDS):
        return None
    if len(new.grid_m) != len(old.grid_m):
        return None
    numbers = _numbers(new, old)
    try:
        same = _with_changes(base, _Numbers(_leb128(numbers))) == blob
    except ValueError:
        return None
    return numbers if same else None


def _numbers(new: SurfaceTile, old: SurfaceTile) -> list[int]:
    height = _heights(new) - _heights(old)
    nodes, _ = grid_nodes(new, np.arange(len(new.rows)))
    ends = np.cumsum(new.rows.astype(np.int64) * new.columns)
    steps = [np.unique(part) for part in np.split(height[nodes], ends)[:-1]]
    changed = (
        np.array([len(each) == 1 and each[0] != 0 for each in steps], bool),
        np.array([len(each) > 1 for each in steps], bool),
        new.sigma_m != old.sigma_m,
        new.vehicles != old.vehicles,
        new.last_seen_ns != old.last_seen_ns,
    )
    what = np.sum([int(flag) * column for flag, column in zip(_SurfaceChange, changed, strict=True)], axis=0)
    rows = np.flatnonzero(what)
    shifted, bent, sigma, vehicles, seen = map(np.flatnonzero, changed)
    ages = (new.time_ns - new.last_seen_ns[seen]).tolist()
    divisor = max(math.gcd(*ages), 1)
    sigma_steps = np.round(new.sigma_m[sigma].astype(np.float64) * _STEPS_PER_M).astype(np.int64)
    return [
        len(rows),
        _zigzag(new.time_ns - old.time_ns),
        divisor,
        *np.diff(rows, prepend=-1).tolist(),
        *what[rows].tolist(),
        *map(_zigzag, height[new.first_height[shifted]].tolist()),
        *map(_zigzag, height[grid_nodes(new, bent)[0]].tolist()),
        *sigma_steps.tolist(),
        *new.vehicles[vehicles].tolist(),
        *(_zigzag(age // divisor) for age in ages),
    ]


def _with_changes(base: bytes, numbers: _Numbers) -> bytes:
    """Apply changes to a tile's blob; ValueError if they do not fit the tile."""
    try:
        old = decode(SurfaceTile, base).message
    except DecodeError as error:
        raise ReleaseError("packed blob", "base", f"a tile of surfaces ({error})") from None
    count = numbers.take(1)[0]
    time_ns, divisor = old.time_ns + _signed(numbers.take(1)[0]), numbers.take(1)[0]
    if count > len(old.rows):
        raise ValueError(f"{count} surfaces of {len(old.rows)}")
    rows = np.cumsum(np.array(numbers.take(count), np.int64)) - 1
    what = np.array(numbers.take(count), np.int64)
    if count and (rows[0] < 0 or (np.diff(rows) <= 0).any() or rows[-1] >= len(old.rows)):
        raise ValueError("rows beyond the tile")
    shifted, bent, sigma, vehicles, seen = (rows[(what & int(flag)) != 0] for flag in _SurfaceChange)
    shifted_nodes, of_surface = grid_nodes(old, shifted)
    bent_nodes, _ = grid_nodes(old, bent)
    shifts = np.array([_signed(number) for number in numbers.take(len(shifted))], np.int64)
    steps = np.array([_signed(number) for number in numbers.take(len(bent_nodes))], np.int64)
    raised_m = np.concatenate((shifts[of_surface], steps)) / _STEPS_PER_M
    sigma_m = np.array(numbers.take(len(sigma)), np.float64) / _STEPS_PER_M
    vehicle_counts = np.array(numbers.take(len(vehicles)), np.int32)
    seen_ns = [time_ns - _signed(age) * divisor for age in numbers.take(len(seen))]
    numbers.finish()
    return encode(
        changed_tile(
            old,
            time_ns=time_ns,
            raised=(np.concatenate((shifted_nodes, bent_nodes)), raised_m),
            sigma_m=(sigma, sigma_m),
            vehicles=(vehicles, vehicle_counts),
            last_seen_ns=(seen, np.array(seen_ns, np.int64)),
        )
    )


def _heights(tile: SurfaceTile) -> Integers:
    heights_m = tile.base_height_m + tile.grid_m.astype(np.float64)
    steps: Integers = np.round(heights_m * _STEPS_PER_M).astype(np.int64)
    return steps


def _zigzag(number: int) -> int:
    return 2 * number if number >= 0 else -2 * number - 1


def _signed(number: int) -> int:
    return -(number + 1) // 2 if number & 1 else number // 2


def _leb128(numbers: Iterable[int]) -> bytes:
    out = bytearray()
    for number in numbers:
        while number > 0x7F:
            out.append(number & 0x7F | 0x80)
            number >>= 7
        out.append(number)
    return bytes(out)


class _Numbers:
    """Reader of LEB128 integers; ValueError at the end of the data."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def take(self, count: int) -> list[int]:
        if count > len(self._data) - self._at:
            raise ValueError("numbers are missing")
        return [self._next() for _ in range(count)]

    def finish(self) -> None:
        if self._at != len(self._data):
            raise ValueError("numbers are left over")

    def _next(self) -> int:
        number = shift = 0
        while self._at < len(self._data) and shift <= 63:
            byte = self._data[self._at]
            self._at += 1
            number |= (byte & 0x7F) << shift
            if byte < 0x80:
                return number
            shift += 7
        raise ValueError("a number without an end")
