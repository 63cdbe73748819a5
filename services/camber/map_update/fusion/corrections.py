"""Corrections: by how much the road's surfaces differ from the reference, as the fleet has found.

A reference (a survey, an import) never changes. A release is the reference and one row here for each surface that the
fleet has corrected, so that any earlier state of the map is made again from a few bytes.

What is kept of the fleet in a release is a count of vehicles and a day: `settled` cuts times to days, because the time
at which one vehicle passed is nobody's business.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.gps_time import NS_PER_DAY
from camber.road_map.road_columns import ReleaseError
from camber.schemas.base import EARLIEST_NS
from camber.schemas.codec import DecodeError, decode, encode
from camber.schemas.road import SurfaceCorrections

Corrections = NDArray[np.void]

CORRECTION = np.dtype(
    [
        ("surface_id", "<i8"),
        ("offset_m", "<f8"),
        ("sigma_m", "<f8"),
        ("vehicles", "<i4"),
        ("last_seen_ns", "<i8"),
        ("since_map_version", "<i8"),
    ]
)
"""One corrected surface: it lies `offset_m` above the reference, with `sigma_m`; each surface once, ids ascend.

`since_map_version` is the release that first had this offset; `settled` fills it in.
"""

NONE: Corrections = np.zeros(0, CORRECTION)
"""No corrections: the release is the reference."""

STEP_M = 1e-4
"""Offsets and σ are whole multiples of it, as heights in tiles are."""
LARGEST_M = 100.0
"""A road that moved further is another road."""


def settled(corrections: Corrections, before: Corrections, map_version: int) -> Corrections:
    """The corrections as release `map_version` will have them: in order, in whole steps, with their `since`.

    σ is rounded up and never below one step: nobody may be told more than is known. `before` are those of the release
    before: an offset that stands there keeps its `since_map_version`. Raises ReleaseError for a surface that stands
    twice and for numbers that are none.
    """
    rows = np.sort(corrections.astype(CORRECTION), order="surface_id")
    if len(rows) and (np.diff(rows["surface_id"]) == 0).any():
        raise ReleaseError("corrections", "surface_id", "each surface once")
    for name in ("offset_m", "sigma_m"):
        if not np.isfinite(rows[name]).all():
            raise ReleaseError("corrections", name, "finite numbers")
    if (np.abs(rows["offset_m"]) > LARGEST_M).any():
        raise ReleaseError("corrections", "offset_m", f"at most {LARGEST_M:g} m")
    rows["offset_m"] = np.round(rows["offset_m"] / STEP_M) * STEP_M + 0.0
    rows["sigma_m"] = np.maximum(np.ceil(rows["sigma_m"] / STEP_M - 1e-6), 1.0) * STEP_M
    days = np.maximum(rows["last_seen_ns"], EARLIEST_NS) // NS_PER_DAY
    rows["last_seen_ns"] = np.maximum(days * NS_PER_DAY, EARLIEST_NS)
    rows["since_map_version"] = map_version
    at = rows_of(before, rows["surface_id"])
    stays = np.flatnonzero(at >= 0)
    stays = stays[np.abs(before["offset_m"][at[stays]] - rows["offset_m"][stays]) < 0.5 * STEP_M]
    rows["since_map_version"][stays] = before["since_map_version"][at[stays]]
    return rows


def rows_of(corrections: Corrections, surface_id: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows (n,) of surfaces by their ids (n,) in corrections whose ids ascend; −1 where one has none."""
    at = np.searchsorted(corrections["surface_id"], surface_id)
    there = at < len(corrections)
    there[there] = corrections["surface_id"][at[there]] == surface_id[there]
    return np.where(there, at, -1)


def to_bytes(corrections: Corrections, time_ns: int) -> bytes:
    """The bytes of settled corrections: equal ones for equal values."""
    columns = {name: np.ascontiguousarray(corrections[name]) for name in CORRECTION.names or ()}
    return encode(SurfaceCorrections(time_ns=time_ns, **columns))


def from_bytes(data: bytes, name: str = "corrections") -> Corrections:
    """The corrections in the bytes that `to_bytes` made; else ReleaseError, which calls them `name`."""
    try:
        message = decode(SurfaceCorrections, data).message
    except DecodeError as error:
        raise ReleaseError(name, "bytes", f"corrections of surfaces ({error})") from None
    rows = np.zeros(len(message.surface_id), CORRECTION)
    for column in CORRECTION.names or ():
        rows[column] = getattr(message, column)
    if (np.diff(rows["surface_id"]) <= 0).any():
        raise ReleaseError(name, "surface_id", "ids that ascend")
    return rows
