"""The judge: from fix, pose with road, and antenna height to one verdict per fix (H, parts 140 and 150).

Pure: messages and times go in, a judgement comes out. The order of the tests is that of the table in
`docs/services/integrity.md`; every way out names its reason.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from camber.geodesy.offsets import east_north_between
from camber.integrity.comparison import Comparison, compare
from camber.integrity.determination import (
    ALL_AGREE,
    HEIGHT_CONTRADICTS,
    POSITION_CONTRADICTS,
    POSITION_UNVERIFIED,
    REASONS,
)
from camber.integrity.fix_order import FixOrder
from camber.integrity.height_check import Height, RoadPoint, road_at
from camber.integrity.joint_test import AGREES, CONTRADICTS
from camber.integrity.judgement import Judgement
from camber.integrity.learning import Correction, Learning
from camber.integrity.pose_gate import claimed_sigma_m, offset_from_pose, pose_sigma_m
from camber.integrity.position import is_provisional
from camber.integrity.re_estimation import limits_after
from camber.integrity.receiver_word import ReceiverWord
from camber.integrity.residuals import Key, Residual
from camber.integrity.rules import Rules
from camber.integrity.situation import Situation, age_s, unusable_fix
from camber.integrity.start import StartCount, StartFix
from camber.integrity.time_series import Link, continues, next_link
from camber.integrity.true_sigma import with_true_sigma
from camber.integrity.verification import Integers, phase_residuals_agree, scan_matching_agrees, verified
from camber.schemas.antenna import AntennaHeight
from camber.schemas.gnss import Fix, ReceiverIntegrity
from camber.schemas.integrity import Evidence, Reason, VerdictWord
from camber.schemas.pose import Pose

_POSES = 64  # a second or more at any rate of the pose
_FREE_OF_FIXES = ("scan_match", "given")
_NEAR_S = 0.5  # the pose by which a displacement is told is at most so far from the fix


class Judge:
    """Holds what was heard last and the little it remembers: what was learnt, the chain of right fixes, their integers,
    the start."""

    def __init__(self, rules: Rules, learning: Learning | None = None) -> None:
        self.rules = rules
        self.learning = learning if learning is not None else Learning(rules.learning)
        self._base = ""  # of the newest fix
        self._receiver = ReceiverWord()
        self._integers = Integers()
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

    def hear_receiver(self, statement: ReceiverIntegrity) -> None:
        """What the receiver says of its own integrity."""
        self._receiver.hear(statement)

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
        if self._integers.last_ns > limit_ns:
            self._integers = Integers()
        self._receiver.forget_after(limit_ns)
        self._fixes.forget_after(limit_ns)

    def situation(self, at_ns: int, alive: frozenset[str]) -> Situation:
        """What is known for a judgement at this time: the pose nearest to it."""
        return Situation(self._nearest_pose(at_ns), self._antenna, alive)

    def correction(self, situation: Situation) -> Correction:
        """The correction in force, for a height that needs no fix."""
        return self.learning.correction(key_of(self._base, situation.pose, situation.antenna))

    def judge(
        self,
        fix: Fix,
        now_ns: int,
        alive: frozenset[str],
        others: Callable[[Judgement], Judgement] = lambda judgement: judgement,
    ) -> Judgement | None:
        """The one verdict on a fix, None where it has had it; what is learnt from it is learnt here.

        `others` may put the judgement of another estimate in place of the first one.
        """
        if self._fixes.has_verdict(fix):
            return None
        reason = self._fixes.misplaced(fix, now_ns, self.rules) or unusable_fix(fix, self.rules)
        if reason is not None:
            found = others(Judgement(fix, "unknown", reason))
            return self.settle(found) if found.confirmed else found
        return self.settle(others(self.examine(fix, alive)))

    def examine(self, fix: Fix, alive: frozenset[str], trials: int = 1) -> Judgement:
        """What is to be said of a usable fix, the last of so many estimates. Nothing is remembered until `settle`."""
        situation = self.situation(fix.time_ns, alive)
        key = key_of(base_of(fix), situation.pose, situation.antenna)
        draft = Judgement(
            fix,
            "unknown",
            "none",
            correction_m=self.learning.correction(key).correction_m,
            pose=situation.pose,
            antenna=situation.antenna,
            cause=self.learning.diagnosis(None).cause,
            trials=trials,
        )
        against = self._against_itself(draft)
        if against is not None:
            return against
        reason = situation.missing(fix.time_ns, self.rules)
        return self._locate(draft) if reason is None else replace(draft, reason=reason)

    def settle(self, judgement: Judgement) -> Judgement:
        """Make a judgement the final one: remember what follows from it for the fixes to come."""
        fix, confirmed = judgement.fix, judgement.word == "confirmed"
        self._base = base_of(fix)
        # The engine compares integers with those of its own fix, not with another estimate's.
        self._integers = self._integers.after(
            fix,
            confirmed=confirmed and judgement.trials == 1,
            contradicted=judgement.reason == "continuity_disagrees",
        )
        starting = judgement.pose is not None and is_provisional(judgement.pose)
        in_a_row = starting and (confirmed or judgement.reason == "starting")
        self._start = self._start_after(fix) if in_a_row else StartCount()
        if judgement.confirmed and judgement.road is not None and self._is_sharp(fix):
            self._chain = self._chain_after(judgement, judgement.road)
        if judgement.comparison is not None:
            self.learning.hear(self._residual(judgement, judgement.comparison))
        return judgement

    def _against_itself(self, draft: Judgement) -> Judgement | None:
        """What is against a fix before anything else is asked: its phases, its receiver, the integers before it."""
        fix, tests = draft.fix, self.rules.determination.tests
        if "phase_residuals" in tests and fix.phase_residuals == "contradictory":
            return replace(draft, word="erroneous", reason="phase_residuals_contradict")
        warning = self._receiver.warning(fix.time_ns, self.rules.receiver_max_age_s)
        if "receiver" in tests and warning is not None:
            return replace(draft, reason="receiver_warns", detail=warning)
        if "continuity" in tests and self._integers.contradict(fix, self.rules.series.longest_gap_s):
            ago_s = age_s(self._integers.last_ns, fix.time_ns)
            detail = f"other integers than those confirmed {ago_s:.1f} s ago"
            return replace(draft, reason="continuity_disagrees", detail=detail)
        return None

    def _locate(self, draft: Judgement) -> Judgement:
        """Is there a road below the fix, known well enough to check anything by it?"""
        fix, pose, rules = draft.fix, draft.pose, self.rules.determination
        assert pose is not None
        if pose.road.datum is not None and pose.road.datum != fix.datum:
            return replace(draft, reason="datum_mismatch", detail=f"fix {fix.datum}, map {pose.road.datum}")
        if not rules.asks_height:
            return self._determine(draft, None)
        # The road's planes are told from where the pose was when it was made.
        road = road_at(pose.road, *offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose, pose.time_ns))
        if road is None:
            return self._off_the_road(draft)
        assert draft.antenna is not None
        assert draft.antenna.height_m is not None
        assert draft.antenna.sigma_m is not None
        correction = self.learning.correction(key_of(base_of(fix), pose, draft.antenna))
        height = Height(
            draft.antenna.height_m,
            correction.correction_m,
            math.hypot(draft.antenna.sigma_m, correction.sigma_m),
        )
        model_sigma_m = math.sqrt(height.variance_m2(road))
        if not model_sigma_m <= rules.largest_tolerance_m:
            worse: Reason = "road_unknown" if not road.sigma_m <= height.sigma_m else "antenna_height_missing"
            most = f"expected at most the largest tolerance, {rules.largest_tolerance_m} m"
            return replace(draft, reason=worse, detail=f"σ {model_sigma_m:.2f} m of road and antenna, {most}")
        if not math.isfinite(height.expected_m(road)):
            return replace(draft, reason="road_unknown", detail="the height is not a number")
        cause = self.learning.diagnosis(road.surface_id).cause
        return self._determine(replace(draft, road=road, cause=cause), height)

    def _off_the_road(self, draft: Judgement) -> Judgement:
        """The planes of the map do not reach the fix: because it is off the pose, or because the pose is."""
        assert draft.pose is not None
        limits = limits_after(self.rules.determination, draft.trials)
        found = compare(draft.fix, draft.pose, None, None, self.rules.true_sigma, limits)
        if "position" in self.rules.determination.tests and found.position == CONTRADICTS:
            return self._disagreed(replace(draft, comparison=found), found, POSITION_CONTRADICTS)
        detail = "the fix is beyond the surface's plane"
        return replace(draft, reason="pose_too_uncertain", detail=detail)

    def _determine(self, draft: Judgement, height: Height | None) -> Judgement:
        """Height and position, alone and together."""
        assert draft.pose is not None
        limits = limits_after(self.rules.determination, draft.trials)
        found = compare(draft.fix, draft.pose, draft.road, height, self.rules.true_sigma, limits)
        draft = replace(draft, comparison=found)
        if found.outcome == ALL_AGREE:
            return self._agreed(draft, found)
        return self._disagreed(draft, found, found.outcome)

    def _agreed(self, draft: Judgement, found: Comparison) -> Judgement:
        """Confirmed, where anything speaks for the fix and the start is over."""
        assert draft.pose is not None
        starting, rules = is_provisional(draft.pose), self.rules
        evidence = self._evidence(draft, found)
        if not evidence:
            detail = "nothing that is asked speaks for the fix"
            return replace(draft, reason="height_unverified", detail=detail)
        if starting:
            count = self._start_after(draft.fix)
            if not count.enough(rules.start):
                detail = f"{count.fixes} in a row agree, {rules.start.fixes} are needed"
                return replace(draft, reason="starting", detail=detail)
            evidence = (*evidence, "track")
        reason: Reason = "height_agrees" if rules.determination.asks_height else "none"
        return replace(draft, word="confirmed", reason=reason, evidence=evidence)

    def _evidence(self, draft: Judgement, found: Comparison) -> tuple[Evidence, ...]:
        """What speaks for a fix that nothing speaks against, and what could have spoken against it."""
        assert draft.pose is not None
        rules, evidence = self.rules.determination, list[Evidence]()
        if rules.asks_height:
            evidence.append("height")
        # A pose that stems from the fixes themselves, or is metres wide, agrees with everything.
        narrow = found.reach_m <= rules.position_cap_m
        if rules.asks_position and narrow and not is_provisional(draft.pose):
            evidence.append("position")
        if "phase_residuals" in rules.tests and draft.fix.phase_residuals == "consistent":
            evidence.append("phase_residuals")
        return tuple(evidence)

    def _disagreed(self, draft: Judgement, found: Comparison, outcome: int) -> Judgement:
        """Common to all fixes? Verified by something else? Else erroneous, or not known."""
        assert draft.pose is not None
        starting = is_provisional(draft.pose)
        reason, detail = REASONS[outcome], found.in_words(pose_sigma_m(draft.pose))
        if draft.cause == "base":
            return replace(draft, reason="common_offset", detail=f"{reason}: {detail}")
        # The place of a provisional pose is that of the fixes before: they contradict one another.
        wrong = outcome >= HEIGHT_CONTRADICTS and not (starting and outcome == POSITION_CONTRADICTS)
        # A fix that is not where the vehicle is says nothing of the road there.
        road = None if found.position == CONTRADICTS else draft.road
        word: VerdictWord = "erroneous" if wrong else "unknown"
        held = replace(draft, word=word, reason=reason, detail=detail, road=road)
        if starting or not self._is_sharp(draft.fix):
            return held
        witnesses = self._witnesses(draft)
        if found.position != AGREES:
            # With the height agreed, the pose is in doubt as much as the fix: what speaks owes nothing to the pose.
            doubtful = outcome == POSITION_UNVERIFIED
            witnesses = tuple(w for w in witnesses if doubtful and w == "ambiguity_continuity")
        if not verified(frozenset(witnesses), self.rules.verification):
            return held
        return replace(held, word="confirmed_after_verification", evidence=witnesses)

    def _is_sharp(self, fix: Fix) -> bool:
        """Is the fix so precise, by its own account, that where it stands and how it moved says something?"""
        assert fix.covariance_enu_m2 is not None
        sigma_m = claimed_sigma_m(with_true_sigma(fix.covariance_enu_m2, self.rules.true_sigma))
        return sigma_m <= self.rules.verification.fix_sigma_m

    def _witnesses(self, draft: Judgement) -> tuple[Evidence, ...]:
        """What speaks for the fix although height or position are against it."""
        fix, pose, rules = draft.fix, draft.pose, self.rules
        assert pose is not None
        spoken: dict[Evidence, bool] = {
            "time_series": self._continues(fix),
            "ambiguity_continuity": self._integers.carry(fix, rules.verification),
            "scan_matching": rules.determination.asks_position
            and scan_matching_agrees(
                pose,
                pose_sigma_m(pose),
                fix.time_ns,
                rules.pose_max_age_s,
                rules.verification.scan_sigma_m,
            ),
            "phase_residuals": phase_residuals_agree(fix, rules.verification),
        }
        return tuple(name for name, speaks in spoken.items() if speaks)

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
        pose = self._nearest_pose(time_ns)
        if pose is None or pose.latitude_rad is None or not abs(age_s(pose.time_ns, time_ns)) <= _NEAR_S:
            return None
        return pose

    def _nearest_pose(self, time_ns: int) -> Pose | None:
        """Of two as near the earlier; they are in the order of their times."""
        poses = self._poses
        if not poses or time_ns >= poses[-1].time_ns:
            return self.pose
        after = bisect_left(poses, time_ns, key=lambda pose: pose.time_ns)
        before = max(after - 1, 0)
        nearer = time_ns - poses[before].time_ns <= poses[after].time_ns - time_ns
        return poses[before if nearer else after]

    def _chain_after(self, judgement: Judgement, road: RoadPoint) -> Link:
        """The chain with a position found right as its head."""
        fix = judgement.fix
        link = Link(
            fix.time_ns,
            fix.latitude_rad,
            fix.longitude_rad,
            fix.height_m,
            road.slope_east,
            road.slope_north,
        )
        return next_link(link, self._chain, verified=judgement.word != "confirmed")

    def _residual(self, judgement: Judgement, found: Comparison) -> Residual:
        """What learning hears of a judged fix."""
        fix, pose, antenna, road = judgement.fix, judgement.pose, judgement.antenna, judgement.road
        residual = Residual(
            fix.time_ns,
            judgement.word,
            fix.latitude_rad,
            fix.longitude_rad,
            speed_m_s=self._speed_at(fix.time_ns),
            key=key_of(base_of(fix), pose, antenna),
        )
        if pose is not None and pose.provenance in _FREE_OF_FIXES:
            east_m, north_m = found.position_m
            residual = replace(
                residual, east_m=east_m, north_m=north_m, horizontal_sigma_m=found.position_sigma_m
            )
        if road is None or antenna is None or antenna.height_m is None:
            return residual
        return replace(
            residual,
            up_m=fix.height_m - road.elevation_m - antenna.height_m,
            fix_sigma_m=math.sqrt(max(found.height_sigma_m**2 - road.sigma_m**2, 0.0)),
            map_sigma_m=road.sigma_m,
            surface_id=road.surface_id,
        )

    def _speed_at(self, time_ns: int) -> float | None:
        if self._speed is None or not abs(age_s(self._speed[0], time_ns)) <= self.rules.motion_max_age_s:
            return None
        return self._speed[1]


def base_of(fix: Fix) -> str:
    """Whose fixes these are: those of another receiver, engine or frame may all be off by something else."""
    return f"{fix.origin}:{fix.datum}"


def key_of(base: str, pose: Pose | None, antenna: AntennaHeight | None) -> Key:
    """To what a lasting difference of height belongs."""
    way = antenna.way if antenna is not None and antenna.way is not None else ""
    version = pose.road.map_version if pose is not None else None
    return Key(way, base, version if version is not None else 0)
