"""What the judge says of a fix, and the position a consumer may use."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from camber.schemas.base import (
    Angle,
    Count,
    Covariance3,
    Height,
    Latitude,
    Longitude,
    Message,
    Probability,
    Sigma,
    Text,
    Vector2,
)

VerdictValue = Literal["confirmed", "confirmed_after_verification", "erroneous", "unknown"]
CONFIRMED_VERDICTS: tuple[VerdictValue, ...] = ("confirmed", "confirmed_after_verification")
"""Of fixes that may be used as positions."""
Reason = Literal[
    "none",
    "height_agrees",
    "height_disagrees",
    "starting",
    "not_a_fix",
    "position_disagrees",
    "height_and_position_disagree",
    "height_unverified",
    "position_unverified",
    "phase_residuals_contradict",
    "subsets_disagree",
    "estimates_disagree",
    "receiver_warns",
    "common_offset",
    "continuity_disagrees",
    "fix_implausible",
    "fix_repeated",
    "fix_out_of_order",
    "pose_missing",
    "pose_stale",
    "pose_provisional",
    "pose_too_uncertain",
    "road_unknown",
    "levels_ambiguous",
    "map_server_absent",
    "antenna_height_missing",
    "antenna_height_stale",
    "antenna_height_disagrees",
    "datum_mismatch",
    "gnss_absent",
    "gnss_stale",
    "localizer_absent",
    "antenna_height_absent",
    "no_independent_position",
]
Evidence = Literal[
    "height",
    "position",
    "time_series",
    "ambiguity_continuity",
    "scan_matching",
    "track",
    "phase_residuals",
    "subset_agreement",
    "estimates",
    "consistency",
]
"""`position`: the fix agrees with a position that rests on no fix; `consistency`: with a pose that rests on fixes."""
Cause = Literal["none", "antenna", "road", "base", "drift", "ambiguous"]
"""What a lasting difference comes from: the antenna's height, one surface of the map, the base station or the datum
(every fix is off by one vector), fixes led away along a growing vector, or what one vehicle cannot distinguish."""
HorizontalReference = Literal["required", "assumed"]
"""Whether a position is usable only with a horizontal reference that rests on no fix, or base station and signals are
assumed to be honest."""
PositionSource = Literal["rtk", "doppler", "sensors", "scan_match", "none"]


class Verdict(Message):
    """The one final word on one fix, or, without a fix (`fix_id` None), on the epoch.

    Only `confirmed` and `confirmed_after_verification` may be used as positions. `unknown` is not trust.
    The difference is that of JP7707657B2 eq. (3) in the form that goes to zero: (h_m + h_a) + h_e − h_r.
    """

    fix_id: Count | None
    verdict: VerdictValue
    reason: Reason
    detail: Text = ""
    evidence: tuple[Evidence, ...] = Field((), max_length=10)
    height_difference_m: float | None = None
    tolerance_m: Sigma | None = None
    position_difference_m: Vector2 | None = Field(
        None, description="fix less pose, east and north, at the fix's time"
    )
    joint_distance2: Sigma | None = Field(
        None, description="squared Mahalanobis distance of height and position together"
    )
    joint_limit: Sigma | None = Field(None, description="beyond it the fix contradicts")
    missed_detection_probability: Probability | None = Field(
        None, description="that a wrong fix would have passed, all trials charged"
    )
    cause: Cause = Field("none", description="of a lasting difference, where one is known")
    horizontal_reference: HorizontalReference = Field(
        "required", description="the judge's setting when this was judged"
    )
    correction_m: float = Field(0.0, description="h_e in force when this was judged")
    trials: Count = 0
    latitude_rad: Latitude | None = Field(None, description="of the antenna, where confirmed")
    longitude_rad: Longitude | None = None
    height_m: Height | None = None
    covariance_enu_m2: Covariance3 | None = None
    surface_id: Count | None = None
    map_version: Count | None = None


class Position(Message):
    """What consumers use, at every epoch: where the antenna is, how far off it may be, and whether to use it."""

    source: PositionSource
    usable: bool = Field(
        description="the protection levels at the integrity risk are below their alert limits"
    )
    reason: Reason = "none"
    horizontal_reference: HorizontalReference = Field(
        "required", description="the judge's setting that `usable` and the levels follow"
    )
    latitude_rad: Latitude | None = None
    longitude_rad: Longitude | None = None
    height_m: Height | None = Field(None, description="ellipsoidal")
    covariance_enu_m2: Covariance3 | None = None
    yaw_rad: Angle | None = None
    semi_major_99_m: Sigma | None = Field(None, description="99 % horizontal error ellipse")
    semi_minor_99_m: Sigma | None = None
    semi_major_999_m: Sigma | None = Field(None, description="99.9 % horizontal error ellipse")
    semi_minor_999_m: Sigma | None = None
    orientation_rad: Angle | None = Field(None, description="of the major axis, counter-clockwise from east")
    horizontal_protection_level_m: Sigma | None = None
    vertical_protection_level_m: Sigma | None = None
    integrity_risk: Probability | None = Field(None, description="per epoch, at which the levels hold")
    alert_limit_m: Sigma
    vertical_alert_limit_m: Sigma | None = None
    wrong_fix_probability: Probability | None = Field(
        None, description="that a wrong fix has passed, as the levels take it into account"
    )
    fix_id: Count | None = None
