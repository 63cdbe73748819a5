"""What the localizer's filter says: the pose, how it is held, where it comes from, how old its sources are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

from camber.localizer.filter.source_conflict import Disputing
from camber.localizer.filter.start import largest_variance
from camber.localizer.links.link_filter import Array
from camber.localizer.links.link_matching import LinkId

Mode: TypeAlias = Literal["none", "provisional", "anchored", "scan_match", "dead_reckoning"]
Provenance: TypeAlias = Literal["none", "fixes", "scan_match", "given", "confirmed"]


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """The pose of the vehicle's reference point in the plane, and where it comes from.

    Covariance (3, 3) of east, north (m) and yaw (rad). Ages are None for what never came; speed and yaw rate
    None where the last reading gave none. With an unknown heading `yaw_known` is false and yaw means nothing.
    `disputed_by`: the source that contradicts the pose; the covariance covers both. `wheel_slip_suspected`:
    the wheels do not say how fast the vehicle goes. `motion_late_s`: other sources have said something of this much
    later than the last motion sample.
    """

    time_ns: int
    mode: Mode
    provenance: Provenance
    east_m: float
    north_m: float
    yaw_rad: float
    yaw_known: bool
    covariance: Array
    speed_m_s: float | None
    yaw_rate_rad_s: float | None
    standing: bool
    speed_age_s: float | None
    rotation_age_s: float | None
    anchor_age_s: float | None
    match_age_s: float | None
    link_age_s: float | None
    link_status: Literal["none", "ambiguous", "matched"]
    link_id: LinkId | None
    link_level: int | None
    link_candidates: tuple[LinkId, ...]
    link_offset_m: float
    link_offset_sigma_m: float
    disputed_by: Disputing | None = None
    wheel_slip_suspected: bool = False
    motion_late_s: float = 0.0

    @property
    def horizontal_sigma_m(self) -> float:
        """Square root of the position covariance's larger eigenvalue."""
        return math.sqrt(largest_variance(self.covariance))


class Prediction(NamedTuple):
    """The pose at a time near now, by the driven track: m, rad, covariance (3, 3). See `PoseEstimate`."""

    time_ns: int
    east_m: float
    north_m: float
    yaw_rad: float
    yaw_known: bool
    covariance: Array
