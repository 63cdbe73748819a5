"""What the fixes judged so far leave behind for those to come: the chain of right ones, their integers, the start."""

from __future__ import annotations

import math

from camber.geodesy.horizontal_offsets import east_north_between
from camber.integrity.checks.captured_pose import CapturedPose, FixRun
from camber.integrity.checks.height_model import RoadPoint
from camber.integrity.checks.pose_offset import claimed_sigma_m, offset_from_pose
from camber.integrity.checks.start_rule import StartCount, StartFix
from camber.integrity.checks.time_series import ChainedFix, continues_chain, next_in_chain
from camber.integrity.checks.verification import AmbiguityHistory
from camber.integrity.judgement import FixJudgement
from camber.integrity.pose_provenance import is_provisional
from camber.integrity.protection.covariance_inflation import inflate_covariance
from camber.integrity.protection.latent_fault import is_same_draw
from camber.integrity.rules import Rules
from camber.schemas.gnss import Fix
from camber.schemas.pose import Pose


class FixHistory:
    """Changed by `settle` alone; all else only asks."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.integers = AmbiguityHistory()
        self.chain: ChainedFix | None = None
        self.captured = CapturedPose()
        self._start = StartCount()
        self._last_ns: int | None = None

    def settle(self, judgement: FixJudgement, speed_m_s: float | None) -> None:
        """Remember what follows from a judgement that is final; `speed_m_s` of the wheels then, None: not known."""
        fix, confirmed = judgement.fix, judgement.verdict == "confirmed"
        # The engine compares integers with those of its own fix, not with another estimate's.
        self.integers = self.integers.after(
            fix,
            confirmed=confirmed and judgement.trials == 1,
            contradicted=judgement.reason == "continuity_disagrees",
        )
        starting = judgement.pose is not None and is_provisional(judgement.pose)
        in_a_row = starting and (confirmed or judgement.reason == "starting")
        self._start = self.start_after(fix, speed_m_s) if in_a_row else StartCount()
        if judgement.confirmed and judgement.road is not None and is_precise(fix, self._rules):
            self.chain = self._chain_after(judgement, judgement.road)
        self.captured = self._captured_after(judgement)
        self._last_ns = fix.time_ns

    def forget_after(self, limit_ns: int) -> None:
        """Drop what is dated later than this."""
        if self.chain is not None and self.chain.time_ns > limit_ns:
            self.chain = None
        if self._last_ns is not None and self._last_ns > limit_ns:
            self._last_ns = None
        if self.integers.last_ns > limit_ns:
            self.integers = AmbiguityHistory()
        runs = self.captured.support, self.captured.rival
        if any(run is not None and run.last_ns > limit_ns for run in runs):
            self.captured = CapturedPose()

    def start_after(self, fix: Fix, speed_m_s: float | None) -> StartCount:
        """Agreeing fixes in a row, if this is one more."""
        start = StartFix(
            time_ns=fix.time_ns,
            latitude_rad=fix.latitude_rad,
            longitude_rad=fix.longitude_rad,
            speed_m_s=speed_m_s,
        )
        return self._start.after(start, self._rules.start)

    def is_consistent_with_previous(self, fix: Fix, pose_then: Pose | None, pose_now: Pose | None) -> bool:
        """Has the fix moved since the last right one as the vehicle has? The poses are those of both times."""
        last = self.chain
        if last is None or pose_then is None or pose_now is None:
            return False
        east_m, north_m = east_north_between(
            last.latitude_rad, last.longitude_rad, fix.latitude_rad, fix.longitude_rad
        )
        east_then, north_then = offset_from_pose(
            last.latitude_rad, last.longitude_rad, pose_then, last.time_ns
        )
        east_now, north_now = offset_from_pose(fix.latitude_rad, fix.longitude_rad, pose_now, fix.time_ns)
        return continues_chain(
            last,
            self._rules.series,
            time_ns=fix.time_ns,
            moved_east_m=east_m,
            moved_north_m=north_m,
            # It has moved otherwise than the vehicle by as much as it has moved against the pose.
            drift_m=math.hypot(east_now - east_then, north_now - north_then),
            height_m=fix.height_m,
        )

    def run_of(self, fix: Fix, offset_m: tuple[float, float]) -> FixRun:
        """A fix as a run of one, `offset_m` from the pose east and north."""
        share = self._rules.levels.wrong_fix.prior_of(fix.satellites)
        return FixRun(
            first_ns=fix.time_ns,
            last_ns=fix.time_ns,
            odds=share / (1.0 - share),
            offset_m=offset_m,
            carried=is_same_draw(fix, self._last_ns),
        )

    def rival_odds(self, rival: FixRun) -> float:
        """That a run of fixes is right and the pose that it contradicts captured."""
        wrong = self._rules.levels.wrong_fix
        return self.captured.odds_of(rival, prior=wrong.prior, episode_s=wrong.episode_s)

    def _captured_after(self, judgement: FixJudgement) -> CapturedPose:
        """The hypothesis of a captured pose after a judgement; what is against a fix by itself changes nothing."""
        rules, wrong, result = self._rules.capture, self._rules.levels.wrong_fix, judgement.comparison
        if result is None:
            return self.captured
        if "position" in judgement.evidence:
            return CapturedPose()
        run = self.run_of(judgement.fix, result.position_m)
        if judgement.reason == "position_disagrees" and judgement.verdict != "erroneous":
            return self.captured.contradicted(run, rules, won=judgement.confirmed)
        if not judgement.confirmed:
            return self.captured.rejects(run, rules)
        opens = judgement.verdict == "confirmed" and "consistency" not in judgement.evidence
        after = self.captured.agreed(run, rules, opens=opens)
        return after.settled(rules, prior=wrong.prior, episode_s=wrong.episode_s)

    def _chain_after(self, judgement: FixJudgement, road: RoadPoint) -> ChainedFix:
        """The chain with a position found right as its head."""
        fix = judgement.fix
        link = ChainedFix(
            time_ns=fix.time_ns,
            latitude_rad=fix.latitude_rad,
            longitude_rad=fix.longitude_rad,
            height_m=fix.height_m,
            slope_east=road.slope_east,
            slope_north=road.slope_north,
        )
        return next_in_chain(link, self.chain, verified=judgement.verdict != "confirmed")


def is_precise(fix: Fix, rules: Rules) -> bool:
    """Is the fix so precise, by its own account, that where it stands and how it moves says something?"""
    assert fix.covariance_enu_m2 is not None
    return claimed_sigma_m(inflate_covariance(fix.covariance_enu_m2, rules.true_sigma)) <= (
        rules.verification.fix_sigma_m
    )
