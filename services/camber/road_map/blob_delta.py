"""Compress the blobs of a release for transfer, as a difference when the receiver has an older blob.

The first byte names the encoding:

    r   raw
    z   zstd (RFC 8878)
    p   zstd with the older blob as dictionary
    s   a surface tile in which only heights, σ, vehicles or times have changed: zstd of integers

The integers of `s` are LEB128 (zigzag where they may be negative), column by column: number of surfaces; increase of
the tile's time [ns]; greatest common divisor of the ages; then for each surface the step from the row before; what
changes (bits of `_ChangeFlags`); height in steps of 0.1 mm, once or per node; σ in steps of 0.1 mm; vehicles; age in
divisors.

The receiver verifies the hash of the result and asks for the whole blob if it differs.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable

import numpy as np
import zstandard
from numpy.typing import NDArray

from camber.road_map.release_files import MAX_BLOB_BYTES
from camber.road_map.road_columns import ReleaseError
from camber.schemas.codec import DecodeError, decode, encode
from camber.schemas.road import SurfaceTile

Integers = NDArray[np.int64]

# Resolution of heights in a tile: `road_tiles` rounds them to 0.1 mm.
_STEPS_PER_M = 10_000
_HEIGHT_DECIMALS = 4
_LARGE_BYTES = 1 << 20  # larger blobs take seconds at the highest compression level
_MAX_WINDOW_LOG = 27  # largest window that zstd decoders accept by default (RFC 8878: 128 MiB)
_UNCHANGED_FIELDS = (
    *("x", "y", "base_height_m", "surface_id", "link_id", "level", "centre_east_m", "centre_north_m"),
    *("yaw_rad", "half_length_m", "half_width_m", "rows", "columns", "first_height"),
)


class _ChangeFlags(enum.IntFlag):
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


# -- zstd ------------------------------------------------------------------------------------------------------------


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


# -- surfaces of a tile ----------------------------------------------------------------------------------------------


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
    sizes = new.rows.astype(np.int64) * new.columns
    changed, shifts, nodes = [], list[int](), list[int]()
    for row in range(len(sizes)):
        first = int(new.first_height[row])
        mine = height[first : first + int(sizes[row])]
        what = _ChangeFlags(0)
        if mine.any():
            what |= _ChangeFlags.SHIFT if (mine == mine[0]).all() else _ChangeFlags.NODES
        what |= _ChangeFlags.SIGMA if new.sigma_m[row] != old.sigma_m[row] else _ChangeFlags(0)
        what |= _ChangeFlags.VEHICLES if new.vehicles[row] != old.vehicles[row] else _ChangeFlags(0)
        what |= _ChangeFlags.SEEN if new.last_seen_ns[row] != old.last_seen_ns[row] else _ChangeFlags(0)
        if what:
            changed.append((row, what))
        if what & _ChangeFlags.SHIFT:
            shifts.append(int(mine[0]))
        elif what & _ChangeFlags.NODES:
            nodes += mine.tolist()
    rows = np.array([row for row, _ in changed], np.int64)

    def of(flag: _ChangeFlags) -> Integers:
        return np.array([row for row, what in changed if what & flag], np.int64)

    ages = new.time_ns - new.last_seen_ns[of(_ChangeFlags.SEEN)]
    divisor = max(math.gcd(*ages.tolist()), 1) if len(ages) else 1
    sigma = np.round(new.sigma_m[of(_ChangeFlags.SIGMA)].astype(np.float64) * _STEPS_PER_M).astype(np.int64)
    return [
        len(changed),
        _zigzag(new.time_ns - old.time_ns),
        divisor,
        *np.diff(rows, prepend=-1).tolist(),
        *(int(what) for _, what in changed),
        *map(_zigzag, shifts),
        *map(_zigzag, nodes),
        *sigma.tolist(),
        *new.vehicles[of(_ChangeFlags.VEHICLES)].tolist(),
        *(_zigzag(age // divisor) for age in ages.tolist()),
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

    def of(flag: _ChangeFlags) -> Integers:
        chosen: Integers = rows[(what & int(flag)) != 0]
        return chosen

    grid_m, sigma_m = old.grid_m.copy(), old.sigma_m.copy()
    vehicles, last_seen_ns = old.vehicles.copy(), old.last_seen_ns.copy()
    sizes = old.rows.astype(np.int64) * old.columns
    shifted, bent = of(_ChangeFlags.SHIFT), of(_ChangeFlags.NODES)
    steps = np.repeat(_signed_column(numbers.take(len(shifted))), sizes[shifted])
    at = np.concatenate((_nodes(old, shifted), _nodes(old, bent)))
    steps = np.concatenate((steps, _signed_column(numbers.take(int(sizes[bent].sum())))))
    heights_m = np.round(old.base_height_m + grid_m[at].astype(np.float64), _HEIGHT_DECIMALS)
    heights_m = np.round(heights_m + steps / _STEPS_PER_M, _HEIGHT_DECIMALS)
    grid_m[at] = (heights_m - old.base_height_m).astype(np.float32)
    surer, counted, seen = of(_ChangeFlags.SIGMA), of(_ChangeFlags.VEHICLES), of(_ChangeFlags.SEEN)
    sigma_m[surer] = (np.array(numbers.take(len(surer)), np.float64) / _STEPS_PER_M).astype(np.float32)
    vehicles[counted] = np.array(numbers.take(len(counted)), np.int32)
    ages = [time_ns - _signed(age) * divisor for age in numbers.take(len(seen))]
    last_seen_ns[seen] = np.array(ages, np.int64)
    numbers.finish()
    changed = {"grid_m": grid_m, "sigma_m": sigma_m, "vehicles": vehicles, "last_seen_ns": last_seen_ns}
    return encode(SurfaceTile(**old.__dict__ | changed | {"time_ns": time_ns}))


def _heights(tile: SurfaceTile) -> Integers:
    heights_m = tile.base_height_m + tile.grid_m.astype(np.float64)
    steps: Integers = np.round(heights_m * _STEPS_PER_M).astype(np.int64)
    return steps


def _nodes(tile: SurfaceTile, surfaces: Integers) -> Integers:
    sizes = tile.rows[surfaces].astype(np.int64) * tile.columns[surfaces]
    nth = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    nodes: Integers = np.repeat(tile.first_height[surfaces].astype(np.int64), sizes) + nth
    return nodes


# -- numbers ---------------------------------------------------------------------------------------------------------


def _zigzag(number: int) -> int:
    return 2 * number if number >= 0 else -2 * number - 1


def _signed(number: int) -> int:
    return -(number + 1) // 2 if number & 1 else number // 2


def _signed_column(numbers: list[int]) -> Integers:
    return np.array([_signed(number) for number in numbers], np.int64)


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
