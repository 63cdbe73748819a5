"""What the judge knows at one time, and what of it is missing.

Each check returns the reason why a verdict cannot be given, or None. They are asked in this order; the first that
answers is the reason published, so the reason nearest to the cause comes first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from camber.integrity.checks.pose_gate import can_move_on, claimed_sigma_m, pose_sigma_m
from camber.integrity.rules import SAME_EPOCH_S, Rules
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Reason
from camber.schemas.pose import Pose

_ROAD_REASONS: dict[str, Reason] = {
    "no_pose": "pose_missing",
    "pose_too_uncertain": "pose_too_uncertain",
    "levels_ambiguous": "levels_ambiguous",
    "map_server_absent": "map_server_absent",
    "datum_mismatch": "datum_mismatch",
}


def age_s(time_ns: int, now_ns: int) -> float:
    """Seconds since `time_ns`; negative for what is dated ahead."""
    return (now_ns - time_ns) / 1e9


@dataclass(frozen=True, slots=True)
class EpochInputs:
    """The inputs nearest to the time of a judgement, and which services are on the bus."""

    pose: Pose | None
    antenna: AntennaHeight | None
    alive: frozenset[str]

    def missing_pose(self, at_ns: int, rules: Rules) -> Reason | None:
        """No pose, one of another time, one of no use?"""
        pose = self.pose
        if pose is None or not abs(age_s(pose.time_ns, at_ns)) <= rules.pose_max_age_s:
            if "localizer" not in self.alive:
                return "localizer_absent"
            return "pose_missing" if pose is None else "pose_stale"
        if pose.mode == "none" or pose.provenance == "none":
            return "pose_missing"
        if pose.latitude_rad is None or pose.longitude_rad is None or pose.covariance_east_north_yaw is None:
            return "pose_missing"
        if not abs(age_s(pose.time_ns, at_ns)) <= SAME_EPOCH_S and not can_move_on(pose):
            return "pose_stale"
        return None if pose_sigma_m(pose) <= rules.pose_sigma_limit_m else "pose_too_uncertain"

    def missing_antenna(self, at_ns: int, rules: Rules) -> Reason | None:
        """No antenna height, one of another time, or ways that contradict one another?"""
        antenna = self.antenna
        if antenna is None or not abs(age_s(antenna.time_ns, at_ns)) <= rules.antenna_max_age_s:
            if "antenna_height" not in self.alive:
                return "antenna_height_absent"
            return "antenna_height_missing" if antenna is None else "antenna_height_stale"
        if antenna.status == "disagreement":
            return "antenna_height_disagrees"
        if antenna.status != "known" or antenna.height_m is None or antenna.sigma_m is None:
            return "antenna_height_missing"
        return None

    def missing_road(self) -> Reason | None:
        """No road under the pose, or one that does not say in which datum its heights are?"""
        if self.pose is None:
            return "pose_missing"
        road = self.pose.road
        if road.status != "known":
            return _ROAD_REASONS.get(road.reason, "road_unknown")
        if road.elevation_m is None or road.sigma_m is None:
            return "road_unknown"
        return "datum_mismatch" if road.datum is None else None

    def missing(self, at_ns: int, rules: Rules) -> Reason | None:
        """The first thing missing for a verdict on a fix at this time; road and antenna where the height is asked."""
        reason = self.missing_pose(at_ns, rules)
        if reason is not None or not rules.determination.asks_height:
            return reason
        return self.missing_antenna(at_ns, rules) or self.missing_road()


def unusable_fix(fix: Fix, rules: Rules) -> Reason | None:
    """Why a solution is no fix that could be confirmed, whatever the road says.

    Resolved integers make centimetres: one that claims less by its own account is none.
    """
    if fix.quality != "fixed":
        return "not_a_fix"
    place_is_known = all(map(math.isfinite, (fix.latitude_rad, fix.longitude_rad, fix.height_m)))
    if fix.covariance_enu_m2 is None or not place_is_known:
        return "fix_implausible"
    return None if claimed_sigma_m(fix.covariance_enu_m2) <= rules.fix_sigma_limit_m else "fix_implausible"
