"""What the judge says of one fix, with all that it rests on, and the verdict that is published."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from camber.integrity.checks.comparison import Comparison
from camber.integrity.checks.height_check import RoadPoint
from camber.integrity.protection.covariance_inflation import TrueSigma, with_true_sigma
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Cause, Evidence, Reason, Verdict, VerdictValue
from camber.schemas.pose import Pose


@dataclass(frozen=True, slots=True)
class Judgement:
    """The one judgement of a fix; `pose`, `antenna`, `road` and `comparison` as far as it came.

    `trials`: as many estimates were judged, this one the last.
    """

    fix: Fix
    word: VerdictValue
    reason: Reason
    detail: str = ""
    evidence: tuple[Evidence, ...] = ()
    comparison: Comparison | None = None
    correction_m: float = 0.0
    road: RoadPoint | None = None
    pose: Pose | None = None
    antenna: AntennaHeight | None = None
    cause: Cause = "none"
    trials: int = 1

    @property
    def confirmed(self) -> bool:
        """May a consumer use the position?"""
        return self.word in ("confirmed", "confirmed_after_verification")


def verdict_of(judgement: Judgement, sigma: TrueSigma) -> Verdict:
    """The message; it has a position only where that is confirmed."""
    fix, found, point = judgement.fix, judgement.comparison, judgement.road
    road = judgement.pose.road if judgement.pose is not None else None
    surface_id = point.surface_id if point is not None else road.surface_id if road is not None else None
    place: dict[str, Any] = {}
    if judgement.confirmed and fix.covariance_enu_m2 is not None:
        place = {
            "latitude_rad": fix.latitude_rad,
            "longitude_rad": fix.longitude_rad,
            "height_m": fix.height_m,
            "covariance_enu_m2": with_true_sigma(fix.covariance_enu_m2, sigma),
        }
    return Verdict(
        time_ns=fix.time_ns,
        fix_id=fix.fix_id,
        verdict=judgement.word,
        reason=judgement.reason,
        detail=judgement.detail,
        evidence=judgement.evidence,
        height_difference_m=found.height_m if found is not None else None,
        tolerance_m=found.tolerance_m if found is not None else None,
        position_difference_m=found.position_m if found is not None else None,
        joint_distance2=found.joint_distance2 if found is not None else None,
        joint_limit=found.joint_limit if found is not None else None,
        cause=judgement.cause,
        correction_m=judgement.correction_m,
        trials=judgement.trials,
        surface_id=surface_id,
        map_version=road.map_version if road is not None else None,
        **place,
    )
