"""What the judge knows at one time, and what of it is missing.

Each check returns the reason why a verdict cannot be given, or None. They are asked in this order; the first that
answers is the reason published, so the reason nearest to the cause comes first.
"""

from __future__ import annotations

from dataclasses import dataclass

from camber.integrity.rules import Rules
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
    """Seconds since `time_ns`."""
    return (now_ns - time_ns) / 1e9


@dataclass(frozen=True, slots=True)
class Situation:
    """The newest of each input at the time of a judgement, and which services are on the bus."""

    pose: Pose | None
    antenna: AntennaHeight | None
    alive: frozenset[str]

    def missing_pose(self, at_ns: int, rules: Rules) -> Reason | None:
        """No pose, an old one, one of no use?"""
        if self.pose is None or abs(age_s(self.pose.time_ns, at_ns)) > rules.pose_max_age_s:
            if "localizer" not in self.alive:
                return "localizer_absent"
            return "pose_missing" if self.pose is None else "pose_stale"
        if self.pose.mode == "none" or self.pose.covariance_east_north_yaw is None:
            return "pose_missing"
        return None

    def missing_road(self, rules: Rules) -> Reason | None:
        """No road under the pose?"""
        assert self.pose is not None
        road = self.pose.road
        return None if road.status == "known" else _ROAD_REASONS.get(road.reason, "road_unknown")

    def missing_antenna(self, at_ns: int, rules: Rules) -> Reason | None:
        """No antenna height, an old one, or ways that contradict one another?"""
        antenna = self.antenna
        if antenna is None or age_s(antenna.time_ns, at_ns) > rules.antenna_max_age_s:
            if "antenna_height" not in self.alive:
                return "antenna_height_absent"
            return "antenna_height_missing" if antenna is None else "antenna_height_stale"
        if antenna.status == "disagreement":
            return "antenna_height_disagrees"
        if antenna.status != "known" or antenna.height_m is None or antenna.sigma_m is None:
            return "antenna_height_missing"
        return None

    def missing(self, at_ns: int, rules: Rules) -> Reason | None:
        """The first thing missing for a verdict on a fix at this time."""
        return (
            self.missing_pose(at_ns, rules)
            or self.missing_antenna(at_ns, rules)
            or self.missing_road(rules)
        )


def unusable_fix(fix: Fix, last: Fix | None, now_ns: int, rules: Rules) -> Reason | None:
    """Why a fix is not judged at all."""
    if fix.quality != "fixed":
        return "not_a_fix"
    if fix.covariance_enu_m2 is None:
        return "fix_implausible"
    if last is not None and fix.time_ns <= last.time_ns:
        return "fix_repeated" if fix.time_ns == last.time_ns else "fix_out_of_order"
    if abs(age_s(fix.time_ns, now_ns)) > rules.fix_max_age_s:
        return "fix_implausible" if fix.time_ns > now_ns else "gnss_stale"
    return None
