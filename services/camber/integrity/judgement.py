"""The judgement of one fix with all that it rests on, and the verdict message that is published."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from camber.integrity.checks.fix_comparison import FixComparison
from camber.integrity.checks.height_model import RoadPoint
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Fix
from camber.schemas.integrity import (
    CONFIRMED_VERDICTS,
    Cause,
    Evidence,
    HorizontalReference,
    Reason,
    Verdict,
    VerdictValue,
)
from camber.schemas.pose import Pose


@dataclass(frozen=True, slots=True, kw_only=True)
class FixJudgement:
    """The judgement of a fix; `pose`, `antenna`, `road` and `comparison` as far as they were used.

    `trials`: number of estimates that were judged, of which this is the last. `testable`: False where the fix itself
    was rejected (stale, not fixed, …), so that the history ignores it. `off_road_since_ns`: when the run of fixes
    that it goes on from began, where a height of them has contradicted the road.
    """

    fix: Fix
    verdict: VerdictValue
    reason: Reason
    detail: str = ""
    evidence: tuple[Evidence, ...] = ()
    comparison: FixComparison | None = None
    correction_m: float = 0.0
    road: RoadPoint | None = None
    pose: Pose | None = None
    antenna: AntennaHeight | None = None
    cause: Cause = "none"
    trials: int = 1
    testable: bool = True
    off_road_since_ns: int | None = None

    @property
    def confirmed(self) -> bool:
        """May a consumer use the position?"""
        return self.verdict in CONFIRMED_VERDICTS


def verdict_of(
    judgement: FixJudgement, sigma: TrueSigma, reference: HorizontalReference = "required"
) -> Verdict:
    """The message, with the setting that it follows; it has a position only where that is confirmed."""
    fix, result, point = judgement.fix, judgement.comparison, judgement.road
    road = judgement.pose.road if judgement.pose is not None else None
    surface_id = point.surface_id if point is not None else road.surface_id if road is not None else None
    place: dict[str, Any] = {}
    if judgement.confirmed and fix.covariance_enu_m2 is not None:
        place = {
            "latitude_rad": fix.latitude_rad,
            "longitude_rad": fix.longitude_rad,
            "height_m": fix.height_m,
            "covariance_enu_m2": inflate_covariance(fix.covariance_enu_m2, sigma),
        }
    return Verdict(
        time_ns=fix.time_ns,
        fix_id=fix.fix_id,
        verdict=judgement.verdict,
        reason=judgement.reason,
        detail=judgement.detail,
        evidence=judgement.evidence,
        height_difference_m=result.height_m if result is not None else None,
        tolerance_m=result.tolerance_m if result is not None else None,
        position_difference_m=result.position_m if result is not None else None,
        joint_distance2=result.joint_distance2 if result is not None else None,
        joint_limit=result.joint_limit if result is not None else None,
        cause=judgement.cause,
        horizontal_reference=reference,
        correction_m=judgement.correction_m,
        trials=judgement.trials,
        surface_id=surface_id,
        map_version=road.map_version if road is not None else None,
        **place,
    )
