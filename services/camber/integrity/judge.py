"""The judge: from fix, pose with road, and antenna height to one verdict per fix (H, parts 140 and 150).

Pure: messages and times go in, a judgement comes out. The order of the tests is that of the table in
`docs/services/integrity.md`; every way out names its reason.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from camber.geodesy.offsets import east_north_between
from camber.integrity.fix_order import FixOrder
from camber.integrity.height_check import RoadPoint, determine, road_at
from camber.integrity.judgement import Judgement
from camber.integrity.learning import Correction, learn
from camber.integrity.pose_gate import distance2, offset_from_pose, pose_sigma_m
from camber.integrity.position import is_provisional
from camber.integrity.rules import Rules
from camber.integrity.situation import Situation, age_s, unusable_fix
from camber.integrity.start import StartCount, StartFix
from camber.integrity.time_series import Link, continues, next_link
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Evidence, Reason
from camber.schemas.pose import Pose

_POSES = 64  # a second or more at any rate of the pose
_NEAR_S = 0.5  # the pose by which a displacement is told is at most so far from the fix


class Judge:
    """Holds what was heard last and the little it remembers: the correction, the chain of right fixes, the start."""

    def __init__(self, rules: Rules, correction: Correction | None = None) -> None:
        self.rules = rules
        self.correction = correction if correction is not None else Correction()
        self._poses: deque[Pose] = deque(maxlen=_POSES)
        self._antenna: AntennaHeight | None = None
        self._speed: tuple[int, float] | None = None
        self._fixes = FixOrder()
        self._chain: Link | None = None
        self._start = StartCount()

    @property
    def last_fix_ns(self) -> int | None:
        """Time of the last solution heard, of whatever quality."""
        return self._fixes.last_ns

    @property
    def pose(self) -> Pose | None:
        """The newest pose."""
        return self._poses[-1] if self._poses else None

    def hear_pose(self, pose: Pose) -> None:
        """A new pose; one that is older than the last is of no use."""
        if not self._poses or pose.time_ns > self._poses[-1].time_ns:
            self._poses.append(pose)

    def hear_antenna(self, antenna: AntennaHeight) -> None:
        """A new antenna height."""
        self._antenna = antenna

    def hear_speed(self, time_ns: int, speed_m_s: float | None) -> None:
        """A new wheel speed; None does not overwrite a known one, its age does."""
        if speed_m_s is not None:
            self._speed = (time_ns, speed_m_s)

    def forget_future(self, now_ns: int) -> None:
        """Drop what is dated ahead: from a clock that is wrong, or from before ours was set back.

        Kept, it would stay the newest for as long as the clock was off, and all that is true would count as old.
        """
        limit_ns = now_ns + round(self.rules.future_limit_s * 1e9)
        while self._poses and self._poses[-1].time_ns > limit_ns:
            self._poses.pop()
        if self._antenna is not None and self._antenna.time_ns > limit_ns:
            self._antenna = None
        if self._chain is not None and self._chain.time_ns > limit_ns:
            self._chain = None
        self._fixes.forget_after(limit_ns)

    def situation(self, at_ns: int, alive: frozenset[str]) -> Situation:
        """What is known for a judgement at this time: the pose nearest to it."""
        pose = min(self._poses, key=lambda p: abs(p.time_ns - at_ns), default=None)
        return Situation(pose, self._antenna, alive)

    def judge(self, fix: Fix, now_ns: int, alive: frozenset[str]) -> Judgement | None:
        """The one verdict on a fix, None where it has had it; what is learnt from it is learnt here."""
        if self._fixes.has_verdict(fix):
            return None
        reason = self._fixes.misplaced(fix, now_ns, self.rules) or unusable_fix(fix, self.rules)
        if reason is not None:
            return Judgement(fix, "unknown", reason)
        situation = self.situation(fix.time_ns, alive)
        draft = Judgement(
            fix,
            "unknown",
            "none",
            correction_m=self.correction.correction_m,
            pose=situation.pose,
            antenna=situation.antenna,
        )
        reason = situation.missing(fix.time_ns, self.rules)
        if reason is not None:
            self._start = StartCount()
            return replace(draft, reason=reason)
        return self._locate(draft)

    def _locate(self, draft: Judgement) -> Judgement:
        """Can the fix be where the pose is, and is there a road below it?"""
        fix, pose = draft.fix, draft.pose
        assert pose is not None
        assert pose.covariance_east_north_yaw is not None
        assert fix.covariance_enu_m2 is not None
        if pose.road.datum != fix.datum:
            return replace(draft, reason="datum_mismatch", detail=f"fix {fix.datum}, map {pose.road.datum}")
        east_m, north_m = offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, fix.time_ns)
        distance = distance2(
            east_m,
            north_m,
            pose.covariance_east_north_yaw,
            fix.covariance_enu_m2,
            self.rules.pose_sigma_floor_m,
        )
        if not distance <= self.rules.gate:
            self._start = StartCount()
            detail = f"{math.hypot(east_m, north_m):.2f} m from the pose of σ {pose_sigma_m(pose):.2f} m"
            return replace(draft, reason="position_disagrees", detail=detail)
        # The road's planes are told from where the pose was when it was made.
        road = road_at(pose.road, *offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, pose.time_ns))
        if road is None:
            return replace(draft, reason="pose_too_uncertain", detail="the fix is beyond the surface's plane")
        return self._determine(replace(draft, road=road), road)

    def _determine(self, draft: Judgement, road: RoadPoint) -> Judgement:
        """The height check, where the height is known well enough to check anything by it."""
        fix, antenna, tolerance_m = draft.fix, draft.antenna, self.rules.tolerance_m
        assert antenna is not None
        assert antenna.height_m is not None
        assert antenna.sigma_m is not None
        assert fix.covariance_enu_m2 is not None
        model_sigma_m = math.hypot(road.sigma_m, antenna.sigma_m)
        if not model_sigma_m <= tolerance_m:
            worse: Reason = (
                "road_unknown" if not road.sigma_m <= antenna.sigma_m else "antenna_height_missing"
            )
            detail = f"σ {model_sigma_m:.2f} m of road and antenna, expected at most the tolerance, {tolerance_m} m"
            return replace(draft, reason=worse, detail=detail)
        outcome = determine(
            road,
            antenna.height_m,
            antenna.sigma_m,
            self.correction.correction_m,
            fix.height_m,
            math.sqrt(fix.covariance_enu_m2[5]),
            tolerance_m,
        )
        if not math.isfinite(outcome.difference_m):
            return replace(draft, reason="road_unknown", detail="the height difference is not a number")
        return self._conclude(replace(draft, determination=outcome), road)

    def _conclude(self, draft: Judgement, road: RoadPoint) -> Judgement:
        """Start rule, verification, learning."""
        assert draft.pose is not None
        assert draft.determination is not None
        agrees, starting = draft.determination.agrees, is_provisional(draft.pose)
        self._start = self._start_after(draft.fix) if starting and agrees else StartCount()
        if starting and agrees and not self._start.enough(self.rules.start):
            detail = f"{self._start.fixes} in a row agree, {self.rules.start.fixes} are needed"
            return replace(draft, reason="starting", detail=detail)
        if agrees:
            evidence: tuple[Evidence, ...] = ("height", "track") if starting else ("height",)
            return self._right(
                replace(draft, word="confirmed", reason="height_agrees", evidence=evidence), road
            )
        wrong = replace(draft, word="erroneous", reason="height_disagrees")
        if starting or not self._continues(draft.fix):
            return wrong
        return self._right(
            replace(wrong, word="confirmed_after_verification", evidence=("time_series",)), road
        )

    def _start_after(self, fix: Fix) -> StartCount:
        speed_m_s = self._speed_at(fix.time_ns)
        start = StartFix(fix.time_ns, fix.latitude_rad, fix.longitude_rad, fix.height_m, speed_m_s)
        return self._start.after(start, self.rules.start)

    def _continues(self, fix: Fix) -> bool:
        last = self._chain
        if last is None:
            return False
        before, now = self._pose_near(last.time_ns), self._pose_near(fix.time_ns)
        if before is None or now is None:
            return False
        moved = east_north_between(
            last.latitude_rad, last.longitude_rad, fix.latitude_rad, fix.longitude_rad, fix.height_m
        )
        east_before, north_before = offset_from_pose(
            last.latitude_rad, last.longitude_rad, before, last.time_ns
        )
        east_now, north_now = offset_from_pose(fix.latitude_rad, fix.longitude_rad, now, fix.time_ns)
        return continues(
            last,
            self.rules.series,
            time_ns=fix.time_ns,
            moved_east_m=moved[0],
            moved_north_m=moved[1],
            # What the vehicle moved is what the fix moved, less what the fix moved against the pose.
            vehicle_east_m=moved[0] - (east_now - east_before),
            vehicle_north_m=moved[1] - (north_now - north_before),
            height_m=fix.height_m,
        )

    def _pose_near(self, time_ns: int) -> Pose | None:
        pose = min(self._poses, key=lambda p: abs(p.time_ns - time_ns), default=None)
        if pose is None or pose.latitude_rad is None or not abs(age_s(pose.time_ns, time_ns)) <= _NEAR_S:
            return None
        return pose

    def _right(self, judgement: Judgement, road: RoadPoint) -> Judgement:
        """Remember a position found right: as head of the chain, and for the correction."""
        fix, antenna = judgement.fix, judgement.antenna
        assert antenna is not None
        assert antenna.height_m is not None
        link = Link(
            fix.time_ns,
            fix.latitude_rad,
            fix.longitude_rad,
            fix.height_m,
            road.slope_east,
            road.slope_north,
        )
        self._chain = next_link(link, self._chain, verified=judgement.word != "confirmed")
        self.correction = learn(
            self.correction,
            self.rules.learning,
            receiver_m=fix.height_m,
            antenna_m=antenna.height_m,
            road_m=road.elevation_m,
            speed_m_s=self._speed_at(fix.time_ns),
        )
        return judgement

    def _speed_at(self, time_ns: int) -> float | None:
        if self._speed is None or not abs(age_s(self._speed[0], time_ns)) <= self.rules.motion_max_age_s:
            return None
        return self._speed[1]
