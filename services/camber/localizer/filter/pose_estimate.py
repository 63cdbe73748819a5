"""The filter's output: the pose, its mode and provenance, and the time of each source."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

from camber.localizer.arrays import Floats
from camber.localizer.filter.planar_pose import largest_variance
from camber.localizer.filter.source_conflict import ConflictSource
from camber.localizer.links.link_matching import LinkMatch

Mode: TypeAlias = Literal["none", "provisional", "anchored", "scan_match", "dead_reckoning"]
Provenance: TypeAlias = Literal["none", "fixes", "scan_match", "given", "confirmed"]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseEstimate:
    """The pose of the vehicle's reference point in the plane; covariance (3, 3) of east, north [m] and yaw [rad].

    Times are None for sources that never came; speed and yaw rate are None where the last reading gave none. With an
    unknown heading `yaw_known` is false and yaw has no meaning. `conflict`: the source that contradicts the pose; the
    covariance covers both.
    """

    time_ns: int
    mode: Mode
    provenance: Provenance
    east_m: float
    north_m: float
    yaw_rad: float
    yaw_known: bool
    covariance: Floats
    speed_m_s: float | None
    yaw_rate_rad_s: float | None
    rotation_read: bool
    anchor_time_ns: int | None
    match_time_ns: int | None
    link: LinkMatch
    conflict: ConflictSource | None = None
    wheel_slip_suspected: bool = False

    @property
    def horizontal_sigma_m(self) -> float:
        """Square root of the position covariance's larger eigenvalue."""
        return math.sqrt(largest_variance(self.covariance))


class Prediction(NamedTuple):
    """The pose at a time near now, by the driven track [m, rad], covariance (3, 3). See `PoseEstimate`."""

    time_ns: int
    east_m: float
    north_m: float
    yaw_rad: float
    yaw_known: bool
    covariance: Floats

    @property
    def position_sigma_m(self) -> float:
        """The larger of σ in east and in north."""
        return math.sqrt(max(float(self.covariance[0, 0]), float(self.covariance[1, 1])))

    @property
    def yaw_sigma_rad(self) -> float:
        """σ of the yaw."""
        return math.sqrt(float(self.covariance[2, 2]))
