"""Consecutive scan matches that agree: carried along the driven track, each follows from the one before."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats
from camber.localizer.filter.planar_pose import covariance_at_offset, largest_variance, rotated
from camber.localizer.filter.track import OverlayLag, TrackPoint


class MatchedPose(NamedTuple):
    """A pose by a scan match [m, rad], its covariance (3, 3), the track's point at its time, and the overlay's lag."""

    time_ns: int
    east_m: float
    north_m: float
    yaw_rad: float
    covariance: Floats
    track: TrackPoint
    overlay_lag: OverlayLag = OverlayLag()

    def carried(self, track: TrackPoint) -> tuple[float, float, float, Floats]:
        """Return east, north, yaw and covariance (3, 3) carried to another point of the track."""
        turned = self.yaw_rad - self.track.yaw_rad
        east, north = rotated(turned, track.east_m - self.track.east_m, track.north_m - self.track.north_m)
        covariance = covariance_at_offset(self.covariance, east, north)
        return self.east_m + east, self.north_m + north, track.yaw_rad + turned, covariance

    def shifted(self, east_m: float, north_m: float) -> MatchedPose:
        """Return the match in a plane whose origin has moved by (east, north)."""
        return self._replace(east_m=self.east_m - east_m, north_m=self.north_m - north_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsistencyModel:
    """When two matches agree, and how precise a match must be to count. Chosen: drift is a generous bound of dead
    reckoning over `max_gap_s`; a σ above the limits leaves a direction open."""

    gate: float = 21.11  # chi-square, 3 degrees of freedom, 99.99 %
    drift_m: float = 0.05
    drift_per_m: float = 0.01
    drift_rad: float = math.radians(0.5)
    max_gap_s: float = 3.0
    max_sigma_m: float = 0.5
    max_sigma_rad: float = math.radians(3.0)


class ConsistentMatchSequence:
    """Collects unique matches that agree; one that does not agree begins a new sequence."""

    def __init__(self, model: ConsistencyModel) -> None:
        self._model = model
        self.forget()

    def forget(self) -> None:
        """Clear the sequence."""
        self._first: MatchedPose | None = None
        self._last: MatchedPose | None = None
        self.count = 0

    @property
    def path_m(self) -> float:
        """Distance driven from the first to the last match."""
        if self._first is None or self._last is None:
            return 0.0
        return self._last.track.path_m - self._first.track.path_m

    @property
    def duration_s(self) -> float:
        """Time from the first to the last match."""
        return 0.0 if self._first is None or self._last is None else _seconds(self._first, self._last)

    def shift(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        self._first, self._last = (
            None if m is None else m.shifted(east_m, north_m) for m in (self._first, self._last)
        )

    def add(self, match: MatchedPose, *, unique: bool) -> None:
        """Add a match, unless it is not unique or not precise in every direction."""
        model = self._model
        sigma_m = math.sqrt(largest_variance(match.covariance))
        sigma_rad = math.sqrt(float(match.covariance[2, 2]))
        if not unique or sigma_m > model.max_sigma_m or sigma_rad > model.max_sigma_rad:
            return
        first, last = self._first, self._last
        follows = first is not None and last is not None and self._follows(first, last, match)
        self._first = first if follows else match
        self.count = self.count + 1 if follows else 1
        self._last = match

    def _follows(self, first: MatchedPose, last: MatchedPose, match: MatchedPose) -> bool:
        if not 0.0 < _seconds(last, match) <= self._model.max_gap_s:
            return False
        return self._agree(last, match) and self._agree(first, match)

    def _agree(self, a: MatchedPose, b: MatchedPose) -> bool:
        model = self._model
        east, north, yaw, covariance = a.carried(b.track)
        off = np.array([b.east_m - east, b.north_m - north, wrap_pi(b.yaw_rad - yaw)])
        drift = (model.drift_m + model.drift_per_m * abs(b.track.path_m - a.track.path_m)) ** 2
        s = covariance + b.covariance + np.diag([drift, drift, model.drift_rad**2])
        return float(off @ np.linalg.solve(s, off)) <= model.gate


def _seconds(a: MatchedPose, b: MatchedPose) -> float:
    return (b.time_ns - a.time_ns) * 1e-9
