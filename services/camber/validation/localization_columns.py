"""Poses and scan matches as columns, and how far the poses are from the truth."""

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
from camber.validation.truth import truth_of

M = TypeVar("M", Pose, ScanMatch)
Words = NDArray[np.str_]
INSIDE_PROBABILITY = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class PoseColumns:
    """n poses; numbers are NaN where there is none. `covariance` (n, 3, 3) of east, north [m] and yaw [rad]."""

    time_ns: Integers
    mode: Words
    provenance: Words
    latitude_rad: Floats
    longitude_rad: Floats
    yaw_rad: Floats
    covariance: Floats
    elevation_m: Floats
    level: Floats

    @classmethod
    def of(cls, poses: Sequence[Pose]) -> PoseColumns:
        """In the order in which they came."""
        upper = np.array([pose.covariance_east_north_yaw or [np.nan] * 6 for pose in poses]).reshape(-1, 6)
        return cls(
            np.array([pose.time_ns for pose in poses], np.int64),
            np.array([pose.mode for pose in poses], np.str_),
            np.array([pose.provenance for pose in poses], np.str_),
            _numbers(poses, lambda pose: pose.latitude_rad),
            _numbers(poses, lambda pose: pose.longitude_rad),
            _numbers(poses, lambda pose: pose.yaw_rad),
            upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3),
            _numbers(poses, lambda pose: pose.road.elevation_m),
            _numbers(poses, lambda pose: pose.road.level),
        )

    @property
    def radius_m(self) -> Floats:
        """Larger half axis (n,) of the ellipse that holds the place with `INSIDE_PROBABILITY`."""
        ee, en, nn = self.covariance[:, 0, 0], self.covariance[:, 0, 1], self.covariance[:, 1, 1]
        larger = 0.5 * (ee + nn) + np.hypot(0.5 * (ee - nn), en)
        return np.sqrt(confidence_scale(INSIDE_PROBABILITY) * larger)


@dataclass(frozen=True, slots=True, eq=False)
class MatchColumns:
    """n scan matches; `layer_mean_distance_m` (n, layers); numbers are NaN where there is none."""

    time_ns: Integers
    status: Words
    overlap: Floats
    layer_mean_distance_m: Floats
    sensor_height_m: Floats
    ground_height_m: Floats

    @classmethod
    def of(cls, matches: Sequence[ScanMatch]) -> MatchColumns:
        """In the order in which they came."""
        layers = max((match.layers for match in matches), default=0)
        distance_m = np.array([match.distances_m(layers) for match in matches]).reshape(len(matches), layers)
        return cls(
            np.array([match.time_ns for match in matches], np.int64),
            np.array([match.status for match in matches], np.str_),
            _numbers(matches, lambda match: match.overlap),
            distance_m,
            _numbers(matches, lambda match: match.sensor_height_m),
            _numbers(matches, lambda match: match.ground_height_m),
        )


@dataclass(frozen=True, slots=True, eq=False)
class PoseErrors:
    """Of n poses against the truth; NaN where one of the two is not known.

    `share_of_ellipse` is the squared error over that of the ellipse's edge: up to 1 the truth is inside.
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
        """(n,)"""
        return np.hypot(self.along_m, self.cross_m)

    @classmethod
    def of(cls, poses: PoseColumns, table: TruthTable) -> PoseErrors:
        """Along and across the truth's own heading. The road's height and level are a simulator's: NaN without them."""
        # The horizontal error does not care for the height: that of the truth's first epoch will do.
        height_m = np.full(len(poses.time_ns), table.height_m[0])
        enu_m = truth_of(table).error_enu_m(
            poses.time_ns, poses.latitude_rad, poses.longitude_rad, height_m, (0.0, 0.0, 0.0)
        )
        yaw_rad = _at(table, poses.time_ns, lambda truth: truth.yaw_rad)
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        east_m, north_m = enu_m[:, 0], enu_m[:, 1]
        return cls(
            east_m * cos + north_m * sin,
            -east_m * sin + north_m * cos,
            wrap_pi_array(poses.yaw_rad - yaw_rad),
            _share_of_ellipse(enu_m[:, :2], poses.covariance[:, :2, :2]),
            poses.elevation_m - _interpolated(table, "road_height_m", poses.time_ns),
            _same(poses.level, _nearest(table, "level", poses.time_ns)),
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
    """A further column of the truth where the truth is known."""
    if name not in table.more:
        return np.full(len(time_ns), np.nan)
    known = ~np.isnan(_at(table, time_ns, lambda truth: truth.height_m))
    since = (table.time_ns - table.time_ns[0]).astype(np.float64)
    values = np.interp((time_ns - table.time_ns[0]).astype(np.float64), since, table.more[name])
    return np.where(known, values, np.nan)


def _nearest(table: TruthTable, name: str, time_ns: Integers) -> Floats:
    """The same for a column that does not go from one value to the next."""
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
