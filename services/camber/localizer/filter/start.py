"""Start without an anchor: from a given pose, or from unconfirmed fixes that agree with the motion.

Independence is a law: no unconfirmed fix changes a pose that was anchored or given. Fixes enter here only, and
what they give is *provisional*; whether the road agrees with it is judged elsewhere.

Several fixes in a row are taken for right where one rigid motion lays the dead-reckoned track onto them
(Procrustes without scale: an unknown place and an unknown heading). At a standstill they must coincide, and
the heading stays unknown until the motion shows it. Wrong fixes that wander together pass this test: that is
why the start is provisional.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from camber.localizer.filter.dead_reckoning import RelativeTrack, TrackPoint
from camber.localizer.links.link_filter import Array, require, wrapped

StartProvenance: TypeAlias = Literal["given", "fixes"]


@dataclass(frozen=True, slots=True, eq=False)
class StartPose:
    """A pose to start from: of the vehicle's reference point, covariance (3, 3) in m and rad. A yaw of None
    is unknown, whatever its variance says. ValueError names what is not finite or not a covariance."""

    time_ns: int
    east_m: float
    north_m: float
    yaw_rad: float | None
    covariance: Array
    provenance: StartProvenance = "given"

    def __post_init__(self) -> None:
        for name in ("east_m", "north_m", "yaw_rad"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise ValueError(f"{name}: must be finite; got {value}")
        require_covariance("covariance", self.covariance, 3)


@dataclass(frozen=True, slots=True)
class FixStartModel:
    """When fixes in a row agree with one another and with the motion."""

    min_fixes: int = 5
    min_duration_s: float = 1.0
    max_gap_s: float = 2.0
    window_s: float = 30.0
    sigma_floor_m: float = 0.05
    tolerance_sigmas: float = 4.0
    tolerance_per_m: float = 0.01
    max_heading_sigma_rad: float = 0.15
    min_baseline_m: float = 1.0
    max_sigma_m: float = 1.0


class _Fix(NamedTuple):
    time_ns: int
    east_m: float
    north_m: float
    variance_m2: float
    track: TrackPoint


class StartFromFixes:
    """Collects unconfirmed fixes of the antenna until they show a pose. Antenna x forward, y left (m)."""

    def __init__(
        self, antenna_x_m: float = 0.0, antenna_y_m: float = 0.0, model: FixStartModel | None = None
    ) -> None:
        self._antenna = (antenna_x_m, antenna_y_m)
        self._model = model or FixStartModel()
        self._run: list[_Fix] = []

    def reset(self) -> None:
        """Forget all fixes."""
        self._run.clear()

    def shift(self, east_m: float, north_m: float) -> None:
        """The plane's origin has moved by (east, north)."""
        self._run = [f._replace(east_m=f.east_m - east_m, north_m=f.north_m - north_m) for f in self._run]

    def add(
        self, time_ns: int, east_m: float, north_m: float, covariance: Array, track: RelativeTrack
    ) -> StartPose | None:
        """Take a fix (antenna, covariance (2, 2)); the pose at its time once enough of them agree.

        One that does not follow the others begins a new run. None also where the track does not reach.
        """
        for name, value in (("east_m", east_m), ("north_m", north_m)):
            if not math.isfinite(value):
                raise ValueError(f"{name}: must be finite; got {value}")
        require_covariance("covariance", covariance, 2)
        model = self._model
        here = track.at(time_ns)
        variance = max(largest_variance(covariance), model.sigma_floor_m**2)
        if here is None or variance > model.max_sigma_m**2:
            return None
        if self._run and time_ns <= self._run[-1].time_ns:
            return None
        if self._run and time_ns - self._run[-1].time_ns > model.max_gap_s * 1e9:
            self._run.clear()
        self._run.append(_Fix(time_ns, east_m, north_m, variance, here))
        oldest_ns = time_ns - round(model.window_s * 1e9)
        self._run = [fix for fix in self._run if fix.time_ns >= oldest_ns]
        rotation_rad = self._agree()
        if rotation_rad is None:
            del self._run[:-1]
            return None
        long_enough = time_ns - self._run[0].time_ns >= model.min_duration_s * 1e9
        if len(self._run) < model.min_fixes or not long_enough:
            return None
        return self._pose(rotation_rad)

    def _agree(self) -> float | None:
        """Rotation from the track's frame to the plane that lays one on the other; None where none does."""
        model, run = self._model, self._run
        fixes = np.array([(fix.east_m, fix.north_m) for fix in run])
        track = np.array([antenna_on_track(fix.track, *self._antenna) for fix in run])
        fixes -= fixes.mean(axis=0)
        track -= track.mean(axis=0)
        cross = float((track[:, 0] * fixes[:, 1] - track[:, 1] * fixes[:, 0]).sum())
        angle = math.atan2(cross, float((track * fixes).sum()))
        sin, cos = math.sin(angle), math.cos(angle)
        residual = fixes - track @ np.array([[cos, sin], [-sin, cos]])
        distance = np.hypot(residual[:, 0], residual[:, 1])
        path = np.array([fix.track.path_m for fix in run])
        sigma = np.sqrt([fix.variance_m2 for fix in run])
        allowed = model.tolerance_sigmas * sigma + model.tolerance_per_m * (path.max() - path.min())
        return angle if bool((distance <= allowed).all()) else None

    def _pose(self, rotation_rad: float) -> StartPose:
        model, last = self._model, self._run[-1]
        end = antenna_on_track(last.track, *self._antenna)
        points = [antenna_on_track(fix.track, *self._antenna) for fix in self._run]
        far = max(points, key=lambda point: math.dist(point, end))
        baseline, variance = math.dist(far, end), last.variance_m2
        sigma_rad = math.sqrt(2.0 * variance) / baseline if baseline > 0.0 else math.inf
        if baseline < model.min_baseline_m or sigma_rad > model.max_heading_sigma_rad:
            lever_var = 0.5 * (self._antenna[0] ** 2 + self._antenna[1] ** 2)
            covariance = np.diag([variance + lever_var, variance + lever_var, math.pi**2])
            return StartPose(last.time_ns, last.east_m, last.north_m, None, covariance, "fixes")
        yaw = wrapped(last.track.yaw_rad + rotation_rad)
        east, north = lever_arm(yaw, *self._antenna)
        direction = math.atan2(end[1] - far[1], end[0] - far[0]) + rotation_rad
        covariance = track_covariance(variance, variance, baseline, direction)
        covariance = moved_by_lever(covariance, -east, -north)
        return StartPose(last.time_ns, last.east_m - east, last.north_m - north, yaw, covariance, "fixes")


class Place(NamedTuple):
    """A position (m), its variance per axis, and where the dead-reckoned track was then."""

    east_m: float
    north_m: float
    variance_m2: float
    track: TrackPoint


@dataclass(frozen=True, slots=True)
class HeadingModel:
    """When two places and the track between them show the heading."""

    min_baseline_m: float = 1.0
    max_sigma_rad: float = 0.15
    tolerance_sigmas: float = 4.0
    tolerance_per_m: float = 0.02


class HeadingSearch:
    """A known place with an unknown heading, until the track between two places shows it.

    Places are of the antenna or, from a given pose, of the vehicle: the lever arm is in the variance.
    """

    def __init__(self, place: Place, antenna_x_m: float, antenna_y_m: float, model: HeadingModel) -> None:
        self._antenna, self._model = (antenna_x_m, antenna_y_m), model
        self._first = self._last = place

    def add(self, place: Place) -> tuple[float, Array] | None:
        """Take a new place; once the heading shows, the rotation from the track's frame to the plane and
        the covariance (3, 3) of antenna and yaw."""
        model, first = self._model, self._first
        self._last = place
        begin = antenna_on_track(first.track, *self._antenna)
        end = antenna_on_track(place.track, *self._antenna)
        baseline = math.dist(begin, end)
        seen = math.hypot(place.east_m - first.east_m, place.north_m - first.north_m)
        spread = math.sqrt(place.variance_m2 + first.variance_m2)
        path = abs(place.track.path_m - first.track.path_m)
        agrees = abs(seen - baseline) <= model.tolerance_sigmas * spread + model.tolerance_per_m * path
        if agrees and baseline > max(model.min_baseline_m, spread / model.max_sigma_rad):
            direction = math.atan2(place.north_m - first.north_m, place.east_m - first.east_m)
            turned = direction - math.atan2(end[1] - begin[1], end[0] - begin[0])
            return turned, track_covariance(first.variance_m2, place.variance_m2, baseline, direction)
        if not agrees or first.variance_m2 > 9.0 * place.variance_m2:
            self._first = place
        return None

    def spread(self, here: TrackPoint) -> tuple[float, float, float]:
        """Place and variance per axis now: a displacement d of unknown direction leaves the mean where it
        was, with a variance of d^2 / 2 in each axis."""
        last = self._last
        moved_m2 = (here.east_m - last.track.east_m) ** 2 + (here.north_m - last.track.north_m) ** 2
        lever_m2 = self._antenna[0] ** 2 + self._antenna[1] ** 2
        drift_m = self._model.tolerance_per_m * (here.path_m - last.track.path_m)
        variance = last.variance_m2 + 0.5 * (moved_m2 + lever_m2) + drift_m * drift_m
        return last.east_m, last.north_m, variance

    def shift(self, east_m: float, north_m: float) -> None:
        """The plane's origin has moved by (east, north)."""
        first, last = self._first, self._last
        self._first = first._replace(east_m=first.east_m - east_m, north_m=first.north_m - north_m)
        self._last = last._replace(east_m=last.east_m - east_m, north_m=last.north_m - north_m)


def lever_arm(yaw_rad: float, x_m: float, y_m: float) -> tuple[float, float]:
    """East and north of a point x forward and y left of the vehicle's reference point."""
    sin, cos = math.sin(yaw_rad), math.cos(yaw_rad)
    return x_m * cos - y_m * sin, x_m * sin + y_m * cos


def antenna_on_track(point: TrackPoint, x_m: float, y_m: float) -> tuple[float, float]:
    """The antenna's place in the track's own frame."""
    east, north = lever_arm(point.yaw_rad, x_m, y_m)
    return point.east_m + east, point.north_m + north


def track_covariance(
    begin_variance_m2: float, end_variance_m2: float, baseline_m: float, direction_rad: float
) -> Array:
    """Covariance (3, 3) of the antenna's place and the yaw from two positions: the yaw is the difference of
    their errors across the track by its length, so the last position's error is also the yaw's."""
    across = (-math.sin(direction_rad), math.cos(direction_rad))
    covariance = np.diag(
        [end_variance_m2, end_variance_m2, (begin_variance_m2 + end_variance_m2) / baseline_m**2]
    )
    for axis in (0, 1):
        covariance[axis, 2] = covariance[2, axis] = end_variance_m2 / baseline_m * across[axis]
    return covariance


def moved_by_lever(covariance: Array, east_m: float, north_m: float) -> Array:
    """Covariance (3, 3) of a pose seen at another point of the rigid vehicle, (east, north) away."""
    f = np.array([[1.0, 0.0, -north_m], [0.0, 1.0, east_m], [0.0, 0.0, 1.0]])
    return np.asarray(f @ covariance @ f.T)


def largest_variance(covariance: Array) -> float:
    """The larger eigenvalue of a covariance (2, 2)."""
    a, b, c = float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[0, 1])
    return 0.5 * (a + b) + math.hypot(0.5 * (a - b), c)


def require_covariance(name: str, value: Array, size: int) -> None:
    """ValueError naming the argument unless it is finite, symmetric, and its eigenvalues are positive."""
    require(name, value, (size, size))
    if np.abs(value - value.T).max() > 1e-6 * np.abs(value).max():
        raise ValueError(f"{name}: must be symmetric")
    if size == 2:
        a, b, c = float(value[0, 0]), float(value[1, 1]), float(value[0, 1])
        positive = a > 0.0 and a * b > c * c
    else:
        positive = bool(np.linalg.eigvalsh(value)[0] > 0.0)
    if not positive:
        raise ValueError(f"{name}: must be positive definite")
