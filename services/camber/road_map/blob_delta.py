"""Blobs of a release as they travel: packed, where the receiver has an older blob as a difference against it.

    r   as it is
    z   zstd (RFC 8878) of the whole
    p   zstd with the older blob as dictionary, so that what is in both costs nothing
    s   surfaces of a tile that have other heights, σ, vehicles or times, and nothing else: zstd of numbers (below)

The numbers of `s` are variable-length integers (LEB128; zigzag where they may be negative), one column behind the
other: number of surfaces; by how much the tile's time grows in ns; the greatest common divisor of the times; then of
each surface the step to its row from the one before; what changes (bits of `_Change`); height in steps of 0.1 mm, once
or for each node; σ in steps of 0.1 mm; vehicles; how long before the tile's time it was seen, in divisors.

A difference is a wish of the sender that comes true or not: the receiver compares the hash of what comes out, and asks
for the whole blob where it is another.
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

_STEPS_PER_M = 10_000
_HEIGHT_DECIMALS = 4
_LARGE_BYTES = 1 << 20  # beyond it the highest level takes seconds
_MAX_WINDOW_LOG = 27
_SAME = (
    *(
        "x",
        "y",
        "base_height_m",
        "surface_id",
        "link_id",
        "level",
        "centre_east_m",
        "centre_north_m",
        "yaw_rad",
    ),
    *("half_length_m", "half_width_m", "rows", "columns", "first_height"),
)


class _Change(enum.IntFlag):
    SHIFT = 1  # all nodes by the same
    NODES = 2  # each node by its own
    SIGMA = 4
    VEHICLES = 8
    SEEN = 16


def packed(blob: bytes, base: bytes | None = None) -> bytes:
    """The fewest bytes that `unpacked` makes the blob of again, by whoever has `base`."""
    ways = [as_it_is(blob), b"z" + _compressed(blob, None)]
    if base is not None:
        ways.append(b"p" + _compressed(blob, base))
        numbers = _surface_numbers(blob, base)
        if numbers is not None:
            ways.append(b"s" + _compressed(_leb128(numbers), None))
    return min(ways, key=len)


def as_it_is(blob: bytes) -> bytes:
    """The blob for `unpacked`, at no cost."""
    return b"r" + blob


def unpacked(data: bytes, base: bytes | None, *, limit: int = MAX_BLOB_BYTES) -> bytes:
    """The blob of `packed` bytes; ReleaseError where they are none, or make more than `limit` bytes.

    It need not be the blob that was asked for: the caller verifies its hash.
    """
    way = data[:1]
    if way in (b"p", b"s") and base is None:
        raise ReleaseError("packed blob", "way", "one without another blob", actual=way.decode())
    if way == b"r" and len(data) - 1 <= limit:
        return data[1:]
    if way == b"z":
        return _decompressed(data[1:], None, limit)
    if way == b"p":
        return _decompressed(data[1:], base, limit)
    if way == b"s":
        assert base is not None
        try:
            return _with_changes(base, _Numbers(_decompressed(data[1:], None, limit)))
        except (ValueError, OverflowError, IndexError) as error:  # ReleaseError is a ValueError too
            raise ReleaseError(
                "packed blob", "surfaces", f"changes of surfaces of the tile ({error})"
            ) from None
    raise ReleaseError("packed blob", "way", "r, z, p or s", actual=repr(way))


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
    """What has changed, as numbers; None: it is not a tile of surfaces, or more has changed than numbers say."""
    try:
        new, old = decode(SurfaceTile, blob).message, decode(SurfaceTile, base).message
    except DecodeError:
        return None
    if any(not np.array_equal(getattr(new, name), getattr(old, name)) for name in _SAME):
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
        what = _Change(0)
        if mine.any():
            what |= _Change.SHIFT if (mine == mine[0]).all() else _Change.NODES
        what |= _Change.SIGMA if new.sigma_m[row] != old.sigma_m[row] else _Change(0)
        what |= _Change.VEHICLES if new.vehicles[row] != old.vehicles[row] else _Change(0)
        what |= _Change.SEEN if new.last_seen_ns[row] != old.last_seen_ns[row] else _Change(0)
        if what:
            changed.append((row, what))
        if what & _Change.SHIFT:
            shifts.append(int(mine[0]))
        elif what & _Change.NODES:
            nodes += mine.tolist()
    rows = np.array([row for row, _ in changed], np.int64)

    def of(flag: _Change) -> Integers:
        return np.array([row for row, what in changed if what & flag], np.int64)

    ages = new.time_ns - new.last_seen_ns[of(_Change.SEEN)]
    divisor = max(math.gcd(*ages.tolist()), 1) if len(ages) else 1
    sigma = np.round(new.sigma_m[of(_Change.SIGMA)].astype(np.float64) * _STEPS_PER_M).astype(np.int64)
    return [
        len(changed),
        _zigzag(new.time_ns - old.time_ns),
        divisor,
        *np.diff(rows, prepend=-1).tolist(),
        *(int(what) for _, what in changed),
        *map(_zigzag, shifts),
        *map(_zigzag, nodes),
        *sigma.tolist(),
        *new.vehicles[of(_Change.VEHICLES)].tolist(),
        *(_zigzag(age // divisor) for age in ages.tolist()),
    ]


def _with_changes(base: bytes, numbers: _Numbers) -> bytes:
    """The blob of a tile with what the numbers say; ValueError where they say nothing of this tile."""
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

    def of(flag: _Change) -> Integers:
        chosen: Integers = rows[(what & int(flag)) != 0]
        return chosen

    grid_m, sigma_m = old.grid_m.copy(), old.sigma_m.copy()
    vehicles, last_seen_ns = old.vehicles.copy(), old.last_seen_ns.copy()
    sizes = old.rows.astype(np.int64) * old.columns
    shifted, bent = of(_Change.SHIFT), of(_Change.NODES)
    steps = np.repeat(_signed_column(numbers.take(len(shifted))), sizes[shifted])
    at = np.concatenate((_nodes(old, shifted), _nodes(old, bent)))
    steps = np.concatenate((steps, _signed_column(numbers.take(int(sizes[bent].sum())))))
    heights_m = np.round(old.base_height_m + grid_m[at].astype(np.float64), _HEIGHT_DECIMALS)
    heights_m = np.round(heights_m + steps / _STEPS_PER_M, _HEIGHT_DECIMALS)
    grid_m[at] = (heights_m - old.base_height_m).astype(np.float32)
    surer, counted, seen = of(_Change.SIGMA), of(_Change.VEHICLES), of(_Change.SEEN)
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
    """Numbers taken one after the other from the bytes of `_leb128`; ValueError where there are no more."""

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
