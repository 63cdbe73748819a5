"""What a judged fix is off from road, antenna and pose, and such differences gathered by stretches of road.

The map's error is alike over some twenty metres: twenty fixes on them are no more than one observation of it. So the
fixes of a stretch make one cell, by their medians, which a few wrong fixes do not move.
"""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.learning.fix_track_offset import JudgedTrackOffset
from camber.schemas.integrity import CONFIRMED_VERDICTS, VerdictValue

_FAR_M = 1e5  # chosen: no position that is compared lies so far away
MOST_FIXES = 256
"""In one cell; chosen: a vehicle that stands observes nothing new of the road."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceKey:
    """What an offset belongs to: how the antenna's height is known, whose fixes these are, which map."""

    antenna: str = ""
    base: str = ""
    map_version: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class FixResidual:
    """One judged fix less its model, without any learnt correction; None: not known.

    `up_m` is `h_r − (h_m + h_a)` of JP7707657B2 eq. (4), `fix_sigma_m` that of fix and antenna together,
    `map_sigma_m` the road's.
    `east_m`, `north_m` are fix less pose, `horizontal_sigma_m` is theirs in the worst direction; `anchored_ns` is the
    time of the newest confirmed fix that the pose leans on, None where it leans on none. `independent` is fix less
    independent position, east and north, its covariance (ee, en, nn), and σ of the fix; `evidence_ns` is the time of
    its last evidence; `track_offset` is that of the fixes' own track by heights. Since `run_begin_ns` no fix has
    stepped as to other integers, None: not known. `heading_rad` is the pose's. `link_id` is the road's, from
    crossing to crossing; a surface is a piece of it.
    """

    time_ns: int
    verdict: VerdictValue
    latitude_rad: float
    longitude_rad: float
    up_m: float | None = None
    fix_sigma_m: float = 0.0
    map_sigma_m: float = 0.0
    east_m: float | None = None
    north_m: float | None = None
    horizontal_sigma_m: float | None = None
    surface_id: int | None = None
    speed_m_s: float | None = None
    key: ReferenceKey = ReferenceKey()
    link_id: int | None = None
    anchored_ns: int | None = None
    independent: tuple[float, float, float, float, float, float] | None = None
    evidence_ns: int | None = None
    track_offset: JudgedTrackOffset | None = None
    run_begin_ns: int | None = None
    heading_rad: float | None = None

    @property
    def confirmed(self) -> bool:
        """May a consumer use the position?"""
        return self.verdict in CONFIRMED_VERDICTS

    @property
    def known_up_m(self) -> float | None:
        """`up_m` where it and its σ are numbers that can be used."""
        up_m, sigma_m = self.up_m, math.hypot(self.fix_sigma_m, self.map_sigma_m)
        return up_m if up_m is not None and math.isfinite(up_m) and 0.0 < sigma_m < math.inf else None

    @property
    def known_horizontal_m(self) -> tuple[float, float, float] | None:
        """East, north and their σ where all three are numbers that can be used."""
        if self.east_m is None or self.north_m is None or self.horizontal_sigma_m is None:
            return None
        usable = math.isfinite(self.east_m + self.north_m) and 0.0 < self.horizontal_sigma_m < math.inf
        return (self.east_m, self.north_m, self.horizontal_sigma_m) if usable else None

    @property
    def known_independent(self) -> tuple[float, float, float, float, float, float] | None:
        """`independent` where its numbers can be used: a place near it, a covariance, and a σ."""
        if self.independent is None:
            return None
        east_m, north_m, ee, en, nn, fix_sigma_m = self.independent
        near = abs(east_m) < _FAR_M and abs(north_m) < _FAR_M and 0.0 <= fix_sigma_m < _FAR_M
        usable = near and 0.0 < ee < _FAR_M**2 and 0.0 < nn < _FAR_M**2 and ee * nn > en * en
        return self.independent if usable else None


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualCell:
    """The fixes of one stretch on one surface: medians, and how many of the fixes were verified against the height.

    Where it lies is where it began. `horizontal_m` is east, north and their σ, `anchored_ns` the newest fix that one of
    their poses leans on.
    """

    key: ReferenceKey
    surface_id: int | None
    begin_ns: int
    end_ns: int
    latitude_rad: float
    longitude_rad: float
    up_m: float | None
    fix_sigma_m: float
    map_sigma_m: float
    horizontal_m: tuple[float, float, float] | None
    fixes: int
    verified: int
    link_id: int | None = None
    anchored_ns: int | None = None


class CellCollector:
    """Makes cells of residuals in the order of time."""

    def __init__(self, length_m: float) -> None:
        self._length_m = length_m
        self._residuals: list[FixResidual] = []

    def add(self, residual: FixResidual) -> ResidualCell | None:
        """Take one; returns the cell that it ends, if it ends one. One that is no place is left out."""
        if not math.isfinite(residual.latitude_rad + residual.longitude_rad):
            return None
        ended = None
        if self._residuals and not self._goes_on(self._residuals[0], residual):
            ended = cell_of(self._residuals)
            self._residuals = []
        if len(self._residuals) < MOST_FIXES:
            self._residuals.append(residual)
        return ended

    def _goes_on(self, first: FixResidual, residual: FixResidual) -> bool:
        if (first.surface_id, first.key) != (residual.surface_id, residual.key):
            return False
        return distance_m(first, residual) < self._length_m


def cell_of(residuals: list[FixResidual]) -> ResidualCell:
    """The cell of residuals of one surface and key, at least one."""
    first = residuals[0]
    ups = [(up_m, r) for r in residuals if (up_m := r.known_up_m) is not None]
    sides = [side for r in residuals if (side := r.known_horizontal_m) is not None]
    horizontal_m = None
    if sides:
        east_m, north_m, sigma_m = (statistics.median(column) for column in zip(*sides, strict=True))
        horizontal_m = (east_m, north_m, sigma_m)
    return ResidualCell(
        key=first.key,
        surface_id=first.surface_id,
        begin_ns=first.time_ns,
        end_ns=residuals[-1].time_ns,
        latitude_rad=first.latitude_rad,
        longitude_rad=first.longitude_rad,
        up_m=statistics.median(up_m for up_m, _ in ups) if ups else None,
        fix_sigma_m=statistics.median(r.fix_sigma_m for _, r in ups) if ups else 0.0,
        map_sigma_m=statistics.median(r.map_sigma_m for _, r in ups) if ups else 0.0,
        horizontal_m=horizontal_m,
        fixes=len(residuals),
        verified=sum(r.verdict == "confirmed_after_verification" for r in residuals),
        link_id=first.link_id,
        anchored_ns=max((r.anchored_ns for r in residuals if r.anchored_ns is not None), default=None),
    )


def distance_m(a: FixResidual | ResidualCell, b: FixResidual | ResidualCell) -> float:
    """Between two places, along the ellipsoid's tangent plane."""
    return math.hypot(*east_north_between(a.latitude_rad, a.longitude_rad, b.latitude_rad, b.longitude_rad))
