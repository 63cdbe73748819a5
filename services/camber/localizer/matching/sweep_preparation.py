"""A sweep as it came, made ready for matching: de-skewed, in the vehicle frame of its end, thinned.

Every point was measured where the sensor was at its own time; the dead-reckoned track between then and the sweep's end
brings it to where it is seen from at the end. What is wrong with a sweep is stated in `problem`, never an exception.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.geodesy.se3 import map_from_vehicle
from camber.localizer.filter.dead_reckoning import RelativeTrack, TrackPoint
from camber.localizer.map_clouds.voxel_grid import Floats, voxel_means

SweepProblem: TypeAlias = Literal[
    "empty",
    "too_few_points",
    "repeated",
    "from_the_future",
    "too_old",
    "no_motion",
    "bad_offsets",
    "half_sweep",
    "no_offsets",
]
"""The first that applies. *repeated*: not newer than the last one; *no_motion*: the track does not cover it, its points
are as measured; *bad_offsets*: some points' times are no part of this sweep, they are left out; *no_offsets*: all
points claim the same time, so that nothing could be de-skewed."""

_USABLE: Final = (None, "bad_offsets", "half_sweep", "no_offsets")
_KNOTS: Final = 17  # between them the motion is taken for straight: at 1 rad/s this misses 2 mm at 100 m
_SECTORS: Final = 72


@dataclass(frozen=True, slots=True)
class SensorMount:
    """Where a sensor sits in the vehicle frame: lever arm and attitude (`Rz(yaw) Ry(pitch) Rx(roll)`)."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    @property
    def vehicle_from_sensor(self) -> Floats:
        """The mounting as a 4 × 4 matrix."""
        return map_from_vehicle(self.x_m, self.y_m, self.z_m, self.roll_rad, self.pitch_rad, self.yaw_rad)


@dataclass(frozen=True, slots=True)
class SweepOptions:
    """What of a sweep is used. Points above or below the own vehicle's rectangle are taken for its own parts."""

    voxel_m: float = 0.3
    least_range_m: float = 1.0
    most_range_m: float = 65.0
    own_rear_m: float = 1.5
    own_front_m: float = 4.5
    own_half_width_m: float = 1.15
    longest_s: float = 0.2
    least_coverage: float = 0.6
    least_points: int = 200
    ahead_s: float = 0.05
    too_old_s: float = 1.0


DEFAULT_OPTIONS: Final = SweepOptions()


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSweep:
    """Points (m, 3) in the vehicle frame at `time_ns`, the sweep's end; none where the sweep is not usable.

    `coverage` is the share of all directions (azimuth, in the sensor) in which anything was seen, `dropped` how many
    points were not finite or not of this sweep's time, `at` the track's point at the end, and `skew_m` the way that
    was driven during a sweep that could not be de-skewed (0 where it could; None where that way is not known).
    """

    time_ns: int
    points_m: Floats
    problem: SweepProblem | None
    coverage: float
    dropped: int
    at: TrackPoint | None
    skew_m: float | None

    @property
    def usable(self) -> bool:
        """Can it be overlaid and matched?"""
        return self.problem in _USABLE


def prepare_sweep(
    points_m: NDArray[np.float32],
    offset_ns: NDArray[np.int32],
    time_ns: int,
    mount: SensorMount,
    track: RelativeTrack,
    *,
    now_ns: int | None = None,
    last_time_ns: int | None = None,
    options: SweepOptions = DEFAULT_OPTIONS,
) -> PreparedSweep:
    """Make a sweep ready: points (n, 3) in the sensor's frame, offsets (n,) ≤ 0 against its end at `time_ns`.

    `now_ns` tells sweeps of the future and old ones, `last_time_ns` (of the sweep before) repeated ones; each is
    passed over where it is None. Raises ValueError for arrays of other shapes.
    """
    if points_m.ndim != 2 or points_m.shape[1] != 3 or offset_ns.shape != points_m.shape[:1]:
        raise ValueError(
            f"points_m, offset_ns have shapes {points_m.shape}, {offset_ns.shape}, expected (n, 3), (n,)"
        )
    wrong_time = _wrong_time(time_ns, now_ns, last_time_ns, options)
    if wrong_time is not None:
        return _useless(time_ns, wrong_time)
    if not len(points_m):
        return _useless(time_ns, "empty")
    longest_ns = round(options.longest_s * 1e9)
    of_sweep = (offset_ns <= 0) & (offset_ns >= -longest_ns)
    span_ns = -int(offset_ns[of_sweep].min(initial=0))
    motions, at = _motions(track, time_ns, span_ns)
    limits = np.array(
        [
            options.least_range_m,
            options.most_range_m,
            -options.own_rear_m,
            options.own_front_m,
            options.own_half_width_m,
        ]
    )
    kept, seen, not_finite = _in_vehicle(
        np.ascontiguousarray(points_m, np.float32),
        np.ascontiguousarray(offset_ns, np.int32),
        longest_ns,
        span_ns,
        motions @ mount.vehicle_from_sensor,
        limits,
    )
    strange = len(points_m) - int(of_sweep.sum())
    coverage = float(_SECTOR_SHARE[seen].sum())
    flat_time = strange == 0 and len(points_m) > 1 and int(offset_ns.min()) == int(offset_ns.max())
    problem: SweepProblem | None = None
    if not len(kept):
        problem = "empty"
    elif len(kept) < options.least_points:
        problem = "too_few_points"
    elif at is None:
        problem = "no_motion"
    elif strange > 0.05 * len(points_m):
        problem = "bad_offsets"
    elif coverage < options.least_coverage:
        problem = "half_sweep"
    elif flat_time:
        problem = "no_offsets"
    return PreparedSweep(
        time_ns=time_ns,
        points_m=voxel_means(kept, options.voxel_m),
        problem=problem,
        coverage=coverage,
        dropped=strange + not_finite,
        at=at,
        skew_m=_skew_m(track, time_ns, at, flat_time),
    )


def _wrong_time(
    time_ns: int, now_ns: int | None, last_time_ns: int | None, options: SweepOptions
) -> SweepProblem | None:
    if last_time_ns is not None and time_ns <= last_time_ns:
        return "repeated"
    if now_ns is not None and time_ns - now_ns > options.ahead_s * 1e9:
        return "from_the_future"
    if now_ns is not None and now_ns - time_ns > options.too_old_s * 1e9:
        return "too_old"
    return None


def _useless(time_ns: int, problem: SweepProblem) -> PreparedSweep:
    return PreparedSweep(time_ns, np.zeros((0, 3)), problem, 0.0, 0, None, None)


def _skew_m(track: RelativeTrack, time_ns: int, at: TrackPoint | None, flat_time: bool) -> float | None:
    """A turn of a sensor without times of its points is taken to last a tenth of a second."""
    if at is None:
        return None
    if not flat_time:
        return 0.0
    before = track.at(time_ns - 100_000_000)
    return None if before is None else at.path_m - before.path_m


def _motions(track: RelativeTrack, time_ns: int, span_ns: int) -> tuple[Floats, TrackPoint | None]:
    """From the vehicle at evenly spaced times of the sweep to the vehicle at its end: (knots, 4, 4), and the end."""
    motions = np.tile(np.eye(4), (_KNOTS, 1, 1))
    times = [time_ns - span_ns + span_ns * knot // (_KNOTS - 1) for knot in range(_KNOTS)]
    points = [point for time in times if (point := track.at(time)) is not None]
    if len(points) < _KNOTS:
        return motions, None
    end = points[-1]
    cos, sin = math.cos(end.yaw_rad), math.sin(end.yaw_rad)
    for motion, point in zip(motions, points, strict=True):
        east, north = point.east_m - end.east_m, point.north_m - end.north_m
        turn = point.yaw_rad - end.yaw_rad
        motion[0, 0], motion[0, 1] = math.cos(turn), -math.sin(turn)
        motion[1, 0], motion[1, 1] = math.sin(turn), math.cos(turn)
        motion[0, 3], motion[1, 3] = cos * east + sin * north, cos * north - sin * east
    return motions, end


def _sector_share() -> Floats:
    """Share of the full turn of each sector; sectors are even in y / (|x| + |y|), not in the angle."""
    edge = np.linspace(0.0, 4.0, _SECTORS + 1)
    quarter, rest = np.divmod(edge[:-1], 1.0)
    begin = quarter * 0.5 * math.pi + np.arctan2(rest, 1.0 - rest)
    return np.diff(np.append(begin, 2.0 * math.pi)) / (2.0 * math.pi)


_SECTOR_SHARE: Final = _sector_share()


@compiled_without_gil
def _in_vehicle(
    points_m: NDArray[np.float32],
    offset_ns: NDArray[np.int32],
    longest_ns: int,
    span_ns: int,
    vehicle_from_sensor: Floats,
    limits: Floats,
) -> tuple[Floats, NDArray[np.bool_], int]:
    """The points to keep in the vehicle frame of the end, which sectors saw anything, how many were not finite."""
    n, knots = len(points_m), len(vehicle_from_sensor)
    least_range, most_range, rear, front, half_width = limits
    kept = np.empty((n, 3))
    seen = np.zeros(_SECTORS, np.bool_)
    at = 0
    not_finite = 0
    per_ns = (knots - 1) / span_ns if span_ns > 0 else 0.0
    m = vehicle_from_sensor
    for i in range(n):
        x, y, z = float(points_m[i, 0]), float(points_m[i, 1]), float(points_m[i, 2])
        squared = x * x + y * y + z * z
        if not np.isfinite(squared):
            not_finite += 1
            continue
        offset = offset_ns[i]
        if offset > 0 or offset < -longest_ns or squared < least_range * least_range:
            continue
        # Cheaper than an arctangent: around the circle from 0 to 4, a quarter each.
        size = abs(x) + abs(y)
        if size > 0.0:
            around = y / size
            if x < 0.0:
                around = 2.0 - around
            elif y < 0.0:
                around += 4.0
            seen[min(int(around * (_SECTORS / 4.0)), _SECTORS - 1)] = True
        if squared > most_range * most_range:
            continue
        place = (span_ns + offset) * per_ns
        k = min(int(place), knots - 2)
        v = place - k
        u = 1.0 - v
        a, b = m[k], m[k + 1]
        px = (
            (u * a[0, 0] + v * b[0, 0]) * x
            + (u * a[0, 1] + v * b[0, 1]) * y
            + (u * a[0, 2] + v * b[0, 2]) * z
            + (u * a[0, 3] + v * b[0, 3])
        )
        py = (
            (u * a[1, 0] + v * b[1, 0]) * x
            + (u * a[1, 1] + v * b[1, 1]) * y
            + (u * a[1, 2] + v * b[1, 2]) * z
            + (u * a[1, 3] + v * b[1, 3])
        )
        # The motion is in the plane: it does not touch the heights.
        pz = a[2, 0] * x + a[2, 1] * y + a[2, 2] * z + a[2, 3]
        if rear < px < front and abs(py) < half_width:
            continue
        kept[at, 0], kept[at, 1], kept[at, 2] = px, py, pz
        at += 1
    return kept[:at].copy(), seen, not_finite
