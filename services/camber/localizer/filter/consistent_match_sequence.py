"""Consecutive scan matches that agree: carried along the driven track, each follows from the one before."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats
from camber.localizer.filter.planar_pose import covariance_at_offset, largest_variance, rotated
from camber.localizer.filter.track import OverlayLag, TrackPoint

# Chosen: drift is a generous bound of dead reckoning over the gap; a σ above the limits leaves a direction open.
_DRIFT_M: Final = 0.05
_DRIFT_PER_M: Final = 0.01
_MAX_GAP_S: Final = 3.0
_MAX_SIGMA_M: Final = 0.5
_DRIFT_RAD: Final = math.radians(0.5)
_MAX_SIGMA_RAD: Final = math.radians(3.0)


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


class ConsistentMatchSequence:
    """Collects unique matches that agree, by a chi-square `gate` of 3 degrees of freedom; one that does not agree
    begins a new sequence."""

    def __init__(self, gate: float) -> None:
        self._gate = gate
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
        sigma_m = math.sqrt(largest_variance(match.covariance))
        sigma_rad = math.sqrt(float(match.covariance[2, 2]))
        if not unique or sigma_m > _MAX_SIGMA_M or sigma_rad > _MAX_SIGMA_RAD:
            return
        first, last = self._first, self._last
        follows = first is not None and last is not None and self._follows(first, last, match)
        self._first = first if follows else match
        self.count = self.count + 1 if follows else 1
        self._last = match

    def _follows(self, first: MatchedPose, last: MatchedPose, match: MatchedPose) -> bool:
        if not 0.0 < _seconds(last, match) <= _MAX_GAP_S:
            return False
        return self._agree(last, match) and self._agree(first, match)

    def _agree(self, a: MatchedPose, b: MatchedPose) -> bool:
        east, north, yaw, covariance = a.carried(b.track)
        off = np.array([b.east_m - east, b.north_m - north, wrap_pi(b.yaw_rad - yaw)])
        drift = (_DRIFT_M + _DRIFT_PER_M * abs(b.track.path_m - a.track.path_m)) ** 2
        s = covariance + b.covariance + np.diag([drift, drift, _DRIFT_RAD**2])
        return float(off @ np.linalg.solve(s, off)) <= self._gate


def _seconds(a: MatchedPose, b: MatchedPose) -> float:
    return (b.time_ns - a.time_ns) * 1e-9
