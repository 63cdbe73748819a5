"""A fix whose height agrees and whose place the pose contradicts: either may be wrong.

Until a fix agrees with the pose, the vehicle may be where that fix was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.chi2_test import AGREES
from camber.integrity.checks.consistency import POSITION_CONTRADICTS
from camber.integrity.judgement import FixJudgement
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.integrity.protection.position_bounds import LevelRules, MixtureComponent, widened
from camber.schemas.base import Covariance3
from camber.schemas.pose import Pose

_NOT_OF_THE_POSE = frozenset({"phase_residuals_contradict", "receiver_warns", "common_offset"})
"""It is the fix by its own account, or the base: neither says that the pose is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDispute:
    """A fix whose height agrees and whose place the pose contradicts: one of both is wrong, and which is not known.

    `east_m`, `north_m` from the pose to the fix, `covariance_enu_m2` of the fix, `begun_ns` the time of the first.
    `matches` newer than that agree with the pose, the last at the place `matched_at`.
    """

    begun_ns: int
    time_ns: int
    east_m: float
    north_m: float
    covariance_enu_m2: Covariance3
    matches: int = 0
    matched_at: tuple[float, float] | None = None

    def weight(self, rules: LevelRules) -> float:
        """How likely it is the pose. It does not fade: a wrong pose stays wrong."""
        return rules.disputed_pose_prior * rules.false_match_prior**self.matches

    def update(self, pose: Pose, rules: LevelRules) -> PoseDispute:
        """Count a match that is newer than the dispute and `matches_apart_m` from the last one."""
        if pose.mode != "scan_match" or pose.latitude_rad is None or pose.longitude_rad is None:
            return self
        here = pose.latitude_rad, pose.longitude_rad
        if pose.match_time_ns is None or not pose.match_time_ns > self.begun_ns:
            return self
        if self.matched_at is not None:
            moved_m = math.hypot(*east_north_between(*self.matched_at, *here))
            if not moved_m >= rules.matches_apart_m:
                return self
        return replace(self, matches=self.matches + 1, matched_at=here)

    def with_alternative(
        self, parts: tuple[MixtureComponent, ...], alone: MixtureComponent, weight: float
    ) -> tuple[MixtureComponent, ...]:
        """The parts of a pose, of which `alone` is the one that is right, and that the vehicle is where the fix is."""
        # The fix's height is the road's, as the pose's is.
        there = replace(alone, weight=weight, mean_m=(self.east_m, self.north_m, 0.0))
        others = [replace(part, weight=(1.0 - weight) * part.weight) for part in parts]
        return (*others, widened(there, self.covariance_enu_m2))


def updated_dispute(
    judgement: FixJudgement, before: PoseDispute | None, sigma: TrueSigma
) -> PoseDispute | None:
    """What is disputed after a judgement: a fix that agrees with the pose ends it, one that was not compared does not.

    Those that contradict in height too, or by their own account, are wrong by themselves and say nothing of the pose.
    """
    result, fix = judgement.comparison, judgement.fix
    if judgement.confirmed:
        return None
    if result is None or fix.covariance_enu_m2 is None or judgement.reason in _NOT_OF_THE_POSE:
        return before
    if result.position == AGREES:
        return None
    # Where the map knows no road under the fix, its height speaks neither for it nor against it.
    if result.outcome != POSITION_CONTRADICTS and judgement.reason != "position_disagrees":
        return before
    east_m, north_m = result.position_m
    newest = PoseDispute(
        begun_ns=fix.time_ns,
        time_ns=fix.time_ns,
        east_m=east_m,
        north_m=north_m,
        covariance_enu_m2=inflate_covariance(fix.covariance_enu_m2, sigma),
    )
    if before is None:
        return newest
    return replace(newest, begun_ns=before.begun_ns, matches=before.matches, matched_at=before.matched_at)
