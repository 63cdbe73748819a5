"""Poses, scan matches and antenna heights of a recording as columns, and the errors of poses against the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camber.formats.drive.recording import Recorded
from camber.formats.drive.truth_csv import TruthTable
from camber.formats.observations import Floats, Integers
from camber.geodesy.angles import wrap_pi_array
from camber.geodesy.covariance import confidence_scale
from camber.replay.truth_interpolation import interpolate_truth
from camber.schemas.antenna import AntennaHeight
from camber.schemas.pose import Pose, ScanMatch
from camber.validation.reference_trajectory import truth_of

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
            latitude_rad=np.array([pose.latitude_rad for pose in poses], np.float64),
            longitude_rad=np.array([pose.longitude_rad for pose in poses], np.float64),
            yaw_rad=np.array([pose.yaw_rad for pose in poses], np.float64),
            covariance=upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3),
            elevation_m=np.array([pose.road.elevation_m for pose in poses], np.float64),
            level=np.array([pose.road.level for pose in poses], np.float64),
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
            overlap=np.array([match.overlap for match in matches], np.float64),
            layer_mean_distance_m=distance_m,
            sensor_height_m=np.array([match.sensor_height_m for match in matches], np.float64),
            ground_height_m=np.array([match.ground_height_m for match in matches], np.float64),
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
        truth, known = interpolate_truth(table, poses.time_ns)
        unknown = np.full(len(known), np.nan)
        yaw_rad, road_m, level = unknown.copy(), unknown, unknown
        yaw_rad[known] = truth.yaw_rad
        if "road_height_m" in table.more:
            at_ns, asked_ns = (
                (t - table.time_ns[0]).astype(np.float64) for t in (table.time_ns, poses.time_ns)
            )
            road_m = np.where(known, np.interp(asked_ns, at_ns, table.more["road_height_m"]), np.nan)
        if "level" in table.more:
            level = np.where(known, table.more["level"][_nearest(table.time_ns, poses.time_ns)], np.nan)
        # The horizontal error does not depend on the height: any one near the ground is good enough.
        height_m = np.full(len(poses.time_ns), table.height_m[0])
        enu_m = truth_of(table).error_enu_m(
            poses.time_ns, poses.latitude_rad, poses.longitude_rad, height_m, offset_enu_m=(0.0, 0.0, 0.0)
        )
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        east_m, north_m = enu_m[:, 0], enu_m[:, 1]
        return cls(
            along_m=east_m * cos + north_m * sin,
            cross_m=-east_m * sin + north_m * cos,
            yaw_rad=wrap_pi_array(poses.yaw_rad - yaw_rad),
            share_of_ellipse=_share_of_ellipse(enu_m[:, :2], poses.covariance[:, :2, :2]),
            elevation_m=poses.elevation_m - road_m,
            level=np.where(np.isnan(poses.level) | np.isnan(level), np.nan, poses.level == level),
        )


def _nearest(known_ns: Integers, time_ns: Integers) -> Integers:
    """The row of the nearest of ascending times; of two as near the earlier one."""
    after = np.searchsorted(known_ns, time_ns).clip(1, max(len(known_ns) - 1, 1))
    before, after = after - 1, np.minimum(after, len(known_ns) - 1)
    return np.where(time_ns - known_ns[before] <= known_ns[after] - time_ns, before, after)


def _share_of_ellipse(error_m: Floats, covariance_m2: Floats) -> Floats:
    ee, en, nn = covariance_m2[:, 0, 0], covariance_m2[:, 0, 1], covariance_m2[:, 1, 1]
    east_m, north_m = error_m.T
    square: Floats = (nn * east_m**2 - 2.0 * en * east_m * north_m + ee * north_m**2) / (ee * nn - en**2)
    return square / confidence_scale(INSIDE_PROBABILITY)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocalizerRecord:
    """Poses, matches, and by method the antenna heights: times (n,) and metres (n,)."""

    poses: PoseColumns
    matches: MatchColumns
    heights: dict[str, tuple[Integers, Floats]]

    @classmethod
    def from_recording(cls, recorded: Mapping[str, Sequence[Recorded[Any]]]) -> LocalizerRecord:
        """From the messages by channel; a missing one counts as empty."""
        return cls(
            poses=PoseColumns.from_poses([item.message for item in recorded.get("pose", ())]),
            matches=MatchColumns.from_matches([item.message for item in recorded.get("scan_match", ())]),
            heights=_heights([item.message for item in recorded.get("antenna_height", ())]),
        )

    def summary(self) -> dict[str, Any]:
        """Counts of modes and statuses, and medians; None without a value."""
        distance_m = self.matches.layer_mean_distance_m
        return {
            "modes": dict(Counter(self.poses.mode.tolist()).most_common()),
            "matches": dict(Counter(self.matches.status.tolist()).most_common()),
            "layer_mean_distance_m": [_median(column) for column in distance_m.T],
            "sensor_height_m": _median(self.matches.sensor_height_m),
            "ground_height_m": _median(self.matches.ground_height_m),
            "antenna_height_m": {method: _median(height_m) for method, (_, height_m) in self.heights.items()},
        }


def _heights(messages: Sequence[AntennaHeight]) -> dict[str, tuple[Integers, Floats]]:
    heights: dict[str, list[tuple[int, float]]] = {}
    for message in messages:
        if message.way is not None and message.height_m is not None:
            heights.setdefault(message.way, []).append((message.time_ns, message.height_m))
        for other in message.others:
            heights.setdefault(other.way, []).append((message.time_ns, other.height_m))
    return {
        method: (np.array([t for t, _ in rows], np.int64), np.array([h for _, h in rows], np.float64))
        for method, rows in sorted(heights.items())
    }


def _median(values: Floats) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None
