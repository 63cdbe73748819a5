"""Poses and scan matches as columns, and the errors of poses against the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from camber.formats.drive.truth_csv import TruthTable
from camber.formats.observations import Floats, Integers
from camber.geodesy.angles import wrap_pi_array
from camber.geodesy.covariance import confidence_scale
from camber.replay.truth_interpolation import interpolate_truth
from camber.schemas.pose import Pose, ScanMatch
from camber.validation.reference_trajectory import truth_of

M = TypeVar("M", Pose, ScanMatch)
Names = NDArray[np.str_]
INSIDE_PROBABILITY = 0.99
"""Of the error ellipse; Kikuchi (TUMSAT), reliability index: 99 %."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseColumns:
    """n poses; numbers are NaN where there is none. `covariance` (n, 3, 3) of east, north [m] and yaw [rad]."""

    time_ns: Integers
    mode: Names
    provenance: Names
    latitude_rad: Floats
    longitude_rad: Floats
    yaw_rad: Floats
    covariance: Floats
    elevation_m: Floats
    level: Floats

    @classmethod
    def from_poses(cls, poses: Sequence[Pose]) -> PoseColumns:
        """In the order received."""
        upper = np.array([pose.covariance_east_north_yaw or [np.nan] * 6 for pose in poses]).reshape(-1, 6)
        return cls(
            time_ns=np.array([pose.time_ns for pose in poses], np.int64),
            mode=np.array([pose.mode for pose in poses], np.str_),
            provenance=np.array([pose.provenance for pose in poses], np.str_),
            latitude_rad=_numbers(poses, lambda pose: pose.latitude_rad),
            longitude_rad=_numbers(poses, lambda pose: pose.longitude_rad),
            yaw_rad=_numbers(poses, lambda pose: pose.yaw_rad),
            covariance=upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3),
            elevation_m=_numbers(poses, lambda pose: pose.road.elevation_m),
            level=_numbers(poses, lambda pose: pose.road.level),
        )

    @property
    def radius_m(self) -> Floats:
        """Semi-major axis (n,) of the ellipse that contains the position with `INSIDE_PROBABILITY`."""
        ee, en, nn = self.covariance[:, 0, 0], self.covariance[:, 0, 1], self.covariance[:, 1, 1]
        larger = 0.5 * (ee + nn) + np.hypot(0.5 * (ee - nn), en)
        return np.sqrt(confidence_scale(INSIDE_PROBABILITY) * larger)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MatchColumns:
    """n scan matches; `layer_mean_distance_m` (n, layers); numbers are NaN where there is none."""

    time_ns: Integers
    status: Names
    overlap: Floats
    layer_mean_distance_m: Floats
    sensor_height_m: Floats
    ground_height_m: Floats

    @classmethod
    def from_matches(cls, matches: Sequence[ScanMatch]) -> MatchColumns:
        """In the order received."""
        layers = max((match.layers for match in matches), default=0)
        distance_m = np.array([match.distances_m(layers) for match in matches]).reshape(len(matches), layers)
        return cls(
            time_ns=np.array([match.time_ns for match in matches], np.int64),
            status=np.array([match.status for match in matches], np.str_),
            overlap=_numbers(matches, lambda match: match.overlap),
            layer_mean_distance_m=distance_m,
            sensor_height_m=_numbers(matches, lambda match: match.sensor_height_m),
            ground_height_m=_numbers(matches, lambda match: match.ground_height_m),
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseErrors:
    """Errors of n poses against the truth; NaN where one of the two is unknown.

    `share_of_ellipse` is the squared error over that of the ellipse's edge: at most 1 inside.
    `level` is 0 where pose and truth name another level, 1 where the same.
    """

    along_m: Floats
    cross_m: Floats
    yaw_rad: Floats
    share_of_ellipse: Floats
    elevation_m: Floats
    level: Floats

    @property
    def horizontal_m(self) -> Floats:
        """Horizontal error (n,)."""
        return np.hypot(self.along_m, self.cross_m)

    @classmethod
    def from_truth(cls, poses: PoseColumns, table: TruthTable) -> PoseErrors:
        """Along and across the truth's heading. Only simulated truth has the road's height and level, else NaN."""
        # The horizontal error does not depend on the height: any one near the ground is good enough.
        height_m = np.full(len(poses.time_ns), table.height_m[0])
        enu_m = truth_of(table).error_enu_m(
            poses.time_ns, poses.latitude_rad, poses.longitude_rad, height_m, offset_enu_m=(0.0, 0.0, 0.0)
        )
        yaw_rad = _at(table, poses.time_ns, lambda truth: truth.yaw_rad)
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        east_m, north_m = enu_m[:, 0], enu_m[:, 1]
        return cls(
            along_m=east_m * cos + north_m * sin,
            cross_m=-east_m * sin + north_m * cos,
            yaw_rad=wrap_pi_array(poses.yaw_rad - yaw_rad),
            share_of_ellipse=_share_of_ellipse(enu_m[:, :2], poses.covariance[:, :2, :2]),
            elevation_m=poses.elevation_m - _interpolated(table, "road_height_m", poses.time_ns),
            level=_same(poses.level, _nearest(table, "level", poses.time_ns)),
        )


def _numbers(messages: Sequence[M], get: Callable[[M], float | None]) -> Floats:
    values = [get(message) for message in messages]
    return np.array([np.nan if value is None else value for value in values], np.float64)


def _at(table: TruthTable, time_ns: Integers, get: Callable[[TruthTable], Floats]) -> Floats:
    column = np.full(len(time_ns), np.nan)
    truth, known = interpolate_truth(table, time_ns)
    column[known] = get(truth)
    return column


def _interpolated(table: TruthTable, name: str, time_ns: Integers) -> Floats:
    """An optional column of the truth, interpolated; NaN where it is unknown."""
    if name not in table.more:
        return np.full(len(time_ns), np.nan)
    known = ~np.isnan(_at(table, time_ns, lambda truth: truth.height_m))
    since = (table.time_ns - table.time_ns[0]).astype(np.float64)
    values = np.interp((time_ns - table.time_ns[0]).astype(np.float64), since, table.more[name])
    return np.where(known, values, np.nan)


def _nearest(table: TruthTable, name: str, time_ns: Integers) -> Floats:
    """An optional column of the truth, of the nearest epoch; NaN where it is unknown."""
    if name not in table.more:
        return np.full(len(time_ns), np.nan)
    after = np.searchsorted(table.time_ns, time_ns).clip(1, max(len(table) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(table) - 1)
    nearer = np.where(time_ns - table.time_ns[before] <= table.time_ns[after] - time_ns, before, after)
    known = ~np.isnan(_at(table, time_ns, lambda truth: truth.height_m))
    return np.where(known, table.more[name][nearer], np.nan)


def _same(a: Floats, b: Floats) -> Floats:
    return np.where(np.isnan(a) | np.isnan(b), np.nan, (a == b).astype(np.float64))


def _share_of_ellipse(error_m: Floats, covariance_m2: Floats) -> Floats:
    ee, en, nn = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    east_m, north_m = error_m.T
    square: Floats = (nn * east_m**2 - 2.0 * en * east_m * north_m + ee * north_m**2) / (ee * nn - en**2)
    return square / confidence_scale(INSIDE_PROBABILITY)
