"""Deskewing: each point of a sweep is moved to where it is seen from at the sweep's end.

A point was measured where the sensor was at its time; the dead-reckoned track between then and the sweep's end
gives the motion: in the plane of the road, with the changes of roll and pitch that an inertial unit has measured.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camber.compiled.decorator import compiled_without_gil
from camber.geodesy.se3 import rotation_from_roll_pitch_yaw
from camber.localizer.arrays import Floats, Mask
from camber.localizer.filter.track import RelativeTrack, TrackPoint

_KNOTS: Final = 17  # derived: between them the motion is taken for straight, at 1 rad/s 2 mm off at 100 m
SECTORS: Final = 72  # chosen: of 5°, larger than the step of any LiDAR


class SweepTimes(NamedTuple):
    """The times of a sweep's points: offsets before the end beyond `longest_ns` are of no part of it."""

    offset_ns: NDArray[np.int32]
    longest_ns: int
    span_ns: int


class SweepOptions(NamedTuple):
    """Which points of a sweep are used, by range from the sensor, and the rectangle of the vehicle: points above
    or below it are taken for its parts."""

    voxel_m: float = 0.3
    min_range_m: float = 1.0
    max_range_m: float = 65.0
    vehicle_rear_m: float = 1.5
    vehicle_front_m: float = 4.5
    vehicle_half_width_m: float = 1.15
    longest_s: float = 0.2
    min_coverage: float = 0.6
    min_points: int = 200
    max_bad_share: float = 0.05
    ahead_s: float = 0.05
    too_old_s: float = 1.0


def sweep_motions(track: RelativeTrack, time_ns: int, span_ns: int) -> tuple[Floats, TrackPoint | None]:
    """Return end_from_vehicle (knots, 4, 4) at evenly spaced times of a sweep, and the track's point at its end.

    Where the track does not cover the sweep the motions are identities and the point is None.
    """
    motions = np.tile(np.eye(4), (_KNOTS, 1, 1))
    times = [time_ns - span_ns + span_ns * knot // (_KNOTS - 1) for knot in range(_KNOTS)]
    points = [point for time in times if (point := track.at(time)) is not None]
    if len(points) < _KNOTS:
        return motions, None
    end = points[-1]
    cos, sin = math.cos(end.yaw_rad), math.sin(end.yaw_rad)
    for motion, point in zip(motions, points, strict=True):
        east, north = point.east_m - end.east_m, point.north_m - end.north_m
        motion[:3, :3] = _turn(point, end)
        motion[0, 3], motion[1, 3] = cos * east + sin * north, cos * north - sin * east
    return motions, end


def _turn(point: TrackPoint, end: TrackPoint) -> Floats:
    """Return the rotation (3, 3) from the vehicle's axes at a point of the track to those at the end."""
    turn = point.yaw_rad - end.yaw_rad
    if point.roll_rad == end.roll_rad and point.pitch_rad == end.pitch_rad:
        return rotation_from_roll_pitch_yaw(0.0, 0.0, turn)
    to_end = rotation_from_roll_pitch_yaw(end.roll_rad, end.pitch_rad, 0.0).T
    return np.asarray(to_end @ rotation_from_roll_pitch_yaw(point.roll_rad, point.pitch_rad, turn))


@compiled_without_gil
def deskew(
    points_m: NDArray[np.float32], times: SweepTimes, vehicle_from_sensor: Floats, options: SweepOptions
) -> tuple[Floats, Mask]:
    """Return the points in the vehicle frame of the end, and which sectors have any point."""
    n, knots = len(points_m), len(vehicle_from_sensor)
    kept = np.empty((n, 3))
    seen = np.zeros(SECTORS, np.bool_)
    at = 0
    per_ns = (knots - 1) / times.span_ns if times.span_ns > 0 else 0.0
    m = vehicle_from_sensor
    for i in range(n):
        x, y, z = float(points_m[i, 0]), float(points_m[i, 1]), float(points_m[i, 2])
        squared = x * x + y * y + z * z
        if not np.isfinite(squared):
            continue
        offset = times.offset_ns[i]
        if offset > 0 or offset < -times.longest_ns or squared < options.min_range_m * options.min_range_m:
            continue
        # Cheaper than an arctangent: around the circle from 0 to 4, a quarter each.
        size = abs(x) + abs(y)
        if size > 0.0:
            around = y / size
            if x < 0.0:
                around = 2.0 - around
            elif y < 0.0:
                around += 4.0
            seen[min(int(around * (SECTORS / 4.0)), SECTORS - 1)] = True
        if squared > options.max_range_m * options.max_range_m:
            continue
        knot = (times.span_ns + offset) * per_ns
        k = min(int(knot), knots - 2)
        v = knot - k
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
        pz = (
            (u * a[2, 0] + v * b[2, 0]) * x
            + (u * a[2, 1] + v * b[2, 1]) * y
            + (u * a[2, 2] + v * b[2, 2]) * z
            + (u * a[2, 3] + v * b[2, 3])
        )
        if -options.vehicle_rear_m < px < options.vehicle_front_m and abs(py) < options.vehicle_half_width_m:
            continue
        kept[at, 0], kept[at, 1], kept[at, 2] = px, py, pz
        at += 1
    return kept[:at].copy(), seen
