"""A fix whose height agrees and whose place the pose contradicts: either may be wrong.

Until a fix agrees with the pose, the vehicle may be where that fix was.

If a fix agreed with the pose a moment before, the vehicle may not have been able to come to the disputing one since.
Then the pose was wrong before too, and the fix that agreed was: a fault that fixes and pose share (`latent_fault`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.chi2_test import AGREES
from camber.integrity.checks.consistency_tests import POSITION_CONTRADICTS
from camber.integrity.judgement import FixJudgement
from camber.integrity.protection.covariance_inflation import TrueSigma, inflate_covariance
from camber.integrity.protection.position_bounds import LevelRules, MixtureComponent, widened
from camber.integrity.scalar_or_array import larger_eigenvalue
from camber.schemas.base import Covariance3
from camber.schemas.pose import Pose

_NOT_OF_THE_POSE = frozenset({"phase_residuals_contradict", "receiver_warns", "common_offset"})
"""It is the fix by its own account, or the base: neither says that the pose is wrong."""
_ACCELERATION_M_S2 = 10.0
"""Chosen: the grip of tyres, 1 g; no road vehicle gains speed faster."""
_SURELY_SIGMAS = 5.7  # σ of a fix beyond which it is at 1e-7 in two dimensions
_SAME_RUN_M = 0.5
"""Chosen: wrong integers that are held stay within it; other integers are farther off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseAgreement:
    """The last confirmed fix that agreed with the pose: its time, where the pose was, its speed, and the tolerance."""

    time_ns: int
    latitude_rad: float
    longitude_rad: float
    speed_m_s: float
    tolerance_m: float

    def largest_error_m(self, pose: Pose, time_ns: int) -> float:
        """How far off a pose can be at a later time, if it was right then: its displacement and that of the vehicle."""
        duration_s = (time_ns - self.time_ns) / 1e9
        if pose.latitude_rad is None or pose.longitude_rad is None or not duration_s >= 0.0:
            return math.inf
        moved_m = math.hypot(
            *east_north_between(self.latitude_rad, self.longitude_rad, pose.latitude_rad, pose.longitude_rad)
        )
        driven_m = self.speed_m_s * duration_s + 0.5 * _ACCELERATION_M_S2 * duration_s**2
        return self.tolerance_m + moved_m + driven_m


def updated_agreement(judgement: FixJudgement, before: PoseAgreement | None) -> PoseAgreement | None:
    """The last agreement after a judgement."""
    result, pose = judgement.comparison, judgement.pose
    if not judgement.confirmed or result is None or result.position != AGREES or pose is None:
        return before
    if pose.latitude_rad is None or pose.longitude_rad is None or pose.speed_m_s is None:
        return before
    return PoseAgreement(
        time_ns=judgement.fix.time_ns,
        latitude_rad=pose.latitude_rad,
        longitude_rad=pose.longitude_rad,
        speed_m_s=abs(pose.speed_m_s),
        tolerance_m=float(result.acceptance_radius_m),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDispute:
    """A fix whose height agrees and whose place the pose contradicts: one of both is wrong, and which is not known.

    `east_m`, `north_m` from the pose to the fix, `covariance_enu_m2` of the fix, `begun_ns` the time of the first.
    `matches` newer than that agree with the pose, the last at the place `matched_at`. `out_of_reach`: the vehicle
    cannot have come there since the last fix that agreed with the pose.
    """

    begun_ns: int
    time_ns: int
    east_m: float
    north_m: float
    covariance_enu_m2: Covariance3
    matches: int = 0
    matched_at: tuple[float, float] | None = None
    out_of_reach: bool = False

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
        there = alone._replace(
            weight=weight,
            mean_m=(-self.east_m, -self.north_m, 0.0),
            is_latent=self.out_of_reach,
        )
        others = [part.weighed(1.0 - weight) for part in parts]
        return (*others, widened(there, self.covariance_enu_m2))


def updated_dispute(
    judgement: FixJudgement,
    before: PoseDispute | None,
    sigma: TrueSigma,
    agreement: PoseAgreement | None = None,
) -> PoseDispute | None:
    """What is disputed after a judgement: a fix that agrees with the pose ends it, one that was not compared does not.

    Those that contradict in height too, or by their own account, are wrong by themselves and say nothing of the pose,
    nor do others of the same run: a dispute that it began ends.
    """
    result, fix = judgement.comparison, judgement.fix
    if judgement.confirmed:
        return None
    if result is None or fix.covariance_enu_m2 is None or judgement.reason in _NOT_OF_THE_POSE:
        return before
    if result.position == AGREES:
        return None
    wrong_since_ns = judgement.off_road_since_ns
    if wrong_since_ns is not None:
        return None if before is None or before.begun_ns >= wrong_since_ns else before
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
    newest = replace(newest, out_of_reach=_is_out_of_reach(newest, before, judgement.pose, agreement))
    if before is None:
        return newest
    return replace(newest, begun_ns=before.begun_ns, matches=before.matches, matched_at=before.matched_at)


def _is_out_of_reach(
    newest: PoseDispute, before: PoseDispute | None, pose: Pose | None, agreement: PoseAgreement | None
) -> bool:
    """Can the vehicle not have come to the fix, or is it one of a run that began where it cannot have come?"""
    if before is not None and before.out_of_reach:
        apart_m = math.hypot(newest.east_m - before.east_m, newest.north_m - before.north_m)
        if apart_m <= _SAME_RUN_M:
            return True
    if pose is None or agreement is None:
        return False
    ee, en, _, nn, _, _ = newest.covariance_enu_m2
    reach_m = agreement.largest_error_m(pose, newest.time_ns) + _SURELY_SIGMAS * math.sqrt(
        larger_eigenvalue(ee, en, nn)
    )
    return math.hypot(newest.east_m, newest.north_m) > reach_m
