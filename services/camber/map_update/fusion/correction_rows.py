"""Corrections: the offset of each road surface from the reference, as estimated from the fleet's votes.

A reference (a survey, an import) never changes. A release consists of the reference and one row here for each corrected
surface, so that any earlier state of the map can be restored from a few bytes.

Of the fleet a release holds a count of vehicles and a day: `normalize` truncates times to days, so that no release
shows when a single vehicle passed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camber.geodesy.gps_time import NS_PER_DAY
from camber.road_map.road_columns import ReleaseError, rows_of_ids
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
"""One corrected surface: it is `offset_m` above the reference, with `sigma_m`; each surface once, sorted by id.

`since_map_version` is the release that first had this offset; `normalize` sets it.
"""

NONE: Corrections = np.zeros(0, CORRECTION)
"""No corrections: the release equals the reference."""

STEP_M = 1e-4
"""Resolution of offsets and σ: that of heights in tiles."""
LARGEST_M = 100.0
"""Chosen: a larger offset cannot be a change of the same road; also the bound of SurfaceCorrections.offset_m."""


def normalize(corrections: Corrections, before: Corrections, map_version: int) -> Corrections:
    """Return the corrections as release `map_version` stores them: sorted, rounded, with their `since_map_version`.

    σ is rounded up and is at least one step. An offset equal to that in `before`, the previous release's corrections,
    keeps its `since_map_version`. Raises ReleaseError for repeated surfaces and numbers out of range.
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
    at = rows_of_ids(before["surface_id"], rows["surface_id"])
    same = np.flatnonzero(at >= 0)
    same = same[np.abs(before["offset_m"][at[same]] - rows["offset_m"][same]) < 0.5 * STEP_M]
    rows["since_map_version"][same] = before["since_map_version"][at[same]]
    return rows


def to_bytes(corrections: Corrections, time_ns: int) -> bytes:
    """Encode normalized corrections; equal values give equal bytes."""
    columns = {name: np.ascontiguousarray(corrections[name]) for name in CORRECTION.names or ()}
    return encode(SurfaceCorrections(time_ns=time_ns, **columns))


def from_bytes(data: bytes, name: str = "corrections") -> Corrections:
    """Decode corrections; raises ReleaseError, which refers to them as `name`."""
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
