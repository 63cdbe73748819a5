"""Start of a pose: from a given pose, or from unconfirmed fixes that agree with the motion.

Independence: no unconfirmed fix changes a pose that was anchored or given. Fixes are used here only, and the pose that
they start is *provisional*; whether the road agrees with it is judged elsewhere.

Consecutive fixes are taken for right where one rigid motion maps the dead-reckoned track onto them (Procrustes without
scale: unknown position, unknown heading). At a standstill they must coincide, and the heading stays unknown until the
vehicle moves. Wrong fixes that drift together pass this test: that is why the start is provisional.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from camber.geodesy.angles import wrap_pi
from camber.localizer.arrays import Floats, require_covariance, require_finite
from camber.localizer.filter.heading_search import TrackedPosition, antenna_on_track, baseline_covariance
from camber.localizer.filter.planar_pose import covariance_at_offset, largest_variance, rotated
from camber.localizer.filter.track import RelativeTrack

StartProvenance: TypeAlias = Literal["given", "fixes"]

# Chosen, see decision 0002: when consecutive fixes agree with one another and with the motion.
_MIN_FIXES: Final = 5
_MIN_DURATION_S: Final = 1.0
_MAX_GAP_S: Final = 2.0
_WINDOW_S: Final = 30.0
_SIGMA_FLOOR_M: Final = 0.05
_TOLERANCE_SIGMAS: Final = 4.0
_TOLERANCE_PER_M: Final = 0.01
_MAX_HEADING_SIGMA_RAD: Final = 0.15
_MIN_BASELINE_M: Final = 1.0
_MAX_SIGMA_M: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StartPose:
    """A pose of the vehicle's reference point to start from, covariance (3, 3) in m and rad; yaw None: unknown.

    ValueError names what is not finite or not a covariance.
    """

    time_ns: int
    east_m: float
    north_m: float
    yaw_rad: float | None
    covariance: Floats
    provenance: StartProvenance = "given"

    def __post_init__(self) -> None:
        require_finite(east_m=self.east_m, north_m=self.north_m, yaw_rad=self.yaw_rad)
        require_covariance("covariance", self.covariance, 3)


class _TimedPosition(NamedTuple):
    time_ns: int
    position: TrackedPosition


class StartFromFixes:
    """Collects unconfirmed fixes of the antenna (x forward, y left [m]) until they determine a pose."""

    def __init__(self, antenna_x_m: float = 0.0, antenna_y_m: float = 0.0) -> None:
        self._antenna_m = (antenna_x_m, antenna_y_m)
        self._fixes: list[_TimedPosition] = []

    def reset(self) -> None:
        """Clear all fixes."""
        self._fixes.clear()

    def shift(self, east_m: float, north_m: float) -> None:
        """Apply a move of the plane's origin by (east, north)."""
        self._fixes = [fix._replace(position=fix.position.shifted(east_m, north_m)) for fix in self._fixes]

    def add(
        self, time_ns: int, position_m: tuple[float, float], covariance: Floats, track: RelativeTrack
    ) -> StartPose | None:
        """Add a fix (antenna east, north; covariance (2, 2)); return the pose at its time once enough fixes agree.

        A fix that does not agree with the others begins a new sequence. None also where the track has no point.
        """
        east_m, north_m = position_m
        require_finite(east_m=east_m, north_m=north_m)
        require_covariance("covariance", covariance, 2)
        here = track.at(time_ns)
        variance = max(largest_variance(covariance), _SIGMA_FLOOR_M**2)
        if here is None or variance > _MAX_SIGMA_M**2:
            return None
        if self._fixes and time_ns <= self._fixes[-1].time_ns:
            return None
        if self._fixes and (
            time_ns - self._fixes[-1].time_ns > _MAX_GAP_S * 1e9 or track.at(self._fixes[0].time_ns) is None
        ):
            self._fixes.clear()
        self._fixes.append(_TimedPosition(time_ns, TrackedPosition(east_m, north_m, variance, here)))
        oldest_ns = time_ns - round(_WINDOW_S * 1e9)
        self._fixes = [fix for fix in self._fixes if fix.time_ns >= oldest_ns]
        rotation_rad = self._rotation_of_track()
        if rotation_rad is None:
            del self._fixes[:-1]
            return None
        long_enough = time_ns - self._fixes[0].time_ns >= _MIN_DURATION_S * 1e9
        if len(self._fixes) < _MIN_FIXES or not long_enough:
            return None
        return self._pose(rotation_rad)

    def _rotation_of_track(self) -> float | None:
        """Return the rotation that maps the track onto the fixes; None where they do not agree."""
        positions = [fix.position for fix in self._fixes]
        fixes = np.array([(position.east_m, position.north_m) for position in positions])
        track = np.array([antenna_on_track(position.track, self._antenna_m) for position in positions])
        fixes -= fixes.mean(axis=0)
        track -= track.mean(axis=0)
        cross = float((track[:, 0] * fixes[:, 1] - track[:, 1] * fixes[:, 0]).sum())
        angle = math.atan2(cross, float((track * fixes).sum()))
        sin, cos = math.sin(angle), math.cos(angle)
        residual = fixes - track @ np.array([[cos, sin], [-sin, cos]])
        distance = np.hypot(residual[:, 0], residual[:, 1])
        path = np.array([position.track.path_m for position in positions])
        sigma = np.sqrt([position.variance_m2 for position in positions])
        allowed = _TOLERANCE_SIGMAS * sigma + _TOLERANCE_PER_M * (path.max() - path.min())
        return angle if bool((distance <= allowed).all()) else None

    def _pose(self, rotation_rad: float) -> StartPose:
        time_ns, last = self._fixes[-1]
        end = antenna_on_track(last.track, self._antenna_m)
        points = [antenna_on_track(fix.position.track, self._antenna_m) for fix in self._fixes]
        far = max(points, key=lambda point: math.dist(point, end))
        baseline, variance = math.dist(far, end), last.variance_m2
        sigma_rad = math.sqrt(2.0 * variance) / baseline if baseline > 0.0 else math.inf
        yaw_rad, east, north = None, 0.0, 0.0
        if baseline < _MIN_BASELINE_M or sigma_rad > _MAX_HEADING_SIGMA_RAD:
            lever_var = 0.5 * (self._antenna_m[0] ** 2 + self._antenna_m[1] ** 2)
            covariance = np.diag([variance + lever_var, variance + lever_var, math.pi**2])
        else:
            yaw_rad = wrap_pi(last.track.yaw_rad + rotation_rad)
            east, north = rotated(yaw_rad, *self._antenna_m)
            direction = math.atan2(end[1] - far[1], end[0] - far[0]) + rotation_rad
            covariance = baseline_covariance((variance, variance), baseline, direction)
            covariance = covariance_at_offset(covariance, -east, -north)
        return StartPose(
            time_ns=time_ns,
            east_m=last.east_m - east,
            north_m=last.north_m - north,
            yaw_rad=yaw_rad,
            covariance=covariance,
            provenance="fixes",
        )
