"""The judge: from fix, pose with road, and antenna height to one verdict per fix (H, parts 140 and 150).

Pure: messages and times go in, a judgement comes out. The order of the tests is that of the page
`docs/services/integrity.md`; every way out names its reason.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from camber.geodesy.covariance import eigenvalues_m2
from camber.geodesy.offsets import east_north_between
from camber.integrity.height_check import Determination, RoadPoint, determine, road_at
from camber.integrity.learning import Correction, learn
from camber.integrity.rules import Rules
from camber.integrity.situation import Situation, age_s, unusable_fix
from camber.integrity.start import StartCount
from camber.integrity.time_series import Link, continues, next_link
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Fix
from camber.schemas.integrity import Evidence, Reason, VerdictWord
from camber.schemas.pose import Pose

_CONFIRMED = ("confirmed", "confirmed_after_verification")


@dataclass(frozen=True, slots=True)
class Judgement:
    """One verdict with all it rests on; `road` and `antenna_m` are given wherever they were known."""

    fix: Fix
    word: VerdictWord
    reason: Reason
    detail: str = ""
    evidence: tuple[Evidence, ...] = ()
    determination: Determination | None = None
    correction_m: float = 0.0
    road: RoadPoint | None = None
    pose: Pose | None = None
    antenna: AntennaHeight | None = None

    @property
    def confirmed(self) -> bool:
        """May a consumer use the position?"""
        return self.word in _CONFIRMED


class Judge:
    """Holds what was heard last and the little it remembers: the correction, the chain of right fixes, the start."""

    def __init__(self, rules: Rules, correction: Correction = Correction()) -> None:  # noqa: B008 (frozen)
        self.rules = rules
        self.correction = correction
        self._poses: deque[Pose] = deque(maxlen=64)
        self._antenna: AntennaHeight | None = None
        self._speed: tuple[int, float] | None = None
        self._last_fix: Fix | None = None
        self._chain: Link | None = None
        self._start = StartCount()

    @property
    def last_fix_ns(self) -> int | None:
        """Time of the last solution heard, of whatever quality."""
        return None if self._last_fix is None else self._last_fix.time_ns

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

    def situation(self, at_ns: int, alive: frozenset[str]) -> Situation:
        """What is known for a judgement at this time: the pose nearest to it."""
        pose = min(self._poses, key=lambda p: abs(p.time_ns - at_ns), default=None)
        return Situation(pose, self._antenna, alive)

    def judge(self, fix: Fix, now_ns: int, alive: frozenset[str]) -> Judgement:
        """The one verdict on a fix; what is learnt from it is learnt here."""
        reason = unusable_fix(fix, self._last_fix, now_ns, self.rules)
        if self._last_fix is None or fix.time_ns > self._last_fix.time_ns:
            self._last_fix = fix
        if reason is not None:
            return Judgement(fix, "unknown", reason)
        situation = self.situation(fix.time_ns, alive)
        reason = situation.missing(fix.time_ns, self.rules)
        if reason is not None:
            return Judgement(fix, "unknown", reason, pose=situation.pose, antenna=situation.antenna)
        return self._determine(fix, situation)

    def _determine(self, fix: Fix, situation: Situation) -> Judgement:
        pose, antenna = situation.pose, situation.antenna
        assert pose is not None and antenna is not None and fix.covariance_enu_m2 is not None
        assert antenna.height_m is not None and antenna.sigma_m is not None
        draft = Judgement(
            fix, "unknown", "none", pose=pose, antenna=antenna, correction_m=self.correction.correction_m
        )
        if pose.road.datum is not None and pose.road.datum != fix.datum:
            return replace(draft, reason="datum_mismatch", detail=f"fix {fix.datum}, map {pose.road.datum}")
        east_m, north_m = _offset_from_pose(fix, pose, fix.time_ns)
        distance2, pose_sigma_m = _mahalanobis2(east_m, north_m, pose, fix, self.rules.pose_sigma_floor_m)
        if pose_sigma_m > self.rules.pose_sigma_limit_m:
            return replace(draft, reason="pose_too_uncertain", detail=f"σ {pose_sigma_m:.1f} m")
        if not distance2 <= self.rules.gate:
            self._start = StartCount()
            detail = f"{math.hypot(east_m, north_m):.2f} m from the pose of σ {pose_sigma_m:.2f} m"
            return replace(draft, reason="position_disagrees", detail=detail)
        road = road_at(pose.road, *_offset_from_pose(fix, pose, pose.time_ns))
        if road is None:
            return replace(draft, reason="pose_too_uncertain", detail="the fix is beyond the surface's plane")
        outcome = determine(
            road,
            antenna.height_m,
            antenna.sigma_m,
            self.correction.correction_m,
            fix.height_m,
            math.sqrt(fix.covariance_enu_m2[5]),
            self.rules.tolerance_m,
        )
        return self._conclude(replace(draft, determination=outcome, road=road), outcome.agrees)

    def _conclude(self, draft: Judgement, agrees: bool) -> Judgement:
        """Start rule, verification, learning."""
        assert draft.pose is not None
        starting = draft.pose.provenance == "fixes"
        if starting:
            self._start = self._start.after(draft.fix.time_ns, agrees=agrees, rules=self.rules.start)
            if agrees and not self._start.enough(self.rules.start):
                detail = f"{self._start.fixes} agree in a row; {self.rules.start.fixes} are needed"
                return replace(draft, reason="starting", detail=detail)
        if agrees:
            evidence: tuple[Evidence, ...] = ("height", "track") if starting else ("height",)
            return self._right(replace(draft, word="confirmed", reason="height_agrees", evidence=evidence))
        if not starting and self._continues(draft.fix):
            return self._right(
                replace(
                    draft,
                    word="confirmed_after_verification",
                    reason="height_disagrees",
                    evidence=("time_series",),
                )
            )
        return replace(draft, word="erroneous", reason="height_disagrees")

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
        east_before, north_before = _offset_of(last.latitude_rad, last.longitude_rad, before, last.time_ns)
        east_now, north_now = _offset_from_pose(fix, now, fix.time_ns)
        # What the vehicle moved is what the fix moved, less what the fix moved against the pose.
        vehicle = (moved[0] - (east_now - east_before), moved[1] - (north_now - north_before))
        return continues(
            last,
            self.rules.series,
            time_ns=fix.time_ns,
            moved_east_m=moved[0],
            moved_north_m=moved[1],
            vehicle_east_m=vehicle[0],
            vehicle_north_m=vehicle[1],
            height_m=fix.height_m,
        )

    def _pose_near(self, time_ns: int) -> Pose | None:
        pose = min(self._poses, key=lambda p: abs(p.time_ns - time_ns), default=None)
        if pose is None or pose.latitude_rad is None or abs(age_s(pose.time_ns, time_ns)) > 0.5:
            return None
        return pose

    def _right(self, judgement: Judgement) -> Judgement:
        """Remember a position found right: as head of the chain, and for the correction."""
        fix, pose, antenna, road = judgement.fix, judgement.pose, judgement.antenna, judgement.road
        assert pose is not None and antenna is not None and road is not None
        assert antenna.height_m is not None
        link = Link(
            fix.time_ns,
            fix.latitude_rad,
            fix.longitude_rad,
            fix.height_m,
            pose.road.slope_east or 0.0,
            pose.road.slope_north or 0.0,
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
        if self._speed is None or abs(age_s(self._speed[0], time_ns)) > self.rules.motion_max_age_s:
            return None
        return self._speed[1]


def _offset_from_pose(fix: Fix, pose: Pose, at_ns: int) -> tuple[float, float]:
    return _offset_of(fix.latitude_rad, fix.longitude_rad, pose, at_ns)


def _offset_of(latitude_rad: float, longitude_rad: float, pose: Pose, at_ns: int) -> tuple[float, float]:
    """East and north metres from the pose's antenna, moved on to `at_ns` with its velocity, to a point."""
    assert pose.latitude_rad is not None and pose.longitude_rad is not None
    east_m, north_m = east_north_between(pose.latitude_rad, pose.longitude_rad, latitude_rad, longitude_rad)
    travelled_m = (pose.speed_m_s or 0.0) * age_s(pose.time_ns, at_ns)
    if travelled_m and pose.yaw_rad is not None:
        east_m -= travelled_m * math.cos(pose.yaw_rad)
        north_m -= travelled_m * math.sin(pose.yaw_rad)
    return east_m, north_m


def _mahalanobis2(
    east_m: float, north_m: float, pose: Pose, fix: Fix, floor_m: float
) -> tuple[float, float]:
    """Squared distance of the fix from the pose in units of both covariances, and the pose's largest σ (m)."""
    assert pose.covariance_east_north_yaw is not None and fix.covariance_enu_m2 is not None
    pee, pen, _, pnn, _, _ = pose.covariance_east_north_yaw
    fee, fen, _, fnn, _, _ = fix.covariance_enu_m2
    ee, en, nn = pee + fee + floor_m**2, pen + fen, pnn + fnn + floor_m**2
    determinant = ee * nn - en * en
    if not determinant > 0.0:
        return math.inf, math.inf
    distance2 = (nn * east_m**2 - 2.0 * en * east_m * north_m + ee * north_m**2) / determinant
    return distance2, math.sqrt(max(eigenvalues_m2((pee, pen, pnn))))
