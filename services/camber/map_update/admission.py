"""Admission of uploads: beyond the schema, an observation must be possible and its datum known.

A refusal is final: the vehicle moves the upload to its dead letters. Only what no later knowledge can correct is
refused; whether a possible height is *true* is decided by the fusion. Where the map is known, an observation must be of
a road on it (`check_roads`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, Field

from camber.geodesy.gps_time import NS_PER_DAY
from camber.map_update.contribution import QUALITIES, Contribution
from camber.road_map.height_interpolation import SurfaceHeights
from camber.road_map.tile_grid import Tile, tiles_of
from camber.schemas.base import EARLIEST_NS, Name, Text

_LARGEST_ID = 2**62  # as `Count` in camber.schemas.base
_FIXED = QUALITIES.index("fixed")
_FARTHEST_M = 1000.0
"""From the surface that an observation names; chosen: a single-point position is hardly ever off by 100 m."""
_FOOT_M = 0.3048  # source: international foot, NIST SP 811, B.6
_FEET_OFF_M = 5.0
"""Of a height in feet from its surface; chosen: above nearly all wrong fixes, a tenth of the limit below."""
_METRES_OFF_M = 50.0
"""A height this near to its surface may be metres; chosen: ten times the limit above."""


class AdmissionLimits(BaseModel):
    """Bounds of possible uploads."""

    datums: list[Name] = Field(
        default_factory=lambda: ["WGS84", "ITRF2014", "ITRF2020", "JGD2011"],
        min_length=1,
        description="datums of positions and ellipsoidal heights that the fusion can combine",
    )
    future_limit_s: float = Field(
        3600.0, ge=0.0, description="how far a positioning time may be ahead of this machine's clock"
    )
    lowest_road_m: float = Field(-600.0, description="lowest ellipsoidal height of a road")
    highest_road_m: float = Field(7000.0, description="highest ellipsoidal height of a road")
    least_sigma_m: float = Field(0.001, gt=0.0, description="smallest accepted σ of a road height")
    largest_sigma_m: float = Field(10.0, gt=0.0, description="largest accepted σ of a road height")
    highest_antenna_m: float = Field(20.0, gt=0.0, description="highest antenna above the road")
    most_records: int = Field(20_000, ge=1, description="most records in one batch")
    oldest_upload_days: float | None = Field(
        None,
        gt=0.0,
        le=36500.0,
        description="older observations are refused, and their ledger rows deleted in time; unset: any age is accepted "
        "and the ledger is kept for ever",
    )


class Refusal(NamedTuple):
    """Why an upload is refused: a code to count by, and a line with the field, its value and what was expected."""

    code: Name
    text: Text


def check(
    contributions: Sequence[Contribution], now_ns: int, limits: AdmissionLimits
) -> list[Refusal | None]:
    """Return for each contribution why it cannot be accepted at GPS time `now_ns`, or None."""
    rows = [contribution.observations for contribution in contributions]
    # Checked together first: in general nothing is refused.
    observations_valid = bool(rows) and _check_observations(np.concatenate(rows), now_ns, limits) is None
    return [
        _check_header(contribution, limits)
        or (None if observations_valid else _check_observations(contribution.observations, now_ns, limits))
        for contribution in contributions
    ]


def check_vehicle(key_vehicle: str, contribution: Contribution) -> Refusal | None:
    """Return a refusal if a contribution received under the key of `key_vehicle` names another vehicle."""
    if contribution.vehicle == key_vehicle:
        return None
    text = f"vehicle {contribution.vehicle} was uploaded under the key of {key_vehicle}, expected the same"
    return Refusal("vehicle", text)


@dataclass(frozen=True, kw_only=True)
class KnownRoads:
    """Roads of a reference: its surfaces, its tiles, and the versions of the map that have exactly these surfaces."""

    surfaces: SurfaceHeights
    tiles: frozenset[Tile]
    versions: Collection[int]


def check_roads(contribution: Contribution, roads: KnownRoads) -> Refusal | None:
    """Return a refusal for an observation that cannot be of the road that it names.

    Heights that differ from the reference's are no reason, however large the difference: the reference may be wrong, as
    with another vertical datum. Surfaces that are not known are one within the tiles of the reference only: another
    region may have the same version.
    """
    rows = contribution.observations
    row = roads.surfaces.rows_of(np.ascontiguousarray(rows["surface_id"]))
    latitude, longitude = (np.ascontiguousarray(rows[name]) for name in ("latitude_rad", "longitude_rad"))
    if contribution.map_version in roads.versions and (row < 0).any():
        tiles = zip(*(numbers.tolist() for numbers in tiles_of(latitude, longitude)), strict=True)
        here = np.array([tile in roads.tiles for tile in tiles])
        if ((row < 0) & here).any():
            at = int(np.argmax((row < 0) & here))
            expected = f"a surface of version {contribution.map_version} of the map"
            text = f"record {at}: surface_id {rows['surface_id'][at]}, expected {expected}"
            return Refusal("unknown_surface", text)
    height_m, outside_m = roads.surfaces.heights_m(row, latitude, longitude)
    far = (row >= 0) & ~(outside_m <= _FARTHEST_M)
    if far.any():
        at = int(np.argmax(far))
        place = f"latitude {latitude[at]:.7f} rad, longitude {longitude[at]:.7f} rad"
        expected = f"at most {_FARTHEST_M:g} m from surface {rows['surface_id'][at]}"
        return Refusal("far_from_surface", f"record {at}: {place}, expected {expected}")
    fixed = (row >= 0) & (rows["fix_quality"] == _FIXED)
    in_feet = np.abs(_FOOT_M * rows["road_height_m"] - height_m) <= _FEET_OFF_M
    in_feet &= np.abs(rows["road_height_m"] - height_m) > _METRES_OFF_M
    if fixed.any() and in_feet[fixed].all():
        at = int(np.argmax(fixed))
        expected = f"metres: in feet it is that of the surface, {height_m[at]:.1f} m"
        text = f"record {at}: road_height_m {rows['road_height_m'][at]}, expected {expected}"
        return Refusal("height_in_feet", text)
    return None


def _check_header(contribution: Contribution, limits: AdmissionLimits) -> Refusal | None:
    records = len(contribution.observations)
    if not 1 <= records <= limits.most_records:
        return Refusal("records", f"{records} records, expected 1 to {limits.most_records}")
    if contribution.datum not in limits.datums:
        known = ", ".join(sorted(limits.datums))
        return Refusal("datum", f"datum {contribution.datum}, expected one of {known}"[:512])
    return None


def _check_observations(rows: npt.NDArray[np.void], now_ns: int, limits: AdmissionLimits) -> Refusal | None:
    earliest_ns = EARLIEST_NS
    if limits.oldest_upload_days is not None:
        earliest_ns = max(earliest_ns, now_ns - round(limits.oldest_upload_days * NS_PER_DAY))
    bounds: tuple[tuple[str, float, float], ...] = (
        ("time_ns", earliest_ns, now_ns + round(limits.future_limit_s * 1e9)),
        ("fix_id", 0, _LARGEST_ID),
        ("surface_id", 0, _LARGEST_ID),
        ("latitude_rad", -pi / 2, pi / 2),
        ("longitude_rad", -pi, pi),
        ("horizontal_sigma_m", 0.0, limits.largest_sigma_m),
        ("road_height_m", limits.lowest_road_m, limits.highest_road_m),
        ("road_height_sigma_m", limits.least_sigma_m, limits.largest_sigma_m),
        ("antenna_height_m", 0.0, limits.highest_antenna_m),
    )
    for field, low, high in bounds:
        values = rows[field]
        wrong = (values < low) | (values > high)
        if wrong.any():
            at = int(np.argmax(wrong))
            return Refusal(field, f"record {at}: {field} {values[at]}, expected {low} to {high}")
    unset = (rows["latitude_rad"] == 0.0) & (rows["longitude_rad"] == 0.0)
    if unset.any():
        at = int(np.argmax(unset))
        return Refusal("position", f"record {at}: latitude and longitude 0, expected a position")
    return None
